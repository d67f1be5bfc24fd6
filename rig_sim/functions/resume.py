"""Finished parts of a long computation in a file of JSON lines, so that it can be continued after an interruption.

The first line, the header, says which computation the file belongs to; each further line is one finished row.  A line
is handed to the system as soon as its row is finished: a process that ends, however it ends, loses no earlier row.  The
line that it was writing may be cut; it is dropped when the file is opened again.
"""

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

from stickslip.errors import InputError
from stickslip.output import disk
from stickslip.output.atomic import refuse_existing
from stickslip.output.lock import FileLock

LONGEST_HEADER = 1 << 20  # bytes; what has a longer first line is another file


class ResumeFile:
    """Rows of an earlier run, and the place for further ones: see `resuming`.

    Attributes
    ----------
    path : Path
    rows : list of dict
        What was there when the file was opened.
    number : int
        Rows that the file has now.
    """

    def __init__(self, path: Path, header: Mapping[str, Any], file: IO[bytes]) -> None:
        self.path = path
        self._header = _line(header)
        self._file = file
        self.rows, kept = _read(file, path, self._header)
        self.number = len(self.rows)
        with disk.writing(path):  # the header goes with the first row
            file.seek(file.truncate(kept if self.rows else 0))

    def append(self, row: Mapping[str, Any]) -> None:
        """Write a row of JSON types.

        Raises
        ------
        RefusedError
            The disk refuses; the rows before stay.
        """
        with disk.writing(self.path):
            self._file.write(_line(row) if self.number else self._header + _line(row))
            self._file.flush()
        self.number += 1


@contextmanager
def resuming(path: Path, header: Mapping[str, Any], flag: str = "--resume") -> Iterator[ResumeFile]:
    """Open a file to continue a computation, or to begin one; a file to which nothing was written is removed.

    Parameters
    ----------
    path : Path
        Locked meanwhile, where the file system has locks.
    header : mapping of JSON types
        All that the rows depend on; a file without its first key is of another kind.
    flag : str
        The flag that names the file, for messages.

    Raises
    ------
    InputError
        The file belongs to another computation (the message names the first difference) or is of another kind, a line
        other than the last is damaged, or another process writes it.  The file stays as it is.
    RefusedError
        The disk refuses the file.
    """
    refuse_existing(path, True, flag=flag)
    with disk.writing(path):
        path.touch()
        file = path.open("r+b")
    lock = None
    try:
        lock = _lock(path)
        yield ResumeFile(path, header, file)
    finally:
        try:
            with disk.writing(path):
                file.close()
        finally:
            if lock is not None and path.exists() and path.stat().st_size == 0:
                lock.remove(path)
            elif lock is not None:
                lock.release()


def _lock(path: Path) -> FileLock | None:
    """Return the lock on a file; None where the file system has no locks."""
    try:
        return FileLock(path)
    except BlockingIOError:
        do = "wait for it to end, or name another file"
        raise InputError("another process is writing it", str(path), do) from None
    except OSError:
        return None


def _line(content: Mapping[str, Any]) -> bytes:
    return json.dumps(content, allow_nan=False).encode() + b"\n"


def _read(file: IO[bytes], path: Path, header: bytes) -> tuple[list[dict[str, Any]], int]:
    """Return the rows, and the size in bytes of the lines that are not cut."""
    first = file.readline(LONGEST_HEADER)
    if not first.endswith(b"\n"):
        if not header.startswith(first):
            raise _foreign(path)
        return [], 0
    there, here = _parsed(first), json.loads(header)
    if there is None or next(iter(here)) not in there:
        raise _foreign(path)
    for name, old, new in _differences(there, here):
        what = f"belongs to another computation: {name} is {old!r:.60} there and {new!r:.60} here"
        raise InputError(what, str(path), "repeat the command that began it, or name another file")
    complete, newline, _ = file.read().rpartition(b"\n")
    rows = []
    for number, line in enumerate(complete.split(b"\n") if newline else [], 2):
        row = _parsed(line)
        if row is None:
            raise InputError(f"line {number} is damaged", str(path), "remove that line: its row is computed again")
        rows.append(row)
    return rows, len(first) + len(complete) + len(newline)


def _foreign(path: Path) -> InputError:
    return InputError("exists and holds something else", str(path), "name a file that does not exist")


def _parsed(line: bytes) -> dict[str, Any] | None:
    """Return the object of a line; None when it holds none."""
    try:
        row = json.loads(line)
    except (ValueError, RecursionError):
        return None
    return row if isinstance(row, dict) else None


def _differences(there: Any, here: Any, name: str = "") -> Iterator[tuple[str, Any, Any]]:
    """Yield the name of each key whose values differ, and both values; None for a key that one side lacks."""
    if isinstance(there, dict) and isinstance(here, dict):
        for key in dict.fromkeys([*here, *there]):
            yield from _differences(there.get(key), here.get(key), f"{name}.{key}".lstrip("."))
    elif there != here:
        yield name, there, here
