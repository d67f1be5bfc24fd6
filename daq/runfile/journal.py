"""The journal: what a recording writes while it runs; append-only, so that a power cut costs at most its last second.

File: the magic line, then records (`daq.runfile.journal_records`).  A reader counts what it passes over; a last record
that is cut short is a crash's mark.

::

    H  header        JSON: how the recording was started; the first record, repeated at once and every `HEADER_EVERY`
    R  received      bytes as they came from the port; the stamp is the end of the read
    L  port lost     text: why
    O  port reopened text: its name; a new segment begins
    D  dropped       u64: bytes that the recorder itself could not keep, right before this record
    C  configuration TOML text that replaces the board's CONFIG
    E  end           JSON: how the recording ended

While a recording runs it holds the journal's lock (`stickslip.output.lock`): whoever wants to finish the journal asks
for it first, whoever only reads does not.  A marker comes from another process: one line ``<monotonic ns> <text>``
appended to ``RUN.h5.markers``; and so does the wish to stop: a file ``RUN.h5.stop``.
"""

import contextlib
import errno
import json
import os
import shutil
import time
from array import array
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from daq.runfile import journal_header, journal_records
from daq.runfile.journal_records import (
    CONFIGURATION,
    DROPPED,
    END,
    HEADER,
    LOST,
    MAGIC,
    RECEIVED,
    REOPENED,
    Content,
    Record,
)
from daq.runfile.regular import open_regular
from stickslip.errors import InputError
from stickslip.output import disk
from stickslip.output.lock import FileLock
from stickslip.text import storable

__all__ = ["CONFIGURATION", "DROPPED", "END", "HEADER", "LOST", "MAGIC", "RECEIVED", "REOPENED", "Content", "Record"]

# Between the end of one sync and the beginning of the next: with the time that the writer may wait for data (0.1 s) and
# a sync of 50 ms, what came is on the disk within a second.  Half syncs twice as often, for 2 % more CPU time of a
# recording; 1.0 lets up to 1.1 s of a recording be lost in a power cut.
SYNC_EVERY_S = 0.8
DROPPED_BYTES = 8  # size of a record DROPPED: a whole number, little-endian; one of another length holds no number
# Bytes between two copies of the header: 2 % of the file.  Half costs 4 %; double leaves a longer beginning whose loss
# (a bad sector has 4 kB) may take all copies of it.
HEADER_EVERY = 1 << 16

USE = "use the .part file of the recording"
# What ended a recording, in its last record; another word there is the name of a signal.
COMPLETE, STOPPED, PORT_LOST, BOARD_STOPPED = "complete", "stopped", "port lost", "board stopped"
# How blocks that a program hands over can end.
SOURCE_ENDED, SOURCE_FAILED, SOURCE_SILENT = "source ended", "source failed", "source silent"


class Records:
    """Records of a journal, read from its file each time they are used."""

    def __init__(self, path: Path, places: "array[int]", kinds: bytes) -> None:
        self.path, self.kinds = path, kinds
        self._places = places

    def __len__(self) -> int:
        return len(self._places)

    def __iter__(self) -> Iterator[Record]:
        return self.at(range(len(self)))

    def at(self, numbers: Iterable[int]) -> Iterator[Record]:
        with self.path.open("rb", buffering=0) as file:
            content = Content(file)
            for number in numbers:
                record = journal_records.read_record(content, self._places[number], whole=False)
                if record is None:
                    raise OSError(errno.EIO, "changed while it was read", str(self.path))
                yield record

    def of_kind(self, *kinds: int) -> Iterator[Record]:
        return self.at(number for number, kind in enumerate(self.kinds) if kind in kinds)


@dataclass(frozen=True)
class Journal:
    """A journal as read: its header and the records after it."""

    path: Path
    header: dict[str, Any]
    records: Records
    lost_tail: int  # bytes of a last record that was cut short
    damaged: int = 0  # bytes of everything else that is not a whole record


class Writer:
    """Appends records to a new journal, synced to disk each second."""

    def __init__(self, path: Path, header: dict[str, Any]) -> None:
        self.path = path
        self._file, self._lock = _create(path)
        self.is_asked_to_stop()  # one that an earlier recording of this name has left
        self._synced = time.monotonic()
        self._since_header = 0
        self._header = json.dumps(header).encode()
        self._file.write(MAGIC)
        for _ in range(2):
            self._append_header()
        self.sync()
        disk.sync_folder(path)

    @property
    def locked(self) -> bool:
        """Whether the journal is locked; False where the file system has no locks."""
        return self._lock is not None

    def append(self, kind: int, stamp_ns: int, data: bytes) -> None:
        """Append one record; at most a second later it is on the disk."""
        parts = journal_records.pack(kind, stamp_ns, data)
        for part in parts:
            self._file.write(part)
        self._since_header += sum(map(len, parts))
        if self._since_header >= HEADER_EVERY and kind != HEADER:
            self._append_header()

    def tick(self) -> bool:
        """Flush; sync when the last sync was a second ago, and return whether it was synced."""
        self._file.flush()
        due = time.monotonic() - self._synced >= SYNC_EVERY_S
        if due:
            self.sync()
        return due

    def is_asked_to_stop(self) -> bool:
        """Return whether the file that asks to stop (`stop_path`) exists, and remove it."""
        stop_file = stop_path(self.path)
        if not stop_file.exists():
            return False
        with contextlib.suppress(OSError):
            stop_file.unlink()
        return True

    def sync(self) -> None:
        self._file.flush()
        os.fsync(self._file.fileno())
        self._synced = time.monotonic()

    def is_at(self, path: Path) -> bool:
        """Return whether the journal is the file of this name; it is not after its folder was renamed or removed."""
        try:
            named, opened = path.stat(), os.fstat(self._file.fileno())
        except OSError:
            return False
        return os.path.samestat(named, opened)

    def now_at(self) -> Path | None:
        """Return the journal's name after it was renamed; None where it has no name any more, or it is unknown."""
        try:  # Linux
            path = Path(os.readlink(f"/proc/self/fd/{self._file.fileno()}"))
        except OSError:
            return None
        return path if self.is_at(path) else None

    def move(self, path: Path) -> None:
        """Continue in another file, a copy of this one, for a journal whose name is gone; OSError changes nothing."""
        file, lock = _create(path)
        try:
            self._file.seek(0)
            shutil.copyfileobj(self._file, file, 1 << 20)
            file.flush()
            os.fsync(file.fileno())
        except OSError:
            self._file.seek(0, os.SEEK_END)
            _close_quietly(file)
            if lock is not None:
                lock.remove(path)
            raise
        self.abandon()
        self.path, self._file, self._lock = path, file, lock

    def close(self) -> None:
        """Sync and close; the lock is released."""
        try:
            self.sync()
        finally:
            self.abandon()

    def remove(self) -> None:
        """Remove the journal and close it: its run file is in place."""
        _close_quietly(self._file)
        if self._lock is None:
            self.path.unlink(missing_ok=True)
        else:
            self._lock.remove(self.path)

    def abandon(self) -> None:
        """Close without a sync, as when the disk has refused; the lock is released.  A second call does nothing."""
        _close_quietly(self._file)
        if self._lock is not None:
            self._lock.release()

    def _append_header(self) -> None:
        self.append(HEADER, time.monotonic_ns(), self._header)
        self._since_header = 0


def _create(path: Path) -> tuple[IO[bytes], FileLock | None]:
    """Create a journal, and lock it where the file system has locks."""
    file = path.open("x+b", buffering=1 << 16)
    try:
        return file, FileLock(path)
    except BlockingIOError as error:  # another recorder looks whether it is one without data (`remove_empty`)
        file.close()
        raise FileExistsError(error.errno, "another recorder is using it", str(path)) from error
    except OSError:
        return file, None


def _close_quietly(file: IO[bytes]) -> None:
    try:
        file.close()
    except OSError:  # the buffered rest could not be written either; what is on the disk stays
        return


def is_empty(path: Path) -> bool:
    """Return whether a journal contains no record yet: its recorder has just created it, or there is none."""
    try:
        with path.open("rb") as file:
            content = file.read(len(MAGIC) + 1)
    except OSError:
        return not path.exists()
    return _has_no_record(content)


def _has_no_record(content: bytes | Content) -> bool:
    return len(content) <= len(MAGIC) and MAGIC.startswith(content[:])


def read_header(path: Path) -> dict[str, Any]:
    """Return the header of a journal that is being written; InputError as for `read`."""
    with open_regular(path, USE) as file:
        content = Content(file.read(2 * HEADER_EVERY))
    header = journal_records.find_header(journal_records.scan(content))
    if journal_records.wrong_in_magic(content) is None or header is None:
        raise InputError("is not a journal of daq", str(path), USE)
    return journal_header.parse(header.data, path)


def read(path: Path) -> Journal:
    """Read a journal, whole or cut short."""
    with open_regular(path, USE) as file:
        return _read(path, Content(file))


def _read(path: Path, content: Content) -> Journal:
    if _has_no_record(content):
        raise InputError("contains no record: the recording ended immediately", str(path), "delete it and record again")
    damaged = journal_records.wrong_in_magic(content)
    if damaged is None:
        raise InputError("is not a journal of daq", str(path), USE)
    places, kinds, received = array("q"), bytearray(), 0
    header: Record | None = None
    whole = len(MAGIC)
    for place in journal_records.scan(content):
        kind = place.record.kind
        damaged += place.at - whole + (0 if place.holds else place.record.size)
        whole = place.at + place.record.size
        received += kind == RECEIVED
        if kind == HEADER:
            header = header or place.record
        # What begins right behind the magic line is the header, whatever its damage makes of it.
        if kind != HEADER and place.at > len(MAGIC):
            places.append(place.at)
            kinds.append(kind)
    if header is None:
        raise _make_header_error(path, len(content), received)
    tail = len(content) - whole
    cut = journal_records.is_cut_short(content, whole)
    records = Records(path, places, bytes(kinds))
    return Journal(
        path, journal_header.parse(header.data, path), records, tail if cut else 0, damaged + (0 if cut else tail)
    )


def end_reason(record: Record) -> str:
    """Return how a recording ended, by its last record; "" where that is unknown."""
    try:
        reason = json.loads(record.data)["reason"]
    except (ValueError, KeyError, TypeError, RecursionError):
        return ""
    return reason if isinstance(reason, str) else ""


def _make_header_error(path: Path, size: int, received: int) -> InputError:
    if received:
        what = f"all copies of its header are damaged; {received} records of received bytes follow"
        return InputError(
            what, str(path), "keep it: the bytes are complete, but the settings of the recording are unknown"
        )
    what = f"contains no complete record in its {size} bytes, because it is cut short or damaged"
    return InputError(what, str(path), "use another copy of it, or record again")


def markers_path(run: Path) -> Path:
    """Return the file of the markers of ``run`` (the .h5 or its .part)."""
    return run.with_name(run.name.removesuffix(".part") + ".markers")


def stop_path(run: Path) -> Path:
    """Return the file that asks the recorder of ``run`` (the .h5 or its .part) to stop."""
    return run.with_name(run.name.removesuffix(".part") + ".stop")


def read_markers(path: Path) -> tuple[tuple[int, str], ...]:
    """Return the markers, stamp in monotonic ns and text, by time; damaged lines are left out."""
    if not path.exists():
        return ()
    markers = []
    for line in path.read_text(encoding="utf-8", errors="replace").splitlines():
        stamp, _, text = line.strip().partition(" ")
        if stamp.isascii() and stamp.isdecimal() and len(stamp) < 20:
            markers.append((int(stamp), storable(text)))
    return tuple(sorted(markers))
