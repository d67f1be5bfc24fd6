// ESP32's timer: the bench calls what was started.
#pragma once

#include "Arduino.h"
#include "bench.h"

struct esp_timer_create_args_t {
  void (*callback)(void *);
  void *arg;
  const char *name;
};
typedef const esp_timer_create_args_t *esp_timer_handle_t;

inline int64_t esp_timer_get_time() { return static_cast<int64_t>(bench::now_us); }
inline int esp_timer_create(const esp_timer_create_args_t *args, esp_timer_handle_t *made) {
  static esp_timer_create_args_t kept;
  kept = *args;
  *made = &kept;
  return 0;
}
inline int esp_timer_start_periodic(esp_timer_handle_t timer, uint64_t period_us) {
  bench::sample = timer->callback;
  bench::period_us = static_cast<unsigned>(period_us);
  return 0;
}
