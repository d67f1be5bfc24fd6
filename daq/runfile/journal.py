"""The journal: what a recording writes while it runs; append-only, so that a power cut costs at most its last second.

File: the magic line, then records.  A record is ``kind u8, length u32, stamp i64`` (host's monotonic clock, ns), its
bytes, and a CRC-32 over all of that; little endian.  After a record that does not hold a reader goes on at the next
place where a whole record holds, and counts what it passed over; a last record that is cut short is a crash's mark.
Bytes received are kept when the CRC of their record fails but its length is right: its frames have their own CRCs.

::

    H  header        JSON: how the recording was started; always the first record
    R  received      bytes as they came from the port; the stamp is the end of the read
    L  port lost     text: why
    O  port reopened text: its name; a new segment begins
    D  dropped       u64: bytes that the recorder itself could not keep, right before this record
    C  configuration TOML text that replaces the board's CONFIG
    E  end           JSON: how the recording ended

A marker comes from another process: one line ``<monotonic ns> <text>`` appended to ``RUN.h5.markers``.
"""

import json
import os
import re
import struct
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, NamedTuple
from zlib import crc32

from daq.errors import InputError

MAGIC = b"stickslip journal 1\n"
SYNC_EVERY_S = 1.0
HEADER, RECEIVED, LOST, REOPENED, DROPPED, CONFIGURATION, END = b"HRLODCE"
_KINDS = frozenset(b"HRLODCE")
_KIND = re.compile(b"[HRLODCE]")
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
    """A journal as read: its header and the records after it.

    ``lost_tail`` is the bytes of a last record that was cut short, ``damaged`` those of everything else that did not
    hold.
    """

    path: Path
    header: dict[str, Any]
    records: tuple[Record, ...]
    lost_tail: int
    damaged: int = 0


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
        """Hand what was appended to the system; sync when the last time is a second ago.  Called often."""
        self._file.flush()
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
            raise InputError(
                "contains no record: the recording ended immediately", str(path), "delete it and record again"
            )
        raise InputError("is not a journal of daq", str(path), "give the .part file that the recording left")
    found = list(scan(content))
    if not found or found[0].record.kind != HEADER or found[0].at != len(MAGIC):
        raise InputError("was cut inside its header: it holds no samples", str(path), "delete it and record again")
    whole = len(MAGIC)
    damaged = 0
    for place in found:
        damaged += place.at - whole + (0 if place.holds else _size(place.record))
        whole = place.at + _size(place.record)
    tail = len(content) - whole
    cut = _is_cut_short(content, whole)
    records = tuple(place.record for place in found)
    return Journal(path, json.loads(records[0].data), records[1:], tail if cut else 0, damaged + (0 if cut else tail))


class Place(NamedTuple):
    """A record in a journal's bytes: where it begins, the record, and whether its CRC holds."""

    at: int
    record: Record
    holds: bool


def scan(content: bytes) -> Iterator[Place]:
    """Yield the records in a journal's bytes, passing over what is none."""
    at = len(MAGIC)
    while at + _HEAD.size <= len(content):
        record = _record_at(content, at)
        holds = record is not None
        if record is None:
            record = _received_at(content, at)
        if record is not None:
            yield Place(at, record, holds)
            at += _size(record)
            continue
        # A record begins with its kind: look only at bytes that are one.
        ahead = (place.start() for place in _KIND.finditer(content, at + 1))
        following = next((place for place in ahead if _record_at(content, place)), None)
        if following is None:
            return
        at = following


def _received_at(content: bytes, at: int) -> Record | None:
    """Return a damaged record of received bytes whose length is right: the end, or another record, follows it."""
    kind, length, stamp = _HEAD.unpack_from(content, at)
    end = at + _HEAD.size + length
    if kind != RECEIVED or length > _LONGEST or end + _CRC.size > len(content):
        return None
    if end + _CRC.size < len(content) and _record_at(content, end + _CRC.size) is None:
        return None
    return Record(kind, stamp, content[at + _HEAD.size : end])


def _record_at(content: bytes, at: int) -> Record | None:
    """Return the record that begins at a place, or None when none does."""
    if at + _HEAD.size > len(content):
        return None
    kind, length, stamp = _HEAD.unpack_from(content, at)
    end = at + _HEAD.size + length
    if kind not in _KINDS or length > _LONGEST or end + _CRC.size > len(content):
        return None
    if crc32(content[at:end]) != _CRC.unpack_from(content, end)[0]:
        return None
    return Record(kind, stamp, content[at + _HEAD.size : end])


def _size(record: Record) -> int:
    return _HEAD.size + len(record.data) + _CRC.size


def _is_cut_short(content: bytes, at: int) -> bool:
    """Return whether what begins at a place, and holds no record, is a record whose end is missing."""
    if at + _HEAD.size > len(content):
        return True
    kind, length, _ = _HEAD.unpack_from(content, at)
    return kind in _KINDS and length <= _LONGEST and at + _HEAD.size + length + _CRC.size > len(content)


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
