"""The right to finish or remove a journal: one process at a time holds its lock (`stickslip.output.lock`)."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import datetime
from functools import partial
from pathlib import Path

from daq.runfile import journal, journal_records
from daq.runfile.regular import open_regular
from stickslip.errors import InputError
from stickslip.output.lock import FileLock


@contextmanager
def claim_journal(path: Path) -> Iterator[Callable[[], None]]:
    """Hold a journal's lock, if the file system has locks; yield the function that removes the journal.

    Raises InputError if a recording is writing it, another process is finishing it, or it does not exist.
    """
    open_regular(path, journal.USE).close()
    try:
        lock = FileLock(path)
    except BlockingIOError as error:
        what, do = explain_lock(path)
        raise InputError(what, str(path), do) from error
    except OSError:  # no locks here, or no right to open it for writing
        yield path.unlink
        return
    try:
        yield partial(lock.remove, path)
    finally:
        lock.release()


def is_locked(path: Path) -> bool:
    """Return whether another process is writing or finishing a journal."""
    try:
        FileLock(path).release()
    except BlockingIOError:
        return True
    except OSError:
        return False
    return False


def explain_lock(path: Path) -> tuple[str, str]:
    """Return the holder of a journal's lock, and what to do about it."""
    owner = "another process"
    try:
        started = journal.read_header(path)
        when = datetime.fromtimestamp(started["wall_ns"] / 1e9).astimezone()
        owner = f"process {started['pid']} on {started['host']}, since {when:%Y-%m-%d %H:%M:%S}"
    except (OSError, InputError, KeyError, OverflowError, ValueError):
        pass
    return (
        f"this file is being written by a recording ({owner})",
        "wait until that recording ends, or stop it with Ctrl-C in its terminal",
    )


def remove_empty(path: Path) -> bool:
    """Remove a journal that ended before the first byte was received; return whether it is gone."""
    try:
        lock = FileLock(path)
    except OSError:
        return not path.exists()
    try:
        with path.open("rb") as file:
            content = file.read(journal.HEADER_EVERY)
        records = list(journal_records.scan(journal.Content(content)))
        headers_end = max((place.at + place.record.size for place in records), default=len(journal.MAGIC))
        only_headers = all(place.record.kind == journal.HEADER for place in records)
        only_headers = only_headers and content[headers_end : headers_end + 1] in (b"", bytes([journal.HEADER]))
        is_journal = journal.MAGIC.startswith(content[: len(journal.MAGIC)])
        if is_journal and only_headers and len(content) < journal.HEADER_EVERY:
            lock.remove(path)
    except OSError:
        return False
    finally:
        lock.release()
    return not path.exists()
