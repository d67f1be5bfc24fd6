"""The one door for foreign files: a regular file of a limited size, read once, with the hash of what was read.

Readers that call a library of C do so in a child process, on the bytes that came through this door: no file is opened
by its name a second time, and none that a file names.
"""

import hashlib
import json
import os
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from daq.runfile.isolation import BrokenOffError, Work, isolated
from daq.runfile.regular import regular_file
from stickslip.compute.arrays import Array
from stickslip.errors import InputError

MOST_BYTES = 1 << 28  # of a table; an hour at 1 kHz as text has 80 MB, and takes ten times as much memory
MOST_COLUMNS = 4096
MOST_LINES = 1 << 23  # 2.3 h at 1 kHz
MOST_CELLS = 1 << 24  # each takes 60 to 90 bytes
PARTS = "save the times and positions alone, or a part of them"
LISTED = 12  # names in a message; of the others only the number


@dataclass(frozen=True)
class Source:
    """A file as it was read."""

    path: Path
    data: bytes
    modified_s: float  # time of its last change, s since 1970

    @property
    def sha256(self) -> str:
        return hashlib.sha256(self.data).hexdigest()


def read(path: Path, do: str = "give the CSV file in it") -> Source:
    """Read a file whole; ``do`` says what to give in place of a folder.

    Raises InputError: it is missing, not a regular file, larger than `MOST_BYTES`, or may not be read.
    """
    with regular_file(path, do) as file:
        status = os.fstat(file.fileno())
        check_bytes(status.st_size, str(path))
        return Source(path, file.read(MOST_BYTES), status.st_mtime)


def check_bytes(size: int, where: str) -> None:
    if size > MOST_BYTES:
        what = f"has {size / 1e6:.0f} MB; a table has at most {MOST_BYTES / 1e6:.0f} MB"
        raise InputError(what, where, PARTS)


def check_size(rows: int, columns: int, where: str) -> None:
    """Raise InputError for a table that has too many columns, or too many cells."""
    if columns > MOST_COLUMNS:
        what = f"has {columns:,} columns; a table has at most {MOST_COLUMNS:,}"
    elif rows * columns > MOST_CELLS:
        what = f"has {rows * columns:,} cells; a table has at most {MOST_CELLS:,}"
    else:
        return
    raise InputError(what, where, PARTS)


def shorten(names: Iterable[str]) -> str:
    """Return names for a message, of many the first few and how many more."""
    every = [name if len(name) <= 40 else f"{name[:37]}..." for name in names]
    more = f" and {len(every) - LISTED} more" if len(every) > LISTED else ""
    return ", ".join(every[:LISTED]) + more


def require(library: str, path: Path) -> None:
    """Raise InputError, which says how to install it, where a library of the extra ``formats`` is missing."""
    if find_spec(library) is None:
        what = f"{library}, which reads {path.suffix} files, is not installed"
        do = "install the extra 'formats': pip install 'stickslip[formats]'; or export the table as CSV"
        raise InputError(what, str(path), do)


@dataclass(frozen=True)
class Column:
    """A column that a library read."""

    name: str
    values: Array
    clock: tuple[float, float] | None = None  # of a waveform: time of its first value and interval, s


@dataclass(frozen=True)
class Parsed:
    """What a child process read: where the bytes came from, when they were recorded, the columns."""

    sha256: str
    modified_s: float
    recorded: str
    columns: tuple[Column, ...]


def parse_isolated(work: Work, path: Path, seconds: float, memory: int, kind: str, do: str) -> bytes:
    """Return what a child makes of a file; ``memory`` is what it may take besides the file's own size.

    Raises InputError: the child was ended by a limit, or crashed; and as ``work``.
    """
    with regular_file(path, "give the file in it") as file:
        size = os.fstat(file.fileno()).st_size
    try:
        return isolated(work, path, seconds, memory + 3 * min(size, MOST_BYTES))
    except BrokenOffError as error:
        raise InputError(f"is not a {kind} that can be read: it {error}", str(path), do) from error


def parse(parser: Callable[[Source], tuple[str, list[Column]]], path: Path, kind: str, do: str) -> bytes:
    """Return, in the child, the columns that a parser finds, packed for the parent.

    Raises InputError: the parser failed, or the columns are too many or too large.
    """
    source = read(path, "give the file in it")
    try:
        recorded, columns = parser(source)
    except (MemoryError, InputError):
        raise
    except Exception as error:  # whatever the library stumbles over
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(f"is not a {kind} ({reason[:200]})", str(path), do) from error
    check_size(1, len(columns), str(path))
    check_size(sum(column.values.size for column in columns), 1, str(path))
    about = [(_printable(column.name), column.values.size, column.clock) for column in columns]
    head = json.dumps([source.sha256, source.modified_s, recorded, about])
    return b"\n".join([head.encode(), b"".join(column.values.astype("<f8").tobytes() for column in columns)])


def unpack(sent: bytes) -> Parsed:
    """Return what `parse` packed."""
    head, _, content = sent.partition(b"\n")
    sha256, modified_s, recorded, about = json.loads(head)
    ends = 8 * np.cumsum([0, *(size for _, size, _ in about)])
    columns = tuple(
        Column(name, np.frombuffer(content[first:last], "<f8"), None if clock is None else (clock[0], clock[1]))
        for (name, _, clock), first, last in zip(about, ends[:-1], ends[1:], strict=True)
    )
    return Parsed(sha256, modified_s, recorded, columns)


def usual_length(columns: Sequence[Column]) -> int:
    """Return the length that most columns share."""
    return Counter(column.values.size for column in columns).most_common(1)[0][0]


def _printable(name: str | bytes) -> str:
    """Return a name without bytes that are not UTF-8."""
    text = name.decode("utf-8", "replace") if isinstance(name, bytes) else name.encode("utf-8", "replace").decode()
    return "".join(letter if letter.isprintable() else "?" for letter in text)
