"""The log of a command, by Python's `logging`: on stderr with ``--verbose``, in a file with ``--log FILE``.

Both flags go with every command and are taken off the command line before it is parsed.  Modules log to the logger of
their name; other packages' logs are left out.  A log decides nothing: what it cannot write is dropped.
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
    "All commands accept --verbose (progress on stderr), --log FILE (detailed log), --version and --help; "
    "--install-completion lets your shell complete them."
)
# What the disk may answer to who writes on it: it is full, a quota is, it is damaged, it has become read-only.
TAKES_NOTHING = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EROFS)
logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class LogFlags:
    """Whether stderr shows the log, and the file that it is added to."""

    verbose: bool = False
    file: Path | None = None


def take_log_flags(arguments: Sequence[str]) -> tuple[list[str], LogFlags]:
    """Return the command line without ``--verbose`` and ``--log FILE``, and their values."""
    rest, verbose, files = [], False, []
    remaining = iter(arguments)
    for argument in remaining:
        if argument == "--":
            rest += [argument, *remaining]
        elif argument == "--verbose":
            verbose = True
        elif argument == "--log" or argument.startswith("--log="):
            name = argument.removeprefix("--log").removeprefix("=") or next(remaining, "")
            if not name or (name.startswith("-") and name != "-"):
                raise InputError("--log requires a file", "command line", "write --log FILE")
            files.append(Path(name))
        else:
            rest.append(argument)
    if len(files) > 1:
        raise InputError("--log is given twice", "command line", "use it only once")
    return rest, LogFlags(verbose, files[0] if files else None)


@contextmanager
def log_to(flags: LogFlags, name: str, arguments: Sequence[str]) -> Iterator[None]:
    """Log the block on stderr (INFO) and in a file (all); a full disk is reported on stderr and raises nothing."""
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
        started, cpu = time.monotonic(), time.process_time()
        try:
            yield
        except BaseException:
            logger.debug("ended by an exception", exc_info=True)
            raise
        finally:
            spent = time.monotonic() - started, time.process_time() - cpu
            logger.info("done after %.2f s, %.2f s of CPU time", *spent)


def _handlers(flags: LogFlags, stack: contextlib.ExitStack) -> Iterator[tuple[logging.Handler, int]]:
    if flags.verbose:
        console_handler = _StderrHandler()
        console_handler.setFormatter(_Printable("%(message)s"))
        yield console_handler, logging.INFO
    if flags.file is not None:
        _refuse_foreign(flags.file)
        stream = _open_log(flags.file)
        if stream is None:
            return
        stack.callback(_close, stream)
        file_handler = logging.StreamHandler(stream)
        file_handler.setFormatter(_Printable("%(asctime)s.%(msecs)03d %(levelname)-7s %(name)s: %(message)s", "%F %T"))
        yield file_handler, logging.DEBUG


def _open_log(file: Path) -> TextIO | None:
    """Return a log, with its first line; None where the disk refuses."""
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
        sys.stderr.write(printable(f"the log cannot be written: {file}: {error.strerror}\n", sys.stderr.encoding))
        return None
    return stream


def _close(stream: TextIO) -> None:
    with contextlib.suppress(OSError):  # of what waits to be written
        stream.close()


class _Printable(logging.Formatter):
    """Writes control characters as escapes: a log is read in a terminal."""

    def format(self, record: logging.LogRecord) -> str:
        return printable(super().format(record))


def _refuse_foreign(file: Path) -> None:
    """Raise InputError for an existing file that is not a log of this program."""
    if file.exists() and not file.is_file():
        raise InputError("is not a file", str(file), "choose another name (--log)")
    if file.exists():
        with file.open("rb") as stream:
            begins = stream.read(len(MARK))
        if begins not in (b"", MARK.encode()):
            raise InputError("exists and is not a log of stickslip", str(file), "choose another name (--log)")


class _StderrHandler(logging.Handler):
    """Writes to the stderr of the moment: a progress bar replaces it while it is drawn."""

    def emit(self, record: logging.LogRecord) -> None:
        with contextlib.suppress(OSError, ValueError):
            sys.stderr.write(self.format(record) + "\n")
