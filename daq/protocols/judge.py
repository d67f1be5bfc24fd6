"""A stream of lines without a checksum, judged as it arrives by the rules of `daq.protocols.neighbours`.

The lines come in pieces of any size; the result is that of the whole.  Each stage holds back the lines whose neighbours
have not arrived, and keeps those that the next ones are compared with:

1. lines whose times are out of order are dropped, or their times interpolated;
2. counts that leap are dropped;
3. counts off the course are dropped, times off the course are interpolated;
4. the lines are numbered by their times, from 0 where these show that the board restarted: they step back, or ahead of
   the host's clock; equal times of a coarse clock are separated.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from daq.protocols.neighbours import (
    LOOK_AHEAD,
    find_leaps,
    find_off_course,
    periods_between,
    separate_times,
    sum_steps,
    time_ahead,
)
from daq.wire.arrival import LeastDelay
from daq.wire.counters import LATE_FRAMES, diff_signed
from stickslip.compute import arrays
from stickslip.compute.arrays import Array

# Lines before and after one that stages 2 to 4 keep.  They use 6, 19 (`SPIKE_AMONG` lines, and three around each) and
# 16 lines on either side; `find_off_course` judges no fewer than 32 lines at once.
REACH = 32
ANCHOR = 4  # kept lines after which line numbers no longer depend on the lines before


@dataclass(frozen=True)
class Lines:
    """Lines with a sample, n of them, in order."""

    sent: NDArray[np.int64]  # (n,) times as sent, modulo 2^32
    ticks: NDArray[np.int64]  # (n,) the same; once judged, interpolated where the time as sent was wrong
    up: NDArray[np.int64]  # (n,) counters modulo their width
    down: NDArray[np.int64]
    status: NDArray[np.int64]  # (n,) see `daq.wire.decode.Stream`
    illegal: NDArray[np.int64]
    stamp_ns: NDArray[np.int64]
    fresh: NDArray[np.bool_]  # (n,) the board has restarted before this line
    damaged: NDArray[np.int64]  # (n,) damaged lines between the line before and this one
    number: NDArray[np.int64]  # (n,) once judged: periods since the last start, from the times

    def __len__(self) -> int:
        return len(self.ticks)


class GapNotes:
    """Restarts and damaged lines between lines, carried from the last line of some to the first of the next ones.

    damaged: Damaged lines after the last line.
    """

    def __init__(self) -> None:
        self.damaged = 0
        self._fresh = False

    def carry_over(
        self, fresh: NDArray[np.bool_], damaged: NDArray[np.int64]
    ) -> tuple[NDArray[np.bool_], NDArray[np.int64]]:
        """Return the notes before each of n lines; of the n + 1 values the last is for what follows the last line."""
        fresh[0] |= self._fresh
        damaged[0] += self.damaged
        self._fresh, self.damaged = bool(fresh[-1]), int(damaged[-1])
        return fresh[:-1], damaged[:-1]

    def keep_lines(self, lines: Lines, keep: NDArray[np.bool_]) -> Lines:
        """Return the lines to keep, and note the others as damaged."""
        if keep.all() and not (self._fresh or self.damaged):
            return lines
        next_kept: NDArray[np.int64] = np.cumsum(keep) - keep  # among those kept, of the line itself or of the next one
        kept = arrays.rows(lines, keep)
        fresh = np.zeros(len(kept) + 1, dtype=np.bool_)
        fresh[next_kept[lines.fresh]] = True
        damaged = np.bincount(next_kept, lines.damaged + ~keep, len(kept) + 1).astype(np.int64)
        fresh, damaged = self.carry_over(fresh, damaged)
        return replace(kept, fresh=fresh, damaged=damaged)


class LineJudge:
    """Judge lines by their neighbours, in pieces of any size.

    bits: Width of the counters.
    period: Nominal sample interval, ticks.
    resolution: Ticks by which a coarse clock advances at once, and by which a time may therefore differ from the
        sample's; 0: the clock is not coarse.
    tick_ns: Tick of the board's clock, ns.
    net: There is only one counter, a signed net count, instead of ``up``; it is split into two.
    """

    def __init__(self, bits: int, period: float, resolution: int, tick_ns: int, *, net: bool) -> None:
        self._time_order = _TimeOrder(period)
        self._count_leaps = _CountLeaps(bits)
        self._course = _Course(bits, period, resolution)
        self._numbering = _Numbering(period, resolution, tick_ns)
        self._counters = _TwoCounters(bits) if net else None

    @property
    def damaged(self) -> int:
        """Lines dropped after the last one that is kept."""
        return sum(stage.notes.damaged for stage in (self._time_order, self._count_leaps, self._course))

    def feed(self, lines: Lines, last: bool) -> Lines:
        """Return the lines decided now and kept; with the ``last`` ones, all are decided."""
        for stage in (self._time_order, self._count_leaps, self._course, self._numbering):
            lines = stage.feed(lines, last)
        return lines if self._counters is None else self._counters.split(lines)


class _TimeOrder:
    """Drops lines out of order: a damaged time leaps away, and the lines after it leap back.

    Such a line is kept, its time interpolated, if the lines around it leave room for exactly as many as there are.
    """

    def __init__(self, period: float) -> None:
        self.notes = GapNotes()
        self._period = period
        self._waiting: Lines | None = None
        self._keep = np.zeros(0, dtype=np.bool_)  # which of the waiting lines
        self._line = 0  # the first waiting line that is not decided
        # The last good line and its time, while later lines do not follow it.
        self._last: tuple[int, np.int64] | None = None

    def feed(self, lines: Lines, last: bool) -> Lines:
        """Return the lines that are kept and can no longer change."""
        waiting = arrays.joined([lines] if self._waiting is None else [self._waiting, lines])
        ticks = waiting.ticks  # a copy
        keep = np.concatenate((self._keep, np.ones(len(lines), dtype=np.bool_)))
        self._decide(ticks, waiting.fresh, keep, len(waiting) if last else len(waiting) - LOOK_AHEAD)
        final = len(waiting) if last else max(self._line - LOOK_AHEAD, 0)  # a line may be restored so far back
        self._waiting, self._keep = arrays.rows(waiting, slice(final, None)), keep[final:]
        self._line -= final
        if self._last is not None:
            self._last = self._last[0] - final, self._last[1]
        return self.notes.keep_lines(arrays.rows(waiting, slice(final)), keep[:final])

    def _decide(self, ticks: NDArray[np.int64], fresh: NDArray[np.bool_], keep: NDArray[np.bool_], until: int) -> None:
        """Decide up to a line; ``ticks`` and ``keep`` are changed in place."""
        period = self._period
        step = diff_signed(ticks, 32)
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
                missing = line - last - 1
                if missing and near[0] and not fresh[line] and round(int(ahead[0]) / period) == line - last:
                    offsets = np.round(ahead[0] * np.arange(1, line - last) / (line - last)).astype(np.int64)
                    ticks[last + 1 : line] = last_ticks + offsets & 0xFFFFFFFF
                    keep[last + 1 : line] = True
                self._last = None
            else:
                keep[line] = False
            line += 1
        self._line = line


class _Stage(ABC):
    """Decides on lines by those at most `REACH` lines away."""

    def __init__(self) -> None:
        self.notes = GapNotes()
        self._waiting: Lines | None = None
        self._decided = 0  # how many waiting lines are decided

    def feed(self, lines: Lines, last: bool) -> Lines:
        """Return the lines that are kept and can no longer change."""
        waiting = arrays.joined(
            [lines] if self._waiting is None else [self._waiting, lines]
        )  # a copy, which may be changed
        until = len(waiting) if last else max(self._decided, len(waiting) - REACH)
        decided = self._decide(waiting, slice(self._decided, until), len(waiting) - len(lines))
        first = max(until - REACH, 0)
        self._waiting, self._decided = arrays.rows(waiting, slice(first, None)), until - first
        return decided

    @abstractmethod
    def _decide(self, lines: Lines, undecided: slice, new: int) -> Lines:
        """Return the ``undecided`` lines that are kept; ``new`` is the first line of this call."""


class _CountLeaps(_Stage):
    """Drops lines whose counts leap away."""

    def __init__(self, bits: int) -> None:
        super().__init__()
        self._bits = bits

    def _decide(self, lines: Lines, undecided: slice, new: int) -> Lines:
        leap = find_leaps(lines.up - lines.down, self._bits)
        return self.notes.keep_lines(arrays.rows(lines, undecided), ~leap[undecided])


class _Course(_Stage):
    """Drops lines whose counts deviate from the course of their neighbours; interpolates times that do."""

    def __init__(self, bits: int, period: float, resolution: int) -> None:
        super().__init__()
        self._bits, self._period, self._resolution = bits, period, resolution
        # A waiting line, its time without roll-over and its number, both since the first line of all, so that a phase
        # is rounded as in the whole stream.
        self._anchor = 0, 0, 0

    def _decide(self, lines: Lines, undecided: slice, new: int) -> Lines:
        anchor, anchor_time, anchor_number = self._anchor
        time, number = sum_steps(diff_signed(lines.ticks, 32)), sum_steps(periods_between(lines.ticks, self._period))
        time += anchor_time - time[anchor]
        number += anchor_number - number[anchor]
        damaged, late, course = find_off_course(
            lines.ticks,
            lines.up - lines.down,
            time,
            number,
            bits=self._bits,
            period=self._period,
            resolution=self._resolution,
        )
        if undecided.stop > REACH:
            anchor = undecided.stop - REACH + ANCHOR
            self._anchor = ANCHOR, int(time[anchor]), int(number[anchor])
        ticks = lines.ticks.copy()
        ticks[late] = course & 0xFFFFFFFF
        return self.notes.keep_lines(arrays.rows(replace(lines, ticks=ticks), undecided), ~damaged[undecided])


class _Numbering(_Stage):
    """Numbers the lines from the last start on, by their times; separates lines of a coarse clock."""

    def __init__(self, period: float, resolution: int, tick_ns: int) -> None:
        super().__init__()
        self._period, self._resolution = period, resolution
        self._tick_s = tick_ns / 1e9
        self._device = 0  # ticks from the first line of all to the newest one, without roll-over
        self._least = LeastDelay()
        self._newest: int | None = None  # time of the newest line, before equal times are separated
        self._number = 0  # of the last decided line, and of the last start, both since the first line of all
        self._start = 0

    def _decide(self, lines: Lines, undecided: slice, new: int) -> Lines:
        ticks, fresh = lines.ticks, lines.fresh
        if len(lines) > new:
            newest = int(ticks[new]) if self._newest is None else self._newest
            step = diff_signed(np.concatenate(([newest], ticks[new:])), 32)
            fresh[new:] |= step < -LATE_FRAMES * self._period
            if self._newest is None:
                fresh[0] = False  # the first line of all is no restart
            self._find_leaps(step, lines.stamp_ns[new:], fresh[new:])
            stuck = (step <= 0) & ~fresh[new:]
            stuck[: int(self._newest is None)] = False
            self._newest = int(ticks[-1])
            if self._resolution:
                separate_times(ticks, new + np.flatnonzero(stuck), fresh, self._period, self._resolution)
        number = sum_steps(periods_between(ticks, self._period))
        number += self._number - number[max(undecided.start - 1, 0)]
        number, fresh = number[undecided], fresh[undecided]
        if len(number) == 0:
            return arrays.rows(lines, undecided)
        starts = np.concatenate(([self._start], number[fresh]))
        self._number, self._start = int(number[-1]), int(starts[-1])
        return replace(arrays.rows(lines, undecided), number=number - starts[np.cumsum(fresh)])

    def _find_leaps(self, step: NDArray[np.int64], stamp_ns: NDArray[np.int64], fresh: NDArray[np.bool_]) -> None:
        """Mark, in place, the new lines whose time has leapt ahead of the host's clock: the board restarted."""
        device: Array = np.multiply(self._device + np.cumsum(step), self._tick_s, dtype=np.float64)
        self._device += int(step.sum())
        delay = stamp_ns / 1e9 - device
        first = 0
        for line in np.flatnonzero(fresh | (step > LATE_FRAMES * self._period)).tolist():
            self._least.note(device[first:line], delay[first:line])
            gap_s = float(step[line]) * self._tick_s
            if fresh[line] or self._least.has_leapt(float(device[line]), float(delay[line]), gap_s):
                fresh[line] = True
                self._least.reset()
            first = line
        self._least.note(device[first:], delay[first:])


class _TwoCounters:
    """The up and the down counter equivalent to a net count: up - down is the count, and both only rise."""

    def __init__(self, bits: int) -> None:
        self._bits = bits
        self._last: tuple[int, int] | None = None  # count and down

    def split(self, lines: Lines) -> Lines:
        """Return the lines with both counters; on input, up is the net count."""
        if len(lines) == 0:
            return lines
        count, down = (int(lines.up[0]), 0) if self._last is None else self._last
        step = diff_signed(np.concatenate(([count], lines.up)), self._bits)
        total_down = down + np.cumsum(np.maximum(-step, 0))
        self._last = int(lines.up[-1]), int(total_down[-1])
        limit = (1 << self._bits) - 1
        return replace(lines, up=lines.up + total_down & limit, down=total_down & limit)
