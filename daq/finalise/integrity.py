"""Counts unwrapped, segments cut, and every sample held against what came with it.

A new segment begins where the port came back, where the board restarted or its sequence numbers jumped, and after a gap
across which the counters (the belt's, too) may have rolled over unseen.  In each the count starts at the counters' own
difference: nothing is carried over, nothing is filled in.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

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
    """The counts of n samples in s segments, and what is wrong with them.

    Attributes
    ----------
    count : (n,) int64
        Unwrapped net count.
    segment : (n,) uint16, or uint32 where the run may have more than 65,536 segments
        From 0.
    flags : (n,) uint16
        Status as sent, less the levels, and the host's checks (`daq.wire.counters`).
    lost : (n,) int64
        Samples missing right before each one.
    illegal : int
        Illegal transitions the board counted during this run.
    peak_count_rate : float
        Fastest counting over `PEAK_OVER_S` (over a sample where that is longer), counts/s.
    starts : (s,) int64
        First sample of each segment.
    reasons : tuple of SegmentReason
        What began each segment; of the first one it means nothing.
    gap_s : (s,) float64
        How long after the sample before it each segment begins; 0 for the first one.
    """

    count: NDArray[np.int64]
    segment: NDArray[np.uint16] | NDArray[np.uint32]
    flags: NDArray[np.uint16]
    lost: NDArray[np.int64]
    illegal: int
    peak_count_rate: float
    reasons: tuple[SegmentReason, ...]
    starts: NDArray[np.int64]
    gap_s: NDArray[np.float64]


def check(
    samples: Samples, ident: frames.Ident | None, rig: Rig, rate_hz: float, *, starts_at_phase: bool = True
) -> CheckedCounts:
    """Unwrap the counts of a whole run, cut it into segments, and flag what does not agree (`CountCheck`).

    Raises
    ------
    ValueError
        There is no sample.
    """
    if len(samples) == 0:
        raise ValueError("nothing to check: there is no sample")
    checking = CountCheck(ident, rig, rate_hz, starts_at_phase=starts_at_phase)
    checking.survey([samples])
    return checking.take(samples)


class CountCheck:
    """Unwrap the counts, cut the run into segments, and flag what does not agree: piece by piece, of whole frames.

    Parameters
    ----------
    ident, rig, rate_hz
        Who sent the run, its calibration, and its nominal rate.
    starts_at_phase : bool
        The board's rule: an x4 counter starts at the phase of its levels.  Another sketch's may start anywhere; then
        the offset that most samples of a segment have is taken as its own.

    Attributes
    ----------
    peak_count_rate : float
        Of the whole run, once it has been surveyed (`CheckedCounts`).
    """

    def __init__(self, ident: frames.Ident | None, rig: Rig, rate_hz: float, *, starts_at_phase: bool = True) -> None:
        has = frames.Capability(0) if ident is None else ident.capabilities
        self.peak_count_rate = 0.0
        self._ident, self._rig, self._rate_hz = ident, rig, rate_hz
        self._has_phase = rig.decoder == "x4" and frames.Capability.LEVELS in has
        self._has_illegal = frames.Capability.ILLEGAL in has
        self._starts_at_phase = starts_at_phase
        self._safe_s = float("inf")
        self._wide = False  # whether segment numbers take 32 bits
        self._offsets: NDArray[np.uint8] | None = None  # of each segment
        self._last: Samples | None = None
        self._taken = self._count = self._segments = self._risen = 0

    def survey(self, pieces: Iterable[Samples]) -> None:
        """Look at the whole run: how long a gap the counters' speed allows, and where its counters started."""
        bits, edges = self._rig.counter_bits, EDGES_PER_COUNT.get(self._rig.decoder, 1)
        stride = max(1, round(PEAK_OVER_S * self._rate_hz))
        peak, belt_peak = _PeakRate(stride), _PeakRate(stride)
        self._begin()
        has_belt = False
        most = 1  # segments that there can be
        for samples in pieces:
            window, fresh, _, _, gap = self._follow(samples)
            ups, downs = (counters.increments(column, bits) for column in (window.up, window.down))
            peak.take(window.time, np.maximum(ups, downs), gap | fresh)
            most += int(np.count_nonzero(gap | fresh))
            if window.belt is not None:
                has_belt = True
                belt_peak.take(window.time, np.abs(counters.moves(window.belt, bits)), gap | fresh)
        self._wide = most > 1 << 16
        self.peak_count_rate = peak.found()
        rate_hz = link_budget.peak_edge_rate_hz(self._ident, self._rig, self.peak_count_rate * edges)
        self._safe_s = counters.longest_gap_s(rate_hz, edges, bits)
        if has_belt:
            self._safe_s = min(self._safe_s, counters.longest_gap_s(2 * belt_peak.found(), 1, bits - 1))
        self._begin()
        if self._has_phase and not self._starts_at_phase:
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
        bits = self._rig.counter_bits
        own = slice(1 if self._last is not None else 0, None)
        segments, count_before, risen = self._segments, self._count, self._risen
        window, fresh, lost, interval, gap = self._follow(samples)
        invalid = gap & (interval > self._safe_s) & ~fresh
        begins = fresh | invalid
        n = len(window)
        if n == 0:
            return _nothing_checked(self.peak_count_rate)
        first = counters.signed(window.up.astype(np.int64) - window.down, bits)
        if own.start:
            begins[0], first[0] = True, count_before
        ups, downs = (counters.increments(column, bits) for column in (window.up, window.down))
        count = counters.running_sum(begins, ups - downs, first)
        segment = segments + np.cumsum(begins) - 1
        flags = (window.status & ~np.uint8(frames.LEVELS)).astype(np.uint16)
        flags[lost > 0] |= counters.FLAG_GAP
        if window.time_error is not None:
            flags[window.time_error != 0] |= counters.FLAG_TIME
        both = counters.check_both_moved(window.up, window.down)
        flags[both & ~begins] |= counters.FLAG_BOTH
        if self._has_phase:
            wrong = counters.phase_error(window.up, window.down, window.status)
            if self._offsets is not None:
                wrong -= self._offsets[segment]
            flags[wrong & 3 != 0] |= counters.FLAG_PHASE
        rise = np.zeros(n, dtype=np.int64)
        if self._has_illegal:
            rise[1:] = counters.increments(window.illegal, 16)
            rise[fresh] = 0  # what the board counted before this start is not this run's
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
        )

    def _begin(self) -> None:
        """Begin with the first sample of the run."""
        self._last = None
        self._taken = self._count = self._segments = self._risen = 0

    def _follow(
        self, samples: Samples
    ) -> tuple[Samples, NDArray[np.bool_], NDArray[np.int64], NDArray[np.float64], NDArray[np.bool_]]:
        """Return the next samples with the last one before them, and of each of these how it follows.

        Returns
        -------
        Samples, and arrays of shape (k,)
            The samples; which begin a part; how many are missing before each; how long after the one before it comes,
            s; and whether that is a gap.
        """
        window = samples if self._last is None else joined([self._last, samples])
        fresh = np.diff(window.part, prepend=-1 if self._last is None else window.part[:1]) > 0
        lost = np.where(fresh, window.index, np.diff(window.index, prepend=0) - 1)
        # A start numbers from 0, so what is missing there was lost, too.
        interval = np.diff(window.time, prepend=window.time[:1])
        if self._last is not None:
            lost[0] = 0
        if len(window):
            self._last = window.take(np.arange(len(window)) == len(window) - 1)
        # By its number, or by a time that no jitter explains: above 30 kHz jitter alone is more than half a period.
        gap = (lost > 0) | (interval > max(1.5 / self._rate_hz, PEAK_OVER_S))
        return window, fresh, lost, interval, gap


def _nothing_checked(peak_count_rate: float) -> CheckedCounts:
    none = np.zeros(0, dtype=np.int64)
    flags = none.astype(np.uint16)
    return CheckedCounts(none, flags, flags, none, 0, peak_count_rate, (), none, none.astype(np.float64))


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
        """Return the rate."""
        return self._peak[max(self._peak)] if self._peak else 0.0
