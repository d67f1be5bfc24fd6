"""Fake boards, one per protocol, that can fail in every way a line can.

A board sends unit after unit (a frame, a record, a line) and does at unit k what ``faults[k]`` says; a key may be a
range of units.  A fault is a name of `FAULTS`; "late" (three units on); settings with which the board restarts in the
middle of the unit, "reset" for none; "unplug": the port vanishes for `AWAY_S` and comes back under its name, with a
board that has restarted; "in_waiting": the port fails when it is asked for its bytes; or a function of the unit's bytes
that returns others, or raises.

`BoardPort` is a board at a port of this process, which sends a unit at each read; the others are at the other end of a
pseudo-terminal, and send as fast as they are read.  ``paced``: in real time, or in that of a `Clock`.
"""

import errno
import os
import select
import termios
import threading
import time
import tty
from pathlib import Path
from typing import Any

import numpy as np

from daq.wire import frames
from daq.wire.frames import Capability
from daq.wire.quadrature import levels_of

AWAY_S = 0.3
READ_S = 0.0005  # what a read of a `BoardPort` takes
LATE_UNITS = 3
FAULTS = {
    "drop": lambda line: b"",
    "twice": lambda line: line + line,
    "flip": lambda line: line[: len(line) // 2] + bytes([line[len(line) // 2] ^ 0x40]) + line[len(line) // 2 + 1 :],
}


def motion(k):
    """Return the x4 count at sample k: back and forth, across roll-overs of 16 bits."""
    return np.floor(40_000 * np.sin(np.asarray(k) * 0.01)).astype(np.int64)


STEPS = np.diff(motion(np.arange(-1, 200_000)))
UP = np.cumsum(np.maximum(STEPS, 0)) + int(motion(-1))
DOWN = np.cumsum(np.maximum(-STEPS, 0))  # UP - DOWN is the motion; each of them only rises


class Clock:
    """Stands in for `time`: passes only while someone sleeps, so that a loaded machine changes nothing."""

    def __init__(self):
        self._now = time.monotonic()

    def monotonic(self):
        return self._now

    def monotonic_ns(self):
        return round(1e9 * self._now)

    def time_ns(self):
        return time.time_ns()

    def sleep(self, seconds):
        self._now += seconds
        time.sleep(0)


class Board:
    """What a board sends, and what it answers."""

    clock: Any = time
    protocol = ""
    rate_hz = 1000
    unit = 1  # samples
    columns = None
    starts_by_itself = False
    lead = 0  # units sent before a recording can begin: the faults come as much later
    paced = False
    pause = (0, 0.0)  # from which unit on it is late, and by how much, s

    def __init__(self, faults=None, **settings):
        vars(self).update(settings)
        later = self.lead * (not self.paced)
        each = {k: fault for k, fault in (faults or {}).items() if not isinstance(k, range)}
        self.faults = {k + later: fault for k, fault in each.items()}
        self._lasting = [(when, fault) for when, fault in (faults or {}).items() if isinstance(when, range)]
        self.sent = 0  # units since the board was made: what the faults count
        self.heard: list[str] = []
        self.boot()

    def boot(self):
        self.running = self.starts_by_itself
        self.k = 0
        self._command = ""
        self._late: list[tuple[int, bytes]] = []
        self.out = self.greeting()

    def wait_s(self):
        if self.k == 0:
            self._began = self.clock.monotonic()
        if not self.paced:
            return 0.0
        at, late_s = self.pause
        return self._began + self.k * self.unit / self.rate_hz + late_s * (self.k >= at) - self.clock.monotonic()

    def hear(self, data):
        *lines, self._command = (self._command + data.decode()).split("\n")
        for line in filter(None, lines):
            self.heard.append(line)
            self.out += self.answer(line)

    def fault(self):
        lasting = (fault for when, fault in self._lasting if self.sent in when)
        return self.faults.get(self.sent) or next(lasting, None)

    def send(self):
        line, fault = self.encode(self.k), self.fault()
        self.k += 1
        self.sent += 1
        if fault == "unplug":
            self.unplug()
            return b""
        if fault == "reset" or isinstance(fault, dict):
            vars(self).update({} if fault == "reset" else fault)
            self.boot()
            return line[: len(line) // 2] + self.out
        due = [held for at, held in self._late if at <= self.k]
        self._late = [(at, held) for at, held in self._late if at > self.k]
        if fault == "late":
            self._late.append((self.k + LATE_UNITS, line))
            fault = "drop"
        spoil = FAULTS.get(fault, fault) if fault else bytes
        return spoil(line) + b"".join(due)

    def greeting(self):
        return b""

    def answer(self, line):
        return b""

    def encode(self, k):
        raise NotImplementedError


class Frames(Board):
    protocol = "frames"
    unit = 8
    firmware = "fake"
    tick_ns = 1000
    decoder = "x4"
    decoders = frames.DECODERS
    bits = 16
    first_tick = 777
    config = None

    def identify(self):
        able = (
            Capability.BLOCKS | Capability.LEVELS | Capability.ILLEGAL | Capability.CONFIG * (self.config is not None)
        )
        has = frames.Ident(
            (1, 2, 3), self.decoder, able, self.bits, self.tick_ns, self.block, 5000, 10**8, self.firmware
        )
        return frames.encode_ident(has)

    def greeting(self):
        self.block = 8
        return b"\0" + self.identify()

    def answer(self, line):
        if line == "I":
            return self.identify() + (b"" if self.config is None else frames.encode_config(self.config))
        if line.startswith("B "):
            self.block = int(line[2:])
        if line.startswith("M ") and line[2:] not in self.decoders:
            return frames.encode_notice(f"{line}: no such decoder")
        if line.startswith("M "):
            self.decoder = line[2:]
        if line in ("S", "X"):
            self.running = line == "S"
            self.k = 0
        return b""

    def encode(self, k):
        first = 8 * k
        up, down = UP[first : first + 8], DOWN[first : first + 8]
        coarse = 4 if self.decoder == "x1" else 1
        counted = [(each // coarse % 2**self.bits).tolist() for each in (up, down)]
        ticks = 1_000_000 // self.tick_ns
        at = (ticks * first + self.first_tick) % 2**32
        levels = levels_of(up - down).tolist()
        return frames.encode_samples(frames.SampleBlock(first & 0xFFFF, at, 0, [0, *[ticks] * 7], *counted, levels))


class BoardPort(Frames):
    """A board at a port of this process."""

    closed = False

    def write(self, data):
        self.hear(data)

    @property
    def in_waiting(self):
        if self.running and self.fault() == "in_waiting":
            raise OSError(errno.EIO, "Input/output error")
        return len(self.out)

    def read(self, size=1):
        if not self.out:
            self.clock.sleep(max(0.0, self.wait_s()) if self.running and self.paced else READ_S)
            self.out = self.send() if self.running else b""
        data, self.out = self.out[:size], self.out[size:]
        return data

    def close(self):
        self.closed = True


class Terminal(threading.Thread):
    """The other end of a pseudo-terminal; `path` is its port.  A context manager: the board runs inside of `with`."""

    def __init__(self, path: Path, faults: Any = None, paced: bool = False, **settings: Any):
        threading.Thread.__init__(self, daemon=True)
        self.path = path
        self._over = threading.Event()
        self._plug()
        Board.__init__(self, faults, paced=paced, **settings)

    def _plug(self):
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave, termios.TCSANOW)
        os.set_blocking(self._master, False)
        self.path.unlink(missing_ok=True)
        self.path.symlink_to(os.ttyname(self._slave))

    def _unplug(self):
        self.path.unlink()
        os.close(self._master)
        os.close(self._slave)

    def unplug(self):
        self._unplug()
        self._over.wait(AWAY_S)
        self._plug()
        self.boot()

    def __enter__(self):
        self.start()
        return self

    def __exit__(self, *error):
        self.finish()

    def finish(self):
        self._over.set()
        self.join(5)
        self._unplug()

    def run(self):
        while not self._over.is_set():
            wants = [self._master] if self.out or (self.running and not self.paced) else []
            ready, free, _ = select.select([self._master], wants, [], 0.002 if self.paced else 0.05)
            if ready:
                self.hear(os.read(self._master, 4096))
            while self.running and len(self.out) < 2000 and self.wait_s() <= 0:
                self.out += self.send()
            if free and self.out:
                self.out = self.out[os.write(self._master, self.out[:1000]) :]


class FakeFrames(Terminal, Frames):
    """The board of the frames."""


class FakeQsb(Terminal, Board):
    protocol = "qsb"
    rate_hz = 512

    def greeting(self):
        self.format = 3  # carriage return and line feed, no time stamp
        self.interval = 0
        return b"QSB-S  0E!\r\n"

    def record(self, kind, register, data, ticks):
        stamp = f"{ticks % 2**32:08X}" if self.format & 4 else ""
        end = "\r" * (self.format >> 1 & 1) + "\n" * (self.format & 1)
        return f"{kind}{register}{data % 2**32:08X}{stamp}!{end}".encode()

    def answer(self, line):
        kind, register, data = line[0], line[1:3], line[3:]
        if kind == "W":
            if register == "15":
                self.format = int(data, 16)
            elif register == "0C":
                self.interval = int(data, 16)
            elif register == "16":
                self.running = False
            return self.record("w", register, int(data, 16), self.k)
        if kind == "S":
            self.running, self.k = True, 0
            return b""
        self.running &= register != "0E"
        return self.record("r", register, {"14": 0x00530E00}.get(register, 0), self.k)

    def encode(self, k):
        return self.record("s", "0E", int(motion(k)), k * self.interval)


class FakeText(Terminal, Board):
    """Has no reset of its own that a reader could see: its time begins anew."""

    protocol = "text"
    columns = "t_us,up,down,a,b"
    starts_by_itself = True
    lead = 3000

    def greeting(self):
        return b"# sketch 7\r\n"

    def encode(self, k):
        levels = int(levels_of(UP[k] - DOWN[k]))
        # Its counters start where they like: two off the phase of its levels.
        return f"{1000 * k + 4321},{UP[k] + 52},{DOWN[k] + 50},{levels & 1},{levels >> 1}\r\n".encode()


class FakeUpForLong(FakeText):
    """Was up for some time before the recording; a reset begins its clock anew."""

    columns = "t_us,count"
    uptime_us = 0
    boots = 0

    def greeting(self):
        self.boots += 1
        return super().greeting()

    def encode(self, k):
        since = 1000 * k + (self.uptime_us if self.boots == 1 else 4321)
        return f"{since % 2**32},{int(motion(k))}\r\n".encode()


class FakeTicks(FakeText):
    columns = "ticks,ms"

    def encode(self, k):
        return f"{int(motion(k))}\t{k}\n".encode()


FAKES = {"frames": FakeFrames, "qsb": FakeQsb, "text": FakeText, "ticks": FakeTicks}
