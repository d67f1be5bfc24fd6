"""Many inputs, one after the other, in a child process that is watched: what crashes it, hangs it or writes elsewhere.

A child reports each fault as a line; where it dies the parent notes the input and goes on behind it in a new child.
"""

import contextlib
import mmap
import os
import resource
import signal
import sys
import traceback
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from daq.runfile import isolation
from stickslip.errors import StickslipError

SECONDS, MEMORY = 10, 1 << 30  # that an input may take: CPU time, and bytes beyond those of the imported programs
REPORTED = 50  # every so many inputs a child says what it has done
HANGS_S = 120  # on the clock: another program may hold the processor
# Of what Python reports to its audit hooks: what writes, by the place of its path among the arguments.
WRITES = {
    "os.rename": (0, 1),
    "os.remove": (0,),
    "os.mkdir": (0,),
    "os.rmdir": (0,),
    "os.truncate": (0,),
    "os.chmod": (0,),
}
STARTS = ("subprocess.Popen", "os.system", "os.exec", "os.posix_spawn", "socket.connect", "ctypes.dlopen")
FLAGS = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND


@dataclass
class Tried:
    """What became of a number of inputs, and the worst of each cost.

    ``taken`` were read, and ``crashed`` crashed a child process of the program; the others were refused otherwise.
    """

    inputs: int = 0
    taken: int = 0
    crashed: int = 0
    slowest_s: float = 0.0
    most_bytes: int = 0
    cpu_s: float = 0.0
    faults: list[str] = field(default_factory=list)


def run(name: str, calls: int, folder: Path, one: Callable[[int, Path], None], together: int = 1) -> Tried:
    """Call ``one`` with 0, 1, 2 ... in children.

    It makes the input of a number, or ``together`` of them, in the folder, which is the only one that may be written
    to, and tries it.  A `StickslipError` is a refusal, any other exception and any warning a fault.
    """
    tried = Tried()
    at = 0
    # Shared with the children: the number at work, whether something was done that may not be.
    with mmap.mmap(-1, 64) as shared:
        while at < calls:
            reading, writing = os.pipe()
            child = os.fork()
            if child == 0:
                os.close(reading)
                _be_child(name, range(at, calls), folder, one, shared, writing)
            os.close(writing)
            with open(reading) as lines:
                for line in lines:
                    _note(tried, line.rstrip("\n"), together)
            _, status, used = os.wait4(child, 0)
            tried.cpu_s += used.ru_utime + used.ru_stime
            at = int.from_bytes(shared[:8], "little") + 1
            if status:
                how = f"signal {os.WTERMSIG(status)}" if os.WIFSIGNALED(status) else f"exit {os.WEXITSTATUS(status)}"
                tried.faults.append(f"{name} {at - 1}: the process died, {how}")
    return tried


def _note(tried: Tried, line: str, together: int) -> None:
    kind, _, rest = line.partition(" ")
    if kind == "fault":
        tried.faults.append(rest.replace("\\n", "\n"))
        return
    inputs, taken, crashed, slowest, most = rest.split()
    tried.crashed += int(crashed)
    tried.inputs += int(inputs) * together
    tried.taken += int(taken) * together
    tried.slowest_s = max(tried.slowest_s, float(slowest))
    tried.most_bytes = max(tried.most_bytes, int(most))


def _be_child(
    name: str, numbers: range, folder: Path, one: Callable[[int, Path], None], shared: mmap.mmap, writing: int
) -> None:
    code = 1
    with contextlib.suppress(BaseException):
        os.chdir(folder)
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        warnings.simplefilter("error")
        _limit()
        _watch(folder, shared)
        with open(writing, "w", buffering=1) as report:
            for line in _try(name, numbers, folder, one, shared):
                report.write(line + "\n")
        code = 0
    os._exit(code)


def _limit() -> None:
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    most = pages * resource.getpagesize() + MEMORY
    resource.setrlimit(resource.RLIMIT_AS, (most, resource.RLIM_INFINITY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def _watch(folder: Path, shared: mmap.mmap) -> None:
    """Note whatever is written outside the folder, and every program that is started."""
    inside = (f"{folder}/", os.devnull)

    def elsewhere(path: object) -> bool:
        return isinstance(path, str | os.PathLike) and not os.path.abspath(path).startswith(inside)

    def hook(event: str, arguments: tuple[object, ...]) -> None:
        wrong = event in STARTS
        if event == "open":
            path, _, flags = arguments
            wrong = isinstance(flags, int) and bool(flags & FLAGS) and elsewhere(path)
        elif event in WRITES:
            wrong = any(elsewhere(arguments[place]) for place in WRITES[event])
        if wrong:
            shared[8:9] = b"!"

    sys.addaudithook(hook)


def _try(name: str, numbers: range, folder: Path, one: Callable[[int, Path], None], shared: mmap.mmap) -> Iterator[str]:
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    inputs, taken, crashed, slowest = 0, 0, 0, 0.0
    for number in numbers:
        shared[:9] = number.to_bytes(8, "little") + b"\0"
        signal.alarm(HANGS_S)
        began = _cpu()
        try:
            one(number, folder)
            taken += 1
        except StickslipError as error:
            crashed += isolation.CRASHED in error.what
        except BaseException:
            yield "fault " + f"{name} {number}: {_short(traceback.format_exc())}".replace("\n", "\\n")
        used = _cpu() - began
        inputs += 1
        slowest = max(slowest, used)
        if used > SECONDS:
            yield f"fault {name} {number}: takes {used:.1f} s"
        if shared[8:9] != b"\0":
            yield f"fault {name} {number}: writes elsewhere, or starts a program"
        if number % REPORTED == 0 or number == numbers[-1]:
            most = 1024 * (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
            yield f"done {inputs} {taken} {crashed} {slowest} {most}"
            inputs, taken, crashed, slowest = 0, 0, 0, 0.0
    signal.alarm(0)


def _cpu() -> float:
    own, children = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return own.ru_utime + own.ru_stime + children.ru_utime + children.ru_stime


def _short(text: str) -> str:
    """Return the last line of a traceback, with the last place of the project's own in it."""
    lines = text.rstrip().splitlines()
    own = [line.strip() for line in lines if line.lstrip().startswith("File") and "site-packages" not in line]
    return f"{lines[-1][:200]} ({own[-1][:160] if own else ''})"
