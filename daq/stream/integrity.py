"""Counts unwrapped, segments cut, and every sample checked against the data sent with it.

A new segment begins where the port came back, where the board restarted or its sequence numbers jumped, and after a gap
across which the counters (the belt's, too) may have rolled over unnoticed.  In each the count starts at the difference
of the counters: nothing is carried over or filled in.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from daq.protocols import link_budget
from daq.runfile.rig import Rig
from daq.stream import connections
from daq.stream.timeline import PartReason, Samples, join, make_empty
from daq.wire import counters, frames
from daq.wire.quadrature import EDGES_PER_COUNT

# A segment begins with a part (`daq.stream.timeline`), or where the counters may have rolled over unnoticed.
SegmentReason = PartReason | Literal["invalid"]
PEAK_OVER_S = 1e-3  # over a shorter time, one count more or less would look like a fast motion


@dataclass(frozen=True)
class CheckedCounts:
    """The counts of n samples in s segments, and their faults."""

    count: NDArray[np.int64]  # (n,) unwrapped net count
    segment: NDArray[np.uint16] | NDArray[np.uint32]  # (n,) from 0
    flags: NDArray[np.uint16]  # (n,) status as sent, less the levels, and the host's checks (`daq.wire.counters`)
    lost: NDArray[np.int64]  # (n,) samples missing right before each one
    illegal: int = 0  # illegal transitions the board counted during this run
    peak_count_rate: float = 0.0  # fastest counting over `PEAK_OVER_S` (a sample where that is longer), counts/s
    reasons: tuple[SegmentReason, ...] = ()  # what began each segment; irrelevant for the first one
    starts: NDArray[np.int64] = field(default_factory=make_empty)  # (s,) first sample of each segment
    # (s,) from the last sample before each segment; 0 for the first one
    gap_s: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))
    # (s,) leap of the board's clock there, s; 0 where it did not
    leap_s: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))
    # (p,) samples before which the board paused without a gap in its sequence, and for how long
    paused: NDArray[np.int64] = field(default_factory=make_empty)
    paused_s: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))
    # (s,) number of the identification that each segment was sent under
    source: NDArray[np.int64] = field(default_factory=make_empty)


class CountSurvey:
    """What must be known of a whole run before its counts are checked; its samples come in pieces, of whole frames.

    idents: The identifications that the samples so far were sent under; it grows.
    bits: Width of the counters of a board that does not identify itself.
    rate_hz: Nominal rate, Hz.
    starts_at_phase: Whether an x4 counter starts at the phase of its levels, as the firmware's does.  Another sketch's
        may start anywhere; then the offset of most samples of a segment is used.
    """

    def __init__(
        self, idents: Sequence[frames.Ident | None], bits: int, rate_hz: float, *, starts_at_phase: bool
    ) -> None:
        self.idents, self.bits, self.rate_hz = idents, bits, rate_hz
        stride = max(1, round(PEAK_OVER_S * rate_hz))
        self.peak, self._belt_peak = _PeakRate(stride), _PeakRate(stride)
        self._has_belt = True
        self._starts_at_phase = starts_at_phase
        self._last: Samples | None = None
        self.n_stretches = 0  # without a gap; there are no more segments
        # Of the gaps before them: the length of each, s, and whether a segment begins there in any case; of their
        # samples: how many are off the phase of their levels by 0, 1, 2, 3.
        self._gap_s: list[float] = []
        self._fresh: list[bool] = []
        self._offsets: list[NDArray[np.int64]] = []

    def take(self, samples: Samples) -> None:
        """Add the next samples."""
        continuity = _follow(samples, self._last, self.rate_hz)
        window, broken = continuity.window, continuity.gap | continuity.fresh
        if not len(window):
            return
        bits = np.array([self.bits if ident is None else ident.counter_bits for ident in self.idents])
        bits = bits[window.source[1:]]
        ups, downs = (counters.diff_unsigned(column, bits) for column in (window.up, window.down))
        self.peak.take(window, np.maximum(ups, downs), broken)
        self._has_belt &= window.belt is not None
        if window.belt is not None:
            self._belt_peak.take(window, np.abs(counters.diff_signed(window.belt, bits)), broken)
        new = slice(len(window) - len(samples), None)
        self.n_stretches += int(np.count_nonzero(broken[new]))
        if not self._starts_at_phase:
            first = np.flatnonzero(broken[new])
            self._gap_s += continuity.interval[new][first].tolist()
            self._fresh += continuity.fresh[new][first].tolist()
            stretch = np.cumsum(broken[new])
            offsets = counters.phase_error(samples.up, samples.down, samples.status)
            count = np.bincount(stretch << 2 | offsets, minlength=4 * (len(first) + 1)).reshape(-1, 4)
            if self._offsets:
                self._offsets[-1] += count[0]
            self._offsets += list(count[1:])
        self._last = window.take(np.arange(len(window)) == len(window) - 1)

    def find_safe_gap_s(self, rig: Rig, edges: NDArray[np.int64], peak_count_rate: float) -> float:
        """Return the longest gap, s, across which the counters cannot have rolled over unnoticed."""
        safe_s = float("inf")
        edge_rate_hz = peak_count_rate * EDGES_PER_COUNT.get(rig.decoder, 1)
        for ident, edges_per_count in zip(self.idents, edges.tolist(), strict=True):
            bits = rig.counter_bits if ident is None else ident.counter_bits
            rate_hz = link_budget.peak_edge_rate_hz(ident, rig, edge_rate_hz)
            safe_s = min(safe_s, counters.longest_gap_s(rate_hz, edges_per_count, bits))
            if self._has_belt:
                belt_hz = self._belt_peak.find(np.ones_like(edges))
                safe_s = min(safe_s, counters.longest_gap_s(2 * belt_hz, 1, bits - 1))
        return safe_s

    def find_offsets(self, safe_s: float) -> NDArray[np.uint8] | None:
        """Return the offset from the phase of the levels in each segment, (s,); None: the counters start at it."""
        if self._starts_at_phase or not self._offsets:
            return None
        begins = np.array(self._fresh) | (np.array(self._gap_s) > safe_s)
        count = np.add.reduceat(self._offsets, np.flatnonzero(begins), axis=0)
        return np.asarray(count.argmax(axis=1), np.uint8)


class CountCheck:
    """Unwrap the counts, cut the run into segments, and flag contradictions: piece by piece, of whole frames.

    survey: Of the whole run.
    rig: Its calibration.
    safe_gap_s: Longest gap, s, that begins no segment; None: that of the survey.
    peak_count_rate: Of the whole run (`CheckedCounts`).
    """

    def __init__(self, survey: CountSurvey, rig: Rig, safe_gap_s: float | None = None) -> None:
        self._idents, self._rate_hz = survey.idents, survey.rate_hz
        self._wide = survey.n_stretches > 1 << 16  # whether segment numbers take 32 bits
        self._units = connections.find_units(survey.idents, rig)
        self.peak_count_rate = survey.peak.find(self._units.scale)
        surveyed_s = survey.find_safe_gap_s(rig, self._units.edges, self.peak_count_rate)
        self._safe_s = surveyed_s if safe_gap_s is None else safe_gap_s
        self._offsets = survey.find_offsets(self._safe_s) if self._units.phase.any() else None
        self._last: Samples | None = None
        self._n_taken = self._count = self._segments = self._illegal_rise = 0

    def take(self, samples: Samples) -> CheckedCounts:
        """Check the next samples; the first samples of segments are counted from the start of the run."""
        new = slice(1 if self._last is not None else 0, None)
        segments, count_before, illegal_before = self._segments, self._count, self._illegal_rise
        continuity = _follow(samples, self._last, self._rate_hz)
        window, fresh, lost, interval, gap = continuity[:5]
        bits, scale = _expand(self._units.bits, window), _expand(self._units.scale, window)
        invalid = gap & (interval > self._safe_s) & ~fresh
        begins = fresh | invalid
        n = len(window)
        if n == 0:
            flags = np.zeros(0, dtype=np.uint16)
            return CheckedCounts(make_empty(), flags, flags, make_empty(), peak_count_rate=self.peak_count_rate)
        self._last = window.take(np.arange(n) == n - 1)
        begins[: new.start] = True
        count = counters.net_count(window.up, window.down, begins, bits, scale, count_before if new.start else None)
        segment = segments + np.cumsum(begins) - 1
        flags = (window.status & ~np.uint8(frames.LEVELS)).astype(np.uint16)
        flags[lost > 0] |= counters.FLAG_GAP
        if window.time_error is not None:
            flags[window.time_error != 0] |= counters.FLAG_TIME
        both_moved = counters.check_both_moved(window.up, window.down)
        flags[both_moved & ~begins] |= counters.FLAG_BOTH
        if self._units.phase.any():
            phase_errors = counters.phase_error(window.up, window.down, window.status)
            if self._offsets is not None:
                phase_errors -= self._offsets[segment]
            flags[(phase_errors & 3 != 0) & _expand(self._units.phase, window)] |= counters.FLAG_PHASE
        rise = np.zeros(n, dtype=np.int64)
        if self._units.illegal.any():
            restarts = continuity.begins == _RESTART
            rise[1:] = counters.diff_unsigned(window.illegal, 16)
            rise[restarts | ~_expand(self._units.illegal, window)] = 0  # counted before this start: not this run's
            # The count is for the whole frame, so every sample of the frame is suspect.
            flags[np.isin(window.frame, window.frame[rise > 0])] |= counters.FLAG_ILLEGAL
            # Missed counts stay missing, and an even number of them does not change the phase.
            total = np.cumsum(rise) + illegal_before
            last_restart = np.maximum.accumulate(np.where(restarts, np.arange(n), 0))
            total -= np.where(np.logical_or.accumulate(restarts), total[last_restart], 0)
            flags[total > 0] |= counters.FLAG_COUNT_UNCERTAIN
            self._illegal_rise = int(total[-1])
        starts = np.flatnonzero(begins[new])
        self._count, self._segments = int(count[-1]), int(segment[-1])
        reasons: tuple[SegmentReason, ...] = tuple(
            "invalid" if invalid[new][s] else samples.begun_by[samples.part[s]] for s in starts
        )
        self._n_taken += len(samples)
        tick_s = _expand(self._units.tick_ns, window) / 1e9
        leap_s = np.diff(window.ticks, prepend=window.ticks[:1]) * tick_s - interval
        leap_s[continuity.begins != _LEAP] = 0.0
        paused = np.flatnonzero(continuity.begins[new] == _PAUSE)
        return CheckedCounts(
            count=count[new],
            segment=segment[new].astype(np.uint32) if self._wide else segment[new].astype(np.uint16),
            flags=flags[new],
            lost=lost[new],
            illegal=int(rise.sum()),
            peak_count_rate=self.peak_count_rate,
            reasons=reasons,
            starts=starts + self._n_taken - len(samples),
            gap_s=interval[new][starts],
            leap_s=leap_s[new][starts],
            paused=paused + self._n_taken - len(samples),
            paused_s=interval[new][paused],
            source=samples.source[starts],
        )


# What begins with a sample: nothing, or a part because the board paused, its clock leapt, or it restarted.
_NO_START, _PAUSE, _LEAP, _RESTART = range(4)
_STARTS = {"paused": _PAUSE, "clock": _LEAP}


class _Continuity(NamedTuple):
    """Samples, k of them, with the last one before them, and how each continues the previous one, (k,)."""

    window: Samples
    fresh: NDArray[np.bool_]  # whether a part begins with it, unless the board only paused
    lost: NDArray[np.int64]  # samples missing before it
    interval: NDArray[np.float64]  # since the previous one, s
    gap: NDArray[np.bool_]  # whether that is a gap
    begins: NDArray[np.int64]  # what begins with it: `_NOTHING`, or a part


def _follow(samples: Samples, last: Samples | None, rate_hz: float) -> _Continuity:
    """Return the next samples with the last one before them, and how each of them continues the previous one."""
    window = samples if last is None else join([last, samples])
    begins = np.full(len(window), _NO_START)
    begins[:1] = _NO_START if last is not None else _RESTART
    for sample in (np.flatnonzero(np.diff(window.part)) + 1).tolist():
        reasons = samples.begun_by[window.part[sample - 1] + 1 : window.part[sample] + 1]
        # A part without a kept sample may have begun in another way.
        begins[sample] = max(_STARTS.get(each, _RESTART) for each in reasons)
    fresh, restarts = begins >= _LEAP, begins == _RESTART
    # Numbers start at 0, so samples missing there were lost, too.
    lost = np.where(restarts, window.index, np.diff(window.index, prepend=-1) - 1)
    interval = np.diff(window.time, prepend=window.time[:1])
    if last is not None:
        lost[0] = 0
    # By its number, or by a time that is not jitter: above 30 kHz jitter alone is more than half a period.
    gap = (lost > 0) | (interval > max(1.5 / rate_hz, PEAK_OVER_S))
    return _Continuity(window, fresh, lost, interval, gap, begins)


def _expand(values: NDArray[Any], samples: Samples) -> NDArray[Any]:
    """Return for each sample the value of its identification."""
    return np.asarray(values[samples.source])


class _PeakRate:
    """The fastest counting (counts/s) over ``stride`` samples in a row without a gap; 0 for one sample.

    Where gaps leave no stretch as long, the longest available is used: half of it, a quarter ...
    """

    def __init__(self, stride: int) -> None:
        self._strides = [stride]
        while self._strides[-1] > 1:
            self._strides.append(self._strides[-1] // 2)
        self._peak: dict[int, dict[int, float]] = {}  # of each stride, the fastest under each identification
        self._time, self._moved = np.empty(0), np.empty(0, dtype=np.int64)
        self._source = np.empty(0, dtype=np.int64)
        self._broken = np.empty(0, dtype=np.bool_)

    def take(self, window: Samples, moved: NDArray[np.int64], broken: NDArray[np.bool_]) -> None:
        """Add the next samples, (k,), and the moves between them, (k - 1,).

        The first one of them is the last one of the previous samples.
        """
        time, source = window.time, window.source
        if len(self._time):
            time, broken = np.concatenate((self._time, time[1:])), np.concatenate((self._broken, broken[1:]))
            moved, source = np.concatenate((self._moved, moved)), np.concatenate((self._source, source[1:]))
        total = np.concatenate(([0], np.cumsum(moved)))[: len(time)]
        breaks = np.cumsum(broken)
        for stride in self._strides:
            unbroken = breaks[stride:] == breaks[:-stride]
            if unbroken.any():
                rate = (total[stride:] - total[:-stride]) / (time[stride:] - time[:-stride])
                peaks = self._peak.setdefault(stride, {})
                for number in np.unique(source[stride:][unbroken]).tolist():
                    fastest = float(rate[unbroken & (source[stride:] == number)].max())
                    peaks[number] = max(peaks.get(number, 0.0), fastest)
            if stride in self._peak:
                break
        n_kept = self._strides[0]
        self._time, self._source, self._broken = time[-n_kept:], source[-n_kept:], broken[-n_kept:]
        self._moved = moved[max(0, len(moved) - n_kept + 1) :]

    def find(self, scale: NDArray[np.int64]) -> float:
        """Return the rate in counts of the run, of which one under each identification has so many."""
        peaks = self._peak[max(self._peak)] if self._peak else {}
        return max((float(scale[number]) * rate for number, rate in peaks.items()), default=0.0)
