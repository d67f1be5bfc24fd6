"""Many lines of one length at once: COBS and CRC undone column by column, by the rules of `daq.wire.frames.deframe`.

COBS: the first byte says how far it is to the next code; a code stands where the payload has a zero, and says how far
it is from there.  So a walk along the columns that keeps, for every line, where its next code is due, undoes them all.

CRC: it is linear, so the CRC of a message is that of as many zeros, changed by what each byte adds at its place.  One
table per place, made of the bit's own CRC by `binascii.crc_hqx`, says what.

Lines of 255 bytes and more, whose codes may stand for no zero, are taken one at a time.
"""

from binascii import crc_hqx
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from daq.wire import frames
from daq.wire.cut import Cut

SHORTEST, LONGEST = 5, 254  # bytes of a line: the shortest payload and its CRC; beyond, COBS has another rule


@dataclass(frozen=True)
class Group:
    """Sample frames of one size that say they hold as many samples: their lines (k,) and their payloads (k, size)."""

    lines: NDArray[np.int64]
    payloads: NDArray[np.uint8]


@dataclass(frozen=True)
class Payloads:
    """What the lines of a stream hold.

    Attributes
    ----------
    samples : list of Group
        The SAMPLES frames of our version.
    others : list of (int, bytes)
        Line and payload of every other frame whose CRC holds.
    wrong : (w,) int64
        Lines that do not hold, in order; not the first, whose beginning may be missing; one more than there are for an
        endless one at the end.
    wrong_bytes : int
        Bytes of all that do not hold, the first included.
    """

    samples: list[Group]
    others: list[tuple[int, bytes]]
    wrong: NDArray[np.int64]
    wrong_bytes: int


def payloads(lines: Cut) -> Payloads:
    """Undo COBS and CRC of all lines."""
    held = lines.length == 0
    samples: list[Group] = []
    others: list[tuple[int, bytes]] = []
    ours = bytes((frames.SAMPLES, frames.VERSION))
    for where, rows in lines.by_length(SHORTEST, LONGEST):
        found, good = deframe(rows)
        held[where] = good
        sample = good & (found[:, 0] == frames.SAMPLES) & (found[:, 1] == frames.VERSION)
        sample &= found.shape[1] >= frames.SAMPLES_HEADER
        others += [(int(where[k]), found[k].tobytes()) for k in np.flatnonzero(good & ~sample)]
        for n in np.flatnonzero(np.bincount(found[sample, 2])) if np.any(sample) else ():
            chosen = sample & (found[:, 2] == n)
            samples.append(Group(where[chosen], found[chosen]))
    for k in np.flatnonzero((lines.length > LONGEST) & (lines.length <= frames.LONGEST_LINE)).tolist():
        payload = frames.deframe(lines.line(k))
        held[k] = payload is not None
        if payload is not None and payload[:2] == ours:
            samples.append(Group(np.array([k]), np.frombuffer(payload, dtype=np.uint8)[np.newaxis]))
        elif payload is not None:
            others.append((k, payload))
    wrong = np.flatnonzero(~held)
    lost = int(lines.length[wrong].sum())
    begun = np.flatnonzero(lines.length)[:1]
    wrong = wrong[~np.isin(wrong, begun)]
    if lines.rest > frames.LONGEST_LINE:
        lost += lines.rest
        wrong = np.append(wrong, np.full(len(begun), len(lines)))
    return Payloads(samples, sorted(others), wrong, lost)


def deframe(rows: NDArray[np.uint8]) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
    """Return the payloads of lines, and which of them hold; a payload that does not hold means nothing.

    Parameters
    ----------
    rows : (k, size) uint8
        Lines without their delimiter, so without a zero; ``SHORTEST`` to ``LONGEST`` bytes each.

    Returns
    -------
    tuple
        (k, size - 3) uint8 and (k,) bool.
    """
    size = rows.shape[1]
    columns = np.ascontiguousarray(rows.T)
    due = columns[0].copy()
    held = due <= size
    crc = np.full(len(rows), crc_hqx(bytes(size - 3), frames.CRC_SEED), dtype=np.uint16)
    tables = _tables(size - 3)
    for place in range(1, size):
        column = columns[place]
        code = due == place
        held &= ~code | (column <= size - place)
        due += column * code
        column *= ~code
        if place <= size - 3:
            crc ^= tables[place - 1][column]
    held &= due == size
    held &= crc == columns[size - 2] | columns[size - 1].astype(np.uint16) << 8
    return np.ascontiguousarray(columns[1 : size - 2].T), held


@cache
def _tables(length: int) -> NDArray[np.uint16]:
    """Return what each byte at each place of a payload of that length adds to its CRC, (length, 256)."""
    tables = np.zeros((length, 256), dtype=np.uint16)
    for place in range(length):
        after = bytes(length - 1 - place)
        for bit in range(8):
            tables[place, 1 << bit] = crc_hqx(bytes((1 << bit,)) + after, 0)
    for value in range(256):
        low = value & -value
        tables[:, value] = tables[:, low] ^ tables[:, value ^ low] if value != low else tables[:, value]
    return tables
