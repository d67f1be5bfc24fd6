"""Corners that plateaus of the velocity do not show: near the ends of a record, and landings that overtake the belt.

Near an end of a piece a plateau is too short, or hidden in one-sided fits: a last stick of less than 35 ms would be
smoothed as slip, and the first 30 ms of a last slip as stick.  A corner there is accepted if it raises the log
likelihood by what model selection asks of every corner.

In some landings the mass overtakes the belt: it comes up to the belt's speed, runs ahead, and lands from above.  That
happens where the friction level of the new contact is below the spring's force.  Friction changes its sign where
the mass passes the belt's speed, and the acceleration jumps; the mass sticks when it has come back.  One landing in
about a thousand of the bench does so, for 20 to 100 ms; a stick that begins at the first corner then fits by none of
its samples, and its misfit raises the noise of all sticks.
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
    spans_of,
    state_after,
    sticks_of,
    stretches,
)
from stickslip.compute.arrays import Array

ODD = 4.0  # times the median mean square innovation that a stick's beginning has before it is tried
AHEAD = (1 / 64, 1 / 32, 1 / 16, 1 / 8, 1 / 4)  # of a slip: how long the mass may run ahead, as a first guess
# Samples that the mass runs ahead for, at least.  With 5, at 200 Hz, the corners of a mass that ran ahead by 2 mm/s
# were placed so that the velocity erred by 7 mm/s, where a plain landing errs by 2.
LEAST = 8
AROUND = 1 / 4  # of a slip: what is looked at on either side
GAIN = 30.0  # log likelihood: three times the penalty of one more corner, for the place is picked among others
NEAR = 1 / 4  # of a slip: how far from an end of a piece a corner is looked for; plateaus show those farther in
CLOSER = 4 / 3  # by which each place tried is nearer to the end; their refinement reaches farther than to the next
SHORTEST = 3  # samples of the part that a corner near an end cuts off


def with_ends(
    series: Series,
    workspace: Workspace,
    first: SwitchingTimes,
    times: SwitchingTimes,
    levels: NoiseLevels,
    speed: float,
    needed: float,
) -> SwitchingTimes:
    """Return ``first`` with a landing or a break-away near each end of a piece that needs one, or ``first`` itself.

    first, times: Corners before and after their refinement.
    levels: By label.
    speed: Of the sticks, m/s, NaN where there is none: a part that is cut off as stick must have it.
    needed: Log likelihood that a corner must gain.
    """
    levels = _read_alike(levels)
    begins = list(first.first)
    added: list[tuple[float, int]] = []
    number = {own.start: k for k, own in enumerate(series.pieces)}
    for stretch in stretches(series, times):
        at, kinds = times.at[stretch.corners].tolist(), times.kind[stretch.corners].tolist()
        begin, end = series.time[stretch.own][[0, -1]].tolist()
        span, state = (NEAR + AROUND) * times.unit, stretch.first
        within = begin, min([begin + span, end, *at[:1]])
        place, kind = _corner_near_end(series, workspace, times, levels, within, state, speed, needed, late=False)
        if kind:
            added.append((place, kind))
            state = begins[number[stretch.own.start]] = STICK if kind == LEAVE else SLIP
            at, kinds = at or [place], kinds or [kind]
        within = max([end - span, begin, *at[-1:]]), end
        state = state_after(kinds[-1]) if kinds else state
        place, kind = _corner_near_end(series, workspace, times, levels, within, state, speed, needed, late=True)
        if kind:
            added.append((place, kind))
    if not added:
        return first
    places, kinds = np.array([own[0] for own in added]), np.array([own[1] for own in added], np.uint8)
    order = np.argsort(np.concatenate((times.at, places)), kind="stable")
    return replace(
        first,
        at=np.maximum.accumulate(np.concatenate((first.at, places))[order]),
        sd=np.concatenate((first.sd, np.full(places.size, series.interval)))[order],
        kind=np.concatenate((first.kind, kinds))[order],
        first=tuple(begins),
    )


def _corner_near_end(
    series: Series,
    workspace: Workspace,
    times: SwitchingTimes,
    levels: NoiseLevels,
    within: tuple[float, float],
    state: int,
    speed: float,
    needed: float,
    *,
    late: bool,
) -> tuple[float, int]:
    """Return the corner that gains the most within a span that begins or ends a piece: its time, s, and its kind, or 0.

    ``state`` is the label of the span as it is, ``late`` whether the piece ends with it, ``needed`` the least gain.
    """
    time, position = series.time, series.position
    i, j = (int(k) for k in np.searchsorted(time, within))
    i, j = (i, j + 1) if late else (i, j)
    if state not in (SLIP, STICK) or j - i < 4 * SHORTEST:
        return math.nan, 0
    own = slice(i, j)
    kind = LAND if late == (state == SLIP) else LEAVE
    other = STICK if state == SLIP else SLIP
    as_it_is = (STICK, RIDE) if state == STICK else (SLIP,)  # on a belt that is not even, or where the mass creeps
    best = needed + max(
        _likelihood(series, workspace, times, levels, FilterStretch(own, label, slice(0, 0)), [], [])
        for label in as_it_is
    )
    found, off = (math.nan, 0), NEAR * times.unit
    while off >= SHORTEST * series.interval:
        at = within[1] - off if late else within[0] + off
        m = int(np.searchsorted(time, at))
        off /= CLOSER
        if not i + SHORTEST <= m <= j - SHORTEST:
            continue
        first, last = _ends(position, m, j) if late else _ends(position, i, m)  # of the part that is cut off
        slope = float((position[last] - position[first]) / (time[last] - time[first]))
        if other == STICK and not abs(slope - speed) <= SAME_SPEED * abs(speed):
            continue
        part = FilterStretch(own, state if late else other, slice(0, 1))
        likelihood = _likelihood(series, workspace, times, levels, part, [at], [kind])
        if likelihood > best:
            best, found = likelihood, (at, kind)
    return found


def _ends(position: Array, i: int, j: int) -> tuple[int, int]:
    """Return the first and the last of the samples i..j - 1 whose readings are there, at least two."""
    known = i + np.flatnonzero(~np.isnan(position[i:j]))
    return (int(known[0]), int(known[-1])) if known.size > 1 else (i, j - 1)


def _likelihood(
    series: Series,
    workspace: Workspace,
    times: SwitchingTimes,
    levels: NoiseLevels,
    stretch: FilterStretch,
    at: list[float],
    kind: list[int],
) -> float:
    """Return the log likelihood of a stretch with the corners given, up to a constant."""
    part = replace(times, at=np.array(at), kind=np.array(kind, np.uint8), sd=np.full(len(at), series.interval))
    return float(log_likelihood(*filter_stretch(series, part, levels, stretch, workspace)[1][:, 14:].T).sum())


def _read_alike(levels: NoiseLevels) -> NoiseLevels:
    """Return the levels with readings that err in sticks as they do in slips."""
    reading = levels.reading_variance.copy()
    reading[STICK] = reading[SLIP]
    return replace(levels, reading_variance=reading)


def with_overtaking(
    series: Series, workspace: Workspace, times: SwitchingTimes, levels: NoiseLevels, usual: float | None
) -> tuple[float, SwitchingTimes]:
    """Return the switching times with an overtaking corner before each landing that needs one.

    usual: Mean square innovation that the usual stick of the record begins with; None: that of these.
    Returns: ``usual``.
    """
    levels = _read_alike(levels)
    at, kind, sd = list(times.at), list(times.kind), list(times.sd)
    added: list[int] = []
    every = stretches(series, times)
    misfit = [_misfits_of_landings(series, workspace, times, levels, stretch) for stretch in every]
    usual = _usual(misfit) if usual is None else usual
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
        return usual, times
    times = replace(times, at=np.array(at), kind=np.array(kind, np.uint8), sd=np.array(sd))
    better_times = refine_switching_times(series, workspace, times, levels, 1.0)
    near = np.unique(np.clip(np.array(added)[:, None] + np.arange(-1, 3), 0, times.at.size - 1))
    times.at[near], times.sd[near] = better_times.at[near], better_times.sd[near]
    return usual, times


def misfits(series: Series, workspace: Workspace, times: SwitchingTimes, levels: NoiseLevels) -> Array:
    """Return the mean square innovation of each stick over the median of all, as if its readings erred as a slip's."""
    levels = _read_alike(levels)
    squares = np.zeros(series.time.size)
    for stretch in stretches(series, times):
        squares[stretch.own] = _squares(filter_stretch(series, times, levels, stretch, workspace)[1])
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
    _, stored = filter_stretch(series, times, levels, stretch, workspace)
    own = series.time[stretch.own]
    sizes = {}
    for k in landings:
        end = times.at[k] + AROUND * times.unit
        if k + 1 < stretch.corners.stop:
            end = min(end, float(times.at[k + 1]))
        i, j = np.searchsorted(own, (times.at[k], end))
        sizes[k] = float(_squares(stored[i:j]).mean()) if j - i >= 8 else 0.0
    return sizes


def _usual(misfit: list[dict[int, float]]) -> float:
    sizes = [size for own in misfit for size in own.values()]
    return max(float(np.median(sizes)), 1.0) if sizes else 1.0


def _squares(stored: Array) -> Array:
    """Return the square of every innovation over its variance, 0 where a reading is missing."""
    s, scaled = stored[:, 14:].T
    return np.asarray(scaled**2 / np.where(s > 0, s, 1.0))


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
        whole = FilterStretch(own, SLIP, slice(0, len(place)))
        return _likelihood(series, workspace, times, levels, whole, place, kind)

    best, ahead = likelihood([at], [LAND]) + GAIN, 0.0
    for share in AHEAD:
        if at + share * unit < high - unit / 64:
            found = likelihood([at, at + share * unit], [OVERTAKE, LAND])
            best, ahead = max((best, ahead), (found, share * unit))
    return ahead if ahead >= LEAST * series.interval else 0.0
