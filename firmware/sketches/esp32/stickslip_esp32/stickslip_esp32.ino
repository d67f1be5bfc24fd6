// ESP32: an x4 quadrature counter in hardware (PCNT), sampled at a fixed rate, printed as lines of text.
//
// Wiring: encoder A to GPIO 18, B to GPIO 19, ground to GND.  3.3 V only: an encoder of 5 V needs a level shifter.
// Builds with the Arduino core "esp32" 3.0 or later (its PCNT driver), for ESP32, S2, S3, C6 and H2; a C3 has no PCNT.
// Line: 921,600 baud; a line of 30 bytes at 1 kHz needs 300,000.
#include <Arduino.h>
#include <driver/pulse_cnt.h>
#include <esp_timer.h>

#include "stickslip_lines.h"

const int PIN_A = 18, PIN_B = 19;
const uint64_t PERIOD_US = 1000;
const uint32_t GLITCH_NS = 500; // shorter pulses are noise: edges may follow each other at up to 1 MHz
const int LIMIT = 32000;        // of the hardware counter, 16 bits; beyond it the driver adds up

static stickslip::Queue samples;
static pcnt_unit_handle_t counter;

static void check(esp_err_t error) {
  while (error != ESP_OK) {
    Serial.println("# the pulse counter cannot be set up");
    delay(1000);
  }
}

static void count_edges(int edge_pin, int level_pin, pcnt_channel_edge_action_t rising,
                        pcnt_channel_edge_action_t falling) {
  pcnt_chan_config_t config = {};
  config.edge_gpio_num = edge_pin;
  config.level_gpio_num = level_pin;
  pcnt_channel_handle_t channel;
  check(pcnt_new_channel(counter, &config, &channel));
  check(pcnt_channel_set_edge_action(channel, rising, falling));
  // As stated while the other channel is high, the other way round while it is low.
  check(pcnt_channel_set_level_action(channel, PCNT_CHANNEL_LEVEL_ACTION_KEEP, PCNT_CHANNEL_LEVEL_ACTION_INVERSE));
}

static void sample(void *) {
  int count = 0;
  const uint32_t now = static_cast<uint32_t>(esp_timer_get_time());
  pcnt_unit_get_count(counter, &count);
  samples.put(now, count);
}

void setup() {
  Serial.setTxBufferSize(4096);
  Serial.begin(921600);

  pcnt_unit_config_t unit = {};
  unit.high_limit = LIMIT;
  unit.low_limit = -LIMIT;
  unit.flags.accum_count = 1;
  check(pcnt_new_unit(&unit, &counter));
  pcnt_glitch_filter_config_t filter = {};
  filter.max_glitch_ns = GLITCH_NS;
  check(pcnt_unit_set_glitch_filter(counter, &filter));
  // A rises while B is low, and B rises while A is high, as the mass moves up.
  count_edges(PIN_A, PIN_B, PCNT_CHANNEL_EDGE_ACTION_DECREASE, PCNT_CHANNEL_EDGE_ACTION_INCREASE);
  count_edges(PIN_B, PIN_A, PCNT_CHANNEL_EDGE_ACTION_INCREASE, PCNT_CHANNEL_EDGE_ACTION_DECREASE);
  check(pcnt_unit_add_watch_point(counter, LIMIT)); // the driver adds up at these
  check(pcnt_unit_add_watch_point(counter, -LIMIT));
  check(pcnt_unit_enable(counter));
  check(pcnt_unit_clear_count(counter));
  check(pcnt_unit_start(counter));

  esp_timer_create_args_t args = {};
  args.callback = sample;
  args.name = "sample";
  esp_timer_handle_t timer;
  check(esp_timer_create(&args, &timer));
  check(esp_timer_start_periodic(timer, PERIOD_US));
}

void loop() {
  stickslip::print_waiting(samples, Serial);
  delay(1);
}
