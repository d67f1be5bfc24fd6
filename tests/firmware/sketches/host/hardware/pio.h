// A model of one state machine of the RP2040's PIO: the instructions that the sketch uses, as the data sheet describes
// them (chapter 3.4), its FIFO of four words, and its input pins.  An instruction that it does not know ends the bench.
#pragma once

#include <stdlib.h>

#include "../Arduino.h"
#include "../bench.h"

struct pio_program_t {
  const uint16_t *instructions;
  uint8_t length;
  int8_t origin;
};
struct pio_sm_config {
  unsigned wrap_target = 0, wrap = 31, in_base = 0;
  bool shift_right = true, autopush = false;
};
struct pio_hw_t {};
typedef pio_hw_t *PIO;

namespace pio_model {
const unsigned CYCLES_PER_EDGE = 12; // the least that the sketch allows: 10 of the machine, 2 of the pins' synchroniser
struct Machine {
  uint16_t memory[32];
  pio_sm_config config;
  uint32_t x = 0, y = 0, isr = 0, fifo[4], level = 0, pc = 0;
  bool enabled = false;
};
inline Machine &machine() {
  static Machine only;
  return only;
}
inline uint32_t source(const Machine &own, unsigned code) {
  switch (code) {
  case 1: return own.x;
  case 2: return own.y;
  case 3: return 0;
  case 6: return own.isr;
  }
  abort();
}
inline void step() {
  Machine &own = machine();
  const uint16_t word = own.memory[own.pc];
  const unsigned low = word & 31;
  unsigned next = own.pc == own.config.wrap ? own.config.wrap_target : (own.pc + 1) % 32;
  if (word & 0x1f00) abort(); // no delay, no side-set
  switch (word >> 13) {
  case 0: { // JMP
    const unsigned condition = word >> 5 & 7;
    if (condition == 0) next = low;
    else if (condition == 2) {
      if (own.x != 0) next = low;
      --own.x;
    } else abort();
    break;
  }
  case 2: { // IN, to the left
    const unsigned bits = low ? low : 32, from = word >> 5 & 7;
    if (own.config.shift_right || bits == 32) abort();
    const uint32_t pins = bench::pin_a | bench::pin_b << 1;
    const uint32_t value = from == 0 ? pins : source(own, from);
    own.isr = own.isr << bits | (value & ((1u << bits) - 1));
    break;
  }
  case 4: // PUSH noblock: a full FIFO drops the word, and ISR is empty after it
    if (word != 0x8000) abort();
    if (own.level < 4) own.fifo[own.level++] = own.isr;
    own.isr = 0;
    break;
  case 5: { // MOV
    const unsigned to = word >> 5 & 7, change = word >> 3 & 3;
    uint32_t value = source(own, word & 7);
    value = change == 1 ? ~value : change == 0 ? value : (abort(), 0);
    if (to == 1) own.x = value;
    else if (to == 2) own.y = value;
    else if (to == 5) next = value & 31;
    else if (to == 6) own.isr = value;
    else abort();
    break;
  }
  default:
    abort();
  }
  own.pc = next;
}
inline void run(unsigned cycles) {
  while (machine().enabled && cycles--) step();
}
inline void edge() { run(CYCLES_PER_EDGE); }
} // namespace pio_model

extern PIO pio0;
inline int pio_add_program(PIO, const pio_program_t *program) {
  if (program->origin != 0 || program->length != 32) abort();
  memcpy(pio_model::machine().memory, program->instructions, 64);
  return 0;
}
inline int pio_claim_unused_sm(PIO, bool) { return 0; }
inline pio_sm_config pio_get_default_sm_config() { return pio_sm_config(); }
inline void sm_config_set_wrap(pio_sm_config *config, unsigned target, unsigned wrap) {
  config->wrap_target = target;
  config->wrap = wrap;
}
inline void sm_config_set_in_pins(pio_sm_config *config, unsigned base) { config->in_base = base; }
inline void sm_config_set_in_shift(pio_sm_config *config, bool right, bool autopush, unsigned) {
  config->shift_right = right;
  config->autopush = autopush;
}
inline void pio_sm_init(PIO, unsigned, unsigned pc, const pio_sm_config *config) {
  pio_model::machine().config = *config;
  pio_model::machine().pc = pc;
}
inline void pio_sm_set_enabled(PIO, unsigned, bool enabled) {
  pio_model::machine().enabled = enabled;
  bench::edge = pio_model::edge;
}
inline unsigned pio_sm_get_rx_fifo_level(PIO, unsigned) { return pio_model::machine().level; }
inline uint32_t pio_sm_get(PIO, unsigned) {
  pio_model::Machine &own = pio_model::machine();
  const uint32_t word = own.fifo[0];
  memmove(own.fifo, own.fifo + 1, 3 * sizeof word);
  --own.level;
  pio_model::run(2); // about as long as a read takes
  return word;
}
inline uint32_t pio_sm_get_blocking(PIO pio, unsigned sm) {
  while (pio_model::machine().level == 0) pio_model::step();
  return pio_sm_get(pio, sm);
}
