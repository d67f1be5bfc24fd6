// Lines of text for `daq record --protocol text`: a queue between the timer that samples and the loop that prints.
//
//   17,16000,-1234,2B      number, time in us, count, and the XOR of the bytes before the last comma in two hex digits
//   # columns seq,t_us,count,xor
//
// The second line is repeated, so that the host needs no --columns.  The time is that at which the count was read, not
// that at which it was due.  Where the line cannot carry the samples the queue fills up: samples are lost together with
// their numbers, which the host sees.
#pragma once

#include <stddef.h>
#include <stdint.h>

namespace stickslip {

const uint32_t QUEUE = 256;         // samples: a quarter of a second at 1 kHz, longer than a host pauses
const uint32_t COLUMNS_EVERY = 500; // lines
const size_t LONGEST = 48;          // bytes of a line
const char COLUMNS[] = "# columns seq,t_us,count,xor\n";

struct Sample {
  uint32_t seq;
  uint32_t t_us;
  int32_t count;
};

// One writer (the timer), one reader (the loop).
class Queue {
public:
  // Puts a sample in; one that finds no place is lost, its number not.
  void put(uint32_t t_us, int32_t count) {
    const uint32_t seq = seq_++;
    if (head_ - tail_ >= QUEUE) return;
    Sample &sample = samples_[head_ % QUEUE];
    sample.seq = seq;
    sample.t_us = t_us;
    sample.count = count;
    __sync_synchronize(); // the sample before the head that shows it
    head_ = head_ + 1;
  }

  bool take(Sample &sample) {
    if (tail_ == head_) return false;
    __sync_synchronize();
    sample = samples_[tail_ % QUEUE];
    __sync_synchronize();
    tail_ = tail_ + 1;
    return true;
  }

private:
  Sample samples_[QUEUE];
  volatile uint32_t head_ = 0, tail_ = 0;
  uint32_t seq_ = 0;
};

inline char *digits(char *at, uint32_t value) {
  char reversed[10];
  int n = 0;
  do {
    reversed[n++] = static_cast<char>('0' + value % 10);
    value /= 10;
  } while (value);
  while (n) *at++ = reversed[--n];
  return at;
}

// Writes a line, at most LONGEST bytes, and returns its length.
inline size_t line(char *text, const Sample &sample) {
  char *at = digits(text, sample.seq);
  *at++ = ',';
  at = digits(at, sample.t_us);
  *at++ = ',';
  const uint32_t count = static_cast<uint32_t>(sample.count);
  if (sample.count < 0) *at++ = '-';
  at = digits(at, sample.count < 0 ? 0u - count : count); // also of the least number
  uint8_t check = 0;
  for (const char *byte = text; byte < at; ++byte) check ^= static_cast<uint8_t>(*byte);
  *at++ = ',';
  *at++ = "0123456789ABCDEF"[check >> 4];
  *at++ = "0123456789ABCDEF"[check & 15];
  *at++ = '\n';
  return static_cast<size_t>(at - text);
}

// Prints the samples that wait; `Port` is an Arduino stream.
template <class Port> void print_waiting(Queue &queue, Port &port) {
  static uint32_t printed = 0;
  Sample sample;
  char text[LONGEST];
  while (queue.take(sample)) {
    if (printed++ % COLUMNS_EVERY == 0) port.write(reinterpret_cast<const uint8_t *>(COLUMNS), sizeof COLUMNS - 1);
    port.write(reinterpret_cast<const uint8_t *>(text), line(text, sample));
  }
}

} // namespace stickslip
