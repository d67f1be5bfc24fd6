"""Model selection: a stick is accepted if it raises the log likelihood by 1.5 ln n for each of its corners.

If two in three are accepted, the others need only raise it by any amount; otherwise all are rejected.  The null model
is a motion of white jerk or of white snap throughout, whichever is more likely.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from processing.kalman import white_jerk
from processing.kalman.stick_slip import KICK, LABELS, LAND, LEAVE, MEET, RIDE, SLIP, START, STICK, STOP, NoiseLevels
from processing.record.series import Series
from processing.stick_slip.corners import SwitchingTimes, drop_corners, group_by_stick, span_sticks, split_stretches
from processing.stick_slip.noise import (
    Workspace,
    filter_stretch,
    log_likelihood,
    merge_levels,
    null_model,
    reestimate_noise,
    refine_switching_times,
)
from stickslip.compute.arrays import Array, Integers, Mask

# Of ln n, for each corner: the BIC penalty of its three parameters, (ln n)/2 each (Schwarz, Ann. Stat. 6 (1978) 461).
BIC_FACTOR = 1.5
FEW = 1 / 6  # largest share of odd sticks (a tap splits one in two)

Span = tuple[float, float]


@dataclass(frozen=True, eq=False)
class Gate:
    """The null models that a stick must beat, and how clearly."""

    jerk: white_jerk.Noise  # of a motion of white jerk throughout
    snap: NoiseLevels  # of a motion of white snap throughout
    uneven: NoiseLevels | None  # of sticks on an uneven belt; None if every stick is on an even belt
    lenient: bool  # whether most sticks are clear, so that the others need only raise the likelihood


@dataclass(frozen=True, eq=False)
class PlacedCorners:
    unrefined: SwitchingTimes
    times: SwitchingTimes  # after refinement


def bic_penalty(samples: int) -> float:
    """Return the log likelihood that a corner must gain in a record of so many samples."""
    return BIC_FACTOR * math.log(samples)


def learn_gate(
    series: Series,
    workspace: Workspace,
    corners: PlacedCorners,
    levels: NoiseLevels,
    jerk: white_jerk.Noise,
    needed: float,
) -> tuple[SwitchingTimes, NoiseLevels, Gate] | list[Span]:
    """Return the accepted sticks, on an even or uneven belt, their levels, and the gate.

    If the null model is kept, return the spans of time, s, of the few sticks that prevent the others from being
    accepted, or an empty list.
    """
    times = corners.times
    sticks = group_by_stick(times)
    if not sticks:
        return []
    snap = reestimate_noise(series, workspace, times, null_model(levels), 1, null_model=True)
    gate = Gate(jerk, snap, uneven=None, lenient=False)
    evidence = StickEvidence.of(series, workspace, times, levels, gate, needed)
    if levels.reading_variance[STICK] > 1.3 * levels.reading_variance[SLIP] or evidence.in_doubt.any():
        riding = replace(
            levels, mean_snap=np.zeros(LABELS), reading_variance=np.full(LABELS, levels.reading_variance[SLIP])
        )
        ride_times = _label_as_rides(corners)
        riding = reestimate_noise(series, workspace, ride_times, riding, 2)
        ride_times = _refine_rides(series, workspace, ride_times, riding)
        riding = reestimate_noise(series, workspace, ride_times, riding, 2)
        gate = replace(gate, uneven=riding)
        evidence = evidence.add_rides(series, workspace, ride_times, riding)
        levels = riding if evidence.ridden.all() else merge_levels(levels, riding)
    gate = replace(gate, lenient=bool(evidence.in_doubt.mean() < 1 / 3))
    dropped = evidence.find_rejected(lenient=gate.lenient)
    if dropped.mean() > 1 / 3:
        return []
    misfit = dropped & evidence.long
    if misfit.any():
        return find_odd_spans(series, evidence.times, sticks, misfit)
    times, likelihood = evidence.times, evidence.even
    if dropped.any() or evidence.ridden.any():
        times = _rebuild_times(series, times, sticks, dropped, evidence.ridden)
        for _ in range(2):
            levels = reestimate_noise(series, workspace, times, levels, 2)
            times = refine_switching_times(series, workspace, times, levels, 0.25)
        likelihood = _sum_likelihood(series, times, levels, workspace, evidence.spans)
    # The gain of the remaining sticks must not be lost where others were dropped.
    return (times, levels, gate) if likelihood[-1] - evidence.null[-1] > needed * times.time.size else []


def accept_sticks(
    series: Series,
    workspace: Workspace,
    corners: PlacedCorners,
    even: NoiseLevels,
    levels: NoiseLevels,
    gate: Gate,
    needed: float,
) -> SwitchingTimes | list[Span]:
    """Return the sticks accepted in a block of a record, each independently, or the spans of time, s, of misfits.

    ``even`` are the levels of sticks on an even belt; ``levels`` are those of `learn_gate`.
    """
    times = corners.times
    sticks = group_by_stick(times)
    if not sticks:
        return times
    evidence = StickEvidence.of(series, workspace, times, even, gate, needed)
    if gate.uneven is not None:
        ride_times = _refine_rides(series, workspace, _label_as_rides(corners), gate.uneven)
        evidence = evidence.add_rides(series, workspace, ride_times, gate.uneven)
    dropped = evidence.find_rejected(lenient=gate.lenient)
    misfit = dropped & evidence.long
    if misfit.any():
        return find_odd_spans(series, evidence.times, sticks, misfit, few=math.inf)
    rebuilt = _rebuild_times(series, evidence.times, sticks, dropped, evidence.ridden)
    return rebuilt if gate.uneven is None else refine_switching_times(series, workspace, rebuilt, levels, 0.25)


@dataclass(frozen=True, eq=False)
class StickEvidence:
    """Log likelihoods of the samples of each stick and, last, of all samples."""

    times: SwitchingTimes
    sticks: list[list[int]]  # indices of the corners of each
    spans: Integers
    even: Array  # on an even belt
    null: Array  # of the null model
    rides: Array  # on an uneven belt
    needed: float  # gain per corner

    @classmethod
    def of(
        cls,
        series: Series,
        workspace: Workspace,
        times: SwitchingTimes,
        levels: NoiseLevels,
        gate: Gate,
        needed: float,
    ) -> "StickEvidence":
        sticks = group_by_stick(times)
        spans = span_sticks(series, times, sticks)
        bare = drop_corners(times, np.ones(times.time.size, bool))
        jerk = _sum_jerk_likelihood(series, gate.jerk, workspace, spans)
        null = np.maximum(jerk, _sum_likelihood(series, bare, gate.snap, workspace, spans))
        even = _sum_likelihood(series, times, levels, workspace, spans)
        return cls(times, sticks, spans, even, null, np.full(even.size, -np.inf), needed)

    def add_rides(
        self, series: Series, workspace: Workspace, ride_times: SwitchingTimes, levels: NoiseLevels
    ) -> "StickEvidence":
        """Return the evidence with that on an uneven belt, and with the times of the sticks that prefer it."""
        evidence = replace(self, rides=_sum_likelihood(series, ride_times, levels, workspace, self.spans))
        ridden = [stick for stick, ride in zip(self.sticks, evidence.ridden, strict=True) if ride]
        return replace(evidence, times=_copy_stick_times(self.times, ride_times, ridden))

    @property
    def ridden(self) -> Mask:
        """True for the sticks on an uneven belt."""
        return np.asarray((self.rides > self.even + self.needed)[:-1])

    @property
    def gained(self) -> Array:
        """Gain in log likelihood by each stick."""
        return np.asarray((np.maximum(self.even, self.rides) - self.null)[:-1])

    @property
    def in_doubt(self) -> Mask:
        """True for the sticks that gain less than the penalty of their corners."""
        return np.asarray(self.gained < self.needed * np.array([len(stick) for stick in self.sticks]))

    @property
    def long(self) -> Mask:
        """True for sticks longer than a slip, which cannot be flat parts of a slip."""
        return np.array([np.ptp(self.times.time[stick]) > self.times.unit for stick in self.sticks])

    def find_rejected(self, *, lenient: bool) -> Mask:
        return np.asarray(self.gained < 0) if lenient else self.in_doubt


def _label_as_rides(corners: PlacedCorners) -> SwitchingTimes:
    """Return the unrefined corners of the sticks, labelled as sticks on an uneven belt."""
    first = corners.unrefined
    kinds = np.where(first.kind == LAND, MEET, first.kind).astype(np.uint8)
    firsts = tuple(RIDE if label == STICK else label for label in first.first)
    return _copy_rest_and_kicks(corners.times, replace(first, kind=kinds, first=firsts))


def _refine_rides(series: Series, workspace: Workspace, times: SwitchingTimes, levels: NoiseLevels) -> SwitchingTimes:
    """Refine the corners of sticks on an uneven belt, but not those of rest, which the uneven motion would move."""
    return _copy_rest_and_kicks(times, refine_switching_times(series, workspace, times, levels, 1.0))


def _copy_rest_and_kicks(source: SwitchingTimes, times: SwitchingTimes) -> SwitchingTimes:
    """Return the times with the ends of rest and the kicks from ``source``, which has the same corners."""
    fixed = np.isin(times.kind, (START, STOP, KICK))
    corner_times, sd = np.where(fixed, source.time, times.time), np.where(fixed, source.sd, times.sd)
    return replace(times, time=np.maximum.accumulate(corner_times), sd=sd)


def _copy_stick_times(times: SwitchingTimes, source: SwitchingTimes, sticks: list[list[int]]) -> SwitchingTimes:
    """Return the times with those of ``source`` for some sticks, unless that breaks their order."""
    corner_times, sd = times.time.copy(), times.sd.copy()
    for stick in sticks:
        affected = slice(max(stick[0] - 1, 0), stick[-1] + 2)
        trial = corner_times[affected].copy()
        trial[np.array(stick) - affected.start] = source.time[stick]
        if (np.diff(trial) > 0).all():
            corner_times[affected], sd[stick] = trial, source.sd[stick]
    return replace(times, time=corner_times, sd=sd)


def stick_misfits(series: Series, workspace: Workspace, times: SwitchingTimes, levels: NoiseLevels) -> Array:
    """Return the mean square innovation of each stick over the median of all, with the reading noise of a slip."""
    reading = levels.reading_variance.copy()
    reading[STICK] = reading[SLIP]
    levels = replace(levels, reading_variance=reading)
    squares = np.zeros(series.time.size)
    for stretch in split_stretches(series, times):
        squares[stretch.samples] = _square_innovations(filter_stretch(series, times, levels, stretch, workspace)[1])
    spans = span_sticks(series, times, group_by_stick(times))[:-1]
    sizes = np.array([squares[first:end].mean() if end > first else 0.0 for first, end in spans])
    return np.asarray(sizes / max(float(np.median(sizes)), 1.0)) if sizes.size else sizes


def _square_innovations(stored: Array) -> Array:
    """Return the square of every innovation over its variance, 0 where a reading is missing."""
    s, scaled = stored[:, 14:].T
    return np.asarray(scaled**2 / np.where(s > 0, s, 1.0))


def find_odd_spans(
    series: Series, times: SwitchingTimes, sticks: list[list[int]], odd: Mask, few: float = FEW
) -> list[Span]:
    """Return the spans of the ``odd`` sticks, from middle to middle of their neighbours; empty unless few are odd."""
    if not odd.any() or odd.mean() >= few:
        return []
    middle = np.array([0.5 * (times.time[stick[0]] + times.time[stick[-1]]) for stick in sticks])
    ends = np.concatenate(([series.time[0] - 1.0], middle[~odd], [series.time[-1] + 1.0]))
    following = np.unique(np.searchsorted(ends, middle[odd]))
    return [(float(ends[k - 1]), float(ends[k])) for k in following]


def _sum_likelihood(
    series: Series, times: SwitchingTimes, levels: NoiseLevels, workspace: Workspace, spans: Integers
) -> Array:
    """Return the log likelihood of every span, up to a constant."""
    gain = np.zeros(series.time.size)
    for stretch in split_stretches(series, times):
        stored = filter_stretch(series, times, levels, stretch, workspace)[1]
        gain[stretch.samples] = _log_likelihood(stored[:, 14:])
    return _sum_spans(gain, spans)


def _sum_jerk_likelihood(series: Series, noise: white_jerk.Noise, workspace: Workspace, spans: Integers) -> Array:
    """Return the log likelihood of every span for a motion of white jerk."""
    gain = np.zeros(series.time.size)
    for piece in series.pieces:
        if piece.stop - piece.start >= white_jerk.SHORT:
            stored = workspace.array(piece.stop - piece.start, white_jerk.STORED)
            innovations = white_jerk.filter_innovations(series.time[piece], series.position[piece], noise, stored)
            gain[piece] = _log_likelihood(innovations)
    return _sum_spans(gain, spans)


def _log_likelihood(innovations: Array) -> Array:
    """Return the log likelihood of each sample, up to a constant, from 1/s and e/s, (n, 2)."""
    s, scaled = np.ascontiguousarray(innovations.T)  # else every step reads the filter's whole memory
    return log_likelihood(s, scaled)


def _sum_spans(gain: Array, spans: Integers) -> Array:
    return np.array([gain[first:end].sum() for first, end in spans])


def _rebuild_times(
    series: Series, times: SwitchingTimes, sticks: list[list[int]], dropped: Mask, ridden: Mask
) -> SwitchingTimes:
    """Return the times without the sticks ``dropped``, with those on an uneven belt labelled as rides."""
    kind = times.kind.copy()
    first = list(times.first)
    dropped_corners = np.zeros(kind.size, bool)
    starts = [series.time[piece.start] for piece in series.pieces]
    for stick, drop, ride in zip(sticks, dropped, ridden, strict=True):
        if drop:
            dropped_corners[stick] = True
        if kind[stick[0]] == LEAVE:  # it begins with its piece
            piece = int(np.searchsorted(starts, times.time[stick[0]], side="right")) - 1
            first[piece] = SLIP if drop else RIDE if ride else first[piece]
        elif ride:
            kind[stick[0]] = MEET
    kept = ~dropped_corners
    return replace(times, time=times.time[kept], sd=times.sd[kept], kind=kind[kept], first=tuple(first))
