"""The samples of a journal of blocks (`daq.protocols.blocks`), in the pieces from which the finaliser makes a run.

Their times are those of the source, and increase: the recorder rejects others.  Where they step by n periods, n - 1
samples are missing.  There is one segment, and nothing to unwrap.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from daq.protocols import blocks
from daq.runfile import journal
from daq.stream.integrity import CheckedCounts, SegmentReason
from daq.stream.timeline import Frames, Piece, Samples
from stickslip.compute.arrays import Array, Integers

COUNTER_BITS = 32  # the widest: the source has no counter that rolls over


class BlockPiece(NamedTuple):
    """Some samples of a journal: as a piece of a board's run, and their values, counts or m, (k,)."""

    piece: Piece
    checked: CheckedCounts
    values: Array | Integers


def read_pieces(recorded: journal.Journal) -> Iterator[BlockPiece]:
    """Yield the samples of a journal record by record; a damaged record has none, and counts as damaged."""
    rate_hz, columns, n_requested = (recorded.header[name] for name in ("rate_hz", "columns", "samples"))
    first_s: float | None = None
    last_s, last_index, last_ns, last_value, n_taken = 0.0, -1, 0, 0, 0
    for number, record in enumerate(recorded.records.of_kind(journal.RECEIVED)):
        content = blocks.unpack(record.data, columns)
        time, values = (np.empty(0), np.empty(0)) if content is None else content
        room = len(time) if n_requested is None else n_requested - n_taken
        time, values = time[:room], values[:room]
        if first_s is None and len(time):
            first_s = last_s = float(time[0])
        steps = np.diff(time, prepend=last_s)
        periods = np.maximum(np.rint(steps * rate_hz).astype(np.int64), 1)
        index = last_index + np.cumsum(periods)
        if len(time) and not n_taken:
            index -= index[0]
        lost = np.diff(index, prepend=last_index if n_taken else -1) - 1
        # When each sample was taken, if the source keeps up; the samples of a faster source arrive all at once.
        stamp = record.stamp_ns - np.rint((time[-1:] - time) * 1e9).astype(np.int64)
        stamp = np.maximum(stamp, last_ns) if n_taken else stamp
        peak_rate = 0.0
        if columns == blocks.COUNTS and len(time):
            moved = np.abs(np.diff(values, prepend=last_value if n_taken else values[0]))
            peak_rate = float(np.max(moved / np.maximum(steps, 1 / rate_hz), initial=0.0))
            last_value = int(values[-1])
        yield BlockPiece(
            _build_piece(time - (first_s or 0.0), index, stamp, number, damaged=content is None),
            _build_counts(values, lost, peak_rate, begins=not n_taken),
            values,
        )
        if len(time):
            last_s, last_index, last_ns = float(time[-1]), int(index[-1]), int(stamp[-1])
        n_taken += len(time)


def _build_piece(time: Array, index: Integers, stamp: Integers, number: int, *, damaged: bool) -> Piece:
    zero = np.zeros(len(time), np.int64)
    samples = Samples(
        time=time,
        part=zero,
        begun_by=("reopened",),
        index=index,
        ticks=zero,
        frame=np.full(len(time), number),
        stamp_ns=stamp,
        up=zero.astype(np.uint32),
        down=zero.astype(np.uint32),
        status=zero.astype(np.uint8),
        illegal=zero.astype(np.uint16),
        belt=None,
        edge=None,
        place=index,
    )
    return Piece(samples, Frames(number, length=np.zeros(1, np.int64), crc_frame=np.zeros(int(damaged), np.int64)))


def _build_counts(values: Array | Integers, lost: Integers, rate: float, *, begins: bool) -> CheckedCounts:
    n, starts = len(values), np.zeros(int(begins and len(values) > 0), np.int64)
    reopened: SegmentReason = "reopened"
    return CheckedCounts(
        count=values.astype(np.int64) if values.dtype.kind == "i" else np.zeros(n, np.int64),
        segment=np.zeros(n, np.uint16),
        flags=np.zeros(n, np.uint16),
        lost=lost,
        peak_count_rate=rate,
        reasons=(reopened,) * len(starts),
        starts=starts,
        gap_s=np.zeros(len(starts)),
        leap_s=np.zeros(len(starts)),
        source=starts,
    )
