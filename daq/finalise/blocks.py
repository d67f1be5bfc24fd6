"""The samples of a journal of blocks (`daq.protocols.blocks`), in pieces as of a board's run.

Their times are those of the source, and increase: the recorder rejects others.  Where they step by n periods, n - 1
samples are missing.  There is one segment, and nothing to unwrap.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from daq.protocols import blocks
from daq.stream.integrity import CheckedCounts, SegmentReason
from daq.stream.timeline import Frames, Piece, Samples
from stickslip.compute.arrays import Array, Integers

COUNTER_BITS = 32  # the widest: the source has no counter that rolls over


class BlockPiece(NamedTuple):
    """Some samples of a journal: as a piece of a board's run, and their values, counts or m, (k,)."""

    piece: Piece
    checked: CheckedCounts
    values: Array | Integers


class BlockStream:
    """The samples of a journal, record by record; a damaged record has none, and counts as damaged."""

    def __init__(self, header: Mapping[str, Any]) -> None:
        self._rate_hz, self._columns, self._n_requested = (header[name] for name in ("rate_hz", "columns", "samples"))
        self._first_s = self._last_s = 0.0
        self._last_index, self._last_ns, self._last_value = -1, 0, 0
        self._records = self._n_taken = 0

    def take(self, stamp_ns: int, data: bytes) -> BlockPiece:
        content = blocks.unpack(data, self._columns)
        time, values = (np.empty(0), np.empty(0)) if content is None else content
        room = len(time) if self._n_requested is None else self._n_requested - self._n_taken
        time, values = time[:room], values[:room]
        begins = not self._n_taken and len(time) > 0
        if begins:
            self._first_s = self._last_s = float(time[0])
        steps = np.diff(time, prepend=self._last_s)
        periods = np.maximum(np.rint(steps * self._rate_hz).astype(np.int64), 1)
        index = self._last_index + np.cumsum(periods)
        if begins:
            index -= index[0]
        lost = np.diff(index, prepend=-1 if begins else self._last_index) - 1
        # When each sample was taken, if the source keeps up; the samples of a faster source arrive all at once.
        stamp = stamp_ns - np.rint((time[-1:] - time) * 1e9).astype(np.int64)
        stamp = stamp if begins else np.maximum(stamp, self._last_ns)
        peak_rate = 0.0
        if self._columns == blocks.COUNTS and len(time):
            moved = np.abs(np.diff(values, prepend=values[0] if begins else self._last_value))
            peak_rate = float(np.max(moved / np.maximum(steps, 1 / self._rate_hz), initial=0.0))
            self._last_value = int(values[-1])
        if len(time):
            self._last_s, self._last_index, self._last_ns = float(time[-1]), int(index[-1]), int(stamp[-1])
        self._n_taken += len(time)
        self._records += 1
        piece = _build_piece(time - self._first_s, index, stamp, self._records - 1, damaged=content is None)
        return BlockPiece(piece, _build_counts(values, lost, peak_rate, begins=begins), values)


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
    n, starts = len(values), np.zeros(int(begins), np.int64)
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
