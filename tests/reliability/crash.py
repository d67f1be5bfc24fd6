"""Commands killed before each call that changes a file, and recordings killed at any time."""

import signal
import time
from pathlib import Path

import numpy as np

import daq

from ..boards import FakeFrames
from . import tasks
from .forked import KILL, WRITE, Server
from .result import Result, Size
from .tasks import TASKS

RECORDED_S = 100  # a recording that is killed never lasts so long
KILLED_AFTER_S = (0.1, 2.5)  # the journal is synced once a second
RECORDS = 20  # share of the kill points that are recordings in real time: one in so many


def crash(size: Size, folder: Path, server: Server, sources: Path) -> list[Result]:
    """Kill every command of `TASKS` at up to ``size.amount`` of its calls, and recordings of a paced board."""
    found = {name: _kill_at_calls(tasks.Trials(server, sources, folder / name), name, size.amount) for name in TASKS}
    lost_s, synced_s, kill_faults = _kill_recordings(server, folder / "paced", size)
    points = sum(tried for tried, _, _ in found.values())
    calls = sum(calls for _, calls, _ in found.values())
    faults = [fault for _, _, each in found.values() for fault in each]
    lost_ms = 1e3 * np.array(lost_s)
    return [
        Result(
            "a killed command leaves old files or new ones, never half a file; the next one completes its work",
            f"SIGKILL before {points} of {calls} calls that change a file, of {len(found)} commands",
            f"{points} as promised; every sample in a journal recovered" if not faults else "see faults",
            tuple(faults),
        ),
        Result(
            "a recording that is killed, or whose computer loses its power, loses less than a second",
            f"{len(lost_s)} recordings at 1 kHz, SIGKILL after {KILLED_AFTER_S[0]} to {KILLED_AFTER_S[1]} s, recover",
            f"lost: median {np.median(lost_ms):.0f} ms, at most {lost_ms.max():.0f} ms; every other sample right; "
            f"at most {max(synced_s):.2f} s between two syncs of the journal",
            tuple(kill_faults),
        ),
    ]


def chosen(calls: tuple[int, ...], amount: int) -> list[int]:
    """Return which calls to spoil, counted from 1: all that are no write, and writes evenly among them."""
    others = [k for k, kind in enumerate(calls, start=1) if kind != WRITE]
    writes = [k for k, kind in enumerate(calls, start=1) if kind == WRITE]
    if amount < len(others):
        others = tasks.spread(others, amount)
    return sorted(others + tasks.spread(writes, max(amount - len(others), amount // 3)))


def _kill_at_calls(trials: tasks.Trials, name: str, amount: int) -> tuple[int, int, list[str]]:
    """Return how many kill points were tried, how many calls there are, and the faults."""
    task, known = TASKS[name], trials.known(name)
    whole, left = known.ended, sorted(known.after)
    faults = []
    if (whole.code, left) != (task.ends, sorted(task.leaves)):
        faults.append(f"{' '.join(task.line)}: undisturbed it ended with {whole.code} and {left}: {whole.err}")
    points = chosen(whole.calls, amount)
    recovered = 0
    for at in points:
        found, samples = trials.disturb(name, at, "killed before", -signal.SIGKILL, action=KILL)
        faults += found
        if samples is not None:
            if samples < recovered:
                faults.append(f"{name} killed before call {at}: {samples} samples, {recovered} of a shorter journal")
            recovered = samples
    return len(points), len(whole.calls), faults


def _kill_recordings(server: Server, folder: Path, size: Size) -> tuple[list[float], list[float], list[str]]:
    """Kill recordings in real time; return the seconds that each lost, those between its syncs, and the faults."""
    chance = np.random.default_rng(size.seed)
    lost_s, synced_s, faults = [], [], []
    for k in range(max(3, size.amount // RECORDS * len(TASKS))):
        place = folder / str(k)
        place.mkdir(parents=True)
        after = float(chance.uniform(*KILLED_AFTER_S))
        with FakeFrames(folder / f"tty{k}", paced=True) as board:
            line = ["daq", "record", "--port", str(board.path), "--duration", str(RECORDED_S), "-o", "run.h5"]
            sent, longest_s = _kill_while_recording(server, board, line, place, after)
        ended = server.run(["daq", "recover", "run.h5.part"], place)
        where = f"recording {k} of seed {size.seed}, killed {after:.3f} s after its first sample"
        if ended.code or [path.name for path in place.iterdir()] != ["run.h5"]:
            faults.append(f"{where}: recover ended with {ended.code}: {ended.err}")
            continue
        run = daq.load(place / "run.h5")
        sample = np.round(run.time * board.rate_hz).astype(int)
        if not np.array_equal(sample, np.arange(run.time.size)):
            faults.append(f"{where}: samples are missing in the middle")
        synced_s.append(longest_s)
        lost_s.append((sent - run.time.size) / board.rate_hz)
        if max(lost_s[-1], longest_s) >= 1.0:
            faults.append(f"{where}: {lost_s[-1]:.2f} s lost, {longest_s:.2f} s between two syncs")
    return lost_s, synced_s, faults


def _kill_while_recording(
    server: Server, board: FakeFrames, line: list[str], place: Path, after_s: float
) -> tuple[int, float]:
    """Record, and kill the recorder so long after the first sample.

    Return the samples that the board had sent, and the longest time between two syncs of the journal, or from the last
    one to the end.
    """
    child = server.start(line, place)
    until = time.monotonic() + 60
    while not board.k and time.monotonic() < until:
        time.sleep(0.001)
    time.sleep(after_s)
    killed = time.monotonic()
    child.send(signal.SIGKILL)
    sent = board.k * board.unit
    syncs = child.wait().syncs
    return sent, float(np.diff([*syncs, killed]).max())
