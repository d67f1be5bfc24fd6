"""SIGTERM, and SIGHUP of a terminal that has gone, end a command as Ctrl-C does: what it had begun is cleared away."""

import contextlib
import os
import signal
import sys
from types import FrameType

NAMES = ("SIGTERM", "SIGHUP")


class TerminatedError(KeyboardInterrupt):
    """A signal that ends the command: it unwinds, and ends by that signal (`end_by_signal`)."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number


_came: list[int] = []
_done: list[bool] = []


def heed_signals() -> None:
    """Let the signals raise `TerminatedError` in the main thread; those that are ignored stay so (nohup)."""
    for name in NAMES:
        number = getattr(signal, name, None)
        if number is not None and signal.getsignal(number) is signal.SIG_DFL:
            signal.signal(number, terminate)


def terminate(number: int, frame: FrameType | None) -> None:
    """Raise `TerminatedError`, unless the command clears away already: a terminal and `timeout` may signal twice."""
    _came.append(number)
    if _done or isinstance(sys.exc_info()[1], KeyboardInterrupt):
        return
    if callable(signal.getsignal(signal.SIGINT)):
        signal.signal(signal.SIGINT, lambda number, frame: None)  # not SIG_IGN, of which Python complains if one waits
    raise TerminatedError(number)


def end_by_signal() -> None:
    """End the process by the signal that ended the command, as its caller expects; heed no more where none came."""
    _done.append(True)
    if not _came:
        return
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError):
            stream.flush()
    signal.signal(_came[0], signal.SIG_DFL)
    os.kill(os.getpid(), _came[0])
