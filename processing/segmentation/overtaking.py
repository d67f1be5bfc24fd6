"""Landings in which the mass overtakes the belt: it comes up to the belt's speed, runs ahead, and lands from above.

That happens where the friction level of the new contact is below the spring's force.  Friction changes its sign where
the mass passes the belt's speed, and the acceleration jumps; the mass sticks when it has come back.  One landing in
about a thousand of the bench does so, for 20 to 100 ms; a stick that begins at the first corner then fits by none of
its samples, and its misfit raises the noise of all sticks.
"""

from dataclasses import replace

import numpy as np

from daq.compute.arrays import Array
from processing.kalman.snap_kernel import LAND, OVERTAKE, SLIP, STICK, NoiseLevels
from processing.record.estimates import RecordEstimates
from processing.record.series import Series
from processing.segmentation.noise_levels import Workspace, filter_stretch
from processing.segmentation.switching_estimate import refine_switching_times
from processing.segmentation.switching_times import FilterStretch, SwitchingTimes, spans_of, sticks_of, stretches

ODD = 4.0  # times the median mean square innovation that a stick's beginning has before it is tried
AHEAD = (1 / 64, 1 / 32, 1 / 16, 1 / 8, 1 / 4)  # of a slip: how long the mass may run ahead, as a first guess
# Samples that the mass runs ahead for, at least.  With 5, at 200 Hz, the corners of a mass that ran ahead by 2 mm/s
# were placed so that the velocity erred by 7 mm/s, where a plain landing errs by 2.
LEAST = 8
AROUND = 1 / 4  # of a slip: what is looked at on either side
GAIN = 30.0  # log likelihood: three times the penalty of one more corner, for the place is picked among others


def with_overtaking(
    series: Series, workspace: Workspace, times: SwitchingTimes, levels: NoiseLevels, estimates: RecordEstimates
) -> SwitchingTimes:
    """Return the switching times with an overtaking corner before each landing that needs one."""
    reading = levels.reading_variance.copy()
    reading[STICK] = reading[SLIP]
    levels = levels._replace(reading_variance=reading)
    at, kind, sd = list(times.at), list(times.kind), list(times.sd)
    added: list[int] = []
    every = stretches(series, times)
    misfit = [_misfits_of_landings(series, workspace, times, levels, stretch) for stretch in every]
    usual = estimates.once("usual misfit", lambda: _usual(misfit))
    for stretch, own in zip(every, misfit, strict=True):
        for k in (k for k, size in own.items() if size > ODD * usual):
            better = _time_ahead(series, workspace, times, levels, stretch, k)
            if better > 0:
                place = k + len(added)
                at.insert(place, at[place])
                at[place + 1] += better
                kind.insert(place, np.uint8(OVERTAKE))
                sd.insert(place, sd[place])
                added.append(place)
    if not added:
        return times
    times = replace(times, at=np.array(at), kind=np.array(kind, np.uint8), sd=np.array(sd))
    better_times = refine_switching_times(series, workspace, times, levels, 1.0)
    near = np.unique(np.clip(np.array(added)[:, None] + np.arange(-1, 3), 0, times.at.size - 1))
    times.at[near], times.sd[near] = better_times.at[near], better_times.sd[near]
    return times


def misfits(series: Series, workspace: Workspace, times: SwitchingTimes, levels: NoiseLevels) -> Array:
    """Return the mean square innovation of each stick over the median of all, as if its readings erred as a slip's."""
    reading = levels.reading_variance.copy()
    reading[STICK] = reading[SLIP]
    squares = np.zeros(series.time.size)
    for stretch in stretches(series, times):
        squares[stretch.own] = _squares(series, workspace, times, levels._replace(reading_variance=reading), stretch)
    spans = spans_of(series, times, sticks_of(times))[:-1]
    sizes = np.array([squares[first:end].mean() if end > first else 0.0 for first, end in spans])
    return np.asarray(sizes / max(float(np.median(sizes)), 1.0)) if sizes.size else sizes


def _misfits_of_landings(
    series: Series, workspace: Workspace, times: SwitchingTimes, levels: NoiseLevels, stretch: FilterStretch
) -> dict[int, float]:
    """Return the mean square innovation at the beginning of each stick of a stretch, by the corner it begins with."""
    landings = [k for k in range(stretch.corners.start, stretch.corners.stop) if times.kind[k] == LAND]
    if not landings:
        return {}
    squares = _squares(series, workspace, times, levels, stretch)
    own = series.time[stretch.own]
    sizes = {}
    for k in landings:
        end = times.at[k] + AROUND * times.unit
        if k + 1 < stretch.corners.stop:
            end = min(end, float(times.at[k + 1]))
        i, j = np.searchsorted(own, (times.at[k], end))
        sizes[k] = float(squares[i:j].mean()) if j - i >= 8 else 0.0
    return sizes


def _usual(misfit: list[dict[int, float]]) -> float:
    sizes = [size for own in misfit for size in own.values()]
    return max(float(np.median(sizes)), 1.0) if sizes else 1.0


def _squares(
    series: Series, workspace: Workspace, times: SwitchingTimes, levels: NoiseLevels, stretch: FilterStretch
) -> Array:
    """Return the square of every innovation over its variance."""
    s, scaled = filter_stretch(series, times, levels, stretch, workspace)[1][:, 14:].T
    return np.asarray(scaled**2 / s)


def _time_ahead(
    series: Series,
    workspace: Workspace,
    times: SwitchingTimes,
    levels: NoiseLevels,
    stretch: FilterStretch,
    k: int,
) -> float:
    """Return for how long the mass most likely runs ahead of the belt before the landing ``k``, s; 0: it does not."""
    unit, at = times.unit, float(times.at[k])
    low = at - AROUND * unit
    if k > stretch.corners.start:
        low = max(low, float(times.at[k - 1]))
    high = at + (AHEAD[-1] + AROUND) * unit
    if k + 1 < stretch.corners.stop:
        high = min(high, float(times.at[k + 1]))
    i, j = stretch.own.start + np.searchsorted(series.time[stretch.own], (low, high))
    own = slice(int(i), int(j))
    if own.stop - own.start < 16:
        return 0.0

    def likelihood(place: list[float], kind: list[int]) -> float:
        part = replace(times, at=np.array(place), kind=np.array(kind, np.uint8), sd=np.full(len(place), times.sd[k]))
        whole = FilterStretch(own, SLIP, slice(0, len(place)))
        s, scaled = filter_stretch(series, part, levels, whole, workspace)[1][:, 14:].T
        return float(0.5 * (np.log(s) - scaled**2 / s).sum())

    best, ahead = likelihood([at], [LAND]) + GAIN, 0.0
    for share in AHEAD:
        if at + share * unit < high - unit / 64:
            found = likelihood([at, at + share * unit], [OVERTAKE, LAND])
            best, ahead = max((best, ahead), (found, share * unit))
    return ahead if ahead >= LEAST * series.interval else 0.0
