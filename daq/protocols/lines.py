"""Samples that come as lines of text, without frames, sequence numbers or a checksum: what guards them, and a stream.

Guards: a line must match its whole pattern, so that most damage (a byte that is no digit, a byte too few or too many)
is seen.  A flipped digit is still a digit.  So a line whose time does not lie between its neighbours', or whose count
leaps away from both of them and back, is taken as damaged, too.  What cannot be seen is a wrong digit of little weight
(a leap of `LEAP_COUNTS` counts or `LEAP_MOTIONS` times the motion, a time that stays near its neighbours), and two
damaged lines side by side that agree.  Of lines damaged at random, 1.3 % pass in a QSB's records, 5 % in text lines,
and less than 1 of 256 in text lines with a column xor.

Lost lines show in the time: a step of n periods is n - 1 lines lost.  A sequence number is made from the time, one
period a number, and a net count is split into what went up and what went down, so that everything behind this module is
the same as for frames.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from daq import wire
from daq.counter import LATE_FRAMES, increments
from daq.stream import Stream

LEAP_COUNTS = 32
LEAP_MOTIONS = 8  # how much farther than the motion about it a line must leap to be damaged
LOOK_AHEAD = 8  # lines among which the one must be that follows the last good one, where times disagree


@dataclass
class Rows:
    """Lines as read, in order of arrival.

    Attributes
    ----------
    stamp_ns, ticks, up, down, status, illegal : list of int
        The host's stamp of the read that ended each line; what the line said, modulo its width.  A net count stands in
        ``up``, and ``down`` is empty.
    bad : list of int
        Before which line each damaged one came.
    starts : list of int
        Before which lines the board said that it has started.
    """

    stamp_ns: list[int] = field(default_factory=list)
    ticks: list[int] = field(default_factory=list)
    up: list[int] = field(default_factory=list)
    down: list[int] = field(default_factory=list)
    status: list[int] = field(default_factory=list)
    illegal: list[int] = field(default_factory=list)
    bad: list[int] = field(default_factory=list)
    starts: list[int] = field(default_factory=list)
    discarded_bytes: int = 0

    def __len__(self) -> int:
        return len(self.ticks)


class LineTally:
    """How far a stream of lines has come, by their times; see `daq.protocols.session.Tally`."""

    def __init__(self, period_ticks: float) -> None:
        self.reached = 0
        self.resets = 0
        self.notice = ""
        self._period = period_ticks
        self._last: int | None = None
        self._odd = 0  # lines in a row whose times do not follow the last good one

    def step(self, ticks: int) -> None:
        """Take the time of a line."""
        if self._last is None:
            self.reached += 1
            self._last = ticks
            return
        periods = ((ticks - self._last + 0x80000000 & 0xFFFFFFFF) - 0x80000000) / self._period
        if 0 < periods <= LATE_FRAMES:
            self.reached += max(1, round(periods))
            self._last, self._odd = ticks, 0
            return
        self._odd += 1
        if self._odd > LOOK_AHEAD:  # not one damaged line: there is a gap, or the board has started anew
            self._odd = 0
            if periods > 0:
                self.reached += round(periods)
            else:
                self.resets += 1
            self._last = ticks

    def restarted(self) -> None:
        """Note that the board said it has started."""
        if self._last is not None:
            self.resets += 1
            self._last = None

    def begin_again(self, reached: int) -> None:
        """Begin anew, ``reached`` periods after the start."""
        self._last, self._odd = None, 0
        self.reached = max(self.reached, reached)


def to_stream(rows: Rows, ident: wire.Ident, period_ticks: float) -> Stream:
    """Return lines as a stream of frames of one sample each; lines that cannot be true are counted as damaged."""
    ticks = np.array(rows.ticks, dtype=np.int64)
    up = np.array(rows.up, dtype=np.int64)
    down = np.array(rows.down, dtype=np.int64) if rows.down else np.zeros(len(up), dtype=np.int64)
    stamp_ns = np.array(rows.stamp_ns, dtype=np.int64)
    keep = _in_time(ticks, period_ticks, rows.starts)
    keep[keep] = ~_leaps(up[keep] - down[keep], ident.counter_bits)
    bad = np.sort(np.concatenate((np.array(rows.bad, dtype=np.int64), np.flatnonzero(~keep))))
    kept = np.cumsum(keep)
    before = np.concatenate(([0], kept))  # lines kept before each line
    starts = before[np.array(rows.starts, dtype=np.int64)] if rows.starts else np.empty(0, dtype=np.int64)
    up, down = up[keep], down[keep]
    if not rows.down:
        up, down = _two_counters(up, ident.counter_bits)
    ticks = ticks[keep]
    sequence, starts = _sequence(ticks, period_ticks, starts)
    n = len(ticks)
    nothing = np.empty(0, dtype=np.int64)
    return Stream(
        first=np.arange(n),
        n=np.ones(n, dtype=np.int64),
        seq=sequence,
        ticks=ticks,
        illegal=np.array(rows.illegal, dtype=np.int64)[keep],
        stamp_ns=stamp_ns[keep],
        dt=np.zeros(n, dtype=np.uint16),
        up=_as_wide_as(ident.counter_bits, up),
        down=_as_wide_as(ident.counter_bits, down),
        status=np.array(rows.status, dtype=np.uint8)[keep],
        belt=None,
        edge=None,
        ident=ident,
        idents=starts,
        configs=(),
        notices=(),
        truth_seq=nothing,
        truth_frame=nothing,
        truth=np.empty((0, 4)),
        crc_frame=before[np.minimum(bad, len(before) - 1)],
        crc_errors=len(bad),
        unknown=0,
        discarded_bytes=rows.discarded_bytes,
        length=np.zeros(n, dtype=np.int64),
        part_stamp_ns=nothing,
        part_frame=nothing,
        part_bytes=nothing,
    )


def _two_counters(count: NDArray[np.int64], bits: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the up and the down counter that a net count stands for: up - down is the count, and both only rise."""
    step = _signed(increments(count, bits), bits)
    down = np.concatenate(([0], np.cumsum(np.maximum(-step, 0))))[: len(count)]
    limit = (1 << bits) - 1
    return (count + down) & limit, down & limit


def _as_wide_as(bits: int, values: NDArray[np.int64]) -> NDArray[np.uint16] | NDArray[np.uint32]:
    return values.astype(np.uint32) if bits > 16 else values.astype(np.uint16)


def _signed(steps: NDArray[np.int64], bits: int) -> NDArray[np.int64]:
    half = 1 << (bits - 1)
    return np.asarray((steps + half) % (1 << bits) - half)


def _elapsed(later: NDArray[np.int64], earlier: NDArray[np.int64] | int) -> NDArray[np.int64]:
    """Return the time between, ticks, from -2^31 to 2^31 - 1."""
    return np.asarray((later - earlier + 0x80000000 & 0xFFFFFFFF) - 0x80000000)


def _in_time(ticks: NDArray[np.int64], period: float, starts: Sequence[int]) -> NDArray[np.bool_]:
    """Return which lines do not stand out of time: a damaged time leaps away, and the lines after it leap back."""
    keep = np.ones(len(ticks), dtype=np.bool_)
    step = _elapsed(ticks[1:], ticks[:-1])
    odd = np.flatnonzero((step < -LATE_FRAMES * period) | (step > LATE_FRAMES * period)) + 1
    if len(odd) == 0:
        return keep
    fresh = set(starts)
    last = int(odd[0]) - 1
    for line in range(int(odd[0]), len(ticks)):
        if line in fresh:
            last = line
            continue
        ahead = _elapsed(ticks[line : line + LOOK_AHEAD + 1], int(ticks[last]))
        near = np.abs(ahead) <= (LATE_FRAMES + np.arange(len(ahead))) * period
        if near[0] or not near.any():  # it follows, or nothing does: then it begins a new stretch
            last = line
        else:
            keep[line] = False
    return keep


def _leaps(count: NDArray[np.int64], bits: int) -> NDArray[np.bool_]:
    """Return which counts (modulo 2^bits) leap away from both their neighbours, by far more than the motion about."""
    leaps = np.zeros(len(count), dtype=np.bool_)
    if len(count) < 3:
        return leaps
    step = np.abs(_signed(np.diff(count), bits))
    # The typical step of five lines on either side, whichever is more: a mass may stop dead or start at once.
    padded = np.pad(step, 5, mode="edge")
    typical = np.median(np.lib.stride_tricks.sliding_window_view(padded, 5), axis=1)  # [i]: steps i - 5 ... i - 1
    motion = np.maximum(typical[: len(step) - 1], typical[7 : len(step) + 6])
    limit = LEAP_COUNTS + LEAP_MOTIONS * motion
    leaps[1:-1] = (step[:-1] > limit) & (step[1:] > limit)
    return leaps


def _sequence(
    ticks: NDArray[np.int64], period: float, starts: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return sequence numbers made from the times, and the lines at which they begin with 0 again."""
    step = _elapsed(ticks[1:], ticks[:-1])
    number = np.round(step / period).astype(np.int64)
    number[(step > 0) & (number < 1)] = 1
    anew = np.flatnonzero(step < -LATE_FRAMES * period) + 1
    starts = np.unique(np.concatenate((starts[(starts > 0) & (starts < len(ticks))], anew)))
    total = np.concatenate(([0], np.cumsum(number)))[: len(ticks)]
    origin = np.concatenate((np.zeros(1, dtype=np.int64), starts))
    if len(ticks):
        total = total - total[origin[np.searchsorted(origin, np.arange(len(ticks)), side="right") - 1]]
    return total & 0xFFFF, starts
