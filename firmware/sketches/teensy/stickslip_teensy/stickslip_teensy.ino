// Teensy 3.x and 4.x: an x4 quadrature counter by interrupts, sampled at a fixed rate, printed as lines of text.
//
// Wiring: encoder A to pin 2, B to pin 3, ground to GND.  A Teensy 4 takes 3.3 V only: an encoder of 5 V needs a level
// shifter.  On a Teensy 4 an edge takes about 0.1 us of the processor.
// Builds with Teensyduino, which brings the library Encoder.
// Line: USB; the baud rate is only a name.
#include <Arduino.h>
#include <Encoder.h>

#include "stickslip_lines.h"

const int PIN_A = 2, PIN_B = 3;
const unsigned PERIOD_US = 1000;

static stickslip::Queue samples;
static Encoder encoder(PIN_A, PIN_B);
static IntervalTimer timer;

static void sample() {
  const uint32_t now = micros();
  samples.put(now, encoder.read());
}

void setup() {
  Serial.begin(115200);
  timer.priority(160); // below the edges, which keep their time
  timer.begin(sample, PERIOD_US);
}

void loop() {
  stickslip::print_waiting(samples, Serial);
}
