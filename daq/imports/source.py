"""The one door for foreign files: a regular file of a limited size, read once, with the hash of what was read.

Readers that call a library of C do so in a child process, on the bytes that came through this door: no file is opened
by its name a second time, and none that a file names.
"""

import hashlib
import json
import os
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from daq.runfile.isolation import BrokenOffError, Work, run_isolated
from daq.runfile.regular import open_regular
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
    """Read a file whole; ``do`` says what to give in place of a folder."""
    with open_regular(path, do) as file:
        status = os.fstat(file.fileno())
        check_bytes(status.st_size, str(path))
        return Source(path, file.read(MOST_BYTES), status.st_mtime)


def check_bytes(size: int, where: str) -> None:
    if size > MOST_BYTES:
        what = f"has {size / 1e6:.0f} MB; a table has at most {MOST_BYTES / 1e6:.0f} MB"
        raise InputError(what, where, PARTS)


def check_size(rows: int, columns: int, where: str) -> None:
    if columns > MOST_COLUMNS:
        what = f"has {columns:,} columns; a table has at most {MOST_COLUMNS:,}"
    elif rows * columns > MOST_CELLS:
        what = f"has {rows * columns:,} cells; a table has at most {MOST_CELLS:,}"
    else:
        return
    raise InputError(what, where, PARTS)


def cut(text: str) -> str:
    return text if len(text) <= 40 else f"{text[:37]}..."


def shorten(names: Iterable[str], most: int = LISTED) -> str:
    """Join names for a message: the first ``most``, and how many more."""
    shortened = [cut(name) for name in names]
    more = f" and {len(shortened) - most} more" if len(shortened) > most else ""
    return ", ".join(shortened[:most]) + more


@contextmanager
def refuse_unreadable(kind: str, path: Path, do: str) -> Iterator[None]:
    """Turn any error of a library that reads a file into an InputError."""
    try:
        yield
    except (MemoryError, InputError):
        raise
    except Exception as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(f"is not a {kind} ({reason[:200]})", str(path), do) from error


def require(library: str, path: Path) -> None:
    """Raise InputError, which says how to install it, where a library of the extra ``formats`` is missing."""
    if find_spec(library) is None:
        what = f"{library}, which reads {path.suffix} files, is not installed"
        do = "install the extra 'formats': pip install 'stickslip[formats]'; or export the table as CSV"
        raise InputError(what, str(path), do)


@dataclass(frozen=True)
class Column:
    name: str
    values: Array
    clock: tuple[float, float] | None = None  # of a waveform: time of its first value and interval, s


@dataclass(frozen=True)
class Parsed:
    """What a child process read."""

    sha256: str
    modified_s: float
    recorded: str
    columns: tuple[Column, ...]


def parse_isolated(work: Work, path: Path, seconds: float, memory: int, kind: str, do: str) -> bytes:
    """Return what a child makes of a file; ``memory``, bytes, is what it may use in addition to the file's size."""
    with open_regular(path, "give the file in it") as file:
        size = os.fstat(file.fileno()).st_size
    try:
        return run_isolated(work, path, seconds, memory + 3 * min(size, MOST_BYTES))
    except BrokenOffError as error:
        raise InputError(f"is not a {kind} that can be read: it {error}", str(path), do) from error


def parse(parser: Callable[[Source], tuple[str, list[Column]]], path: Path, kind: str, do: str) -> bytes:
    """Return, in the child, the columns that a parser reads, packed for the parent."""
    source = read(path, "give the file in it")
    with refuse_unreadable(kind, path, do):
        recorded, columns = parser(source)
    check_size(1, len(columns), str(path))
    check_size(sum(column.values.size for column in columns), 1, str(path))
    descriptions = [(_clean_name(column.name), column.values.size, column.clock) for column in columns]
    head = json.dumps([source.sha256, source.modified_s, recorded, descriptions])
    return b"\n".join([head.encode(), b"".join(column.values.astype("<f8").tobytes() for column in columns)])


def unpack(message: bytes) -> Parsed:
    head, _, content = message.partition(b"\n")
    sha256, modified_s, recorded, descriptions = json.loads(head)
    ends = 8 * np.cumsum([0, *(size for _, size, _ in descriptions)])
    columns = tuple(
        Column(name, np.frombuffer(content[first:last], "<f8"), None if clock is None else (clock[0], clock[1]))
        for (name, _, clock), first, last in zip(descriptions, ends[:-1], ends[1:], strict=True)
    )
    return Parsed(sha256, modified_s, recorded, columns)


def find_usual_length(columns: Sequence[Column]) -> int:
    return Counter(column.values.size for column in columns).most_common(1)[0][0]


def _clean_name(name: str | bytes) -> str:
    """Return a name without bytes that are not UTF-8."""
    text = name.decode("utf-8", "replace") if isinstance(name, bytes) else name.encode("utf-8", "replace").decode()
    return "".join(letter if letter.isprintable() else "?" for letter in text)
