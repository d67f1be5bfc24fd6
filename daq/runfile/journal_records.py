"""Records of a journal: bytes to records and back, without any file.

A record is ``kind u8, length u32, stamp i64`` (host's monotonic clock, ns), its bytes, and a CRC-32 over all of that;
little endian.  After a record that does not hold a reader goes on at the next place where a whole record holds.  Bytes
received are kept when the CRC of their record fails but its length is right: its frames have their own CRCs.

The header is written again and again, because nothing can be read without it; journals of version 0.1.0 hold it once.

A journal is read through a `Content`: a window of its file at a time, and at a cost that is linear in its length even
where every byte of it claims to begin a long record.
"""

import re
import struct
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cache
from typing import IO, NamedTuple
from zlib import crc32

MAGIC = b"stickslip journal 1\n"
HEADER, RECEIVED, LOST, REOPENED, DROPPED, CONFIGURATION, END = b"HRLODCE"
_KINDS = frozenset(b"HRLODCE")
_KIND = re.compile(b"[HRLODCE]")
_HEAD = struct.Struct("<BIq")
_CRC = struct.Struct("<I")
_LONGEST = 1 << 26  # bytes; no record is longer, so a longer length is damage
_WINDOW = 1 << 20  # bytes of the file in memory; half and double read as fast
# Bytes from one sum of a `Content` to the next: half takes twice the memory (4 bytes each), double costs 1 us more for
# each range between two of them.
_SUM_EVERY = 1 << 12
_FREE_BYTES = 1 << 20  # bytes of ranges that are summed byte by byte in vain
_MAGIC_HOLDS = 12  # bytes of the magic line that must be right; another format has none of them


@dataclass(frozen=True, slots=True)
class Record:
    """One record: its kind, its host stamp (monotonic ns) and its bytes."""

    kind: int
    stamp_ns: int
    data: bytes

    @property
    def size(self) -> int:
        """Bytes of the record in the journal."""
        return _HEAD.size + len(self.data) + _CRC.size


class Place(NamedTuple):
    """A record in a journal's bytes: its offset, the record, and whether its CRC holds."""

    at: int
    record: Record
    holds: bool


def pack(kind: int, stamp_ns: int, data: bytes) -> tuple[bytes, bytes, bytes]:
    """Return a record's bytes in three parts: before its data, its data, and after them."""
    head = _HEAD.pack(kind, len(data), stamp_ns)
    return head, data, _CRC.pack(crc32(data, crc32(head)))


class Content:
    """The bytes of a journal open for reading, of which a window is in memory; slices of it are bytes."""

    def __init__(self, source: bytes | IO[bytes]) -> None:
        self._file = None if isinstance(source, bytes) else source
        self._window, self._begin = (source, 0) if isinstance(source, bytes) else (b"", 0)
        self._size = len(source) if isinstance(source, bytes) else source.seek(0, 2)
        self._sums = [0]  # CRC of the bytes before each multiple of `_SUM_EVERY`
        self._in_vain = 0

    def __len__(self) -> int:
        return self._size

    def __getitem__(self, where: slice) -> bytes:
        first, last, _ = where.indices(self._size)
        if self._file is not None and not self._begin <= first <= last <= self._begin + len(self._window):
            self._file.seek(first)
            # The window begins anywhere and only moves on: whoever looks far ahead and comes back reads without it.
            ahead = first - self._begin - len(self._window)
            if self._window and not 0 <= ahead < _WINDOW:
                return self._file.read(last - first)
            self._window, self._begin = self._file.read(max(last - first, _WINDOW)), first
        return self._window[first - self._begin : last - self._begin]

    def head(self, offset: int) -> tuple[int, int, int] | None:
        """Return kind, length and stamp of the record that may begin at an offset; None where none fits."""
        if offset + _HEAD.size > self._size:
            return None
        kind, length, stamp = _HEAD.unpack(self[offset : offset + _HEAD.size])
        if kind not in _KINDS or length > _LONGEST or offset + _HEAD.size + length + _CRC.size > self._size:
            return None
        return kind, length, stamp

    def holds(self, begin: int, end: int) -> bool:
        """Return whether the CRC after a range is right; after many failures by sums of the bytes before."""
        stated: int = _CRC.unpack(self[end : end + _CRC.size])[0]
        if end - begin <= _SUM_EVERY or self._in_vain + end - begin <= _FREE_BYTES + begin:
            right = self._sum(0, begin, end) == stated
            self._in_vain += 0 if right else end - begin
            return right
        return self._sum_before(end) ^ _append_zeros(self._sum_before(begin), end - begin) == stated

    def _sum(self, crc: int, begin: int, end: int) -> int:
        for first in range(begin, end, _WINDOW):
            crc = crc32(self[first : min(end, first + _WINDOW)], crc)
        return crc

    def _sum_before(self, offset: int) -> int:
        """Return the CRC of all bytes before an offset."""
        while (summed := len(self._sums) * _SUM_EVERY) <= offset:
            self._sums.append(crc32(self[summed - _SUM_EVERY : summed], self._sums[-1]))
        mark = offset // _SUM_EVERY
        return crc32(self[mark * _SUM_EVERY : offset], self._sums[mark])


def wrong_in_magic(content: Content) -> int | None:
    """Return how many bytes of the magic line are damaged; None where the content is not a journal."""
    right = sum(byte == wanted for byte, wanted in zip(content[: len(MAGIC)], MAGIC, strict=False))
    return len(MAGIC) - right if right >= _MAGIC_HOLDS else None


def scan(content: Content) -> Iterator[Place]:
    """Yield the records in a journal's bytes, skipping everything else."""
    offset: int | None = len(MAGIC)
    while offset is not None and offset + _HEAD.size <= len(content):
        record = read_record(content, offset)
        holds = record is not None
        if record is None:
            record = _read_damaged(content, offset)
        if record is not None:
            yield Place(offset, record, holds)
            offset += record.size
            continue
        offset = _find_next(content, offset + 1)


def _find_next(content: Content, begin: int) -> int | None:
    """Return the first offset from ``offset`` on at which a whole record begins; only bytes of a kind are tried."""
    for first in range(begin, len(content), _WINDOW):
        for match in _KIND.finditer(content[first : first + _WINDOW]):
            if _is_record(content, first + match.start()):
                return first + match.start()
    return None


def find_header(places: Iterable[Place]) -> Record | None:
    """Return a journal's header: the first copy whose CRC holds."""
    return next((place.record for place in places if place.record.kind == HEADER), None)


def is_cut_short(content: Content, offset: int) -> bool:
    """Return whether the bytes at an offset, which hold no record, are a record whose end is missing."""
    if offset + _HEAD.size > len(content):
        return True
    kind, length, _ = _HEAD.unpack(content[offset : offset + _HEAD.size])
    return kind in _KINDS and length <= _LONGEST and offset + _HEAD.size + length + _CRC.size > len(content)


def _read_damaged(content: Content, offset: int) -> Record | None:
    """Return a damaged record of received bytes whose length is right: the end, or another record, follows it."""
    head = content.head(offset)
    if head is None or head[0] != RECEIVED:
        return None
    kind, length, stamp = head
    end = offset + _HEAD.size + length
    if end + _CRC.size < len(content) and not _is_record(content, end + _CRC.size):
        return None
    return Record(kind, stamp, content[offset + _HEAD.size : end])


def read_record(content: Content, offset: int, *, whole: bool = True) -> Record | None:
    """Return the record that begins at an offset, or None when none does; ``whole``: its CRC must hold."""
    head = content.head(offset)
    if head is None or (whole and not content.holds(offset, offset + _HEAD.size + head[1])):
        return None
    kind, length, stamp = head
    return Record(kind, stamp, content[offset + _HEAD.size : offset + _HEAD.size + length])


def _is_record(content: Content, offset: int) -> bool:
    head = content.head(offset)
    return head is not None and content.holds(offset, offset + _HEAD.size + head[1])


def _shift_byte(register: int) -> int:
    """Return CRC-32's register after eight zero bits."""
    for _ in range(8):
        register = register >> 1 ^ (0xEDB88320 if register & 1 else 0)
    return register


def _append_zeros(register: int, count: int) -> int:
    """Return what bytes of this CRC add to the CRC of themselves and ``count`` more (zlib's crc32_combine)."""
    for power, tables in enumerate(_make_zero_tables()):
        if count >> power & 1:
            a, b, c, d = tables
            register = a[register & 255] ^ b[register >> 8 & 255] ^ c[register >> 16 & 255] ^ d[register >> 24]
    return register


@cache
def _make_zero_tables() -> list[list[list[int]]]:
    """Return, for 1, 2, 4 ... zero bytes up to the longest record, what each byte of the register becomes."""

    def tables(bit: list[int]) -> list[list[int]]:
        by_byte = []
        for byte in range(4):
            table = [0]
            for position in range(8):
                table += [value ^ bit[8 * byte + position] for value in table]
            by_byte.append(table)
        return by_byte

    powers = [tables([_shift_byte(1 << position) for position in range(32)])]
    while len(powers) < (_LONGEST + _HEAD.size).bit_length():
        a, b, c, d = powers[-1]
        once = [
            a[1 << position] if position < 8 else (b, c, d)[position // 8 - 1][1 << position % 8]
            for position in range(32)
        ]
        twice = [a[r & 255] ^ b[r >> 8 & 255] ^ c[r >> 16 & 255] ^ d[r >> 24] for r in once]
        powers.append(tables(twice))
    return powers
