"""Model selection: a stick is accepted if it raises the log likelihood by 1.5 ln n for each of its corners.

Where two in three are accepted, the others need only raise it at all; else all are rejected.  The null
model is a motion of white jerk or of white snap throughout, whichever is more likely.
"""

import math
from dataclasses import replace

import numpy as np

from daq.compute.arrays import Array, Integers, Mask
from processing.kalman import white_jerk
from processing.kalman.stick_slip import LABELS, LAND, LEAVE, MEET, RIDE, SLIP, STICK, NoiseLevels
from processing.record.estimates import RecordEstimates
from processing.record.series import Series
from processing.segmentation.noise_levels import Workspace, filter_stretch, merged, null_model, reestimate_noise
from processing.segmentation.switching_estimate import refine_switching_times
from processing.segmentation.switching_times import SwitchingTimes, spans_of, sticks_of, stretches, without

# Of ln n, for each corner: the BIC penalty of its three parameters, (ln n)/2 each (Schwarz, Ann. Stat. 6 (1978) 461).
BIC_FACTOR = 1.5
FEW = 1 / 6  # share of the sticks that may be odd (a tap makes two of one): the others still show what a stick is

Span = tuple[float, float]


def accept_sticks(
    series: Series,
    workspace: Workspace,
    times: SwitchingTimes,
    levels: NoiseLevels,
    noise: white_jerk.Noise,
    first: SwitchingTimes,
    estimates: RecordEstimates,
) -> tuple[SwitchingTimes, NoiseLevels] | list[Span]:
    """Return switching times and noise levels of the sticks accepted, each on an even belt or on an uneven one.

    Parameters
    ----------
    times, levels : SwitchingTimes, NoiseLevels
        The estimates.
    noise : white_jerk.Noise
        Of the null model of white jerk.
    first : SwitchingTimes
        Where the estimation began: that of uneven sticks starts there again.
    estimates : RecordEstimates
        Of the record: in a block of it each stick is accepted or rejected by itself, as one of the record.

    Returns
    -------
    (SwitchingTimes, NoiseLevels), or list of (float, float)
        Where the null model is kept, the spans of time, s, of the few sticks that prevent the others from being
        accepted; empty where these are not few.
    """
    sticks = sticks_of(times)
    if not sticks:
        return (times, _final_levels(levels, estimates)) if estimates.closed else []
    bare = without(times, np.ones(times.at.size, bool))
    snap = estimates.once(
        "null model",
        lambda: reestimate_noise(series, workspace, times, null_model(levels), 3, null_model=True),
    )
    spans = spans_of(series, times, sticks)
    plain = _jerk_gains(series, noise, workspace, spans)
    smooth = _gains(series, bare, snap, workspace, spans)
    even = _gains(series, times, levels, workspace, spans)
    needed = estimates.once("needed", lambda: BIC_FACTOR * math.log(series.time.size))
    corners = np.array([len(stick) for stick in sticks])
    ridden = np.zeros(len(sticks), bool)
    other_way = np.maximum(plain, smooth)
    gained = (even - other_way)[:-1]
    if estimates.once("rounded", lambda: bool((gained < needed * corners).any())):
        even = _better_rounded(series, times, levels, workspace, spans, even)
        gained = (even - other_way)[:-1]
    uneven = levels.reading_variance[STICK] > 1.3 * levels.reading_variance[SLIP]
    if estimates.once("uneven", lambda: bool(uneven or (gained < needed * corners).any())):
        kinds = np.where(first.kind == LAND, MEET, first.kind).astype(np.uint8)
        firsts = tuple(RIDE if label == STICK else label for label in first.first)
        other = replace(first, kind=kinds, first=firsts)
        riding = levels._replace(
            mean_snap=np.zeros(LABELS), reading_variance=np.full(LABELS, levels.reading_variance[SLIP])
        )
        for width in (1.0, 0.25):
            riding = _reestimated(series, workspace, other, riding, estimates, f"riding, {width}")
            other = refine_switching_times(series, workspace, other, riding, width)
        riding = _reestimated(series, workspace, other, riding, estimates, "riding")
        rides = _gains(series, other, riding, workspace, spans)
        ridden = (rides > even + needed)[:-1]
        gained = np.maximum(gained, (rides - other_way)[:-1])
        levels = estimates.once("ridden", lambda: _with_riding(levels, riding, ridden))
        times = _with_times_of(times, other, [stick for stick, ride in zip(sticks, ridden, strict=True) if ride])
    odd = odd_spans(series, times, sticks, gained < 0)
    dropped = gained < needed * corners
    # Where most sticks are beyond doubt, the others need only help.
    if estimates.once("beyond doubt", lambda: bool(dropped.mean() < 1 / 3)):
        dropped = gained < 0
    if dropped.mean() > 1 / 3 and not estimates.closed:
        return []
    lengths = np.array([np.ptp(times.at[stick]) for stick in sticks])
    misfit = dropped & (lengths > times.unit)  # a flat part of a slip is shorter: these are sticks of another kind
    if misfit.any():
        return odd_spans(series, times, sticks, misfit, few=1.0 if estimates.closed else FEW)
    changed = bool(dropped.any() or ridden.any())
    before = times
    if changed or estimates.known("rebuilt 0"):
        times, levels = _rebuilt(series, workspace, times, levels, sticks, dropped, ridden, estimates)
    if changed:
        even = _gains(series, times, levels, workspace, spans)
        even = _better_rounded(series, times, levels, workspace, spans, even)
    if estimates.closed:
        hopeless = dropped & (even[:-1] < other_way[:-1] - needed)
        return odd_spans(series, before, sticks, hopeless, few=1.0) if hopeless.any() else (times, levels)
    # What the sticks that are left gain must not be lost where the others were dropped.
    return (times, levels) if even[-1] - max(plain[-1], smooth[-1]) > needed * times.at.size else odd


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


def _final_levels(levels: NoiseLevels, estimates: RecordEstimates) -> NoiseLevels:
    """Return the levels of a record whose gate has been through, for a block of it that has no corner."""
    ridden = estimates.once("ridden", lambda: levels)
    return estimates.once("rebuilt 1", lambda: ridden)


def _with_riding(levels: NoiseLevels, riding: NoiseLevels, ridden: Mask) -> NoiseLevels:
    if not ridden.any():
        return levels
    return riding if ridden.all() else merged(levels, riding)


def _reestimated(
    series: Series,
    workspace: Workspace,
    times: SwitchingTimes,
    levels: NoiseLevels,
    estimates: RecordEstimates,
    name: str,
) -> NoiseLevels:
    return estimates.once(name, lambda: reestimate_noise(series, workspace, times, levels, 2))


def odd_spans(
    series: Series, times: SwitchingTimes, sticks: list[list[int]], odd: Mask, few: float = FEW
) -> list[Span]:
    """Return where the sticks that are ``odd`` lie, if few are: from middle to middle of the sticks beside them."""
    if not odd.any() or odd.mean() >= few:
        return []
    middle = np.array([0.5 * (times.at[stick[0]] + times.at[stick[-1]]) for stick in sticks])
    ends = np.concatenate(([series.time[0] - 1.0], middle[~odd], [series.time[-1] + 1.0]))
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
    """Return the likelihoods of even sticks, each with the reading variance of all sticks or of the slips.

    A belt that moves a round number of counts in a sample is rounded alike throughout a stick: by nothing in most, by
    half a count at every other sample in some.  One variance does not suit both.
    """
    reading = levels.reading_variance.copy()
    reading[STICK] = reading[SLIP]
    more = np.maximum(_gains(series, times, levels._replace(reading_variance=reading), workspace, spans) - even, 0.0)
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
    return np.asarray(0.5 * (np.log(s) - scaled**2 / s))


def _summed(gain: Array, spans: Integers) -> Array:
    return np.array([gain[first:end].sum() for first, end in spans])


def _rebuilt(
    series: Series,
    workspace: Workspace,
    times: SwitchingTimes,
    levels: NoiseLevels,
    sticks: list[list[int]],
    dropped: Mask,
    ridden: Mask,
    estimates: RecordEstimates,
) -> tuple[SwitchingTimes, NoiseLevels]:
    """Return the times after the gate's verdict, its corners placed and its levels learned again."""
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
    times = replace(times, at=times.at[kept], sd=times.sd[kept], kind=kind[kept], first=tuple(first))
    if estimates.closed and not estimates.known("rebuilt 0"):
        return times, levels
    for k in range(2):
        levels = _reestimated(series, workspace, times, levels, estimates, f"rebuilt {k}")
        times = refine_switching_times(series, workspace, times, levels, 0.25)
    return times, levels
