"""Model selection: a stick is accepted if it raises the log likelihood by 1.5 ln n for each of its corners.

Where two in three are accepted, the others need only raise it at all; else all are rejected.  The null
model is a motion of white jerk or of white snap throughout, whichever is more likely.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from processing.kalman import white_jerk
from processing.kalman.stick_slip import (
    KICK,
    LABELS,
    LAND,
    LEAVE,
    MEET,
    RIDE,
    SLIP,
    START,
    STICK,
    STOP,
    NoiseLevels,
)
from processing.record.series import Series
from processing.segmentation.noise_levels import (
    Workspace,
    filter_stretch,
    log_likelihood,
    merged,
    null_model,
    reestimate_noise,
)
from processing.segmentation.switching_estimate import refine_switching_times
from processing.segmentation.switching_times import SwitchingTimes, spans_of, sticks_of, stretches, without
from stickslip.compute.arrays import Array, Integers, Mask

# Of ln n, for each corner: the BIC penalty of its three parameters, (ln n)/2 each (Schwarz, Ann. Stat. 6 (1978) 461).
BIC_FACTOR = 1.5
WIDTHS = 1.0, 0.25  # of the search for the corners of sticks on an uneven belt, in turn
FEW = 1 / 6  # share of the sticks that may be odd (a tap makes two of one): the others still show what a stick is

Span = tuple[float, float]


@dataclass(frozen=True, eq=False)
class Gate:
    """What a stick must be more likely than."""

    jerk: white_jerk.Noise  # of a motion of white jerk throughout
    snap: NoiseLevels  # of a motion of white snap throughout
    # of sticks on an uneven belt, as each stick is tried; None where every one is on an even belt
    uneven: NoiseLevels | None
    lenient: bool  # whether most sticks are beyond doubt, so that the others need only help


@dataclass(frozen=True, eq=False)
class PlacedCorners:
    """Corners before their refinement, ``first``, and after it."""

    first: SwitchingTimes
    times: SwitchingTimes


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
) -> tuple[SwitchingTimes, NoiseLevels, Gate, "Judged"] | list[Span]:
    """Return the sticks accepted, each on an even belt or on an uneven one, the levels they have, and the gate.

    Last are the sticks as they are judged on an even belt.

    corners: Of all sticks.
    levels: Of sticks on an even belt.
    jerk: Of the null model of white jerk.
    needed: Log likelihood that a corner must gain.
    Returns: (SwitchingTimes, NoiseLevels, Gate, Judged) Where the null model is kept, the spans of time, s, of the few
        sticks that prevent the others from being accepted; empty where these are not few.
    """
    times = corners.times
    sticks = sticks_of(times)
    if not sticks:
        return []
    snap = reestimate_noise(series, workspace, times, null_model(levels), 3, null_model=True)
    gate = Gate(jerk, snap, uneven=None, lenient=False)
    judged = before = Judged.of(series, workspace, times, levels, gate, needed)
    if levels.reading_variance[STICK] > 1.3 * levels.reading_variance[SLIP] or judged.in_doubt.any():
        riding = replace(
            levels, mean_snap=np.zeros(LABELS), reading_variance=np.full(LABELS, levels.reading_variance[SLIP])
        )
        other = _as_rides(corners)
        for width in WIDTHS:
            riding = reestimate_noise(series, workspace, other, riding, 2)
            other = _refined_rides(series, workspace, other, riding, width)
        riding = reestimate_noise(series, workspace, other, riding, 2)
        gate = replace(gate, uneven=riding)
        judged = judged.with_rides(series, workspace, other, riding)
        levels = riding if judged.ridden.all() else merged(levels, riding)
    odd = odd_spans(series, times, sticks, judged.gained < 0)
    gate = replace(gate, lenient=bool(judged.in_doubt.mean() < 1 / 3))
    dropped = judged.dropped(lenient=gate.lenient)
    if dropped.mean() > 1 / 3:
        return []
    misfit = dropped & judged.long
    if misfit.any():
        return odd_spans(series, judged.times, sticks, misfit)
    times, even = judged.times, judged.even
    if dropped.any() or judged.ridden.any():
        times = _rebuilt(series, times, sticks, dropped, judged.ridden)
        for _ in range(2):
            levels = reestimate_noise(series, workspace, times, levels, 2)
            times = refine_switching_times(series, workspace, times, levels, 0.25)
        even = _gains(series, times, levels, workspace, judged.spans)
        even = _better_rounded(series, times, levels, workspace, judged.spans, even)
    # What the sticks that are left gain must not be lost where the others were dropped.
    return (times, levels, gate, before) if even[-1] - judged.null[-1] > needed * times.at.size else odd


def accept_sticks(
    series: Series,
    workspace: Workspace,
    corners: PlacedCorners,
    even: NoiseLevels,
    levels: NoiseLevels,
    gate: Gate,
    needed: float,
    judged: "Judged | None" = None,
) -> SwitchingTimes | list[Span]:
    """Return the sticks accepted in a block of a record, each by itself, as one of the record.

    even, levels: Of sticks on an even belt, and those that `learn_gate` returned.
    judged: The sticks that `learn_gate` returned, where it did so for these corners of this record.
    Returns: Where sticks do not fit, the spans of time, s, around them.
    """
    times = corners.times
    sticks = sticks_of(times)
    if not sticks:
        return times
    judged = judged or Judged.of(series, workspace, times, even, gate, needed)
    if gate.uneven is not None:
        other = _as_rides(corners)
        for width in WIDTHS:
            other = _refined_rides(series, workspace, other, gate.uneven, width)
        judged = judged.with_rides(series, workspace, other, gate.uneven)
    dropped = judged.dropped(lenient=gate.lenient)
    misfit = dropped & judged.long
    if misfit.any():
        return odd_spans(series, judged.times, sticks, misfit, few=math.inf)
    rebuilt = _rebuilt(series, judged.times, sticks, dropped, judged.ridden)
    if dropped.any():
        gains = _gains(series, rebuilt, levels, workspace, judged.spans)
        gains = _better_rounded(series, rebuilt, levels, workspace, judged.spans, gains)
        hopeless = dropped & (gains < judged.null - needed)[:-1]
        if hopeless.any():
            return odd_spans(series, judged.times, sticks, hopeless, few=math.inf)
    return rebuilt if gate.uneven is None else refine_switching_times(series, workspace, rebuilt, levels, 0.25)


@dataclass(frozen=True, eq=False)
class Judged:
    """Sticks, and the log likelihoods of the samples of each and, last, of all: with them, and of the null model."""

    times: SwitchingTimes
    sticks: list[list[int]]
    spans: Integers
    even: Array
    null: Array
    rides: Array
    needed: float

    @classmethod
    def of(
        cls,
        series: Series,
        workspace: Workspace,
        times: SwitchingTimes,
        levels: NoiseLevels,
        gate: Gate,
        needed: float,
    ) -> "Judged":
        """Return the sticks on an even belt."""
        sticks = sticks_of(times)
        spans = spans_of(series, times, sticks)
        bare = without(times, np.ones(times.at.size, bool))
        jerk, snap = _jerk_gains(series, gate.jerk, workspace, spans), _gains(series, bare, gate.snap, workspace, spans)
        null = np.maximum(jerk, snap)
        even = _gains(series, times, levels, workspace, spans)
        made = cls(times, sticks, spans, even, null, np.full(even.size, -np.inf), needed)
        doubt = made.in_doubt
        if not doubt.any():
            return made
        better = np.where(np.append(doubt, True), _better_rounded(series, times, levels, workspace, spans, even), even)
        better[-1] = even[-1] + (better - even)[:-1].sum()
        return replace(made, even=better)

    def with_rides(self, series: Series, workspace: Workspace, other: SwitchingTimes, levels: NoiseLevels) -> "Judged":
        """Return the sticks with what each gains on an uneven belt, and with the times it then has."""
        made = replace(self, rides=_gains(series, other, levels, workspace, self.spans))
        ridden = [stick for stick, ride in zip(self.sticks, made.ridden, strict=True) if ride]
        return replace(made, times=_with_times_of(self.times, other, ridden))

    @property
    def ridden(self) -> Mask:
        """True for the sticks on an uneven belt."""
        return np.asarray((self.rides > self.even + self.needed)[:-1])

    @property
    def gained(self) -> Array:
        """What each stick makes the record more likely by."""
        return np.asarray((np.maximum(self.even, self.rides) - self.null)[:-1])

    @property
    def in_doubt(self) -> Mask:
        """True for the sticks that gain less than their corners must."""
        return np.asarray(self.gained < self.needed * np.array([len(stick) for stick in self.sticks]))

    @property
    def long(self) -> Mask:
        """True for sticks longer than a slip: a flat part of a slip is shorter, these are sticks of another kind."""
        return np.array([np.ptp(self.times.at[stick]) > self.times.unit for stick in self.sticks])

    def dropped(self, *, lenient: bool) -> Mask:
        """Return True for the sticks that are not accepted."""
        return np.asarray(self.gained < 0) if lenient else self.in_doubt


def _as_rides(corners: PlacedCorners) -> SwitchingTimes:
    """Return the corners as those of sticks on an uneven belt: the sticks' before the first refinement."""
    first = corners.first
    kinds = np.where(first.kind == LAND, MEET, first.kind).astype(np.uint8)
    firsts = tuple(RIDE if label == STICK else label for label in first.first)
    return _with_rest_of(corners.times, replace(first, kind=kinds, first=firsts))


def _refined_rides(
    series: Series, workspace: Workspace, times: SwitchingTimes, levels: NoiseLevels, width: float
) -> SwitchingTimes:
    """Return the corners of sticks on an uneven belt where they are most likely; those of rest stay where they are.

    What an uneven belt does to a stick would move the start of the belt, too.
    """
    return _with_rest_of(times, refine_switching_times(series, workspace, times, levels, width))


def _with_rest_of(known: SwitchingTimes, times: SwitchingTimes) -> SwitchingTimes:
    """Return the times with the ends of rest, and kicks, of the same corners ``known``."""
    own = np.isin(times.kind, (START, STOP, KICK))
    at, sd = np.where(own, known.at, times.at), np.where(own, known.sd, times.sd)
    return replace(times, at=np.maximum.accumulate(at), sd=sd)


def _with_times_of(times: SwitchingTimes, other: SwitchingTimes, sticks: list[list[int]]) -> SwitchingTimes:
    """Return the times with those of ``other`` for some sticks, where they stay in order."""
    at, sd = times.at.copy(), times.sd.copy()
    for stick in sticks:
        near = slice(max(stick[0] - 1, 0), stick[-1] + 2)
        trial = at[near].copy()
        trial[np.array(stick) - near.start] = other.at[stick]
        if (np.diff(trial) > 0).all():
            at[near], sd[stick] = trial, other.sd[stick]
    return replace(times, at=at, sd=sd)


def odd_spans(
    series: Series, times: SwitchingTimes, sticks: list[list[int]], odd: Mask, few: float = FEW
) -> list[Span]:
    """Return where the sticks that are ``odd`` lie, if few are: from middle to middle of the sticks beside them."""
    if not odd.any() or odd.mean() >= few:
        return []
    middle = np.array([0.5 * (times.at[stick[0]] + times.at[stick[-1]]) for stick in sticks])
    # A mass that is ahead of the belt where the record ends lands behind its end.
    begin, end = min(series.time[0], times.at[0]), max(series.time[-1], times.at[-1])
    ends = np.concatenate(([begin - 1.0], middle[~odd], [end + 1.0]))
    behind = np.unique(np.searchsorted(ends, middle[odd]))
    return [(float(ends[k - 1]), float(ends[k])) for k in behind]


def _gains(series: Series, times: SwitchingTimes, levels: NoiseLevels, workspace: Workspace, spans: Integers) -> Array:
    """Return the log likelihood of the samples of every span given those before, up to a constant."""
    gain = np.zeros(series.time.size)
    for stretch in stretches(series, times):
        stored = filter_stretch(series, times, levels, stretch, workspace)[1]
        gain[stretch.own] = _log_likelihood(stored[:, 14:])
    return _summed(gain, spans)


def _better_rounded(
    series: Series, times: SwitchingTimes, levels: NoiseLevels, workspace: Workspace, spans: Integers, even: Array
) -> Array:
    """Return the gains ``even`` of even sticks, each with the reading variance of all sticks or of the slips.

    A belt that moves a round number of counts in a sample is rounded alike throughout a stick: by nothing in most, by
    half a count at every other sample in some.  One variance does not suit both.
    """
    reading = levels.reading_variance.copy()
    reading[STICK] = reading[SLIP]
    more = np.maximum(_gains(series, times, replace(levels, reading_variance=reading), workspace, spans) - even, 0.0)
    more[-1] = more[:-1].sum()
    return even + more


def _jerk_gains(series: Series, noise: white_jerk.Noise, workspace: Workspace, spans: Integers) -> Array:
    """As `_gains`, for the motion of white jerk."""
    gain = np.zeros(series.time.size)
    for piece in series.pieces:
        if piece.stop - piece.start >= white_jerk.SHORT:
            stored = workspace.array(piece.stop - piece.start, white_jerk.STORED)
            found = white_jerk.innovations(series.time[piece], series.position[piece], noise, stored)
            gain[piece] = _log_likelihood(found)
    return _summed(gain, spans)


def _log_likelihood(innovations: Array) -> Array:
    """Return the log likelihood of each sample, up to a constant, from 1/s and e/s, (n, 2)."""
    s, scaled = np.ascontiguousarray(innovations.T)  # else every step reads the filter's whole memory
    return log_likelihood(s, scaled)


def _summed(gain: Array, spans: Integers) -> Array:
    return np.array([gain[first:end].sum() for first, end in spans])


def _rebuilt(
    series: Series, times: SwitchingTimes, sticks: list[list[int]], dropped: Mask, ridden: Mask
) -> SwitchingTimes:
    """Return the times without the sticks ``dropped``, those on an uneven belt named so."""
    kind = times.kind.copy()
    first = list(times.first)
    gone = np.zeros(kind.size, bool)
    starts = [series.time[piece.start] for piece in series.pieces]
    for stick, drop, ride in zip(sticks, dropped, ridden, strict=True):
        if drop:
            gone[stick] = True
        if kind[stick[0]] == LEAVE:  # it begins with its piece
            piece = int(np.searchsorted(starts, times.at[stick[0]], side="right")) - 1
            first[piece] = SLIP if drop else RIDE if ride else first[piece]
        elif ride:
            kind[stick[0]] = MEET
    kept = ~gone
    return replace(times, at=times.at[kept], sd=times.sd[kept], kind=kind[kept], first=tuple(first))
