// What the sketches use of Arduino, on this computer: time and pins are the bench's, the serial line is stdout.
#pragma once

#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>

namespace bench {
extern uint64_t now_us;
extern bool pin_a, pin_b;
} // namespace bench

struct HostSerial {
  void begin(unsigned long) {}
  void setTxBufferSize(size_t) {}
  size_t write(const uint8_t *bytes, size_t n) { return fwrite(bytes, 1, n, stdout); }
  void println(const char *text) { printf("%s\n", text); }
};
extern HostSerial Serial;

inline void delay(unsigned long) {}
inline uint32_t micros() { return static_cast<uint32_t>(bench::now_us); }

// Teensy's timer: the bench calls what was begun.
struct IntervalTimer {
  void priority(int) {}
  bool begin(void (*callback)(), unsigned period_us);
};
