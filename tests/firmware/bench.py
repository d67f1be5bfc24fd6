"""The bench: a board in the emulator, edges on its pins, a recorder of what it sends, and the truth beside it.

An edge list is what the encoder would have put on the wires: 64-bit cycles (16 MHz, from the board's start of sampling)
and levels.  The emulator writes down, for every sample that the board latches, the cycle at which that interrupt was
entered and how many edges had been played by then: what the sample must say.
"""

import json
import math
import subprocess
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import serial

from daq.wire.decode import Stream, decode_pieces
from daq.wire.frames import FrameReader
from daq.wire.quadrature import levels_of
from rig_sim.board.encoder import QuadratureEncoder
from rig_sim.motion.play import ScenePlayer

HERE = Path(__file__).resolve().parent
FIRMWARE = HERE.parents[1] / "firmware"
CYCLES_PER_S = 16_000_000
CYCLES_PER_TICK = 8
MCU = {"uno": "atmega328p", "mega": "atmega2560"}
AB_PINS = {"uno": "D2,D3", "mega": "E4,E5"}
COUNTER_PINS = {"uno": "D5,D4", "mega": "L2,D7"}
ENTRY_CYCLES = {"uno": 4, "mega": 5}
VECTORS = {"uno": {1: "A", 2: "B", 7: "latch", 9: "clock"}, "mega": {5: "A", 6: "B", 13: "latch", 15: "clock"}}


@dataclass(frozen=True)
class Edges:
    """What happens on the pins: ``levels`` from each ``cycle`` on; the first entry is what stands there before.

    ``count`` is the net count (x4 counts, or up minus down pulses) after each entry.
    """

    cycle: np.ndarray
    levels: np.ndarray
    count: np.ndarray

    def write(self, path):
        np.stack((self.cycle, self.levels), axis=1).astype("<u8").tofile(path)

    def peak_rate(self, over=8):
        """Return the fastest rate over so many edges, edges/s."""
        return over * CYCLES_PER_S / float((self.cycle[1 + over :] - self.cycle[1:-over]).min())


def of_motion(scene, seconds, jitter=0.0, seed=0, grid_hz=20_000):
    """Return the x4 edges of a scene's encoder; ``jitter`` moves each by so much of its distance to the next."""
    encoder = QuadratureEncoder(scene.encoder, scene.start.x)
    first = encoder.n
    motion = ScenePlayer(scene)
    nodes = motion.follow(np.arange(1, int(seconds * grid_hz)) / grid_hz, forces=False).nodes
    t, y = nodes.t, nodes.x / encoder.delta
    n = np.floor(y).astype(np.int64)
    jumps = np.diff(n)
    piece = np.repeat(np.arange(len(jumps)), np.abs(jumps))
    sign = np.sign(jumps)[piece]
    within = np.arange(len(piece)) - np.repeat(np.cumsum(np.abs(jumps)) - np.abs(jumps), np.abs(jumps))
    # Upwards the line n + 1 is crossed first, downwards the line n.
    line = n[piece] + np.where(sign > 0, within + 1, -within)
    share = (line - y[piece]) / (y[piece + 1] - y[piece])
    when = t[piece] + share * (t[piece + 1] - t[piece])
    count = first + np.cumsum(sign)
    cycle = when * CYCLES_PER_S
    if jitter:
        gap = np.minimum(np.diff(cycle, append=np.inf), np.diff(cycle, prepend=-np.inf))
        cycle = cycle + np.random.default_rng(seed).uniform(-jitter, jitter, len(cycle)) * np.minimum(gap, CYCLES_PER_S)
    return of_counts(cycle, count, first)


def of_counts(cycle, count, first):
    """Return the x4 edges at which the count becomes ``count``, from ``first`` on."""
    cycle = np.maximum.accumulate(np.concatenate(([0], np.round(cycle).astype(np.int64) + 1)))
    count = np.concatenate(([first], count))
    return Edges(cycle, levels_of(count).astype(np.int64), count)


def of_pulses(up_cycle, down_cycle, width=4):
    """Return the pulses of a J-K box on two wires: rises at these cycles, falls ``width`` cycles later."""
    ups, downs = np.asarray(up_cycle), np.asarray(down_cycle)
    cycle = np.concatenate((ups, ups + width, downs, downs + width))
    bit = np.repeat([1, -1, 2, -2], [len(ups), len(ups), len(downs), len(downs)])
    step = np.repeat([1, 0, -1, 0], [len(ups), len(ups), len(downs), len(downs)])
    order = np.argsort(cycle, kind="stable")
    levels = np.cumsum(bit[order])
    return Edges(
        np.concatenate(([0], cycle[order] + 1)),
        np.concatenate(([0], levels)),
        np.concatenate(([0], np.cumsum(step[order]))),
    )


@dataclass(frozen=True)
class Taken:
    """What the board sent, n samples, and the truth about them.

    ``net`` is unwrapped from the first sample's own difference; ``true`` and ``entry`` (cycles) are the emulator's.
    """

    stream: Stream
    seq: np.ndarray
    ticks: np.ndarray
    net: np.ndarray
    illegal: np.ndarray
    entry: np.ndarray
    true: np.ndarray
    report: dict

    @property
    def error(self):
        return self.net - self.true


class Board:
    """A board in the emulator; a context manager that yields itself with ``port``, the name of its pty."""

    def __init__(
        self, emulator, kind, hexfile, folder, *, edges=None, pins=None, watch=None, speed=0, hang=None, late=False
    ):
        self.kind, self.folder, self.edges = kind, Path(folder), edges
        self.log = self.folder / "samples.log"
        line = [str(emulator), "--mcu", MCU[kind], "--hex", str(hexfile), "--speed", str(speed)]
        line += ["--latency", str(ENTRY_CYCLES[kind])]
        if edges is not None:
            edges.write(self.folder / "edges.bin")
            line += ["--edges", str(self.folder / "edges.bin"), "--pins", pins or AB_PINS[kind]]
        if watch is not None:
            line += ["--watch", str(watch), "--log", str(self.log)]
        if hang is not None:
            line += ["--hang", str(hang)]
        if late:
            line += ["--late", "1"]
        self._line = line
        self.report = {}

    def __enter__(self):
        self._process = subprocess.Popen(self._line, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self.port = self._process.stdout.readline().split()[1]
        return self

    def __exit__(self, *error):
        self.stop()

    def truth(self, cycle):
        """Return the cycles at which the samples' latches were entered, and the counts they must show.

        ``cycle`` is the samples' recorded time, counted from anywhere; the first of them is the first ever latched.
        """
        if not self.log.exists() or self.edges is None:
            return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
        log = np.fromfile(self.log, "<u8").reshape(-1, 2).astype(np.int64)
        place = np.searchsorted(log[:, 0], cycle - cycle[0] + log[0, 0] - 800)  # 50 us before
        log = log[place]
        return log[:, 0], self.edges.count[np.maximum(log[:, 1] - 1, 0)]

    def stop(self):
        if self._process.poll() is None:
            out, _ = self._process.communicate(timeout=600)
            self.report = json.loads(out)
        return self.report


def ask(port, line, expect):
    """Send a line until something comes that ``expect`` (a function of the bytes so far) accepts; return it.

    Ten questions are what daq asks before it gives up.  Where they fail, ten more follow with longer pauses, and so on:
    on a busy computer the emulator is slow, and a question breaks off the answer to the one before.
    """
    heard = b""
    for pause in [0.2] * 10 + [1.0] * 10 + [5.0] * 10:
        port.write(line)
        again = time.monotonic() + pause
        while time.monotonic() < again:
            heard += port.read(max(1, port.in_waiting))
            if expect(heard):
                return heard
    raise AssertionError(f"no answer to {line!r}, but {heard[:200]!r}")


def record(board, rate_hz, samples, *, baud=115_200, block=8, mode=None):
    with serial.Serial(board.port, baud, timeout=0.05) as port:
        ask(port, b"\nX\nI\n", lambda heard: b"stickslip" in heard)
        time.sleep(0.05)
        port.reset_input_buffer()
        setting = f"R {rate_hz}\nB {block}\n" + (f"M {mode}\n" if mode else "")
        port.write(setting.encode())
        reads = [(0, b"\0" + ask(port, b"I\n", lambda heard: heard.endswith(b"\0") and b"stickslip" in heard))]
        port.write(b"S\n")
        length = 0
        quiet = 0
        enough = samples / block * (15 + 7 * block)
        while length < enough and quiet < 40:
            data = port.read(max(1, port.in_waiting))
            quiet = 0 if data else quiet + 1
            length += len(data)
            reads.append((0, data))
        port.write(b"X\n")
        while data := port.read(4096):
            reads.append((0, data))
    report = board.stop()
    stream = next(decode_pieces(reads, math.inf))
    return taken(stream, board, report)


def taken(stream, board, report):
    within = np.arange(len(stream.up)) - np.repeat(stream.first, stream.n)
    frame = np.repeat(np.arange(len(stream.n)), stream.n)
    ahead = np.cumsum(stream.dt.astype(np.int64))
    ticks = stream.ticks[frame] + ahead - ahead[stream.first[frame]]
    seq = stream.seq[frame] + within
    seq = seq + 65536 * np.concatenate(([0], np.cumsum(np.diff(seq) < -30_000)))
    net = np.cumsum(np.diff(stream.up.astype(np.int64), prepend=stream.up[0]) & 0xFFFF)
    net -= np.cumsum(np.diff(stream.down.astype(np.int64), prepend=stream.down[0]) & 0xFFFF)
    entry, true = board.truth(ticks * CYCLES_PER_TICK)
    if len(true):
        net = net + true[0]
    return Taken(stream, seq, ticks, net, stream.illegal[frame], entry, true, report)


def first_sample(board, mode=None):
    """Return the cycle after the start at which a board, which is then switched off, latches its first sample."""
    with board:
        return int(record(board, 1000, 16, mode=mode).entry[0])


class Host:
    """The other end of a board's line, once the board has answered; a context manager."""

    def __init__(self, board, baud=115_200):
        self.port = serial.Serial(board.port, baud, timeout=0.05)
        ask(self.port, b"\nX\nI\n", lambda heard: b"stickslip" in heard)
        while self.port.read(4096):
            pass
        self._reader = FrameReader()

    def __enter__(self):
        return self

    def __exit__(self, *error):
        self.port.close()

    def say(self, *commands, wait=0.3, until=None, broken=0):
        """Send commands and return the frames that come.

        They are waited for ``wait`` seconds, or until one of the kind ``until`` came; so many may be ``broken``.
        """
        self.port.write("".join(f"{command}\n" for command in commands).encode())
        found = []
        end = time.monotonic() + wait
        while time.monotonic() < end and not any(type(frame) is until for frame in found):
            found += self._reader.feed(self.port.read(max(1, self.port.in_waiting)))
        assert self._reader.crc_errors <= broken
        return found
