"""Corners that plateaus of the velocity do not show: near the ends of a record, and landings that overtake the belt.

Near an end of a piece a plateau is too short, or hidden in one-sided fits: a last stick of less than 35 ms would be
smoothed as slip, and the first 30 ms of a last slip as stick.  A corner there is accepted if it raises the log
likelihood by the penalty of model selection for a corner.

In some landings the mass overtakes the belt: it reaches the belt's speed, runs ahead, and lands from above.  That
happens where the friction level of the new contact is below the spring's force.  Friction changes its sign where
the mass passes the belt's speed, and the acceleration jumps; the mass sticks when it has come back.  About one landing
in a thousand of the bench does so, for 20 to 100 ms; a stick that begins at the first corner then fits none of its
samples, and its misfit raises the noise of all sticks.
"""

import math
from dataclasses import replace

import numpy as np

from processing.kalman.stick_slip import LAND, LEAVE, OVERTAKE, RIDE, SLIP, STICK, NoiseLevels
from processing.record.series import Series
from processing.segmentation.belt_speed import SAME_SPEED
from processing.segmentation.noise_levels import Workspace, filter_stretch, log_likelihood
from processing.segmentation.switching_estimate import refine_switching_times
from processing.segmentation.switching_times import (
    FilterStretch,
    SwitchingTimes,
    group_by_stick,
    label_after,
    span_sticks,
    split_stretches,
)
from stickslip.compute.arrays import Array

ODD = 4.0  # times the median mean square innovation: a larger misfit at the start of a stick suggests overtaking
AHEAD = (1 / 64, 1 / 32, 1 / 16, 1 / 8, 1 / 4)  # of a slip: first guesses of how long the mass runs ahead
LEAST = 8  # samples that the mass runs ahead for, at least: with fewer a plain landing is more accurate
AROUND = 1 / 4  # of a slip: samples used on either side
GAIN = 30.0  # log likelihood: three times the penalty of one more corner, because several times are tried
NEAR = 1 / 4  # of a slip: distance from an end of a piece searched for a corner; plateaus show those farther in
CLOSER = 4 / 3  # ratio of the distances from the end of one time tried and the next
SHORTEST = 3  # samples of the part that a corner near an end cuts off


def add_end_corners(
    series: Series,
    workspace: Workspace,
    first: SwitchingTimes,
    times: SwitchingTimes,
    levels: NoiseLevels,
    speed: float,
    required_gain: float,
) -> SwitchingTimes:
    """Return ``first`` with a landing or a break-away near each end of a piece that needs one, or ``first`` itself.

    ``first`` and ``times`` are the corners before and after refinement; ``speed`` is that of the sticks, m/s, or NaN.
    """
    levels = _share_reading_variance(levels)
    begins = list(first.first)
    added: list[tuple[float, int]] = []
    number = {piece.start: k for k, piece in enumerate(series.pieces)}
    for stretch in split_stretches(series, times):
        corner_times, kinds = times.time[stretch.corners].tolist(), times.kind[stretch.corners].tolist()
        begin, end = series.time[stretch.samples][[0, -1]].tolist()
        span, state = (NEAR + AROUND) * times.unit, stretch.first
        search_span = begin, min([begin + span, end, *corner_times[:1]])
        corner_time, kind = _find_corner_near_end(
            series, workspace, times, levels, search_span, state, speed, required_gain, late=False
        )
        if kind:
            added.append((corner_time, kind))
            state = begins[number[stretch.samples.start]] = STICK if kind == LEAVE else SLIP
            corner_times, kinds = corner_times or [corner_time], kinds or [kind]
        search_span = max([end - span, begin, *corner_times[-1:]]), end
        state = label_after(kinds[-1]) if kinds else state
        corner_time, kind = _find_corner_near_end(
            series, workspace, times, levels, search_span, state, speed, required_gain, late=True
        )
        if kind:
            added.append((corner_time, kind))
    if not added:
        return first
    added_times, kinds = np.array([corner[0] for corner in added]), np.array([corner[1] for corner in added], np.uint8)
    order = np.argsort(np.concatenate((times.time, added_times)), kind="stable")
    return replace(
        first,
        time=np.maximum.accumulate(np.concatenate((first.time, added_times))[order]),
        sd=np.concatenate((first.sd, np.full(added_times.size, series.interval)))[order],
        kind=np.concatenate((first.kind, kinds))[order],
        first=tuple(begins),
    )


def _find_corner_near_end(
    series: Series,
    workspace: Workspace,
    times: SwitchingTimes,
    levels: NoiseLevels,
    search_span: tuple[float, float],
    state: int,
    speed: float,
    required_gain: float,
    *,
    late: bool,
) -> tuple[float, int]:
    """Return time, s, and kind of the most likely corner in a span that begins or ends a piece; kind 0 if none gains.

    ``state`` is the label of the span without a corner; ``late`` tells whether the span ends the piece.
    """
    time, position = series.time, series.position
    i, j = (int(k) for k in np.searchsorted(time, search_span))
    i, j = (i, j + 1) if late else (i, j)
    if state not in (SLIP, STICK) or j - i < 4 * SHORTEST:
        return math.nan, 0
    samples = slice(i, j)
    kind = LAND if late == (state == SLIP) else LEAVE
    other = STICK if state == SLIP else SLIP
    as_it_is = (STICK, RIDE) if state == STICK else (SLIP,)  # on a belt that is not even, or where the mass creeps
    best = required_gain + max(
        _likelihood(series, workspace, times, levels, FilterStretch(samples, label, slice(0, 0)), [], [])
        for label in as_it_is
    )
    corner, distance = (math.nan, 0), NEAR * times.unit
    while distance >= SHORTEST * series.interval:
        corner_time = search_span[1] - distance if late else search_span[0] + distance
        m = int(np.searchsorted(time, corner_time))
        distance /= CLOSER
        if not i + SHORTEST <= m <= j - SHORTEST:
            continue
        first, last = (
            _find_end_readings(position, m, j) if late else _find_end_readings(position, i, m)
        )  # of the part that is cut off
        slope = float((position[last] - position[first]) / (time[last] - time[first]))
        if other == STICK and not abs(slope - speed) <= SAME_SPEED * abs(speed):
            continue
        part = FilterStretch(samples, state if late else other, slice(0, 1))
        likelihood = _likelihood(series, workspace, times, levels, part, [corner_time], [kind])
        if likelihood > best:
            best, corner = likelihood, (corner_time, kind)
    return corner


def _find_end_readings(position: Array, i: int, j: int) -> tuple[int, int]:
    """Return the first and the last of the samples i..j - 1 that are not missing."""
    present = i + np.flatnonzero(~np.isnan(position[i:j]))
    return (int(present[0]), int(present[-1])) if present.size > 1 else (i, j - 1)


def _likelihood(
    series: Series,
    workspace: Workspace,
    times: SwitchingTimes,
    levels: NoiseLevels,
    stretch: FilterStretch,
    corner_times: list[float],
    kind: list[int],
) -> float:
    """Return the log likelihood of a stretch with these corners, up to a constant."""
    hypothesis = replace(
        times,
        time=np.array(corner_times),
        kind=np.array(kind, np.uint8),
        sd=np.full(len(corner_times), series.interval),
    )
    return float(log_likelihood(*filter_stretch(series, hypothesis, levels, stretch, workspace)[1][:, 14:].T).sum())


def _share_reading_variance(levels: NoiseLevels) -> NoiseLevels:
    """Return the levels with the reading variance of slips also in sticks."""
    reading = levels.reading_variance.copy()
    reading[STICK] = reading[SLIP]
    return replace(levels, reading_variance=reading)


def add_overtaking(
    series: Series, workspace: Workspace, times: SwitchingTimes, levels: NoiseLevels, usual: float | None
) -> tuple[float, SwitchingTimes]:
    """Return ``usual``, and the switching times with an overtaking corner before each landing that needs one.

    ``usual`` is the median misfit at the start of a stick of the record; None takes that of these sticks.
    """
    levels = _share_reading_variance(levels)
    corner_times, kind, sd = list(times.time), list(times.kind), list(times.sd)
    added: list[int] = []
    all_stretches = split_stretches(series, times)
    landing_misfits = [_measure_landing_misfits(series, workspace, times, levels, stretch) for stretch in all_stretches]
    usual = _median_misfit(landing_misfits) if usual is None else usual
    for stretch, stretch_misfits in zip(all_stretches, landing_misfits, strict=True):
        for k in (k for k, size in stretch_misfits.items() if size > ODD * usual):
            time_ahead = _estimate_time_ahead(series, workspace, times, levels, stretch, k)
            if time_ahead > 0:
                index = k + len(added)
                corner_times.insert(index, corner_times[index])
                corner_times[index + 1] += time_ahead
                kind.insert(index, np.uint8(OVERTAKE))
                sd.insert(index, sd[index])
                added.append(index)
    if not added:
        return usual, times
    times = replace(times, time=np.array(corner_times), kind=np.array(kind, np.uint8), sd=np.array(sd))
    refined = refine_switching_times(series, workspace, times, levels, 1.0)
    affected = np.unique(np.clip(np.array(added)[:, None] + np.arange(-1, 3), 0, times.time.size - 1))
    times.time[affected], times.sd[affected] = refined.time[affected], refined.sd[affected]
    return usual, times


def stick_misfits(series: Series, workspace: Workspace, times: SwitchingTimes, levels: NoiseLevels) -> Array:
    """Return the mean square innovation of each stick over the median of all, with the reading noise of a slip."""
    levels = _share_reading_variance(levels)
    squares = np.zeros(series.time.size)
    for stretch in split_stretches(series, times):
        squares[stretch.samples] = _square_innovations(filter_stretch(series, times, levels, stretch, workspace)[1])
    spans = span_sticks(series, times, group_by_stick(times))[:-1]
    sizes = np.array([squares[first:end].mean() if end > first else 0.0 for first, end in spans])
    return np.asarray(sizes / max(float(np.median(sizes)), 1.0)) if sizes.size else sizes


def _measure_landing_misfits(
    series: Series, workspace: Workspace, times: SwitchingTimes, levels: NoiseLevels, stretch: FilterStretch
) -> dict[int, float]:
    """Return the mean square innovation at the start of each stick of a stretch, by the index of its landing."""
    landings = [k for k in range(stretch.corners.start, stretch.corners.stop) if times.kind[k] == LAND]
    if not landings:
        return {}
    _, stored = filter_stretch(series, times, levels, stretch, workspace)
    time = series.time[stretch.samples]
    sizes = {}
    for k in landings:
        end = times.time[k] + AROUND * times.unit
        if k + 1 < stretch.corners.stop:
            end = min(end, float(times.time[k + 1]))
        i, j = np.searchsorted(time, (times.time[k], end))
        sizes[k] = float(_square_innovations(stored[i:j]).mean()) if j - i >= 8 else 0.0
    return sizes


def _median_misfit(misfit: list[dict[int, float]]) -> float:
    sizes = [size for stretch_misfits in misfit for size in stretch_misfits.values()]
    return max(float(np.median(sizes)), 1.0) if sizes else 1.0


def _square_innovations(stored: Array) -> Array:
    """Return the square of every innovation over its variance, 0 where a reading is missing."""
    s, scaled = stored[:, 14:].T
    return np.asarray(scaled**2 / np.where(s > 0, s, 1.0))


def _estimate_time_ahead(
    series: Series,
    workspace: Workspace,
    times: SwitchingTimes,
    levels: NoiseLevels,
    stretch: FilterStretch,
    k: int,
) -> float:
    """Return for how long the mass most likely runs ahead of the belt before landing ``k``, s, or 0."""
    unit, landing = times.unit, float(times.time[k])
    low = landing - AROUND * unit
    if k > stretch.corners.start:
        low = max(low, float(times.time[k - 1]))
    high = landing + (AHEAD[-1] + AROUND) * unit
    if k + 1 < stretch.corners.stop:
        high = min(high, float(times.time[k + 1]))
    i, j = stretch.samples.start + np.searchsorted(series.time[stretch.samples], (low, high))
    samples = slice(int(i), int(j))
    if samples.stop - samples.start < 16:
        return 0.0

    def likelihood(corner_times: list[float], kind: list[int]) -> float:
        hypothesis = FilterStretch(samples, SLIP, slice(0, len(corner_times)))
        return _likelihood(series, workspace, times, levels, hypothesis, corner_times, kind)

    best, time_ahead = likelihood([landing], [LAND]) + GAIN, 0.0
    for share in AHEAD:
        if landing + share * unit < high - unit / 64:
            gain = likelihood([landing, landing + share * unit], [OVERTAKE, LAND])
            best, time_ahead = max((best, time_ahead), (gain, share * unit))
    return time_ahead if time_ahead >= LEAST * series.interval else 0.0
