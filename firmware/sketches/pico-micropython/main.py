# Raspberry Pi Pico with MicroPython: an x4 quadrature counter in the PIO, sampled and printed as lines of text.
#
# Wiring: encoder A to GP2, B to GP3 (two neighbours, A the lower one), ground to GND.  3.3 V only: an encoder of 5 V
# needs a level shifter.
# Copy this file to the board as main.py, with any editor for MicroPython or `mpremote cp main.py :main.py`.
#
#   17,16000,-1234,2B      number, time in us, count, and the XOR of the bytes before the last comma in two hex digits
#   # columns seq,t_us,count,xor
#
# The second line is repeated, so that the host needs no --columns.  A sample that comes late has its own time, not the
# one at which it was due; one that is missed leaves its number out.
import sys
import time
from array import array

import rp2
from machine import Pin

PIN_A = 2
RATE_HZ = 500  # MicroPython writes about 1000 lines a second; half of that leaves time for its memory
COLUMNS = "# columns seq,t_us,count,xor\n"
COLUMNS_EVERY = 500  # lines
DIGITS = b"0123456789ABCDEF"


# The program of quadrature.pio of the project, where it is described: X holds the count, Y the levels seen last.  Its 32
# instructions fill the memory of the PIO, so that it stands at address 0, which its table needs.
@rp2.asm_pio(in_shiftdir=rp2.PIO.SHIFT_LEFT)
def quadrature_x4():
    jmp("look")  # levels before and after, A the lower one: 00 -> 00
    jmp("up")  # 00 -> A
    jmp("down")  # 00 -> B
    jmp("look")
    jmp("down")  # A -> 00
    jmp("look")
    jmp("look")
    jmp("up")  # A -> AB
    jmp("up")  # B -> 00
    jmp("look")
    jmp("look")
    jmp("down")  # B -> AB
    jmp("look")
    jmp("down")  # AB -> A
    jmp("up")  # AB -> B
    jmp("look")
    label("down")
    jmp(x_dec, "look")
    wrap_target()
    label("look")
    mov(isr, x)
    push(noblock)
    in_(y, 2)
    in_(pins, 2)
    mov(y, isr)
    mov(pc, isr)
    label("up")
    mov(x, invert(x))
    jmp(x_dec, "again")
    label("again")
    mov(x, invert(x))
    wrap()
    nop()
    nop()
    nop()
    nop()
    nop()
    nop()


class Counter:
    """The count of a state machine: what waits in its FIFO is old, the value behind it is new."""

    def __init__(self, machine):
        self._machine = machine
        self._words = array("I", bytes(4 * 9))

    def read(self):
        self._machine.get(self._words)
        count = self._words[8]
        return count - 0x100000000 if count & 0x80000000 else count


class Clock:
    """Microseconds modulo 2^32: those of MicroPython roll over earlier."""

    def __init__(self):
        self._last = time.ticks_us()
        self._t = 0

    def read(self):
        now = time.ticks_us()
        self._t = (self._t + time.ticks_diff(now, self._last)) & 0xFFFFFFFF
        self._last = now
        return self._t


def line(seq, t_us, count):
    text = b"%d,%d,%d" % (seq, t_us, count)
    check = 0
    for byte in text:
        check ^= byte
    return b"%s,%c%c\n" % (text, DIGITS[check >> 4], DIGITS[check & 15])


def run(counter, clock, write, lines=None, rate_hz=RATE_HZ):
    """Print samples for ever, or so many lines."""
    period = 1000000 // rate_hz
    seq, printed, due = 0, 0, clock.read()
    while lines is None or printed < lines:
        t = clock.read()
        if (t - due) & 0x80000000:
            continue
        count = counter.read()
        if printed % COLUMNS_EVERY == 0:
            write(COLUMNS.encode())
        write(line(seq, t, count))
        printed += 1
        missed = ((t - due) & 0xFFFFFFFF) // period
        seq = (seq + 1 + missed) & 0xFFFFFFFF
        due = (due + (1 + missed) * period) & 0xFFFFFFFF


if __name__ == "__main__":
    pins = [Pin(PIN_A + k, Pin.IN, Pin.PULL_UP) for k in range(2)]
    machine = rp2.StateMachine(0, quadrature_x4, in_base=pins[0])
    machine.active(1)
    run(Counter(machine), Clock(), sys.stdout.buffer.write)
