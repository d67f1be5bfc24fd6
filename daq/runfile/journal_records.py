"""Records of a journal: bytes to records and back, without any file.

A record is ``kind u8, length u32, stamp i64`` (host's monotonic clock, ns), its bytes, and a CRC-32 over all of that;
little endian.  After a record that does not hold a reader goes on at the next place where a whole record holds.  Bytes
received are kept when the CRC of their record fails but its length is right: its frames have their own CRCs.

The header is written again and again, because nothing can be read without it.  Journals of version 0.1.0 hold it once:
there one wrong byte is corrected by means of the CRC.
"""

import re
import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple
from zlib import crc32

MAGIC = b"stickslip journal 1\n"
HEADER, RECEIVED, LOST, REOPENED, DROPPED, CONFIGURATION, END = b"HRLODCE"
_KINDS = frozenset(b"HRLODCE")
_KIND = re.compile(b"[HRLODCE]")
_HEAD = struct.Struct("<BIq")
_CRC = struct.Struct("<I")
_LONGEST = 1 << 26  # bytes; no record is longer, so a longer length is damage
_LONGEST_HEADER = 1 << 16  # bytes in which a wrong byte is looked for; a header has 1 to 2 kB
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


def wrong_in_magic(content: bytes) -> int | None:
    """Return how many bytes of the magic line are damaged; None where the content is no journal."""
    right = sum(byte == wanted for byte, wanted in zip(content, MAGIC, strict=False))
    return len(MAGIC) - right if right >= _MAGIC_HOLDS else None


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
            at += record.size
            continue
        # A record begins with its kind: look only at bytes that are one.
        ahead = (place.start() for place in _KIND.finditer(content, at + 1))
        following = next((place for place in ahead if _record_at(content, place)), None)
        if following is None:
            return
        at = following


def header(content: bytes, found: Sequence[Place]) -> Record | None:
    """Return a journal's header: the first copy that holds, or a single copy in which one byte was wrong.

    Parameters
    ----------
    content : bytes
        The journal.
    found : sequence of Place
        Its records.
    """
    copy = next((place.record for place in found if place.record.kind == HEADER), None)
    if copy is not None:
        return copy
    following = next((place.at for place in found if place.holds), len(content))
    return _corrected(content[len(MAGIC) : following])


def is_cut_short(content: bytes, at: int) -> bool:
    """Return whether what begins at a place, and holds no record, is a record whose end is missing."""
    if at + _HEAD.size > len(content):
        return True
    kind, length, _ = _HEAD.unpack_from(content, at)
    return kind in _KINDS and length <= _LONGEST and at + _HEAD.size + length + _CRC.size > len(content)


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
    record = _record_at(text + _CRC.pack(crc32(text)), 0)
    if record is None or record.kind != HEADER or record.size != len(text) + _CRC.size:
        return None
    return record


def _shifted(register: int) -> int:
    """Return CRC-32's register after eight zero bits."""
    for _ in range(8):
        register = register >> 1 ^ (0xEDB88320 if register & 1 else 0)
    return register
