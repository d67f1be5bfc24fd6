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

LONGEST_HEADER = 1 << 20  # bytes; a file with a longer first line is not one of these


class ResumeFile:
    """Rows of an earlier run, with further ones appended: see `open_resume_file`."""

    def __init__(self, path: Path, header: Mapping[str, Any], file: IO[bytes]) -> None:
        self.path = path
        self._header = format_line(header)
        self._file = file
        self.rows, size = read_rows(file, path, self._header)  # when the file was opened
        self.number = len(self.rows)  # rows in the file now
        with disk.writing(path):  # the header goes with the first row
            file.seek(file.truncate(size if self.rows else 0))

    def append(self, row: Mapping[str, Any]) -> None:
        """Write a row of JSON types; raises RefusedError where the disk refuses, and the rows before stay."""
        with disk.writing(self.path):
            self._file.write(format_line(row) if self.number else self._header + format_line(row))
            self._file.flush()
        self.number += 1


@contextmanager
def open_resume_file(path: Path, header: Mapping[str, Any], flag: str = "--resume") -> Iterator[ResumeFile]:
    """Open a file to continue a computation, or to start one; a file to which nothing was written is removed.

    The ``header`` contains everything that the rows depend on; a file without its first key is of another kind.  The
    file is locked meanwhile, where the file system has locks, and stays unchanged where an error refuses it.
    """
    refuse_existing(path, True, flag=flag)
    with disk.writing(path):
        path.touch()
        file = path.open("r+b")
    lock = None
    try:
        lock = lock_file(path)
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


def lock_file(path: Path) -> FileLock | None:
    """Return the lock on a file; None where the file system has no locks."""
    try:
        return FileLock(path)
    except BlockingIOError:
        do = "wait until that process has ended, or use another file"
        raise InputError("another process is writing this file", str(path), do) from None
    except OSError:
        return None


def format_line(content: Mapping[str, Any]) -> bytes:
    return json.dumps(content, allow_nan=False).encode() + b"\n"


def read_rows(file: IO[bytes], path: Path, header: bytes) -> tuple[list[dict[str, Any]], int]:
    """Return the rows, and the size in bytes of the complete lines."""
    first = file.readline(LONGEST_HEADER)
    if not first.endswith(b"\n"):
        if not header.startswith(first):
            raise reject_foreign(path)
        return [], 0
    stored, expected = parse_line(first), json.loads(header)
    if stored is None or next(iter(expected)) not in stored:
        raise reject_foreign(path)
    for name, old, new in find_differences(stored, expected):
        problem = f"belongs to another computation: {name} is {old!r:.60} there, but {new!r:.60} here"
        raise InputError(problem, str(path), "repeat the original command, or use another file")
    complete, newline, _ = file.read().rpartition(b"\n")
    rows = []
    for number, line in enumerate(complete.split(b"\n") if newline else [], 2):
        row = parse_line(line)
        if row is None:
            raise InputError(f"line {number} is damaged", str(path), "remove that line, and its row is computed again")
        rows.append(row)
    return rows, len(first) + len(complete) + len(newline)


def reject_foreign(path: Path) -> InputError:
    return InputError("exists but was not written by this command", str(path), "use a file that does not exist")


def parse_line(line: bytes) -> dict[str, Any] | None:
    try:
        row = json.loads(line)
    except (ValueError, RecursionError):
        return None
    return row if isinstance(row, dict) else None


def find_differences(stored: Any, expected: Any, name: str = "") -> Iterator[tuple[str, Any, Any]]:
    """Yield the name of each key whose values differ, and both values; None for a key that one side lacks."""
    if isinstance(stored, dict) and isinstance(expected, dict):
        for key in dict.fromkeys([*expected, *stored]):
            yield from find_differences(stored.get(key), expected.get(key), f"{name}.{key}".lstrip("."))
    elif stored != expected:
        yield name, stored, expected
