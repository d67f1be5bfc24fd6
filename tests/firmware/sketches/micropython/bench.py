# Runs main.py of the Pico: its assembled program on a line, then so many lines of samples by a made-up clock.
import sys

import main

LINES = int(sys.argv[1])


class Counter:
    k = -1

    def read(self):
        Counter.k += 1
        return 40 * abs(Counter.k % 4000 - 2000) - 40000


class Ticks:
    """MicroPython's clock on a Pico: microseconds modulo 2^30."""

    def __init__(self):
        self.now = (1 << 30) - 3000000

    def ticks_us(self):
        self.now += 487
        return self.now & 0x3FFFFFFF

    def ticks_diff(self, one, other):
        return ((one - other + (1 << 29)) & 0x3FFFFFFF) - (1 << 29)


main.time = Ticks()
program = main.quadrature_x4
print(program.wrap_target, program.wrap, *program.words)
clock = main.Clock()
clock._t = (1 << 32) - 5000000  # rolls over 5 s after the start
main.run(Counter(), clock, sys.stdout.buffer.write, LINES)


class Machine:
    def get(self, words):
        for k in range(len(words)):
            words[k] = 0xFFFFFFF0 + k


print(main.Counter(Machine()).read(), main.line(7, 4294967295, -2147483648).decode().strip())
