"""Signals at every moment of a command, terminals that close, and standard streams that are closed already."""

import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import daq
from stickslip.errors import EXIT_DATA, EXIT_DEVICE, EXIT_DONE, EXIT_INTERRUPTED

from . import tasks
from .forked import HANGS_S, ROOT, SEND, Server, compiled
from .result import Result, Size
from .tasks import TASKS

ENTRIES = {"daq": "daq", "process": "process", "fit-friction": "fit_friction"}
SINGLE = ("INT", "TERM", "HUP", "STOP, CONT")  # the others are tried at every other moment
EVERY_S = 0.025  # of CPU time: on an idle computer that of a clock, since a command works while it starts and ends
WHILE_RECORDING_S = (0.0, 0.3, 0.6, 0.9)
STOPPED_S = 0.05
PACKAGES = ("stickslip", "daq", "processing", "fitting", "rig_sim")
AT_A_TIME = 4
RECORD = ("daq", "record", "--realtime", "--duration", "1", "-o", "new.h5", "--json")
SAMPLES = 1000
WAYS: dict[str, tuple[int, ...]] = {
    "INT": (signal.SIGINT,),
    "TERM": (signal.SIGTERM,),
    "HUP": (signal.SIGHUP,),
    "STOP, CONT": (signal.SIGSTOP, signal.SIGCONT),
    "INT, TERM and HUP": (signal.SIGINT, signal.SIGTERM, signal.SIGHUP),
    "INT twice": (signal.SIGINT, signal.SIGINT),
}


def signals(size: Size, folder: Path, server: Server, sources: Path) -> list[Result]:
    """Signal recordings at most ``size.amount`` times while they start, run and end, and commands at their calls."""
    _heed_signals()
    timed, timed_faults = _at_times(compiled(folder), sources, folder / "timed", size)
    called, called_faults = _at_calls(tasks.Trials(server, sources, folder / "called"), size)
    streams, stream_faults = _streams(sources, folder / "streams", size)
    return [
        Result(
            "a signal at any moment ends a command without a traceback; what was recorded is in the run file, and "
            "other files are as before or as after",
            f"{timed} processes signalled every {1e3 * EVERY_S:.0f} ms of CPU time and while they record "
            f"({'; '.join(WAYS)}), and Ctrl-C before {called} calls that change a file",
            f"{timed + called - len(timed_faults) - len(called_faults)} as promised, none hung",
            (*timed_faults, *called_faults),
        ),
        Result(
            "a closed terminal, or closed standard streams, cost no sample and no result",
            f"{streams} commands with streams closed in every combination, or a terminal that closes",
            f"{streams - len(stream_faults)} as promised",
            tuple(stream_faults),
        ),
    ]


def _line(line: Sequence[str]) -> list[str]:
    return [sys.executable, "-c", f"from stickslip.console.start import {ENTRIES[line[0]]} as run; run()", *line[1:]]


def _heed_signals() -> None:
    """Undo what a shell does to its background jobs, for this process and those that it starts."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


@dataclass(frozen=True)
class Moment:
    """When to signal: after so much CPU time of the command, or so long after its journal holds samples."""

    cpu_s: float | None = None
    recording_s: float = 0.0

    def __str__(self) -> str:
        if self.cpu_s is None:
            return f"{self.recording_s:.1f} s after the first samples"
        return f"at {self.cpu_s:.3f} s of CPU time"


def _start(line: Sequence[str], folder: Path, **variables: str) -> "subprocess.Popen[str]":
    pipe = subprocess.PIPE
    return subprocess.Popen(
        _line(line), cwd=folder, stdout=pipe, stderr=pipe, text=True, start_new_session=True, env=os.environ | variables
    )


def _at_times(library: Path, sources: Path, folder: Path, size: Size) -> tuple[int, list[str]]:
    """Signal recordings and smoothings at equal steps of their CPU time; return how many, and the faults."""
    moments = _moments(RECORD, sources, folder) + [Moment(recording_s=after) for after in WHILE_RECORDING_S]
    trials = [(way, moment) for way in WAYS for moment in moments[:: 1 if way in SINGLE else 2]]
    trials = tasks.spread(trials, size.amount)
    smooth = TASKS["smooth"]
    smooth.begin(sources, folder)
    before = tasks.contents(folder)
    steps = tasks.spread(_moments(smooth.line, sources, folder), max(3, size.amount // len(WAYS)))
    after = tasks.contents(folder)

    def record(number: int) -> list[str]:
        way, moment = trials[number]
        place = folder / str(number)
        TASKS["record"].begin(sources, place)
        code, out, err = _signalled(library, RECORD, place, WAYS[way], moment)
        found = _recording_faults(code, out, err, place, WAYS[way])
        shutil.rmtree(place)
        return [f"{' '.join(RECORD)}, {way} {moment}: {what}" for what in found]

    def smoothed(number: int) -> list[str]:
        place = folder / f"smooth{number}"
        smooth.begin(sources, place)
        code, _, err = _signalled(library, smooth.line, place, (signal.SIGINT,), steps[number])
        found = [f"ended with {code}: {err}"] if _ended_badly(code, err, {EXIT_DONE, EXIT_INTERRUPTED}) else []
        found += tasks.spoiled(smooth, place, before, after)
        found += [f"{path.name} is left" for path in place.glob(".*")]
        shutil.rmtree(place)
        return [f"{' '.join(smooth.line)}, INT {steps[number]}: {what}" for what in found]

    with ThreadPoolExecutor(AT_A_TIME) as pool:  # a recording in real time mostly waits
        outcomes = [*pool.map(record, range(len(trials))), *pool.map(smoothed, range(len(steps)))]
    faults = [fault for found in outcomes for fault in found]
    return len(trials) + len(steps), faults


def _moments(line: Sequence[str], sources: Path, folder: Path) -> list[Moment]:
    """Return equal steps of the CPU time that a command takes from its start to its end."""
    next(task for task in TASKS.values() if task.line[1] == line[1]).begin(sources, folder)
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    _start(line, folder).communicate()
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    lasts_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return [Moment(k * EVERY_S) for k in range(int(lasts_s / EVERY_S) + 1)]


def _signalled(
    library: Path, line: Sequence[str], folder: Path, numbers: Sequence[int], moment: Moment
) -> tuple[int, str, str]:
    if moment.cpu_s is None:
        process = _start(line, folder)
        tasks.wait_for_journal(folder / "new.h5.part", lambda: process.poll() is not None)
        time.sleep(moment.recording_s)
        for number in numbers:
            process.send_signal(number)
            if number == signal.SIGSTOP:
                time.sleep(STOPPED_S)
    else:
        own = [number for number in numbers if number != signal.SIGCONT]
        asked = " ".join([f"{moment.cpu_s:.3f}", *(f"{number:d}" for number in own)])
        process = _start(line, folder, LD_PRELOAD=str(library), RELIABILITY_SIGNALS=asked)
        if signal.SIGCONT in numbers and _stops(process.pid):
            time.sleep(STOPPED_S)
            process.send_signal(signal.SIGCONT)
    try:
        out, err = process.communicate(timeout=HANGS_S)
    except subprocess.TimeoutExpired:
        process.kill()
        out, err = process.communicate()
        return -signal.SIGKILL, out, f"hung; {err}"
    return process.returncode, out, err


def _stops(pid: int) -> bool:
    """Wait until a process stops or has ended; return whether it stops."""
    until = time.monotonic() + HANGS_S
    while time.monotonic() < until:
        seen = os.waitid(os.P_PID, pid, os.WSTOPPED | os.WEXITED | os.WNOHANG | os.WNOWAIT)
        if seen is not None:
            return seen.si_code == os.CLD_STOPPED
        time.sleep(0.005)
    return False


def _ended_badly(code: int, err: str, known: set[int]) -> bool:
    """Return whether a command ended with another exit code, hung, or printed a traceback.

    At a Ctrl-C before it has come to our modules the interpreter ends as it does, with a traceback of its own.
    """
    ours = any(f"{ROOT / package}{os.sep}" in err for package in PACKAGES)
    if not ours and (code == -signal.SIGINT or "Fatal Python error: init_" in err):
        return False
    return code not in known or "Traceback" in err or "hung" in err


def _recording_faults(code: int, out: str, err: str, folder: Path, numbers: Sequence[int]) -> list[str]:
    """Return what is wrong with the end of a recording that got signals."""
    found = []
    killed = {-number for number in numbers if number != signal.SIGSTOP}
    if _ended_badly(code, err, {EXIT_DONE, EXIT_DATA, EXIT_INTERRUPTED, *killed}):
        found.append(f"ended with {code}: {err}")
    left = sorted(path.name for path in folder.iterdir())
    if code in killed and left == ["new.h5"]:  # the recording was over, and the command about to print its result
        samples = daq.load(folder / "new.h5").time.size
        return found if samples == SAMPLES else [*found, f"{samples} of {SAMPLES} samples"]
    if code in (EXIT_DONE, EXIT_DATA) and left == ["new.h5"]:
        samples = daq.load(folder / "new.h5").time.size
        if samples != json.loads(out)["samples"]:
            found.append(f"{samples} samples in the file, {out}")
        if signal.SIGSTOP in numbers and samples != SAMPLES:
            found.append(f"{samples} of {SAMPLES} samples")
    elif left == ["new.h5.part"] and code == EXIT_INTERRUPTED:
        if "daq recover" not in out:
            found.append(f"does not say what to do with the journal: {out}")
    elif left or code == EXIT_DONE:
        found.append(f"ended with {code} and left {left}: {err}")
    return found


def _at_calls(trials: tasks.Trials, size: Size) -> tuple[int, list[str]]:
    """Interrupt every command before its calls; return how often, and the faults."""
    interrupt = {"action": SEND, "error": signal.SIGINT}
    tried, faults = 0, []
    for name in TASKS:
        calls = len(trials.known(name).ended.calls)
        for at in tasks.spread(list(range(1, calls + 1)), max(2, size.amount // 25)):
            tried += 1
            faults += trials.disturb(name, at, "INT before", TASKS[name].ends, EXIT_INTERRUPTED, **interrupt)[0]
    return tried, faults


def _streams(sources: Path, folder: Path, size: Size) -> tuple[int, list[str]]:
    """Run commands without standard streams, and on terminals that close; return how many, and the faults."""
    closed = [which for n in (1, 2, 3) for which in combinations((0, 1, 2), n)]
    names = ("record", "smooth", "import", "note")
    trials = tasks.spread([(name, which) for name in names for which in closed], max(7, size.amount // 10))
    faults = []
    for name, which in trials:
        task = TASKS[name]
        task.begin(sources, folder)
        shell = " ".join(["exec", '"$@"', *(f"{number}{'<' if number == 0 else '>'}&-" for number in which)])
        ended = subprocess.run(
            ["sh", "-c", shell, "sh", *_line(task.line)],
            cwd=folder,
            capture_output=True,
            text=True,
            timeout=HANGS_S,
            check=False,
        )
        where = f"{' '.join(task.line)} with {which} closed"
        if ended.returncode not in (task.ends, EXIT_DEVICE * (1 in which)) or "Traceback" in ended.stderr:
            faults.append(f"{where}: ended with {ended.returncode}: {ended.stderr}")
        if {path.name for path in folder.iterdir()} != task.leaves:
            faults.append(f"{where}: left {sorted(path.name for path in folder.iterdir())}")
        elif name == "record" and daq.load(folder / "new.h5").time.size != tasks.SAMPLES:
            faults.append(f"{where}: samples are missing")
    terminals = max(1, size.amount // 100)
    for k in range(terminals):
        faults += _terminal_closes(folder, 0.2 + 0.6 * k / terminals)
    return len(trials) + terminals, faults


def _terminal_closes(folder: Path, after_s: float) -> list[str]:
    """Record on a terminal that closes so long after the first sample; return the faults."""
    TASKS["record"].begin(folder, folder)
    line = _line(["daq", "record", "--realtime", "--duration", "3", "-o", "new.h5"])
    terminal, side = os.openpty()
    on_terminal = "import os, sys; os.login_tty(int(sys.argv[1])); os.execv(sys.argv[2], sys.argv[2:])"
    child = subprocess.Popen([sys.executable, "-c", on_terminal, str(side), *line], cwd=folder, pass_fds=[side])
    os.close(side)
    tasks.wait_for_journal(folder / "new.h5.part")
    time.sleep(after_s)
    os.close(terminal)
    code = child.wait()
    left = sorted(path.name for path in folder.iterdir())
    if code != EXIT_DATA or left != ["new.h5"]:
        return [f"a terminal closed {after_s:.2f} s after the first sample: ended with {code} and left {left}"]
    samples = daq.load(folder / "new.h5").time.size
    return [] if samples > 900 * after_s else [f"a terminal closed after {after_s:.2f} s: {samples} samples"]
