"""Samples that come as lines of text, without frames, sequence numbers or a checksum: what guards them, and a stream.

Guards: a line must match its whole pattern, so that most damage (a byte that is no digit, a byte too few or too many)
is seen.  A flipped digit is still a digit.  So a line whose time does not lie between its neighbours', or whose count
leaps away from both of them and back, is taken as damaged, too, and so is one whose count or time alone stands off the
smooth course of its neighbours (`_spikes`).  What cannot be seen is a wrong last digit, and damaged lines side by side.
Of lines damaged at random, 0.9 % pass in a QSB's records, 3 % in text lines, and less than 1 of 256 in text lines with
a column xor.

Lost lines show in the time: a step of n periods is n - 1 lines lost.  A sequence number is made from the time, one
period a number, and a net count is split into what went up and what went down, so that everything behind this module is
the same as for frames.
"""

from array import array
from collections.abc import Callable, Iterable, Sequence
from enum import IntFlag
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from daq.protocols.session import Tally
from daq.wire import frames
from daq.wire.counters import LATE_FRAMES, moves, signed
from daq.wire.decode import Stream
from daq.wire.splitter import Splitter

LEAP_COUNTS = 32
LEAP_MOTIONS = 8  # how much farther than the motion about it a line must leap to be damaged
SPIKE_LEAST = 3.0  # counts, or us: how far off the course of its neighbours a value is damaged
SPIKE_OVER_USUAL = 12  # and over what is usual about it
SPIKE_AMONG = 16  # lines on either side, without the nearest, that define what is usual
LOOK_AHEAD = 8  # lines among which the one must be that follows the last good one, where times disagree


class Other(IntFlag):
    """What a line is that holds no sample."""

    REMARK = 0
    DAMAGED = 1
    START = 2  # the board reports its start; with `DAMAGED` after a line that its reset cut short


# What a sample's line holds, as far as the protocol has it: ticks, up, down, status, illegal, each modulo its width.  A
# net count stands for up.
Row = tuple[int, ...]


class LineReader:
    """Read samples from a stream of lines; never raises on garbage, back in step at the next delimiter.

    Parameters
    ----------
    delimiter, longest : bytes, int
        What ends a line, and bytes beyond which a line is damaged.
    parse : callable
        Returns what a line holds.
    trusts_first : bool
        A first line that has lost its beginning is seen as damaged by its form.  It is no error then; where it could
        not be seen, the first line is no sample either.

    Attributes
    ----------
    example : bytes
        The first line that was damaged.
    """

    def __init__(
        self, delimiter: bytes, longest: int, parse: Callable[[bytes], Row | Other], *, trusts_first: bool
    ) -> None:
        self.example = b""
        self._splitter = Splitter(delimiter, longest)
        self._longest = longest
        self._parse = parse
        self._trusts_first = trusts_first
        self._first = True
        self._damaged_bytes = 0

    @property
    def discarded_bytes(self) -> int:
        """Bytes of all damaged lines, delimiters not included."""
        return self._damaged_bytes + self._splitter.dropped_bytes

    def feed(self, data: bytes) -> tuple[list[Row], list[tuple[int, Other]]]:
        """Take bytes as they came; return the samples in order, and damage and starts: each behind how many of them."""
        rows: list[Row] = []
        others: list[tuple[int, Other]] = []
        for line in self._splitter.feed(data):
            item = self._parse(line) if len(line) <= self._longest else Other.DAMAGED
            if isinstance(item, tuple):
                if self._trusts_first or not self._first:
                    rows.append(item)
            elif item:
                if Other.DAMAGED in item:
                    self.example = self.example or line
                    self._damaged_bytes += len(line)
                if self._first:
                    item &= ~Other.DAMAGED
                others.append((len(rows), item))
            self._first = False
        return rows, others


class LineTally(Tally):
    """How far a stream of lines has come, by their times; see `daq.protocols.session.Tally`."""

    def __init__(self, make_reader: Callable[[], LineReader], period_ticks: float) -> None:
        super().__init__()
        self._make_reader = make_reader
        self._reader = make_reader()
        self._period = period_ticks
        self._last: int | None = None
        self._odd = 0  # lines in a row whose times do not follow the last good one

    def feed(self, data: bytes) -> None:
        """Take bytes as they came."""
        rows, others = self._reader.feed(data)
        starts = [behind for behind, other in others if Other.START in other]
        for behind in range(len(rows) + 1):
            if behind in starts and self._last is not None:
                self.resets += 1
                self._last = None
            if behind < len(rows):
                self._step(rows[behind][0])

    def begin_again(self, reached: int) -> None:
        """Begin anew, ``reached`` periods after the start."""
        self._reader = self._make_reader()
        self._last, self._odd = None, 0
        super().begin_again(reached)

    def _step(self, ticks: int) -> None:
        """Take the time of a line."""
        if self._last is None:
            self.reached += 1
            self._last = ticks
            return
        periods = signed(ticks - self._last, 32) / self._period
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


def decode(
    reads: Iterable[tuple[int, bytes]], reader: LineReader, ident: frames.Ident, period_ticks: float, *, net: bool
) -> Stream:
    """Decode the reads of one connection into frames of one sample each.

    Lines that cannot be true are counted as damaged.

    Parameters
    ----------
    reads : iterable of (int, bytes)
        Host's monotonic stamp in ns at the end of each read, and the bytes it gave.
    reader, ident, period_ticks
        Reader of this protocol's lines, what is known of the board, and the nominal sample interval.
    net : bool
        There is but one counter, a signed net count.
    """
    values = array("q")
    stamps: list[int] = []  # of each good line
    found: list[tuple[int, Other]] = []  # behind how many good lines
    for stamp, data in reads:
        rows, others = reader.feed(data)
        found += [(len(stamps) + behind, other) for behind, other in others]
        values.extend(chain.from_iterable(rows))
        stamps += [stamp] * len(rows)
    bad, begun = ([behind for behind, other in found if what in other] for what in (Other.DAMAGED, Other.START))
    columns = np.zeros((5, len(stamps)), dtype=np.int64)
    sent = np.frombuffer(values, dtype=np.int64).reshape(len(stamps), -1).T if stamps else columns
    columns[: len(sent)] = sent
    ticks, up, down, status, illegal = columns
    keep = _in_time(ticks, period_ticks, begun)
    keep[keep] = ~_leaps(up[keep] - down[keep], ident.counter_bits)
    periods = moves(ticks[keep], 32) / period_ticks
    keep[keep] = ~_spikes(period_ticks * (periods - np.round(periods)))  # lines that are missing are none
    periods = moves(ticks[keep], 32) / period_ticks
    # [i + 1]: no line is missing among i - 2 ... i + 2, or the course would not be smooth.
    together = np.convolve(np.append(np.abs(periods - 1) < 0.5, False), np.ones(4)) == 4
    moved = moves(up[keep] - down[keep], ident.counter_bits)
    keep[keep] = ~(_spikes(moved) & together[1 : len(moved) + 2])
    damaged = np.sort(np.concatenate((np.array(bad, dtype=np.int64), np.flatnonzero(~keep))))
    kept = np.concatenate(([0], np.cumsum(keep)))  # lines kept before each good one
    ticks, up, down = ticks[keep], up[keep], down[keep]
    if net:
        up, down = _two_counters(up, ident.counter_bits)
    sequence, starts = _sequence(ticks, period_ticks, kept[np.array(begun, dtype=np.int64)])
    n = len(ticks)
    wide = ident.counter_bits > 16
    return Stream(
        first=np.arange(n),
        n=np.ones(n, dtype=np.int64),
        seq=sequence,
        ticks=ticks,
        illegal=illegal[keep],
        stamp_ns=np.array(stamps, dtype=np.int64)[keep],
        dt=np.zeros(n, dtype=np.uint16),
        up=up.astype(np.uint32) if wide else up.astype(np.uint16),
        down=down.astype(np.uint32) if wide else down.astype(np.uint16),
        status=status[keep].astype(np.uint8),
        ident=ident,
        idents=starts,
        crc_frame=kept[damaged],
        crc_errors=len(damaged),
        discarded_bytes=reader.discarded_bytes,
        length=np.zeros(n, dtype=np.int64),
    )


def _two_counters(count: NDArray[np.int64], bits: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the up and the down counter that a net count stands for: up - down is the count, and both only rise."""
    step = moves(count, bits)
    down = np.concatenate(([0], np.cumsum(np.maximum(-step, 0))))[: len(count)]
    limit = (1 << bits) - 1
    return (count + down) & limit, down & limit


def _in_time(ticks: NDArray[np.int64], period: float, starts: Sequence[int]) -> NDArray[np.bool_]:
    """Return which lines do not stand out of time: a damaged time leaps away, and the lines after it leap back."""
    keep = np.ones(len(ticks), dtype=np.bool_)
    step = moves(ticks, 32)
    odd = np.flatnonzero((step < -LATE_FRAMES * period) | (step > LATE_FRAMES * period)) + 1
    if len(odd) == 0:
        return keep
    fresh = set(starts)
    last = int(odd[0]) - 1
    for line in range(int(odd[0]), len(ticks)):
        if line in fresh:
            last = line
            continue
        ahead = (ticks[line : line + LOOK_AHEAD + 1] - ticks[last] + 0x80000000 & 0xFFFFFFFF) - 0x80000000
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
    step = np.abs(moves(count, bits))
    # The typical step of five lines on either side, whichever is more: a mass may stop dead or start at once.
    padded = np.pad(step, 5, mode="edge")
    typical = np.median(np.lib.stride_tricks.sliding_window_view(padded, 5), axis=1)  # [i]: steps i - 5 ... i - 1
    motion = np.maximum(typical[: len(step) - 1], typical[7 : len(step) + 6])
    limit = LEAP_COUNTS + LEAP_MOTIONS * motion
    leaps[1:-1] = (step[:-1] > limit) & (step[1:] > limit)
    return leaps


def _spikes(step: NDArray[np.int64] | NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return which of n values alone stands off the smooth course of two neighbours on either side; ``step``: (n - 1,).

    The value is held against the cubic through these four.  A value off by e is off it by e, its neighbours by -2e/3
    and e/6; a jump, a kick or a gap has other ratios, and so has noise that is as large all about.
    """
    n = len(step) + 1
    spikes = np.zeros(n, dtype=np.bool_)
    if n < 2 * SPIKE_AMONG:
        return spikes
    v = np.concatenate(([0.0], np.cumsum(step)))
    off = np.zeros(n)
    off[2:-2] = v[2:-2] - (4 * (v[1:-3] + v[3:-1]) - v[:-4] - v[4:]) / 6
    size = np.abs(off)
    # What is usual: the median of some on either side, whichever is more, those that a spike disturbs left out.
    usual = np.median(
        np.lib.stride_tricks.sliding_window_view(np.pad(size, SPIKE_AMONG, mode="edge"), SPIKE_AMONG - 2), axis=1
    )
    usual = np.maximum(usual[:n], usual[SPIKE_AMONG + 3 : SPIKE_AMONG + 3 + n])
    slack = SPIKE_LEAST + SPIKE_OVER_USUAL * usual
    beside = np.maximum(np.abs(off[1:-3] + off[2:-2] / 1.5), np.abs(off[3:-1] + off[2:-2] / 1.5))
    # A kick has -1/2 beside it where a spike has -2/3.
    spikes[2:-2] = (size > slack)[2:-2] & (beside < np.minimum(0.15 * size, 0.08 * size + 0.5)[2:-2])
    return spikes


def _sequence(
    ticks: NDArray[np.int64], period: float, starts: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return sequence numbers made from the times, and the lines at which they begin with 0 again."""
    step = moves(ticks, 32)
    number = np.round(step / period).astype(np.int64)
    number[(step > 0) & (number < 1)] = 1
    anew = np.flatnonzero(step < -LATE_FRAMES * period) + 1
    starts = np.unique(np.concatenate((starts[(starts > 0) & (starts < len(ticks))], anew)))
    total = np.concatenate(([0], np.cumsum(number)))[: len(ticks)]
    origin = np.concatenate((np.zeros(1, dtype=np.int64), starts))
    if len(ticks):
        total = total - total[origin[np.searchsorted(origin, np.arange(len(ticks)), side="right") - 1]]
    return total & 0xFFFF, starts
