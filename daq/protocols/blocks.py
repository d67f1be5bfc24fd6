"""Blocks of samples that a program supplies instead of a board's bytes: times and values as stored in a journal.

A record of a journal holds n times (float64, s), n values (counts as int64, positions in m as float64), and the CRC-32
of both, little endian.  The header's ``columns`` say which values they are.
"""

from binascii import crc32
from collections.abc import Iterator

import numpy as np

from stickslip.compute.arrays import Array, Integers

NAME = "blocks"
COUNTS, POSITIONS = "t_s,count", "t_s,x_m"
# Samples of a record; a longer block becomes several records.
RECORD_SAMPLES = 1 << 16
_CRC_BYTES = 4


def pack(time: Array, values: Array | Integers) -> Iterator[bytes]:
    """Yield the records of a block: times, s, and values, (n,) each."""
    kind = "<i8" if values.dtype.kind == "i" else "<f8"
    for first in range(0, len(time), RECORD_SAMPLES):
        span = slice(first, first + RECORD_SAMPLES)
        content = time[span].astype("<f8").tobytes() + values[span].astype(kind).tobytes()
        yield content + crc32(content).to_bytes(_CRC_BYTES, "little")


def unpack(record: bytes, columns: str) -> tuple[Array, Array | Integers] | None:
    """Return the times and values in a record, (n,) each; None if it is damaged."""
    content, crc = record[:-_CRC_BYTES], record[-_CRC_BYTES:]
    n, rest = divmod(len(content), 16)
    if not n or rest or crc32(content) != int.from_bytes(crc, "little"):
        return None
    time = np.frombuffer(content, "<f8", n).astype(np.float64)
    if columns == COUNTS:
        return time, np.frombuffer(content, "<i8", n, 8 * n).astype(np.int64)
    return time, np.frombuffer(content, "<f8", n, 8 * n).astype(np.float64)
