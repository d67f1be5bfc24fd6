"""A stream of lines without a checksum, judged as it comes by the rules of `daq.protocols.neighbours`.

The lines come in pieces of any size; the result is that of the whole.  Each stage holds back the lines whose neighbours
are still to come, and keeps those that the next ones are held against:

1. lines whose times are out of order are dropped, or their times interpolated;
2. counts that leap are dropped;
3. counts off the course are dropped, times off the course are interpolated;
4. the lines are numbered by their times, from 0 where these show that the board started anew: they step back, or ahead
   of the host's clock; those of a coarse clock are set apart.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from daq.protocols.neighbours import LOOK_AHEAD, leaps, off_course, periods_between, running, spread, time_ahead
from daq.wire.arrival import LeastDelay
from daq.wire.counters import LATE_FRAMES, moves
from stickslip.compute import arrays
from stickslip.compute.arrays import Array

# Lines before and behind one that stages 2 to 4 keep.  They look 6, 19 (`SPIKE_AMONG` lines, and three about each) and
# 16 lines far; `off_course` judges no fewer than 32 lines at once.  Half is too few, double gives the same result.
REACH = 32
ANCHOR = 4  # lines into those kept from which on their numbers do not depend on the lines before them


@dataclass(frozen=True)
class Lines:
    """Lines with a sample, n of them, in order."""

    sent: NDArray[np.int64]  # (n,) times as sent, modulo 2^32
    ticks: NDArray[np.int64]  # (n,) the same; once judged, interpolated where the time as sent was not true
    up: NDArray[np.int64]  # (n,) counters modulo their width
    down: NDArray[np.int64]
    status: NDArray[np.int64]  # (n,) see `daq.wire.decode.Stream`
    illegal: NDArray[np.int64]
    stamp_ns: NDArray[np.int64]
    fresh: NDArray[np.bool_]  # (n,) the board has started anew before this line
    damaged: NDArray[np.int64]  # (n,) damaged lines between the line before and this one
    number: NDArray[np.int64]  # (n,) once judged: periods since the start that the line follows, made from the times

    def __len__(self) -> int:
        return len(self.ticks)


class Between:
    """What stands between lines: what follows the last of some is before the first of the next ones.

    damaged: Damaged lines behind the last line.
    """

    def __init__(self) -> None:
        self.damaged = 0
        self._fresh = False

    def before(
        self, fresh: NDArray[np.bool_], damaged: NDArray[np.int64]
    ) -> tuple[NDArray[np.bool_], NDArray[np.int64]]:
        """Return what is before each of n lines; given are n + 1 values, the last for what is behind the last line."""
        fresh[0] |= self._fresh
        damaged[0] += self.damaged
        self._fresh, self.damaged = bool(fresh[-1]), int(damaged[-1])
        return fresh[:-1], damaged[:-1]

    def kept(self, lines: Lines, keep: NDArray[np.bool_]) -> Lines:
        """Return the lines to keep; the others are damaged."""
        if keep.all() and not (self._fresh or self.damaged):
            return lines
        place: NDArray[np.int64] = np.cumsum(keep) - keep  # among those kept, of the line itself or of the next one
        kept = arrays.rows(lines, keep)
        fresh = np.zeros(len(kept) + 1, dtype=np.bool_)
        fresh[place[lines.fresh]] = True
        damaged = np.bincount(place, lines.damaged + ~keep, len(kept) + 1).astype(np.int64)
        fresh, damaged = self.before(fresh, damaged)
        return replace(kept, fresh=fresh, damaged=damaged)


class Judge:
    """Judge lines by their neighbours, in pieces of any size.

    bits: Width of the counters.
    period: Nominal sample interval, ticks.
    resolution: Ticks by which a coarse clock advances at once: so much may a time differ from the sample's.  0: none is
        coarse.
    tick_ns: Tick of the board's clock, ns.
    net: There is but one counter, a signed net count, in place of ``up``; it is split into two.
    """

    def __init__(self, bits: int, period: float, resolution: int, tick_ns: int, *, net: bool) -> None:
        self._in_time = _InTime(period)
        self._leaps = _Leaps(bits)
        self._on_course = _OnCourse(bits, period, resolution)
        self._numbered = _Numbered(period, resolution, tick_ns)
        self._counters = _TwoCounters(bits) if net else None

    @property
    def damaged(self) -> int:
        """Lines dropped behind the last one that is kept."""
        return sum(stage.between.damaged for stage in (self._in_time, self._leaps, self._on_course))

    def feed(self, lines: Lines, last: bool) -> Lines:
        """Take the next lines; return those decided now and kept.  With the ``last`` ones, all are decided."""
        for stage in (self._in_time, self._leaps, self._on_course, self._numbered):
            lines = stage.feed(lines, last)
        return lines if self._counters is None else self._counters.split(lines)


class _InTime:
    """Drop lines out of order: a damaged time leaps away, and the lines after it leap back.

    Such a line is kept, its time interpolated, where the lines around it leave room for just as many as there are.
    """

    def __init__(self, period: float) -> None:
        self.between = Between()
        self._period = period
        self._held: Lines | None = None
        self._keep = np.zeros(0, dtype=np.bool_)  # which of them
        self._line = 0  # the first of them that is not decided
        self._last: tuple[int, np.int64] | None = None  # the last good line and its time, while lines do not follow it

    def feed(self, lines: Lines, last: bool) -> Lines:
        """Take the next lines; return those that are kept and can no longer change."""
        held = arrays.joined([lines] if self._held is None else [self._held, lines])
        ticks = held.ticks  # a copy
        keep = np.concatenate((self._keep, np.ones(len(lines), dtype=np.bool_)))
        self._decide(ticks, held.fresh, keep, len(held) if last else len(held) - LOOK_AHEAD)
        final = len(held) if last else max(self._line - LOOK_AHEAD, 0)  # a line may be restored so far back
        self._held, self._keep = arrays.rows(held, slice(final, None)), keep[final:]
        self._line -= final
        if self._last is not None:
            self._last = self._last[0] - final, self._last[1]
        return self.between.kept(arrays.rows(held, slice(final)), keep[:final])

    def _decide(self, ticks: NDArray[np.int64], fresh: NDArray[np.bool_], keep: NDArray[np.bool_], until: int) -> None:
        """Decide up to a line; ``ticks`` and ``keep`` are changed in place."""
        period = self._period
        step = moves(ticks, 32)
        odd = np.flatnonzero((step < -LATE_FRAMES * period) | (step > LATE_FRAMES * period)) + 1
        line = self._line
        while line < until:
            if self._last is None:  # up to the next one that is odd, each line follows
                after = np.searchsorted(odd, line)
                line = min(int(odd[after]), until) if after < len(odd) else until
                if line == until:
                    break
                self._last = line - 1, ticks[line - 1]
            last, last_ticks = self._last
            ahead = time_ahead(last_ticks, ticks[line : line + LOOK_AHEAD + 1])
            near = np.abs(ahead) <= (LATE_FRAMES + np.arange(len(ahead))) * period
            if fresh[line] or near[0] or not near.any():  # it follows, or nothing does: then it begins a new stretch
                between = line - last - 1
                if between and near[0] and not fresh[line] and round(int(ahead[0]) / period) == line - last:
                    place = np.round(ahead[0] * np.arange(1, line - last) / (line - last)).astype(np.int64)
                    ticks[last + 1 : line] = last_ticks + place & 0xFFFFFFFF
                    keep[last + 1 : line] = True
                self._last = None
            else:
                keep[line] = False
            line += 1
        self._line = line


class _Stage(ABC):
    """Decide on lines by those at most `REACH` before and behind them."""

    def __init__(self) -> None:
        self.between = Between()
        self._held: Lines | None = None
        self._decided = 0  # how many of them have been decided on

    def feed(self, lines: Lines, last: bool) -> Lines:
        """Take the next lines; return those that are kept and can no longer change."""
        held = arrays.joined([lines] if self._held is None else [self._held, lines])  # a copy, which may be changed
        until = len(held) if last else max(self._decided, len(held) - REACH)
        decided = self._decide(held, slice(self._decided, until), len(held) - len(lines))
        first = max(until - REACH, 0)
        self._held, self._decided = arrays.rows(held, slice(first, None)), until - first
        return decided

    @abstractmethod
    def _decide(self, lines: Lines, here: slice, new: int) -> Lines:
        """Return those of the ``lines`` ``here`` that are kept; ``new`` is the first of all that has come now."""


class _Leaps(_Stage):
    """Drop lines whose counts leap away."""

    def __init__(self, bits: int) -> None:
        super().__init__()
        self._bits = bits

    def _decide(self, lines: Lines, here: slice, new: int) -> Lines:
        leap = leaps(lines.up - lines.down, self._bits)
        return self.between.kept(arrays.rows(lines, here), ~leap[here])


class _OnCourse(_Stage):
    """Drop lines whose counts are off the course of their neighbours; interpolate times that are."""

    def __init__(self, bits: int, period: float, resolution: int) -> None:
        super().__init__()
        self._bits, self._period, self._resolution = bits, period, resolution
        # A line of those held, its time without roll-over and its number: from the first line of all, so that a phase
        # is rounded as that of the whole stream.
        self._anchor = 0, 0, 0

    def _decide(self, lines: Lines, here: slice, new: int) -> Lines:
        at, time_there, number_there = self._anchor
        time, number = running(moves(lines.ticks, 32)), running(periods_between(lines.ticks, self._period))
        time += time_there - time[at]
        number += number_there - number[at]
        damaged, late, course = off_course(
            lines.ticks,
            lines.up - lines.down,
            time,
            number,
            bits=self._bits,
            period=self._period,
            resolution=self._resolution,
        )
        if here.stop > REACH:
            at = here.stop - REACH + ANCHOR
            self._anchor = ANCHOR, int(time[at]), int(number[at])
        ticks = lines.ticks.copy()
        ticks[late] = course & 0xFFFFFFFF
        return self.between.kept(arrays.rows(replace(lines, ticks=ticks), here), ~damaged[here])


class _Numbered(_Stage):
    """Number the lines from the last start on, by their times; set lines of a coarse clock apart."""

    def __init__(self, period: float, resolution: int, tick_ns: int) -> None:
        super().__init__()
        self._period, self._resolution = period, resolution
        self._tick_s = tick_ns / 1e9
        self._device = 0  # ticks from the first line of all to the newest one, without roll-over
        self._least = LeastDelay()
        self._newest: int | None = None  # time of the newest line, before any is set apart
        self._number = 0  # of the last line decided on, and of the last start, both since the first line of all
        self._start = 0

    def _decide(self, lines: Lines, here: slice, new: int) -> Lines:
        ticks, fresh = lines.ticks, lines.fresh
        if len(lines) > new:
            newest = int(ticks[new]) if self._newest is None else self._newest
            step = moves(np.concatenate(([newest], ticks[new:])), 32)
            fresh[new:] |= step < -LATE_FRAMES * self._period
            if self._newest is None:
                fresh[0] = False  # the first line of all begins nothing anew
            self._find_leaps(step, lines.stamp_ns[new:], fresh[new:])
            stuck = (step <= 0) & ~fresh[new:]
            stuck[: int(self._newest is None)] = False
            self._newest = int(ticks[-1])
            if self._resolution:
                spread(ticks, new + np.flatnonzero(stuck), fresh, self._period, self._resolution)
        number = running(periods_between(ticks, self._period))
        number += self._number - number[max(here.start - 1, 0)]
        number, fresh = number[here], fresh[here]
        if len(number) == 0:
            return arrays.rows(lines, here)
        starts = np.concatenate(([self._start], number[fresh]))
        self._number, self._start = int(number[-1]), int(starts[-1])
        return replace(arrays.rows(lines, here), number=number - starts[np.cumsum(fresh)])

    def _find_leaps(self, step: NDArray[np.int64], stamp_ns: NDArray[np.int64], fresh: NDArray[np.bool_]) -> None:
        """Mark, in place, the new lines whose time has leapt ahead of the host's clock: the board started anew."""
        device: Array = np.multiply(self._device + np.cumsum(step), self._tick_s, dtype=np.float64)
        self._device += int(step.sum())
        delay = stamp_ns / 1e9 - device
        begun = 0
        for line in np.flatnonzero(fresh | (step > LATE_FRAMES * self._period)).tolist():
            self._least.note(device[begun:line], delay[begun:line])
            gap_s = float(step[line]) * self._tick_s
            if fresh[line] or self._least.leapt(float(device[line]), float(delay[line]), gap_s):
                fresh[line] = True
                self._least.begin()
            begun = line
        self._least.note(device[begun:], delay[begun:])


class _TwoCounters:
    """The up and the down counter that a net count stands for: up - down is the count, and both only rise."""

    def __init__(self, bits: int) -> None:
        self._bits = bits
        self._last: tuple[int, int] | None = None  # count and down

    def split(self, lines: Lines) -> Lines:
        """Return the next lines with both counters; given, up is the count."""
        if len(lines) == 0:
            return lines
        count, down = (int(lines.up[0]), 0) if self._last is None else self._last
        step = moves(np.concatenate(([count], lines.up)), self._bits)
        falls = down + np.cumsum(np.maximum(-step, 0))
        self._last = int(lines.up[-1]), int(falls[-1])
        limit = (1 << self._bits) - 1
        return replace(lines, up=lines.up + falls & limit, down=falls & limit)
