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


_signals: list[int] = []
_ending: list[bool] = []


def heed_signals() -> None:
    """Let the signals raise `TerminatedError` in the main thread; those that are ignored stay so (nohup)."""
    for name in NAMES:
        number = getattr(signal, name, None)
        if number is not None and signal.getsignal(number) is signal.SIG_DFL:
            signal.signal(number, terminate)


def terminate(number: int, frame: FrameType | None) -> None:
    """Raise `TerminatedError`, unless the command is cleaning up already: a terminal and `timeout` may signal twice."""
    _signals.append(number)
    if _ending or isinstance(sys.exc_info()[1], KeyboardInterrupt):
        return
    if callable(signal.getsignal(signal.SIGINT)):
        signal.signal(signal.SIGINT, lambda number, frame: None)  # not SIG_IGN, of which Python complains if one waits
    raise TerminatedError(number)


def end_by_signal() -> None:
    """End the process by the signal that ended the command, as its caller expects; return where none came."""
    _ending.append(True)
    if not _signals:
        return
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError):
            stream.flush()
    signal.signal(_signals[0], signal.SIG_DFL)
    os.kill(os.getpid(), _signals[0])
