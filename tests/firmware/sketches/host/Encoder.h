// In place of Teensyduino's library: every edge counted, by the order of the levels.
#pragma once

#include "Arduino.h"
#include "bench.h"

class Encoder {
public:
  Encoder(int, int) { bench::edge = edge; }
  int32_t read() { return count(); }

private:
  static int32_t &count() {
    static int32_t own = 0;
    return own;
  }
  static void edge() {
    static int last = 0;
    const int phase = bench::pin_a ? (bench::pin_b ? 2 : 1) : (bench::pin_b ? 3 : 0);
    count() += (phase - last + 4) % 4 == 1 ? 1 : -1;
    last = phase;
  }
};
