"""Counts unwrapped, segments cut, and every sample held against what came with it.

A new segment begins where the port came back, where the board restarted or its sequence numbers jumped, and after a gap
across which the counters (the belt's, too) may have rolled over unseen.  In each the count starts at the counters' own
difference: nothing is carried over, nothing is filled in.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from daq.finalise import connections
from daq.finalise.timeline import PartReason, Samples, joined
from daq.protocols import link_budget
from daq.runfile.rig import Rig
from daq.wire import counters, frames
from daq.wire.quadrature import EDGES_PER_COUNT

# A segment begins with a part (`daq.finalise.timeline`), or where the counters may have rolled over unseen.
SegmentReason = PartReason | Literal["invalid"]
PEAK_OVER_S = 1e-3  # over less, one count more or less would look like a fast motion


@dataclass(frozen=True)
class CheckedCounts:
    """The counts of n samples in s segments, and what is wrong with them."""

    count: NDArray[np.int64]  # (n,) unwrapped net count
    segment: NDArray[np.uint16] | NDArray[np.uint32]  # (n,) from 0
    flags: NDArray[np.uint16]  # (n,) status as sent, less the levels, and the host's checks (`daq.wire.counters`)
    lost: NDArray[np.int64]  # (n,) samples missing right before each one
    illegal: int  # illegal transitions the board counted during this run
    peak_count_rate: float  # fastest counting over `PEAK_OVER_S` (over a sample where that is longer), counts/s
    reasons: tuple[SegmentReason, ...]  # what began each segment; of the first one it means nothing
    starts: NDArray[np.int64]  # (s,) first sample of each segment
    gap_s: NDArray[np.float64]  # (s,) how long after the sample before it each segment begins; 0 for the first one
    leap_s: NDArray[np.float64]  # (s,) by how much the board's clock leapt there, s; 0 where it did not
    # (p,) samples before which the board paused without a gap in its sequence, and for how long
    paused: NDArray[np.int64]
    paused_s: NDArray[np.float64]
    source: NDArray[np.int64]  # (s,) under which identification each segment was sent


def check(
    samples: Samples, ident: frames.Ident | None, rig: Rig, rate_hz: float, *, starts_at_phase: bool = True
) -> CheckedCounts:
    """Unwrap the counts of a whole run, cut it into segments, and flag what does not agree (`CountCheck`).

    Raises ValueError: there is no sample.
    """
    if len(samples) == 0:
        raise ValueError("nothing to check: there is no sample")
    checking = CountCheck([ident], rig, rate_hz, starts_at_phase=starts_at_phase)
    samples = replace(samples, source=None)
    checking.survey([samples])
    return checking.take(samples)


class CountCheck:
    """Unwrap the counts, cut the run into segments, and flag what does not agree: piece by piece, of whole frames.

    idents, rig, rate_hz: The identifications that the run was sent under, its calibration, and its nominal rate.
    starts_at_phase: The board's rule: an x4 counter starts at the phase of its levels.  Another sketch's may start
        anywhere; then the offset that most samples of a segment have is taken as its own.
    peak_count_rate: Of the whole run, once it has been surveyed (`CheckedCounts`).
    """

    def __init__(
        self, idents: Sequence[frames.Ident | None], rig: Rig, rate_hz: float, *, starts_at_phase: bool = True
    ) -> None:
        self.peak_count_rate = 0.0
        self._idents, self._rig, self._rate_hz = idents, rig, rate_hz
        self._units = connections.units(idents, rig)
        self._starts_at_phase = starts_at_phase
        self._safe_s = float("inf")
        self._wide = False  # whether segment numbers take 32 bits
        self._offsets: NDArray[np.uint8] | None = None  # offset of each segment
        self._last: Samples | None = None
        self._taken = self._count = self._segments = self._risen = 0

    def survey(self, pieces: Iterable[Samples]) -> None:
        """Look at the whole run: how long a gap the counters' speed allows, and where its counters started."""
        units, edges = self._units, EDGES_PER_COUNT.get(self._rig.decoder, 1)
        stride = max(1, round(PEAK_OVER_S * self._rate_hz))
        peak, belt_peak = _PeakRate(stride), _PeakRate(stride)
        self._begin()
        has_belt = False
        most = 1  # segments that there can be
        for samples in pieces:
            follows = self._follow(samples)
            window, broken = follows.window, follows.gap | follows.fresh
            bits, scale = (_each(values, window)[1:] for values in (units.bits, units.scale))
            ups, downs = (counters.increments(column, bits) for column in (window.up, window.down))
            peak.take(window.time, np.maximum(ups, downs) * scale, broken)
            most += int(np.count_nonzero(broken))
            if window.belt is not None:
                has_belt = True
                belt_peak.take(window.time, np.abs(counters.moves(window.belt, bits)), broken)
        self._wide = most > 1 << 16
        self.peak_count_rate = peak.found()
        self._safe_s = float("inf")
        for ident, bits_, own in zip(self._idents, units.bits.tolist(), units.edges.tolist(), strict=True):
            rate_hz = link_budget.peak_edge_rate_hz(ident, self._rig, self.peak_count_rate * edges)
            self._safe_s = min(self._safe_s, counters.longest_gap_s(rate_hz, own, bits_))
            if has_belt:
                self._safe_s = min(self._safe_s, counters.longest_gap_s(2 * belt_peak.found(), 1, bits_ - 1))
        self._begin()
        if units.phase.any() and not self._starts_at_phase:
            seen = np.zeros(0, dtype=np.int64)  # how often each segment is off by 0, 1, 2, 3
            for samples in pieces:
                segments = self.take(samples).segment
                wrong = counters.phase_error(samples.up, samples.down, samples.status)
                here = np.bincount(segments.astype(np.int64) << 2 | wrong)
                seen = np.pad(seen, (0, max(0, len(here) - len(seen))))
                seen[: len(here)] += here
            self._offsets = np.pad(seen, (0, -len(seen) % 4)).reshape(-1, 4).argmax(axis=1).astype(np.uint8)
            self._begin()

    def take(self, samples: Samples) -> CheckedCounts:
        """Check the next samples; of segments, the first samples are counted from the start of the run."""
        own = slice(1 if self._last is not None else 0, None)
        segments, count_before, risen = self._segments, self._count, self._risen
        follows = self._follow(samples)
        window, fresh, lost, interval, gap = follows[:5]
        bits, scale = _each(self._units.bits, window), _each(self._units.scale, window)
        invalid = gap & (interval > self._safe_s) & ~fresh
        begins = fresh | invalid
        n = len(window)
        if n == 0:
            return _nothing_checked(self.peak_count_rate)
        first = counters.signed(window.up.astype(np.int64) - window.down, bits) * scale
        if own.start:
            begins[0], first[0] = True, count_before
        ups, downs = (counters.increments(column, bits[1:]) for column in (window.up, window.down))
        count = counters.running_sum(begins, (ups - downs) * scale[1:], first)
        segment = segments + np.cumsum(begins) - 1
        flags = (window.status & ~np.uint8(frames.LEVELS)).astype(np.uint16)
        flags[lost > 0] |= counters.FLAG_GAP
        if window.time_error is not None:
            flags[window.time_error != 0] |= counters.FLAG_TIME
        both = counters.check_both_moved(window.up, window.down)
        flags[both & ~begins] |= counters.FLAG_BOTH
        if self._units.phase.any():
            wrong = counters.phase_error(window.up, window.down, window.status)
            if self._offsets is not None:
                wrong -= self._offsets[segment]
            flags[(wrong & 3 != 0) & _each(self._units.phase, window)] |= counters.FLAG_PHASE
        rise = np.zeros(n, dtype=np.int64)
        if self._units.illegal.any():
            fresh = follows.begins == _ANEW
            rise[1:] = counters.increments(window.illegal, 16)
            rise[fresh | ~_each(self._units.illegal, window)] = 0  # counted before this start: not this run's
            # The count stands for its whole frame, so every sample of the frame is suspect.
            flags[np.isin(window.frame, window.frame[rise > 0])] |= counters.FLAG_ILLEGAL
            # What was missed stays missing, and an even number of misses hides from the phase.
            total = np.cumsum(rise) + risen
            begun = np.maximum.accumulate(np.where(fresh, np.arange(n), 0))
            total -= np.where(np.logical_or.accumulate(fresh), total[begun], 0)
            flags[total > 0] |= counters.FLAG_COUNT_UNCERTAIN
            self._risen = int(total[-1])
        starts = np.flatnonzero(begins[own])
        self._count, self._segments = int(count[-1]), int(segment[-1])
        reasons: tuple[SegmentReason, ...] = tuple(
            "invalid" if invalid[own][s] else samples.begun_by[samples.part[s]] for s in starts
        )
        self._taken += len(samples)
        tick_s = self._ticks_s(window)
        leap_s = np.diff(window.ticks, prepend=window.ticks[:1]) * tick_s - interval
        leap_s[follows.begins != _LEAP] = 0.0
        paused = np.flatnonzero(follows.begins[own] == _PAUSE)
        return CheckedCounts(
            count=count[own],
            segment=segment[own].astype(np.uint32) if self._wide else segment[own].astype(np.uint16),
            flags=flags[own],
            lost=lost[own],
            illegal=int(rise.sum()),
            peak_count_rate=self.peak_count_rate,
            reasons=reasons,
            starts=starts + self._taken - len(samples),
            gap_s=interval[own][starts],
            leap_s=leap_s[own][starts],
            paused=paused + self._taken - len(samples),
            paused_s=interval[own][paused],
            source=_source(samples)[starts],
        )

    def _ticks_s(self, window: Samples) -> NDArray[np.float64]:
        """Return the tick of the clock that each sample was stamped by, s, (k,)."""
        ticks = np.array([1000 if ident is None else ident.tick_ns for ident in self._idents])
        return np.asarray(_each(ticks, window) / 1e9)

    def _begin(self) -> None:
        """Begin with the first sample of the run."""
        self._last = None
        self._taken = self._count = self._segments = self._risen = 0

    def _follow(self, samples: Samples) -> "_Follows":
        """Return the next samples with the last one before them, and of each of these how it follows."""
        window = samples if self._last is None else joined([self._last, samples])
        begins = np.full(len(window), _NOTHING)
        begins[:1] = _NOTHING if self._last is not None else _ANEW
        for at in (np.flatnonzero(np.diff(window.part)) + 1).tolist():
            begun = samples.begun_by[window.part[at - 1] + 1 : window.part[at] + 1]
            # A part of which no sample was kept may have begun otherwise.
            begins[at] = max(_BEGINS.get(each, _ANEW) for each in begun)
        fresh, anew = begins >= _LEAP, begins == _ANEW
        # A start numbers from 0, so what is missing there was lost, too.
        lost = np.where(anew, window.index, np.diff(window.index, prepend=-1) - 1)
        interval = np.diff(window.time, prepend=window.time[:1])
        if self._last is not None:
            lost[0] = 0
        if len(window):
            self._last = window.take(np.arange(len(window)) == len(window) - 1)
        # By its number, or by a time that no jitter explains: above 30 kHz jitter alone is more than half a period.
        gap = (lost > 0) | (interval > max(1.5 / self._rate_hz, PEAK_OVER_S))
        return _Follows(window, fresh, lost, interval, gap, begins)


# What begins with a sample: nothing, or a part: the board has paused, its clock has leapt, or all is new.
_NOTHING, _PAUSE, _LEAP, _ANEW = range(4)
_BEGINS = {"paused": _PAUSE, "clock": _LEAP}


class _Follows(NamedTuple):
    """Samples, k of them, with the last one before them, and of each how it follows, (k,)."""

    window: Samples  # the samples
    fresh: NDArray[np.bool_]  # a segment begins with it: it begins a part, and the board has not only paused
    lost: NDArray[np.int64]  # how many are missing before it
    interval: NDArray[np.float64]  # how long after the one before it comes, s
    gap: NDArray[np.bool_]  # whether that is a gap
    begins: NDArray[np.int64]  # what begins with it: `_NOTHING`, or a part


def _source(samples: Samples) -> NDArray[np.int64]:
    return np.zeros(len(samples), dtype=np.int64) if samples.source is None else samples.source


def _each(values: NDArray[Any], samples: Samples) -> NDArray[Any]:
    """Return of each sample the value of its identification."""
    return np.asarray(values[_source(samples)])


def _nothing_checked(peak_count_rate: float) -> CheckedCounts:
    none = np.zeros(0, dtype=np.int64)
    flags = none.astype(np.uint16)
    seconds = none.astype(np.float64)
    return CheckedCounts(none, flags, flags, none, 0, peak_count_rate, (), none, seconds, seconds, none, seconds, none)


class _PeakRate:
    """The fastest counting (counts/s) over ``stride`` samples in a row that no gap breaks; 0 for one sample.

    Where gaps leave no stretch as long, the longest that there are must do: half of it, a quarter ...
    """

    def __init__(self, stride: int) -> None:
        self._strides = [stride]
        while self._strides[-1] > 1:
            self._strides.append(self._strides[-1] // 2)
        self._peak: dict[int, float] = {}
        self._time, self._moved = np.empty(0), np.empty(0, dtype=np.int64)
        self._broken = np.empty(0, dtype=np.bool_)

    def take(self, time: NDArray[np.float64], moved: NDArray[np.int64], broken: NDArray[np.bool_]) -> None:
        """Take the next samples, (k,), and the moves between them, (k - 1,).

        The first one of them is the last one of the samples before.
        """
        if len(self._time):
            time, broken = np.concatenate((self._time, time[1:])), np.concatenate((self._broken, broken[1:]))
            moved = np.concatenate((self._moved, moved))
        total = np.concatenate(([0], np.cumsum(moved)))[: len(time)]
        breaks = np.cumsum(broken)
        for stride in self._strides:
            whole = breaks[stride:] == breaks[:-stride]
            if whole.any():
                rate = (total[stride:] - total[:-stride]) / (time[stride:] - time[:-stride])
                self._peak[stride] = max(self._peak.get(stride, 0.0), float(rate[whole].max()))
            if stride in self._peak:
                break
        kept = self._strides[0]
        self._time, self._moved, self._broken = time[-kept:], moved[max(0, len(moved) - kept + 1) :], broken[-kept:]

    def found(self) -> float:
        return self._peak[max(self._peak)] if self._peak else 0.0
