// The Pico's timer: the bench calls what was added.
#pragma once

#include "../Arduino.h"
#include "../bench.h"

struct repeating_timer_t {
  bool (*callback)(repeating_timer_t *);
};
inline uint32_t time_us_32() { return static_cast<uint32_t>(bench::now_us); }
inline bool add_repeating_timer_us(int64_t delay_us, bool (*callback)(repeating_timer_t *), void *,
                                   repeating_timer_t *timer) {
  static repeating_timer_t *added;
  timer->callback = callback;
  added = timer;
  bench::sample = [](void *) { added->callback(added); };
  bench::period_us = static_cast<unsigned>(delay_us < 0 ? -delay_us : delay_us);
  return true;
}
