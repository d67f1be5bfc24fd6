"""Commands killed before each call that changes a file, and recordings killed at any time."""

import signal
import time
from pathlib import Path

import numpy as np

import daq
from daq.errors import EXIT_DATA

from ..contract.conftest import FakeFrames
from . import campaign, tasks
from .campaign import Result, Size
from .forked import KILL, WRITE, Ended, Server
from .tasks import TASKS, Contents, Task

RECORDED_S = 100  # a recording that is killed never lasts so long
KILLED_AFTER_S = (0.1, 2.5)  # the journal is synced once a second
RECORDS = 20  # share of the kill points that are recordings in real time: one in so many


def crash(size: Size, folder: Path) -> list[Result]:
    """Kill every command of `TASKS` at up to ``size.amount`` of its calls, and recordings of a paced board."""
    with Server(folder / "server") as server:
        sources = folder / "sources"
        tasks.prepare(server, sources)
        found = {name: _kill_at_calls(server, name, sources, folder / name, size.amount) for name in TASKS}
        lost_s, kill_faults = _kill_recordings(server, folder / "paced", size)
    points = sum(tried for tried, _, _ in found.values())
    calls = sum(calls for _, calls, _ in found.values())
    by_task = ", ".join(f"{name} {tried}" for name, (tried, _, _) in found.items())
    faults = [fault for _, _, each in found.values() for fault in each]
    lost_ms = 1e3 * np.array(lost_s)
    return [
        Result(
            "a killed command leaves old files or new ones, never half a file; the next one completes its work and "
            "leaves nothing besides",
            f"SIGKILL before {points} of {calls} calls that write, create, rename, remove or sync a file: {by_task}",
            f"{points} of {points} as promised; every sample in a journal recovered" if not faults else "see faults",
            campaign.test_of("crash"),
            tuple(faults),
        ),
        Result(
            "a recording that is killed loses less than a second",
            f"{len(lost_s)} recordings of a board on a pseudo-terminal at 1 kHz, SIGKILL after "
            f"{KILLED_AFTER_S[0]} to {KILLED_AFTER_S[1]} s, then daq recover",
            f"lost: median {np.median(lost_ms):.0f} ms, at most {lost_ms.max():.0f} ms; every other sample right",
            campaign.test_of("crash"),
            tuple(kill_faults),
        ),
    ]


def chosen(calls: tuple[int, ...], amount: int) -> list[int]:
    """Return which calls to spoil, counted from 1: all that are no write, and writes evenly among them."""
    others = [k for k, kind in enumerate(calls, start=1) if kind != WRITE]
    writes = [k for k, kind in enumerate(calls, start=1) if kind == WRITE]
    if amount < len(others):
        others = _spread(others, amount)
    return sorted(others + _spread(writes, max(amount - len(others), amount // 3)))


def _spread(values: list[int], amount: int) -> list[int]:
    at = np.unique(np.linspace(0, len(values) - 1, min(amount, len(values))).round().astype(int))
    return [values[k] for k in at]


def _kill_at_calls(server: Server, name: str, sources: Path, folder: Path, amount: int) -> tuple[int, int, list[str]]:
    """Return how many kill points were tried, how many calls there are, and the faults."""
    task = TASKS[name]
    task.begin(sources, folder)
    before = tasks.contents(folder)
    whole = server.run(list(task.line), folder)
    after = tasks.contents(folder)
    faults = []
    if (whole.code, set(after)) != (task.ends, task.leaves):
        faults.append(f"{' '.join(task.line)}: undisturbed it ended with {whole.code} and {sorted(after)}: {whole.err}")
    points = chosen(whole.calls, amount)
    recovered = 0
    for at in points:
        task.begin(sources, folder)
        killed = server.run(list(task.line), folder, at=at, action=KILL)
        where = f"{' '.join(task.line)}, killed before call {at} ({killed.name})"
        faults += [f"{where}: {what}" for what in _left(killed, task, folder, before, after)]
        following, samples = _follow(server, task, folder, after)
        faults += [f"{where}, then {what}" for what in following]
        now = tasks.contents(folder)
        faults += [f"{where}: after the next command: {what}" for what in _differences(now, after, name == "record")]
        if samples is not None:
            if samples < recovered:
                faults.append(f"{where}: {samples} samples, {recovered} of a shorter journal")
            recovered = samples
    return len(points), len(whole.calls), faults


def _left(killed: Ended, task: Task, folder: Path, before: Contents, after: Contents) -> list[str]:
    """Return what is wrong with the files that a killed command left: each must be as before or as after."""
    found = [] if killed.code == -signal.SIGKILL else [f"ended with {killed.code}: {killed.err}"]
    for path in folder.iterdir():
        if path.name.endswith((".partial", ".part")):
            continue  # `_follow` shows what they are good for
        try:
            held = tasks.content(path)
        except OSError as error:
            found.append(f"half a file {path.name}: {error}")
            continue
        if task.line[1] == "record" and _is_run(path):
            continue  # a recording is never the same twice; `_differences` looks at its samples
        if held not in (before.get(path.name), after.get(path.name)):
            found.append(f"{path.name} is neither as before nor as after")
    gone = [name for name in before if not (folder / name).exists()]
    done = all((folder / name).exists() for name in task.makes)
    return found + [f"{name} is gone" for name in gone if name not in task.consumes or not done]


def _is_run(path: Path) -> bool:
    return daq.load(path).time.size > 0


def _follow(server: Server, task: Task, folder: Path, after: Contents) -> tuple[list[str], int | None]:
    """Do what a person would do next; return what is wrong with that, and the samples of a journal that was left."""
    part, run = folder / "new.h5.part", folder / "new.h5"
    if part.exists():
        line = ["daq", "recover", part.name]
        ended = server.run(line, folder)
        if ended.code == 0:
            return [], daq.load(run).time.size
        if "delete it and record again" not in ended.err:
            return [f"{' '.join(line)} ended with {ended.code}: {ended.err}"], None
        if ended.code == EXIT_DATA:  # the board had not sent a sample
            part.unlink()
    elif all((folder / name).exists() for name in task.makes) and (
        task.line[1] == "record" or _holds(folder, task.leaves, after)
    ):
        return [], None  # it has done its work
    ended = server.run(list(task.line), folder)
    if ended.code != task.ends or ended.traceback or ended.hung:
        return [f"{' '.join(task.line)} ended with {ended.code}: {ended.err}"], None
    return [], None


def _holds(folder: Path, names: set[str], after: Contents) -> bool:
    return all((folder / name).exists() and tasks.content(folder / name) == after[name] for name in names)


def _differences(now: Contents, after: Contents, recording: bool) -> list[str]:
    """Return how a folder differs from that of a command that was not killed."""
    found = [f"{name} is left over" for name in now if name not in after]
    found += [f"{name} is missing" for name in after if name not in now]
    if recording:
        return found + _shortened(now.get("new.h5"), after["new.h5"])
    return found + [f"{name} differs" for name in after if name in now and now[name] != after[name]]


def _shortened(now: object, after: object) -> list[str]:
    """Return whether a recording's counts are not the beginning of the undisturbed one's."""
    counts = "entry/raw/count_up"
    if isinstance(now, dict) and isinstance(after, dict) and not after[counts].startswith(now[counts]):
        return ["its counts are not the beginning of the undisturbed run's"]
    return []


def _kill_recordings(server: Server, folder: Path, size: Size) -> tuple[list[float], list[str]]:
    """Kill recordings in real time; return the seconds that each lost, and the faults."""
    chance = np.random.default_rng(size.seed)
    lost_s, faults = [], []
    for k in range(max(3, size.amount // RECORDS * len(TASKS))):
        place = folder / str(k)
        place.mkdir(parents=True)
        board = FakeFrames(folder / f"tty{k}", paced=True)
        board.start()
        after = float(chance.uniform(*KILLED_AFTER_S))
        port = ["--port", str(board.path), "--duration", str(RECORDED_S)]
        sent = _kill_while_recording(server, board, ["daq", "record", *port, "-o", "run.h5"], place, after)
        board.finish()
        ended = server.run(["daq", "recover", "run.h5.part"], place)
        where = f"recording {k} of seed {size.seed}, killed {after:.3f} s after its first sample"
        if ended.code or [path.name for path in place.iterdir()] != ["run.h5"]:
            faults.append(f"{where}: recover ended with {ended.code}: {ended.err}")
            continue
        run = daq.load(place / "run.h5")
        sample = np.round(run.time * board.rate_hz).astype(int)
        if not np.array_equal(sample, np.arange(run.time.size)):
            faults.append(f"{where}: samples are missing in the middle")
        lost_s.append((sent - run.time.size) / board.rate_hz)
        if lost_s[-1] >= 1.0:
            faults.append(f"{where}: {lost_s[-1]:.2f} s lost")
    return lost_s, faults


def _kill_while_recording(server: Server, board: FakeFrames, line: list[str], place: Path, after_s: float) -> int:
    """Record, kill the recorder so long after the first sample, and return how many samples the board had sent."""
    child = server.start(line, place)
    until = time.monotonic() + 60
    while not board.k and time.monotonic() < until:
        time.sleep(0.001)
    time.sleep(after_s)
    child.send(signal.SIGKILL)
    sent = board.k * board.unit
    child.wait()
    return sent
