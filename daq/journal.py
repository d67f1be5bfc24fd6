"""The journal: what a recording writes while it runs; append-only, so that a crash costs at most its last second.

File: the magic line, then records.  A record is ``kind u8, length u32, stamp i64`` (host's monotonic clock, ns), its
bytes, and a CRC-32 over all of that; little endian.  A reader stops at the first record that is cut short or does not
hold: whatever the tail looks like after a crash, the records before it are whole.

::

    H  header        JSON: how the recording was started; always the first record
    R  received      bytes as they came from the port; the stamp is the end of the read
    L  port lost     text: why
    O  port reopened text: its name; a new segment begins
    D  dropped       u64: bytes that the recorder itself could not keep, right before this record
    C  configuration TOML text that replaces what the board's CONFIG says
    E  end           JSON: how the recording ended

A marker comes from another process: one line ``<monotonic ns> <text>`` appended to ``RUN.h5.markers``.
"""

import json
import os
import struct
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any
from zlib import crc32

from daq.errors import InputError

MAGIC = b"stickslip journal 1\n"
SYNC_EVERY_S = 1.0
HEADER, RECEIVED, LOST, REOPENED, DROPPED, CONFIGURATION, END = b"HRLODCE"
_KINDS = frozenset(b"HRLODCE")
_HEAD = struct.Struct("<BIq")
_CRC = struct.Struct("<I")
_LONGEST = 1 << 26  # bytes; no record is longer, so a longer length is damage


@dataclass(frozen=True, slots=True)
class Record:
    """One record: its kind, its host stamp (monotonic ns) and its bytes."""

    kind: int
    stamp_ns: int
    data: bytes


@dataclass(frozen=True)
class Journal:
    """A journal as read: its header, the records after it, and how many bytes at the end did not hold."""

    path: Path
    header: dict[str, Any]
    records: tuple[Record, ...]
    lost_tail: int


class Writer:
    """Append records to a new journal; synced to disk each second.

    Raises
    ------
    FileExistsError
        When the file exists: a journal is never overwritten.
    OSError
        When the disk refuses: full, read-only, gone.
    """

    def __init__(self, path: Path, header: dict[str, Any]) -> None:
        self.path = path
        self._file: IO[bytes] = path.open("xb", buffering=1 << 16)
        self._synced = time.monotonic()
        self._file.write(MAGIC)
        self.append(HEADER, time.monotonic_ns(), json.dumps(header).encode())
        self.sync()

    def append(self, kind: int, stamp_ns: int, data: bytes) -> None:
        """Append one record; at most a second later it is on the disk."""
        head = _HEAD.pack(kind, len(data), stamp_ns)
        self._file.write(head)
        self._file.write(data)
        self._file.write(_CRC.pack(crc32(data, crc32(head))))

    def tick(self) -> None:
        """Sync when the last time is a second ago: called often, also while nothing comes in."""
        if time.monotonic() - self._synced >= SYNC_EVERY_S:
            self.sync()

    def sync(self) -> None:
        """Put everything appended so far on the disk."""
        self._file.flush()
        os.fsync(self._file.fileno())
        self._synced = time.monotonic()

    def close(self) -> None:
        """Sync and close."""
        try:
            self.sync()
        finally:
            self._file.close()

    def abandon(self) -> None:
        """Close without a sync: the disk has refused already."""
        try:
            self._file.close()
        except OSError:  # the buffered rest could not be written either; what is on the disk stays
            return


def read(path: Path) -> Journal:
    """Read a journal, whole or cut short.

    Raises
    ------
    InputError
        When the file is missing, is no journal, or was cut before its header was complete.
    """
    try:
        content = path.read_bytes()
    except FileNotFoundError as error:
        raise InputError("no such journal", str(path), "give the .part file that the recording left") from error
    except IsADirectoryError as error:
        raise InputError("is a folder", str(path), "give the .part file that the recording left") from error
    if not content.startswith(MAGIC):
        if MAGIC.startswith(content):
            raise InputError("holds no record: the recording ended at once", str(path), "delete it and record again")
        raise InputError("is no journal of ours", str(path), "give the .part file that the recording left")
    records = list(scan(content))
    if not records or records[0].kind != HEADER:
        raise InputError("was cut inside its header: it holds no samples", str(path), "delete it and record again")
    whole = len(MAGIC) + sum(_HEAD.size + len(record.data) + _CRC.size for record in records)
    return Journal(path, json.loads(records[0].data), tuple(records[1:]), len(content) - whole)


def scan(content: bytes) -> Iterator[Record]:
    """Yield the records of a journal's bytes up to the first that is cut short or does not hold."""
    at = len(MAGIC)
    while at + _HEAD.size <= len(content):
        kind, length, stamp = _HEAD.unpack_from(content, at)
        end = at + _HEAD.size + length
        if kind not in _KINDS or length > _LONGEST or end + _CRC.size > len(content):
            return
        if crc32(content[at:end]) != _CRC.unpack_from(content, end)[0]:
            return
        yield Record(kind, stamp, content[at + _HEAD.size : end])
        at = end + _CRC.size


def markers_path(run: Path) -> Path:
    """Return where the markers of ``run`` (the .h5 or its .part) are."""
    return run.with_name(run.name.removesuffix(".part") + ".markers")


def read_markers(path: Path) -> tuple[tuple[int, str], ...]:
    """Return the markers, stamp in monotonic ns and text, in order of time; none when there is no such file.

    A line that is not a marker (its writer was killed within it) is left out.
    """
    if not path.exists():
        return ()
    found = []
    for line in path.read_text(encoding="utf-8", errors="replace").splitlines():
        stamp, _, text = line.strip().partition(" ")
        if stamp.isascii() and stamp.isdecimal():
            found.append((int(stamp), text))
    return tuple(sorted(found))
