// The bench of the sketches: moves an encoder, calls the sketch's timer and its loop, writes the true counts.
//
//   bench LINES TRUTH [PAUSE]     PAUSE: samples during which the loop stands still, once in 10,000
#include <math.h>
#include <stdlib.h>

#include "Arduino.h"
#include "bench.h"

namespace bench {
uint64_t now_us = (1ull << 32) - 5000000; // rolls over 5 s after the start
bool pin_a = false, pin_b = false;
void (*edge)() = nullptr;
void (*sample)(void *) = nullptr;
unsigned period_us = 0;
} // namespace bench
HostSerial Serial;

bool IntervalTimer::begin(void (*callback)(), unsigned period_us) {
  static void (*called)();
  called = callback;
  bench::sample = [](void *) { called(); };
  bench::period_us = period_us;
  return true;
}

void setup();
void loop();

static void move(int32_t &count, int32_t to) {
  while (count != to) {
    count += count < to ? 1 : -1;
    const int phase = static_cast<int>(static_cast<uint32_t>(count) % 4); // 00, A, AB, B
    bench::pin_a = phase == 1 || phase == 2;
    bench::pin_b = phase == 2 || phase == 3;
    if (bench::edge) bench::edge();
  }
}

int main(int argc, char **argv) {
  const long lines = atol(argv[1]);
  FILE *truth = fopen(argv[2], "wb");
  const long pause = argc > 3 ? atol(argv[3]) : 0;
  setup();
  int32_t count = 0;
  uint64_t due = bench::now_us;
  for (long k = 0; k < lines; ++k) {
    move(count, static_cast<int32_t>(lround(40000 * sin(k * 8e-4) + 5 * sin(k * 0.9))));
    due += bench::period_us;
    bench::now_us = due + static_cast<uint64_t>(k * 2654435761u % 31); // up to 30 us late
    bench::sample(nullptr);
    fwrite(&count, sizeof count, 1, truth);
    if (k % 10000 >= pause) loop();
  }
  loop();
  fclose(truth);
  return 0;
}
