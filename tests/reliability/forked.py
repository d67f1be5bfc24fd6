"""Commands in forks of one process that has imported everything; `preload.c` counts and spoils their calls.

A fork costs some milliseconds, where a fresh interpreter costs half a second of imports: thousands of kill points fit
into minutes.  `Server` is the campaign's side; ``python -m tests.reliability.forked LIBRARY`` the other.
"""

import contextlib
import ctypes
import importlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..conftest import no_other_law

ROOT = Path(__file__).resolve().parents[2]
SOURCE = Path(__file__).with_name("preload.c")
APPS = {
    "daq": "daq.cli.app",
    "process": "processing.cli",
    "fit-friction": "fitting.cli",
    "rig-sim": "rig_sim.cli.app",
}
HANGS_S = 60.0  # no command here takes 5 s of its own; the computer may be busy

# Kinds of calls and what happens at one: the values of preload.c.
WRITE, TRUNCATE, CREATE, RENAME, UNLINK, SYNC, CHMOD = (1 << bit for bit in range(7))
EVERY = 127
COUNT, KILL, REFUSE_ONE, REFUSE_ALL, FOLDER_RENAMED, FOLDER_REMOVED, FOLDER_EMPTIED, SEND = range(8)


@dataclass(frozen=True)
class Ended:
    """How a command ended."""

    code: int  # or minus the signal that ended it
    out: str
    err: str
    calls: tuple[int, ...]  # kinds of those that counted
    name: str  # of the call that was spoiled
    hung: bool
    syncs: tuple[float, ...]  # when each fsync returned, monotonic s
    cpu_s: float

    @property
    def traceback(self) -> bool:
        return "Traceback (most recent call last)" in self.err


def compiled(folder: Path) -> Path:
    library = folder / "preload.so"
    line = ["cc", "-std=gnu11", "-O2", "-Wall", "-shared", "-fPIC", "-o", str(library), str(SOURCE), "-ldl", "-lrt"]
    subprocess.run(line, check=True)
    return library


class Server:
    """A process that forks commands; a context manager.

    The library and the output of commands go into ``folder``; what is spoiled must lie elsewhere.
    """

    def __init__(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self._folder = folder
        self._started = 0
        library = compiled(folder)
        self._process = subprocess.Popen(
            [sys.executable, "-m", "tests.reliability.forked", str(library)],
            cwd=ROOT,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=os.environ | {"LD_PRELOAD": str(library)},
        )

    def __enter__(self) -> "Server":
        return self

    def __exit__(self, *error: object) -> None:
        self._process.stdin.close()
        self._process.wait()
        self._process.stdout.close()

    @property
    def cpu_s(self) -> float:
        used = Path(f"/proc/{self._process.pid}/stat").read_text().rpartition(")")[2].split()[11:15]
        return sum(map(int, used)) / os.sysconf("SC_CLK_TCK")

    def warm(self, line: list[str], cwd: Path) -> None:
        """Run a command in the server itself, so that its forks find everything imported and compiled."""
        self._ask({"do": "warm", "line": line, "cwd": str(cwd)})

    def run(
        self,
        line: list[str],
        cwd: Path,
        *,
        kinds: int = EVERY,
        at: int = 0,
        action: int = COUNT,
        error: int = 0,
        hangs_s: float = HANGS_S,
        all_laws: bool = False,
    ) -> Ended:
        """Run a command (an entry of `APPS` and its arguments) in a fork, which is killed after ``hangs_s``.

        Calls of ``kinds`` in its working folder count; from number ``at`` on (from 1) ``action`` happens, with
        ``error``: the errno, or the signal of SEND.  Without ``all_laws`` no law is fitted beside those asked for.
        """
        armed = {"watched": str(cwd), "kinds": kinds, "at": at, "action": action, "error": error, "all_laws": all_laws}
        return self.start(line, cwd, **armed).wait(hangs_s)

    def start(self, line: list[str], cwd: Path, **armed: Any) -> "Fork":
        """Run a command in a fork, and return at once; counts of calls are those of the fork started last."""
        self._started += 1
        armed = {"watched": "", "kinds": 0, "at": 0, "action": COUNT, "error": 0, "all_laws": False} | armed
        output = str(self._folder / str(self._started))
        asked = {"do": "start", "line": line, "cwd": str(cwd), "output": output, **armed}
        return Fork(self, self._ask(asked)["pid"], output)

    def wait(self, pid: int, output: str, hangs_s: float) -> Ended:
        found = self._ask({"do": "wait", "pid": pid, "hangs_s": hangs_s})
        texts = {}
        for name in ("out", "err"):
            place = Path(f"{output}.{name}")
            texts[name] = place.read_text(errors="replace")
            place.unlink()
        return Ended(**found | texts | {name: tuple(found[name]) for name in ("calls", "syncs")})

    def _ask(self, asked: dict[str, Any]) -> dict[str, Any]:
        self._process.stdin.write(json.dumps(asked) + "\n")
        self._process.stdin.flush()
        answer = self._process.stdout.readline()
        if not answer:
            raise RuntimeError(f"the server of forks is gone, at {asked}")
        return json.loads(answer)


def cpu_time(server: Server | None) -> float:
    """Return the CPU time of this process, of those that it has started and waited for, and of a server, s."""
    return sum(os.times()[:4]) + (server.cpu_s if server else 0.0)


@dataclass(frozen=True)
class Fork:
    """A command that runs in a fork."""

    server: Server
    pid: int
    output: str

    def send(self, number: int) -> None:
        os.kill(self.pid, number)

    def wait(self, hangs_s: float = HANGS_S) -> Ended:
        return self.server.wait(self.pid, self.output, hangs_s)


def _serve(library: ctypes.CDLL) -> None:
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    for request in sys.stdin:
        asked = json.loads(request)
        found = {"warm": _warm, "start": _start, "wait": _wait}[asked["do"]](library, asked)
        answers.write(json.dumps(found) + "\n")
        answers.flush()


def _warm(library: ctypes.CDLL, asked: dict[str, Any]) -> dict[str, Any]:
    from stickslip.console import application

    before = os.getcwd()
    os.chdir(asked["cwd"])
    with tempfile.TemporaryFile("w") as nowhere:
        out, sys.stdout = sys.stdout, nowhere
        err, sys.stderr = sys.stderr, nowhere
        try:
            code = application.run(importlib.import_module(APPS[asked["line"][0]]).app, asked["line"][1:])
        finally:
            sys.stdout, sys.stderr = out, err
            os.chdir(before)
    return {"code": code}


def _start(library: ctypes.CDLL, asked: dict[str, Any]) -> dict[str, Any]:
    library.preload_arm(os.fsencode(asked["watched"]), *(asked[name] for name in ("kinds", "at", "action", "error")))
    child = os.fork()
    if child == 0:
        _become(library, asked)
    return {"pid": child}


def _wait(library: ctypes.CDLL, asked: dict[str, Any]) -> dict[str, Any]:
    began = time.monotonic()
    hung = False
    while True:
        done, status, used = os.wait4(asked["pid"], os.WNOHANG)
        if done:
            break
        if time.monotonic() - began > asked["hangs_s"]:
            hung = True
            os.kill(asked["pid"], signal.SIGKILL)
        time.sleep(0.001)
    times, kinds = (ctypes.c_double * 4096)(), (ctypes.c_ubyte * 65536)()
    synced, counted = library.preload_syncs(times), library.preload_kinds(kinds)
    return {
        "code": os.waitstatus_to_exitcode(status),
        "hung": hung,
        "cpu_s": used.ru_utime + used.ru_stime,
        "calls": kinds[:counted],
        "name": library.preload_name().decode(),
        "syncs": times[:synced],
    }


def _become(library: ctypes.CDLL, asked: dict[str, Any]) -> None:
    """Run the command in this process, which is the fork, as its own interpreter would; never return."""
    import traceback

    from stickslip.console import application

    code: Any = 1
    try:
        os.setsid()
        signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background job ignores it
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        for number, name in ((1, "out"), (2, "err")):
            os.dup2(
                os.open(f"{asked['output']}.{name}", os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_APPEND, 0o644), number
            )
        os.chdir(asked["cwd"])
        command, *arguments = asked["line"]
        sys.argv = [command, *arguments]
        # A process of its own has not shown any; those that the server has shown would not be shown again.
        warnings.simplefilter("always", RuntimeWarning)
        app = importlib.import_module(APPS[command]).app
        searched = contextlib.nullcontext() if asked["all_laws"] or command != "fit-friction" else no_other_law()
        with searched:
            library.preload_begin()
            application.main(app)
    except SystemExit as end:
        code = end.code
    except BaseException:
        traceback.print_exc()
    finally:
        for stream in (sys.stdout, sys.stderr):
            try:
                stream.flush()
            except (OSError, ValueError):
                pass
        os._exit(code if isinstance(code, int) else 0 if code is None else 1)


if __name__ == "__main__":
    made = ctypes.CDLL(sys.argv[1])
    made.preload_arm.argtypes = [ctypes.c_char_p, *[ctypes.c_long] * 4]
    made.preload_name.restype = ctypes.c_char_p
    made.preload_kinds.restype = made.preload_syncs.restype = ctypes.c_long
    for module in APPS.values():
        importlib.import_module(module)
    _serve(made)
