"""The one door for foreign files: a regular file of a limited size, read once, with the hash of what was read.

No file is opened by its name a second time, and none that a file names.
"""

import hashlib
import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from daq.runfile.regular import open_regular
from stickslip.errors import InputError

MOST_BYTES = 1 << 28  # of a table; an hour at 1 kHz as text has 50 MB, and takes 230 MB of memory
MOST_COLUMNS = 4096
MOST_LINES = 1 << 23  # 2.3 h at 1 kHz
MOST_CELLS = 1 << 24  # each takes 20 bytes, in a LabVIEW measurement 60 to 90
PARTS = "save only the times and positions, or a part of them"
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


def read(path: Path, do: str = "choose a file in it") -> Source:
    """Read a file whole; ``do`` says what to give in place of a folder."""
    with open_regular(path, do) as file:
        status = os.fstat(file.fileno())
        check_bytes(status.st_size, str(path))
        return Source(path, file.read(MOST_BYTES), status.st_mtime)


def check_bytes(size: int, where: str) -> None:
    if size > MOST_BYTES:
        what = f"has {size / 1e6:.0f} MB, but a table may have at most {MOST_BYTES / 1e6:.0f} MB"
        raise InputError(what, where, PARTS)


def check_size(rows: int, columns: int, where: str) -> None:
    if columns > MOST_COLUMNS:
        what = f"has {columns:,} columns, but a table may have at most {MOST_COLUMNS:,}"
    elif rows * columns > MOST_CELLS:
        what = f"has {rows * columns:,} cells, but a table may have at most {MOST_CELLS:,}"
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
