"""Records of a journal: bytes to records and back, without any file.

A record is ``kind u8, length u32, stamp i64`` (host's monotonic clock, ns), its bytes, and a CRC-32 over all of that;
little endian.  After a record that does not hold a reader goes on at the next place where a whole record holds.  Bytes
received are kept when the CRC of their record fails but its length is right: its frames have their own CRCs.

The header is written again and again, because nothing can be read without it.  Journals of version 0.1.0 hold it once:
there one wrong byte is corrected by means of the CRC.

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
_LONGEST_HEADER = 1 << 16  # bytes in which a wrong byte is looked for; a header has 1 to 2 kB
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
    """A record in a journal's bytes: where it begins, the record, and whether its CRC holds."""

    at: int
    record: Record
    holds: bool


def packed(kind: int, stamp_ns: int, data: bytes) -> tuple[bytes, bytes, bytes]:
    """Return a record's bytes in three parts: before its data, its data, and after them."""
    head = _HEAD.pack(kind, len(data), stamp_ns)
    return head, data, _CRC.pack(crc32(data, crc32(head)))


class Content:
    """The bytes of a journal, of which a window is in memory; slices of it are bytes.

    source: The file must be open for reading; its length is that of this moment.
    """

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

    def head(self, at: int) -> tuple[int, int, int] | None:
        """Return kind, length and stamp of the record that may begin at a place; None where none fits."""
        if at + _HEAD.size > self._size:
            return None
        kind, length, stamp = _HEAD.unpack(self[at : at + _HEAD.size])
        if kind not in _KINDS or length > _LONGEST or at + _HEAD.size + length + _CRC.size > self._size:
            return None
        return kind, length, stamp

    def holds(self, at: int, end: int) -> bool:
        """Return whether the CRC after a range is that of the range.

        Every range is summed byte by byte until that has failed too often; then by what the sums of the bytes before
        its two ends differ in.
        """
        stated: int = _CRC.unpack(self[end : end + _CRC.size])[0]
        if end - at <= _SUM_EVERY or self._in_vain + end - at <= _FREE_BYTES + at:
            right = self._sum(0, at, end) == stated
            self._in_vain += 0 if right else end - at
            return right
        return self._before(end) ^ _with_zeros(self._before(at), end - at) == stated

    def _sum(self, crc: int, at: int, end: int) -> int:
        for first in range(at, end, _WINDOW):
            crc = crc32(self[first : min(end, first + _WINDOW)], crc)
        return crc

    def _before(self, at: int) -> int:
        """Return the CRC of all bytes before a place."""
        while (known := len(self._sums) * _SUM_EVERY) <= at:
            self._sums.append(crc32(self[known - _SUM_EVERY : known], self._sums[-1]))
        mark = at // _SUM_EVERY
        return crc32(self[mark * _SUM_EVERY : at], self._sums[mark])


def wrong_in_magic(content: Content) -> int | None:
    """Return how many bytes of the magic line are damaged; None where the content is no journal."""
    right = sum(byte == wanted for byte, wanted in zip(content[: len(MAGIC)], MAGIC, strict=False))
    return len(MAGIC) - right if right >= _MAGIC_HOLDS else None


def scan(content: Content) -> Iterator[Place]:
    """Yield the records in a journal's bytes, passing over what is none."""
    at: int | None = len(MAGIC)
    while at is not None and at + _HEAD.size <= len(content):
        record = record_at(content, at)
        holds = record is not None
        if record is None:
            record = _received_at(content, at)
        if record is not None:
            yield Place(at, record, holds)
            at += record.size
            continue
        at = _following(content, at + 1)


def _following(content: Content, at: int) -> int | None:
    """Return the first place from ``at`` on at which a whole record begins; None where there is none.

    A record begins with its kind: only bytes that are one are looked at.
    """
    for first in range(at, len(content), _WINDOW):
        for found in _KIND.finditer(content[first : first + _WINDOW]):
            if _is_record(content, first + found.start()):
                return first + found.start()
    return None


def header(content: Content, found: Iterable[Place]) -> Record | None:
    """Return a journal's header: the first copy that holds, or a single copy in which one byte was wrong.

    content: The journal.
    found: Its records; the first one that holds and the first header are enough.
    """
    following = len(content)
    for place in found:
        if place.record.kind == HEADER:
            return place.record
        if place.holds:
            following = min(following, place.at)
    if following > _HEAD.size + _LONGEST_HEADER:
        return None
    return _corrected(content[len(MAGIC) : following])


def is_cut_short(content: Content, at: int) -> bool:
    """Return whether what begins at a place, and holds no record, is a record whose end is missing."""
    if at + _HEAD.size > len(content):
        return True
    kind, length, _ = _HEAD.unpack(content[at : at + _HEAD.size])
    return kind in _KINDS and length <= _LONGEST and at + _HEAD.size + length + _CRC.size > len(content)


def _received_at(content: Content, at: int) -> Record | None:
    """Return a damaged record of received bytes whose length is right: the end, or another record, follows it."""
    head = content.head(at)
    if head is None or head[0] != RECEIVED:
        return None
    kind, length, stamp = head
    end = at + _HEAD.size + length
    if end + _CRC.size < len(content) and not _is_record(content, end + _CRC.size):
        return None
    return Record(kind, stamp, content[at + _HEAD.size : end])


def record_at(content: Content, at: int, *, whole: bool = True) -> Record | None:
    """Return the record that begins at a place, or None when none does; ``whole``: its CRC must hold."""
    head = content.head(at)
    if head is None or (whole and not content.holds(at, at + _HEAD.size + head[1])):
        return None
    kind, length, stamp = head
    return Record(kind, stamp, content[at + _HEAD.size : at + _HEAD.size + length])


def _is_record(content: Content, at: int) -> bool:
    head = content.head(at)
    return head is not None and content.holds(at, at + _HEAD.size + head[1])


def _corrected(damaged: bytes) -> Record | None:
    """Return the header that these bytes are, but for one wrong byte; None where more is wrong.

    A CRC is linear: what it is off by is the CRC of the error alone.  The register is run backwards from there, byte by
    byte, until it is that of a single byte.
    """
    end = len(damaged) - _CRC.size
    if not _HEAD.size <= end <= _LONGEST_HEADER:
        return None
    text, off = damaged[:end], crc32(damaged[:end]) ^ _CRC.unpack_from(damaged, end)[0]
    if any(off & ~(0xFF << shift) == 0 for shift in (0, 8, 16, 24)):
        return _as_header(text)  # the wrong byte is one of the CRC itself
    table = [_shifted(byte) for byte in range(256)]
    from_top = {value >> 24: byte for byte, value in enumerate(table)}
    single = {value: byte for byte, value in enumerate(table)}
    for at in reversed(range(end)):
        if off in single:
            return _as_header(text[:at] + bytes([text[at] ^ single[off]]) + text[at + 1 :])
        byte = from_top[off >> 24]
        off = ((off ^ table[byte]) << 8 | byte) & 0xFFFFFFFF
    return None


def _as_header(text: bytes) -> Record | None:
    """Return the record of these bytes, its CRC left out; None where they are no header."""
    record = record_at(Content(text + _CRC.pack(crc32(text))), 0)
    if record is None or record.kind != HEADER or record.size != len(text) + _CRC.size:
        return None
    return record


def _shifted(register: int) -> int:
    """Return CRC-32's register after eight zero bits."""
    for _ in range(8):
        register = register >> 1 ^ (0xEDB88320 if register & 1 else 0)
    return register


def _with_zeros(register: int, count: int) -> int:
    """Return what bytes of this CRC add to the CRC of themselves and ``count`` more (zlib's crc32_combine)."""
    for power, tables in enumerate(_zeros()):
        if count >> power & 1:
            a, b, c, d = tables
            register = a[register & 255] ^ b[register >> 8 & 255] ^ c[register >> 16 & 255] ^ d[register >> 24]
    return register


@cache
def _zeros() -> list[list[list[int]]]:
    """Return, for 1, 2, 4 ... zero bytes up to the longest record, what each byte of the register becomes."""

    def tables(bit: list[int]) -> list[list[int]]:
        made = []
        for byte in range(4):
            table = [0]
            for place in range(8):
                table += [value ^ bit[8 * byte + place] for value in table]
            made.append(table)
        return made

    powers = [tables([_shifted(1 << place) for place in range(32)])]
    while len(powers) < (_LONGEST + _HEAD.size).bit_length():
        a, b, c, d = powers[-1]
        once = [a[1 << place] if place < 8 else (b, c, d)[place // 8 - 1][1 << place % 8] for place in range(32)]
        twice = [a[r & 255] ^ b[r >> 8 & 255] ^ c[r >> 16 & 255] ^ d[r >> 24] for r in once]
        powers.append(tables(twice))
    return powers
