// A model of ESP32's pulse counter as its driver's documentation describes it: two channels, each of which counts the
// edges of one pin and turns them round by the level of the other; a counter of 16 bits that begins anew at its limits,
// and a driver that adds these up where they are watched.
#pragma once

#include "../Arduino.h"
#include "../bench.h"

typedef int esp_err_t;
const esp_err_t ESP_OK = 0;

enum pcnt_channel_edge_action_t {
  PCNT_CHANNEL_EDGE_ACTION_HOLD,
  PCNT_CHANNEL_EDGE_ACTION_INCREASE,
  PCNT_CHANNEL_EDGE_ACTION_DECREASE
};
enum pcnt_channel_level_action_t {
  PCNT_CHANNEL_LEVEL_ACTION_KEEP,
  PCNT_CHANNEL_LEVEL_ACTION_INVERSE,
  PCNT_CHANNEL_LEVEL_ACTION_HOLD
};
struct pcnt_unit_config_t {
  int low_limit, high_limit, intr_priority;
  struct {
    uint32_t accum_count : 1;
  } flags;
};
struct pcnt_chan_config_t {
  int edge_gpio_num, level_gpio_num;
};
struct pcnt_glitch_filter_config_t {
  uint32_t max_glitch_ns;
};

namespace pcnt {
struct Channel {
  int edge_pin = -1, level_pin = -1;
  pcnt_channel_edge_action_t rising = PCNT_CHANNEL_EDGE_ACTION_HOLD, falling = PCNT_CHANNEL_EDGE_ACTION_HOLD;
  pcnt_channel_level_action_t high = PCNT_CHANNEL_LEVEL_ACTION_KEEP, low = PCNT_CHANNEL_LEVEL_ACTION_KEEP;
  bool last = false;
};
struct Unit {
  pcnt_unit_config_t config{};
  Channel channels[2];
  int used = 0, value = 0, added = 0;
  bool watched_high = false, watched_low = false, enabled = false, running = false;
};
inline Unit &unit() {
  static Unit only;
  return only;
}
// The sketch names its pins; the lower one is A.
inline bool level(int pin) {
  const Unit &own = unit();
  const int other = own.channels[0].edge_pin == pin ? own.channels[0].level_pin : own.channels[0].edge_pin;
  return pin < other ? bench::pin_a : bench::pin_b;
}
inline void edge() {
  Unit &own = unit();
  for (int k = 0; k < own.used; ++k) {
    Channel &channel = own.channels[k];
    const bool now = level(channel.edge_pin);
    if (now == channel.last) continue;
    channel.last = now;
    const pcnt_channel_edge_action_t action = now ? channel.rising : channel.falling;
    int step = action == PCNT_CHANNEL_EDGE_ACTION_INCREASE ? 1 : action == PCNT_CHANNEL_EDGE_ACTION_DECREASE ? -1 : 0;
    const pcnt_channel_level_action_t turn = level(channel.level_pin) ? channel.high : channel.low;
    step = turn == PCNT_CHANNEL_LEVEL_ACTION_INVERSE ? -step : turn == PCNT_CHANNEL_LEVEL_ACTION_HOLD ? 0 : step;
    if (!own.running) continue;
    own.value += step;
    if (own.value == own.config.high_limit || own.value == own.config.low_limit) {
      const bool watched = own.value > 0 ? own.watched_high : own.watched_low;
      if (own.config.flags.accum_count && watched) own.added += own.value;
      own.value = 0;
    }
  }
}
} // namespace pcnt

typedef pcnt::Unit *pcnt_unit_handle_t;
typedef pcnt::Channel *pcnt_channel_handle_t;

inline esp_err_t pcnt_new_unit(const pcnt_unit_config_t *config, pcnt_unit_handle_t *made) {
  if (config->high_limit > 32767 || config->low_limit < -32768 || config->low_limit >= 0) return 1;
  *made = &pcnt::unit();
  (*made)->config = *config;
  bench::edge = pcnt::edge;
  return ESP_OK;
}
inline esp_err_t pcnt_unit_set_glitch_filter(pcnt_unit_handle_t own, const pcnt_glitch_filter_config_t *) {
  return own->enabled ? 1 : ESP_OK;
}
inline esp_err_t pcnt_new_channel(pcnt_unit_handle_t own, const pcnt_chan_config_t *config, pcnt_channel_handle_t *made) {
  if (own->used == 2 || own->enabled) return 1;
  *made = &own->channels[own->used++];
  (*made)->edge_pin = config->edge_gpio_num;
  (*made)->level_pin = config->level_gpio_num;
  return ESP_OK;
}
inline esp_err_t pcnt_channel_set_edge_action(pcnt_channel_handle_t own, pcnt_channel_edge_action_t rising,
                                              pcnt_channel_edge_action_t falling) {
  own->rising = rising;
  own->falling = falling;
  return ESP_OK;
}
inline esp_err_t pcnt_channel_set_level_action(pcnt_channel_handle_t own, pcnt_channel_level_action_t high,
                                               pcnt_channel_level_action_t low) {
  own->high = high;
  own->low = low;
  return ESP_OK;
}
inline esp_err_t pcnt_unit_add_watch_point(pcnt_unit_handle_t own, int point) {
  own->watched_high |= point == own->config.high_limit;
  own->watched_low |= point == own->config.low_limit;
  return ESP_OK;
}
inline esp_err_t pcnt_unit_enable(pcnt_unit_handle_t own) {
  own->enabled = true;
  return ESP_OK;
}
inline esp_err_t pcnt_unit_clear_count(pcnt_unit_handle_t own) {
  own->value = own->added = 0;
  return ESP_OK;
}
inline esp_err_t pcnt_unit_start(pcnt_unit_handle_t own) {
  own->running = own->enabled;
  return own->enabled ? ESP_OK : 1;
}
inline esp_err_t pcnt_unit_get_count(pcnt_unit_handle_t own, int *value) {
  *value = own->value + own->added;
  return ESP_OK;
}
