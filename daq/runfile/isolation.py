"""Work on a file from a stranger in a child process: what crashes, hangs or fills a library of C ends the child alone.

On Linux the child is a fork, which costs a few milliseconds.  Elsewhere, where libraries of the system do not survive
one, it is a new interpreter, which costs 0.2 s.  Other threads of this process do no harm to a fork: h5py and the
system's memory allocator hold their locks meanwhile, and the work needs no others.
"""

import faulthandler
import importlib
import json
import os
import select
import signal
import subprocess
import sys
import time
import traceback
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import NoReturn

from stickslip.compute.interpreter import start_python
from stickslip.errors import InputError

Work = Callable[[Path], bytes]
# First byte of what came of a child; nothing came of one that crashed.
DONE, REFUSED, FAULT, NO_MEMORY, TOO_LONG = b"=", b"!", b"?", b"m", b"t"
CRASHED = "crashes the library that reads such files"
# Seconds on the clock per second of CPU time that the child may use: a busy computer is no fault of the file.
PATIENCE = 10


class BrokenOffError(Exception):
    """The child ended without an answer; the text says how: it crashed, or took too much time or memory."""


def isolated(work: Work, path: Path, seconds: float, memory: int) -> bytes:
    """Return ``work(path)``, done in a child process.

    work: A function of a module, which takes the path and returns bytes.
    path: The file that it works on.
    seconds: CPU time that it may take, s.
    memory: Bytes that it may take (on Linux).
    Raises InputError: what ``work`` raises.
    Raises BrokenOffError: the child crashed, or was ended by one of the limits.
    Raises RuntimeError: any other exception of ``work``, as text.
    """
    sent = (_fork if sys.platform == "linux" else _spawn)(work, path, seconds, memory)
    kind, content = sent[:1], sent[1:]
    if kind == DONE:
        return content
    if kind == REFUSED:
        raise InputError(**json.loads(content))
    if kind == NO_MEMORY:
        raise BrokenOffError(f"takes more than {memory >> 20} MB of memory to read")
    if kind == FAULT:
        raise RuntimeError(content.decode())
    if kind == TOO_LONG:
        raise BrokenOffError(f"takes more than {seconds:.0f} s to read")
    raise BrokenOffError(CRASHED)


def _answer(work: Work, path: Path, seconds: float, memory: int) -> bytes:
    """Do the work in the child."""
    faulthandler.disable()
    _limit(seconds, memory)
    try:
        return DONE + work(path)
    except InputError as error:
        return REFUSED + json.dumps(error.as_json()).encode()
    except MemoryError:
        return NO_MEMORY
    except Exception:
        return FAULT + traceback.format_exc().encode()


def _limit(seconds: float, memory: int) -> None:
    try:
        import resource
    except ImportError:  # Windows
        return
    used = time.process_time()
    wanted = {resource.RLIMIT_CPU: int(used + seconds) + 1, resource.RLIMIT_CORE: 0}
    if sys.platform == "linux":
        pages = int(Path("/proc/self/statm").read_text().split()[0])
        wanted[resource.RLIMIT_AS] = pages * resource.getpagesize() + memory
    for what, most in wanted.items():
        hard = resource.getrlimit(what)[1]
        soft = most if hard == resource.RLIM_INFINITY else min(most, hard)
        resource.setrlimit(what, (soft, hard))


def _fork(work: Work, path: Path, seconds: float, memory: int) -> bytes:
    """Return what the child sent, or `TOO_LONG`."""
    reading, writing = os.pipe()
    # A signal must find its handlers set: a KeyboardInterrupt in the child would go on as a second parent.
    blocked = signal.pthread_sigmask(signal.SIG_BLOCK, signal.valid_signals())
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # of threads, from Python 3.12
            child = os.fork()
        if child == 0:
            _be_child(work, path, seconds, memory, writing, blocked)
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, blocked)
    os.close(writing)
    sent: bytes | None = None
    try:
        sent = _received(reading, time.monotonic() + PATIENCE * seconds)
    finally:
        os.close(reading)
        if not sent:  # it is too late, or this process is interrupted
            os.kill(child, signal.SIGKILL)
        status = os.waitpid(child, 0)[1]
    late = sent is None or (os.WIFSIGNALED(status) and os.WTERMSIG(status) == signal.SIGXCPU)
    return TOO_LONG if late else sent or b""


def _be_child(
    work: Work, path: Path, seconds: float, memory: int, writing: int, mask: set[int | signal.Signals]
) -> NoReturn:
    try:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends it
        for number in (signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, signal.SIG_DFL)
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)  # the last words of a crashing library
        with open(writing, "wb") as pipe:
            pipe.write(_answer(work, path, seconds, memory))
    finally:
        os._exit(0)


def _received(reading: int, until: float) -> bytes | None:
    """Return what comes through a pipe until it is closed; None past a time of the monotonic clock."""
    poll = select.poll()
    poll.register(reading, select.POLLIN)
    parts: list[bytes] = []
    while poll.poll(max(0.0, 1000 * (until - time.monotonic()))):
        part = os.read(reading, 1 << 20)
        if not part:
            return b"".join(parts)
        parts.append(part)
    return None


def _spawn(work: Work, path: Path, seconds: float, memory: int) -> bytes:
    """Return what `_fork` returns, of a new interpreter."""
    words = (work.__module__, work.__qualname__, str(path), repr(seconds), str(memory))
    nowhere = subprocess.DEVNULL
    with start_python(__name__, *words, stdin=nowhere, stdout=subprocess.PIPE, stderr=nowhere) as child:
        try:
            sent: bytes = child.communicate(timeout=PATIENCE * seconds)[0]
        except subprocess.TimeoutExpired:
            return TOO_LONG
        finally:
            child.kill()  # it is too late, or this process is interrupted
    if child.returncode < 0 and child.returncode == -getattr(signal, "SIGXCPU", 0):
        return TOO_LONG
    return sent


def _main(module: str, name: str, path: str, seconds: str, memory: str) -> None:
    work: Work = getattr(importlib.import_module(module), name)
    sys.stdout.buffer.write(_answer(work, Path(path), float(seconds), int(memory)))


if __name__ == "__main__":
    _main(*sys.argv[1:])
