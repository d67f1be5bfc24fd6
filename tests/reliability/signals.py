"""Signals at every moment of a command, terminals that close, and standard streams that are closed already."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from itertools import combinations
from pathlib import Path

import daq
from daq.errors import EXIT_DATA, EXIT_DEVICE, EXIT_DONE, EXIT_INTERRUPTED

from . import campaign, tasks
from .campaign import Result, Size
from .forked import HANGS_S, SEND, Server
from .tasks import TASKS

ENTRIES = {"daq": "daq", "process": "process", "fit-friction": "fit_friction"}
EVERY_S = 0.025
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


def signals(size: Size, folder: Path) -> list[Result]:
    """Signal commands ``size.amount`` times in all while they start, run and end, and as often at their calls."""
    _heed_signals()
    with Server(folder / "server") as server:
        sources = folder / "sources"
        tasks.prepare(server, sources)
        timed, timed_faults = _at_times(sources, folder / "timed", size)
        called, called_faults = _at_calls(server, sources, folder / "called", size)
    streams, stream_faults = _streams(sources, folder / "streams", size)
    return [
        Result(
            "a signal at any moment ends a command without a traceback; what was recorded is in the run file, and "
            "other files are as before or as after",
            f"{timed} processes signalled every {1e3 * EVERY_S:.0f} ms from their start to their end "
            f"({'; '.join(WAYS)}), and Ctrl-C before {called} calls that change a file",
            f"{timed + called - len(timed_faults) - len(called_faults)} as promised, none hung",
            campaign.test_of("signals"),
            (*timed_faults, *called_faults),
        ),
        Result(
            "a closed terminal, or closed standard streams, cost no sample and no result",
            f"{streams} commands with stdin, stdout and stderr closed in every combination, or a terminal that closes",
            f"{streams - len(stream_faults)} as promised",
            campaign.test_of("signals"),
            tuple(stream_faults),
        ),
    ]


def _line(line: Sequence[str]) -> list[str]:
    """Return a command line as the installed command begins, with its entry point."""
    return [sys.executable, "-c", f"from daq.console.start import {ENTRIES[line[0]]} as run; run()", *line[1:]]


def _heed_signals() -> None:
    """Undo what a shell does to its background jobs, for this process and those that it starts."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


def _start(line: Sequence[str], folder: Path) -> "subprocess.Popen[str]":
    pipe = subprocess.PIPE
    return subprocess.Popen(_line(line), cwd=folder, stdout=pipe, stderr=pipe, text=True, start_new_session=True)


def _at_times(sources: Path, folder: Path, size: Size) -> tuple[int, list[str]]:
    """Signal recordings and smoothings at equal steps of time; return how many, and the faults."""
    lasts_s = _duration(RECORD, sources, folder)
    moments = [k * EVERY_S for k in range(int(lasts_s / EVERY_S))]
    trials = [(way, after) for way in WAYS for after in moments]
    trials = tasks.spread(trials, size.amount)
    faults = []
    for way, after in trials:
        TASKS["record"].begin(sources, folder)
        code, out, err = _signalled(RECORD, folder, WAYS[way], after)
        where = f"{' '.join(RECORD)}, {way} after {after:.3f} s"
        faults += [f"{where}: {what}" for what in _recording_faults(code, out, err, folder, WAYS[way])]
    smooth = TASKS["smooth"]
    smooth.begin(sources, folder)
    before = tasks.contents(folder)
    lasts_s = _duration(smooth.line, sources, folder)
    after_contents = tasks.contents(folder)
    steps = tasks.spread([k * EVERY_S for k in range(int(lasts_s / EVERY_S))], max(3, size.amount // len(WAYS)))
    for after in steps:
        smooth.begin(sources, folder)
        code, _, err = _signalled(smooth.line, folder, (signal.SIGINT,), after)
        where = f"{' '.join(smooth.line)}, INT after {after:.3f} s"
        if "Traceback" in err or code not in (EXIT_DONE, EXIT_INTERRUPTED, -signal.SIGINT):
            faults.append(f"{where}: ended with {code}: {err}")
        faults += [f"{where}: {what}" for what in tasks.spoiled(smooth, folder, before, after_contents)]
        faults += [f"{where}: {path.name} is left" for path in folder.glob(".*")]
    return len(trials) + len(steps), faults


def _duration(line: Sequence[str], sources: Path, folder: Path) -> float:
    """Return how long a command lasts from its start to its end, s."""
    next(task for task in TASKS.values() if task.line[1] == line[1]).begin(sources, folder)
    began = time.monotonic()
    _start(line, folder).communicate()
    return time.monotonic() - began


def _signalled(line: Sequence[str], folder: Path, numbers: Sequence[int], after_s: float) -> tuple[int, str, str]:
    """Run a command, send it signals after a time; return its exit code and what it printed."""
    process = _start(line, folder)
    time.sleep(after_s)
    for number in numbers:
        process.send_signal(number)
        if number == signal.SIGSTOP:
            time.sleep(0.05)
    try:
        out, err = process.communicate(timeout=HANGS_S)
    except subprocess.TimeoutExpired:
        process.kill()
        out, err = process.communicate()
        return -signal.SIGKILL, out, f"hung; {err}"
    return process.returncode, out, err


def _recording_faults(code: int, out: str, err: str, folder: Path, numbers: Sequence[int]) -> list[str]:
    """Return what is wrong with the end of a recording that got signals."""
    found = []
    allowed = {EXIT_DONE, EXIT_DATA, EXIT_INTERRUPTED, *(-number for number in numbers if number != signal.SIGSTOP)}
    if code not in allowed or "Traceback" in err or "hung" in err:
        found.append(f"ended with {code}: {err}")
    left = sorted(path.name for path in folder.iterdir())
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


def _at_calls(server: Server, sources: Path, folder: Path, size: Size) -> tuple[int, list[str]]:
    """Interrupt every command before its calls; return how often, and the faults."""
    tried, faults = 0, []
    for task in TASKS.values():
        known = tasks.undisturbed(server, task, sources, folder)
        calls = known.ended.calls
        for at in tasks.spread(list(range(1, len(calls) + 1)), max(2, size.amount // len(TASKS))):
            task.begin(sources, folder)
            ended = server.run(list(task.line), folder, at=at, action=SEND, error=signal.SIGINT)
            tried += 1
            where = f"{' '.join(task.line)}, INT before call {at} of {len(calls)}"
            if ended.traceback or ended.hung or ended.code not in (task.ends, EXIT_INTERRUPTED):
                faults.append(f"{where}: ended with {ended.code}: {ended.err}")
            faults += tasks.aftermath(server, task, folder, known, where)[0]
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
