#pragma once

inline void gpio_init(unsigned) {}
inline void gpio_pull_up(unsigned) {}
