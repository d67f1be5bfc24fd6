"""Long recordings, and recorders that cannot read for a while: nothing lost, in memory that does not grow."""

import json
import os
import signal
import subprocess
import sys
import tty
from pathlib import Path
from typing import Any

import numpy as np

import daq
from daq.runfile import store

from ..boards import FakeFrames, motion
from . import tasks
from .result import Result, Size

MOST_GROWTH_MB, MOST_FINALISING_MB = 20, 300
RATES_HZ = (1000, 5000)
ASLEEP_S = (6, 30)  # at the short and at the full size; a board that is silent for 5 s counts as lost
UNPLUGGED_S = 10  # of the board's time between two unplugs
STUCK_S = (2, 20)  # of a disk
HANGS_S = 1500
BLOCK = 8

# A board in a process of its own, which sends as fast as it is read: sample k has up = 3 k, down = 2 k.
BOARD = """
import os, select, sys
import numpy as np
from daq.wire import frames
ident, samples, period = bytes.fromhex(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3])
row = np.dtype([("dt", "<u2"), ("up", "<u2"), ("down", "<u2"), ("levels", "u1")])
head = np.dtype([("kind", "u1"), ("version", "u1"), ("n", "u1"), ("seq", "<u2"), ("time", "<u4"), ("illegal", "<u2")])
whole = np.dtype([("head", head), ("rows", row, 8)])

def stream():
    for first in range(0, samples, 80_000):
        k = np.arange(first, min(first + 80_000, samples)).reshape(-1, 8)
        block = np.zeros(len(k), whole)
        block["head"]["kind"], block["head"]["version"], block["head"]["n"] = frames.SAMPLES, 1, 8
        block["head"]["seq"], block["head"]["time"] = k[:, 0] & 0xFFFF, k[:, 0] * period & 0xFFFFFFFF
        block["rows"]["dt"][:, 1:] = period
        block["rows"]["up"], block["rows"]["down"] = 3 * k & 0xFFFF, 2 * k & 0xFFFF
        block["rows"]["levels"] = np.array([0, 1, 3, 2])[k & 3]
        payloads = block.tobytes()
        size = whole.itemsize
        yield b"".join(frames.enframe(payloads[at : at + size]) for at in range(0, len(payloads), size))

pieces, out, command, running = stream(), b"", b"", False
while True:
    if running and not out:
        out = next(pieces, b"")
        running = bool(out)
    ready, free, _ = select.select([0], [1] if out else [], [])
    if ready:
        *words, command = (command + os.read(0, 4096)).split(b"\\n")
        for word in words:
            if word == b"I":
                out += ident
            running = running or word == b"S"
    if free and out:
        out = out[os.write(1, out[:65536]) :]
"""

# A recorder: its memory while it records, and at its peak.
RECORDER = """
import json, os, sys, time
from pathlib import Path
from daq.protocols.request import RecordRequest
from daq.recorder import reader
from daq.recorder.record import record
from daq.runfile import journal
import daq.finalise.run  # what the end imports is no growth
port, output, rate, seconds, pause, stuck = sys.argv[1:]
reader.PAUSE_S = float(pause)
sizes, calls, stuck_s = [], [0], [float(stuck)]

def resident(done):
    calls[0] += 1
    if calls[0] % 100 == 50:
        sizes.append(int(open("/proc/self/statm").read().split()[1]) * os.sysconf("SC_PAGE_SIZE"))

sync = journal.Writer.sync
def slow(writer):
    if stuck_s[0] and sizes:
        time.sleep(stuck_s.pop())
        stuck_s.append(0.0)
    sync(writer)
journal.Writer.sync = slow
began = time.monotonic()
cpu = time.process_time()
found = record(RecordRequest(port, Path(output), int(rate), float(seconds), baud=1_000_000), progress=resident)
# Not ru_maxrss: a new process inherits that of its parent.
peak = 1024 * next(int(line.split()[1]) for line in open("/proc/self/status") if line.startswith("VmHWM"))
print(json.dumps(found.as_json() | {
    "file": None, "growth_mb": (max(sizes) - sizes[0]) / 1e6, "first_mb": sizes[0] / 1e6, "peak_mb": peak / 1e6,
    "cpu_us": 1e6 * (time.process_time() - cpu) / found.samples, "wall_s": time.monotonic() - began,
}))
"""


def load(size: Size, folder: Path) -> list[Result]:
    """Record ``size.amount`` seconds at each rate, and the other trials in proportion."""
    return [
        *(_long(rate_hz, size, folder) for rate_hz in RATES_HZ),
        _stuck(STUCK_S[size.full], folder),
        _asleep(ASLEEP_S[size.full], folder),
        _unplugged(max(2, size.amount // 120), folder),
    ]


def _long(rate_hz: int, size: Size, folder: Path) -> Result:
    samples = size.amount * rate_hz
    output = folder / f"{rate_hz}.h5"
    found = _recorded(output, rate_hz, samples)
    faults = []
    if (found["samples"], found["lost"], found["crc_errors"], found["segments"]) != (samples, 0, 0, 1):
        faults.append(f"{found['samples']} of {samples} samples, {found['lost']} lost, {found['segments']} segments")
    faults += _wrong(output, samples, rate_hz)
    if found["growth_mb"] > MOST_GROWTH_MB or found["peak_mb"] > MOST_FINALISING_MB:
        faults.append(f"memory grew by {found['growth_mb']:.0f} MB, {found['peak_mb']:.0f} MB in the end")
    output.unlink(missing_ok=True)
    return Result(
        f"a recording at {rate_hz} Hz loses no sample, in memory that does not grow",
        f"{size.amount / 3600:.3g} h of samples, in {found['wall_s']:.0f} s",
        f"{found['samples']} samples, {found['lost']} lost; memory +{found['growth_mb']:.1f} MB while recording "
        f"(at most {MOST_GROWTH_MB}), {found['peak_mb']:.0f} MB in the end (at most {MOST_FINALISING_MB}); "
        f"{found['cpu_us']:.2f} us of CPU time per sample",
        tuple(faults),
    )


def _stuck(seconds: int, folder: Path) -> Result:
    """Let the disk take a while for one write: the line is read meanwhile."""
    samples, output = (seconds + 3) * 1000, folder / "stuck.h5"
    with FakeFrames(folder / "ttySTUCK", paced=True) as board:
        found = _run(RECORDER, board.path, output, 1000, samples / 1000, 0.02, seconds)
    faults = [] if (found["samples"], found["lost"]) == (samples, 0) else [f"{found['samples']} of {samples} samples"]
    return Result(
        "a disk that does not take anything for a while costs no sample",
        f"one fsync of {seconds} s at 1 kHz in real time",
        f"{found['samples']} samples, {found['lost']} lost",
        tuple(faults),
    )


def _asleep(seconds: int, folder: Path) -> Result:
    """Stop the recorder as a computer that sleeps does, in front of a board that waits for its line."""
    samples, output = (seconds + 3) * 1000, folder / "asleep.h5"
    with FakeFrames(folder / "ttyASLEEP", paced=True) as board:
        command = [sys.executable, "-m", "daq.cli.app", "record", "--port", str(board.path), "--json"]
        command += ["--duration", str(seconds + 3), "-o", str(output)]
        recorder = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        tasks.wait_for_journal(output.with_name(output.name + ".part"), lambda: recorder.poll() is not None)
        recorder.send_signal(signal.SIGSTOP)
        try:
            recorder.wait(seconds)
        except subprocess.TimeoutExpired:
            recorder.send_signal(signal.SIGCONT)
        out, err = recorder.communicate(timeout=HANGS_S)
    found = json.loads(out) if out.startswith("{") else {"samples": 0, "lost": 0, "segments": 0}
    whole = (recorder.returncode, found["samples"], found["lost"], found["segments"]) == (0, samples, 0, 1)
    faults = [] if whole else [f"exit {recorder.returncode}, {found['samples']} of {samples} samples: {err[-200:]}"]
    return Result(
        "a computer that sleeps costs none of the samples that its board or driver keeps",
        f"the recorder stopped for {seconds} s",
        f"{found['samples']} samples, {found['lost']} lost, {found['segments']} segment",
        tuple(faults),
    )


def _unplugged(times: int, folder: Path) -> Result:
    units = UNPLUGGED_S * FakeFrames.rate_hz // BLOCK
    samples, output = (times + 1) * UNPLUGGED_S * FakeFrames.rate_hz, folder / "unplugged.h5"
    with FakeFrames(folder / "ttyPLUG", {units * (k + 1): "unplug" for k in range(times)}) as board:
        found = _run(RECORDER, board.path, output, FakeFrames.rate_hz, samples / FakeFrames.rate_hz, 0.0, 0)
    faults = []
    if (found["lost"], found["segments"]) != (0, times + 1):
        faults.append(f"{found['lost']} samples lost, {found['segments']} segments after {times} unplugs")
    run = daq.load(output)
    for segment in range(found["segments"]):
        own = run.segment == segment
        k = np.arange(int(own.sum()))
        if run.raw is None or not np.array_equal(run.raw.sample[own], k):
            faults.append(f"segment {segment} has gaps")
        elif not np.array_equal(np.diff(run.position[own]), np.diff(motion(k))):
            faults.append(f"segment {segment} has wrong counts")
    kept = found["samples"] / samples
    if kept < 0.9:
        faults.append(f"{found['samples']} of {samples} samples")
    return Result(
        "a board that is unplugged is found again, and its samples before and after are right",
        f"{times} unplugs, one every {UNPLUGGED_S} s of the board's time",
        f"{found['segments']} segments, {kept:.1%} of the samples, none wrong",
        tuple(faults),
    )


def _recorded(output: Path, rate_hz: int, samples: int) -> dict[str, Any]:
    from daq.wire import frames

    capabilities = frames.Capability.BLOCKS | frames.Capability.LEVELS
    ident = frames.Ident((1, 0, 0), "x4", capabilities, 16, 1000, BLOCK, 10_000, 10**7, "load")
    master, slave = os.openpty()
    tty.setraw(slave)
    line = [sys.executable, "-c", BOARD, frames.encode_ident(ident).hex(), str(samples), str(1_000_000 // rate_hz)]
    board = subprocess.Popen(line, stdin=master, stdout=master)
    try:
        return _run(RECORDER, os.ttyname(slave), output, rate_hz, samples / rate_hz, 0.0, 0)
    finally:
        board.kill()
        board.wait()
        os.close(master)
        os.close(slave)


def _run(program: str, *arguments: object) -> dict[str, Any]:
    line = [sys.executable, "-c", program, *map(str, arguments)]
    done = subprocess.run(line, capture_output=True, text=True, check=False, timeout=HANGS_S)
    if done.returncode:
        raise RuntimeError(f"the recorder ended with {done.returncode}: {done.stderr[-500:]}")
    return json.loads(done.stdout)


def _wrong(output: Path, samples: int, rate_hz: int) -> list[str]:
    """Return what is wrong in a run whose sample k has the count k at the time k / rate."""
    step = 1 << 20
    with store.open_reader(output) as run:
        if run.samples != samples:
            return [f"{run.samples} of {samples} samples in the file"]
        for first in range(0, samples, step):
            k = np.arange(first, min(first + step, samples))
            if not np.array_equal(run.positions(slice(first, first + step)), k):
                return [f"wrong counts from sample {first} on"]
        error = max(
            abs(run.times()[:: max(1, samples // 1000)] - np.arange(0, samples, max(1, samples // 1000)) / rate_hz)
        )
    return [] if error < 1e-9 else [f"times are off by up to {error} s"]
