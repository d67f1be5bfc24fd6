"""The log of a command, by Python's `logging`: on stderr with ``--verbose``, in a file with ``--log FILE``.

Both flags go with every command and are taken off the command line before it is parsed.  Modules log to the logger of
their name; other packages' logs are left out.  A log decides nothing: what it cannot write is dropped, and a file is
written by a thread of its own, so that a slow disk delays nobody.
"""

import contextlib
import errno
import logging
import platform
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TextIO

from stickslip.errors import InputError
from stickslip.text import printable

PACKAGES = ("stickslip", "daq", "processing", "fitting", "rig_sim")
MARK = "# log of stickslip"
FLAGS = (
    "Besides, every command takes --verbose, which prints on stderr what it does, and --log FILE, which adds that to a "
    "file in more detail."
)
# What the disk may answer to who writes on it: it is full, a quota is, it is damaged, it has become read-only.
TAKES_NOTHING = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EROFS)
logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class LogFlags:
    """Whether stderr shows the log, and the file that it is added to."""

    verbose: bool = False
    file: Path | None = None


def taken_off(arguments: Sequence[str]) -> tuple[list[str], LogFlags]:
    """Return the command line without ``--verbose`` and ``--log FILE``, and their values.

    Raises InputError: ``--log`` without a file, or given twice.
    """
    rest, verbose, files = [], False, []
    waiting = iter(arguments)
    for argument in waiting:
        if argument == "--":
            rest += [argument, *waiting]
        elif argument == "--verbose":
            verbose = True
        elif argument == "--log" or argument.startswith("--log="):
            name = argument.removeprefix("--log").removeprefix("=") or next(waiting, "")
            if not name or (name.startswith("-") and name != "-"):
                raise InputError("--log without a file", "command line", "write --log FILE")
            files.append(Path(name))
        else:
            rest.append(argument)
    if len(files) > 1:
        raise InputError("--log given twice", "command line", "give it once")
    return rest, LogFlags(verbose, files[0] if files else None)


@contextmanager
def logging_to(flags: LogFlags, name: str, arguments: Sequence[str]) -> Iterator[None]:
    """Log what happens in the block: stderr gets INFO and above, the file everything; nothing without flags.

    Raises InputError: the file is no log of ours, which is not added to.
    Raises OSError: it cannot be opened.  Where the disk takes nothing there is no error: stderr says that no log is
        written.
    """
    if not flags.verbose and flags.file is None:
        yield
        return
    logging.raiseExceptions = False
    with contextlib.ExitStack() as stack:
        for handler, level in _handlers(flags, stack):
            handler.setLevel(level)
            for package in PACKAGES:
                package_log = logging.getLogger(package)
                package_log.setLevel(logging.DEBUG)
                package_log.propagate = False
                package_log.addHandler(handler)
                stack.callback(package_log.removeHandler, handler)
        from stickslip.version import VERSION

        logger.info("%s %s on Python %s, %s", name, VERSION, platform.python_version(), platform.platform())
        logger.info("in %s: %s", Path.cwd(), " ".join([name, *arguments]))
        begun, cpu = time.monotonic(), time.process_time()
        try:
            yield
        except BaseException:
            logger.debug("ended by an exception", exc_info=True)
            raise
        finally:
            spent = time.monotonic() - begun, time.process_time() - cpu
            logger.info("done after %.2f s, %.2f s of CPU time", *spent)


def _handlers(flags: LogFlags, stack: contextlib.ExitStack) -> Iterator[tuple[logging.Handler, int]]:
    if flags.verbose:
        shown = _StderrHandler()
        shown.setFormatter(_Printable("%(message)s"))
        yield shown, logging.INFO
    if flags.file is not None:
        import queue
        from logging.handlers import QueueHandler, QueueListener

        _refuse_foreign(flags.file)
        stream = _opened(flags.file)
        if stream is None:
            return
        stack.callback(_close, stream)
        written = logging.StreamHandler(stream)
        written.setFormatter(_Printable("%(asctime)s.%(msecs)03d %(levelname)-7s %(name)s: %(message)s", "%F %T"))
        waiting: queue.SimpleQueue[logging.LogRecord] = queue.SimpleQueue()
        listener = QueueListener(waiting, written)
        listener.start()
        stack.callback(listener.stop)
        yield QueueHandler(waiting), logging.DEBUG


def _opened(file: Path) -> TextIO | None:
    """Return a log, with its first line; None where the disk takes nothing."""
    try:
        stream = file.open("a", encoding="utf-8")
        try:
            if stream.tell() == 0:
                stream.write(MARK + "\n")
                stream.flush()
        except OSError:
            _close(stream)
            raise
    except OSError as error:
        if error.errno not in TAKES_NOTHING:
            raise
        sys.stderr.write(printable(f"no log is written: {file}: {error.strerror}\n", sys.stderr.encoding))
        return None
    return stream


def _close(stream: TextIO) -> None:
    with contextlib.suppress(OSError):  # of what waits to be written
        stream.close()


class _Printable(logging.Formatter):
    """Writes control characters as escapes: a log is read in a terminal."""

    def format(self, record: logging.LogRecord) -> str:
        """Return the line, or the lines with a traceback."""
        return printable(super().format(record))


def _refuse_foreign(file: Path) -> None:
    """Raise InputError for a file that exists and is no log of ours: it would be added to."""
    if file.exists() and not file.is_file():
        raise InputError("is not a file", str(file), "give another name (--log)")
    if file.exists():
        with file.open("rb") as stream:
            begins = stream.read(len(MARK))
        if begins not in (b"", MARK.encode()):
            raise InputError("exists and is no log of stickslip", str(file), "give another name (--log)")


class _StderrHandler(logging.Handler):
    """Writes to the stderr of the moment: a progress bar replaces it while it is drawn."""

    def emit(self, record: logging.LogRecord) -> None:
        """Write a line; what cannot be written is dropped."""
        with contextlib.suppress(OSError, ValueError):
            sys.stderr.write(self.format(record) + "\n")
