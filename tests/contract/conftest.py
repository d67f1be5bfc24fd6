"""Fake boards at the other end of a pseudo-terminal, one per protocol, that can fail in every way a line can.

A fake sends unit after unit (a frame, a record, a line) as fast as it is read, or at its own pace in real time, and
does at unit k what ``faults[k]`` says: "drop" it, send it "twice", "flip" a bit of it, send it "late" (three units on),
"reset" in its middle, or "unplug": the port vanishes for `AWAY_S` and comes back under its name, with a board that has
restarted.
"""

import os
import select
import termios
import threading
import time
import tty
from pathlib import Path

import numpy as np
import pytest

from daq.protocols import session
from daq.wire import frames
from daq.wire.quadrature import levels_of

AWAY_S = 0.3
LATE_UNITS = 3


def motion(k):
    """Return the x4 count at sample k: back and forth, across roll-overs of 16 bits."""
    return np.floor(40_000 * np.sin(np.asarray(k) * 0.01)).astype(np.int64)


STEPS = np.diff(motion(np.arange(-1, 200_000)))
UP = np.cumsum(np.maximum(STEPS, 0)) + int(motion(-1))
DOWN = np.cumsum(np.maximum(-STEPS, 0))  # UP - DOWN is the motion; each of them only rises


class Fake(threading.Thread):
    """A board; `path` is its port.  A context manager: it runs inside of `with`."""

    protocol = ""
    rate_hz = 1000
    unit = 1  # samples
    columns = None
    starts_by_itself = False
    lead = 0  # units sent before a recording can begin: the faults come as much later

    def __init__(self, path: Path, faults=None, paced=False):
        super().__init__(daemon=True)
        self.path = path
        self.paced = paced
        self.faults = {k + self.lead * (not paced): fault for k, fault in (faults or {}).items()}
        self.heard: list[str] = []
        self._over = threading.Event()
        self._plug()

    def _plug(self):
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave, termios.TCSANOW)
        os.set_blocking(self._master, False)
        self.path.unlink(missing_ok=True)
        self.path.symlink_to(os.ttyname(self._slave))
        self._boot()

    def _boot(self):
        self.running = self.starts_by_itself
        self.k = 0
        self._command = ""
        self._late: list[tuple[int, bytes]] = []
        self._out = self.greeting()

    def _unplug(self):
        self.path.unlink()
        os.close(self._master)
        os.close(self._slave)

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
        sent = 0  # units since the fake was made: what the faults count
        while not self._over.is_set():
            wants = [self._master] if self._out or (self.running and not self.paced) else []
            ready, free, _ = select.select([self._master], wants, [], 0.002 if self.paced else 0.05)
            if ready:
                self._hear(os.read(self._master, 4096).decode())
            while self.running and len(self._out) < 2000 and self._due():
                self._out += self._next(sent)
                sent += 1
            if free and self._out:
                self._out = self._out[os.write(self._master, self._out[:1000]) :]

    def _due(self):
        if self.k == 0:
            self._began = time.monotonic()
        return not self.paced or self.k * self.unit <= (time.monotonic() - self._began) * self.rate_hz

    def _hear(self, text):
        *lines, self._command = (self._command + text).split("\n")
        for line in lines:
            if line:
                self.heard.append(line)
                self._out += self.answer(line)

    def _next(self, sent):
        line = self.encode(self.k)
        fault = self.faults.pop(sent, None)
        self.k += 1
        if fault == "reset":
            self._boot()
            return line[: len(line) // 2] + self._out
        if fault == "unplug":
            self._unplug()
            self._over.wait(AWAY_S)
            self._plug()
            return b""
        due = [held for at, held in self._late if at <= self.k]
        self._late = [(at, held) for at, held in self._late if at > self.k]
        if fault == "late":
            self._late.append((self.k + LATE_UNITS, line))
        sendings = {"drop": b"", "late": b"", "twice": line + line, "flip": self.flipped(line)}
        return sendings.get(fault, line) + b"".join(due)

    def flipped(self, line):
        at = len(line) // 2
        return line[:at] + bytes([line[at] ^ 0x40]) + line[at + 1 :]

    def greeting(self):
        return b""

    def answer(self, line):
        return b""

    def encode(self, k):
        raise NotImplementedError


class FakeFrames(Fake):
    protocol = "frames"
    unit = 8

    def ident(self):
        has = frames.Capability
        capabilities = has.BLOCKS | has.LEVELS | has.ILLEGAL
        return frames.encode_ident(
            frames.Ident((1, 2, 3), "x4", capabilities, 16, 1000, self.block, 5000, 10**8, "fake")
        )

    def greeting(self):
        self.block = 8
        return b"\0" + self.ident()

    def answer(self, line):
        if line == "I":
            return self.ident()
        if line.startswith("B "):
            self.block = int(line[2:])
        if line in ("S", "X"):
            self.running = line == "S"
            self.k = 0
        return b""

    def encode(self, k):
        here = slice(8 * k, 8 * k + 8)
        columns = UP[here] % 65536, DOWN[here] % 65536, levels_of(UP[here] - DOWN[here])
        dt = [0, *[1000] * 7]
        ticks = (8000 * k + 777) % 2**32
        return frames.encode_samples(frames.SampleBlock(8 * k & 0xFFFF, ticks, 0, dt, *(c.tolist() for c in columns)))


class FakeQsb(Fake):
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


class FakeText(Fake):
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


class FakeLabelled(FakeText):
    """Its columns are not declared."""

    columns = None

    def encode(self, k):
        return f"us: {1000 * k + 4321}, Pos: {int(motion(k))}, state: run\r\n".encode()


FAKES = {"frames": FakeFrames, "qsb": FakeQsb, "text": FakeText, "ticks": FakeTicks}


@pytest.fixture(params=list(FAKES))
def make_fake(request, tmp_path, monkeypatch):
    """Return a function that starts a fake board with faults; each protocol in turn."""
    monkeypatch.setattr(session, "QUIET_S", 0.02)
    made = []

    def make(faults=None, paced=False):
        fake = FAKES[request.param](tmp_path / "ttyFAKE", faults, paced)
        made.append(fake)
        fake.start()
        return fake

    make.kind = FAKES[request.param]
    yield make
    for fake in made:
        fake.finish()
