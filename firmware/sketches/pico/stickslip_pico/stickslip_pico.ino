// Raspberry Pi Pico: an x4 quadrature counter in the PIO, sampled at a fixed rate, printed as lines of text.
//
// Wiring: encoder A to GP2, B to GP3 (two neighbours, A the lower one), ground to GND.  3.3 V only: an encoder of 5 V
// needs a level shifter.
// Builds with the Arduino core of Earle Philhower ("Raspberry Pi Pico/RP2040"), 3.0 or later; for a Pico 2 too.
// Line: USB; the baud rate is only a name.
#include <Arduino.h>
#include <hardware/gpio.h>
#include <hardware/pio.h>
#include <pico/time.h>

#include "quadrature_pio.h"
#include "stickslip_lines.h"

const unsigned PIN_A = 2;
const int64_t PERIOD_US = 1000;

static stickslip::Queue samples;
static repeating_timer_t timer;
static PIO pio = pio0;
static unsigned machine;

static int32_t read_count() {
  // What waits is old, and each place that is taken is filled at once: the first value after them is new.
  for (unsigned old = pio_sm_get_rx_fifo_level(pio, machine); old; --old) pio_sm_get(pio, machine);
  return static_cast<int32_t>(pio_sm_get_blocking(pio, machine));
}

static bool sample(repeating_timer_t *) {
  const uint32_t now = time_us_32();
  samples.put(now, read_count());
  return true;
}

void setup() {
  Serial.begin(115200);
  for (unsigned pin = PIN_A; pin < PIN_A + 2; ++pin) {
    gpio_init(pin);
    gpio_pull_up(pin);
  }
  pio_program_t program = {};
  program.instructions = QUADRATURE_WORDS;
  program.length = sizeof QUADRATURE_WORDS / sizeof QUADRATURE_WORDS[0];
  program.origin = 0;
  pio_add_program(pio, &program);
  machine = static_cast<unsigned>(pio_claim_unused_sm(pio, true));
  pio_sm_config config = pio_get_default_sm_config();
  sm_config_set_wrap(&config, QUADRATURE_WRAP_TARGET, QUADRATURE_WRAP);
  sm_config_set_in_pins(&config, PIN_A);
  sm_config_set_in_shift(&config, false, false, 32); // to the left, pushed by the program
  pio_sm_init(pio, machine, QUADRATURE_WRAP_TARGET, &config);
  pio_sm_set_enabled(pio, machine, true);
  add_repeating_timer_us(-PERIOD_US, sample, nullptr, &timer); // negative: from start to start
}

void loop() {
  stickslip::print_waiting(samples, Serial);
}
