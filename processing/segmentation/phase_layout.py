"""From the times of corners to phases: sticks, and the slips between them.

Corners of a plateau: a landing is sharp, and lies where the acceleration has fallen to half of the slip's last peak; a
break-away is soft (only the jerk jumps), and is found by extrapolating the rise of the acceleration back to zero.
Corners fitted by a method (`processing.segmentation.smoother`) are used unchanged, with their uncertainties.
"""

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from processing.record.motion import Corner, Motion, Phase, PhaseSegmentation
from processing.record.series import Series
from processing.segmentation.belt_speed import SAME_SPEED, reported_speed, speed_before_creep
from stickslip.compute.arrays import Array, Mask, runs
from stickslip.units import Measured

FAST = 0.25  # of the peak speed of a slip: faster samples belong to it; noise and ringing reach 0.2 on paper
CREEP_SHARE = 0.5  # of a slip's time: a smaller fast part means creep; paper 0.1 to 0.3, the six laws 0.7 to 0.9
SLOW = 0.2  # of the peak speed of the usual slip: slower slips are creep
FEWEST = 8  # slips that determine the usual one

Runs = list[tuple[int, int]]  # first and last sample, both included
Stick = tuple[float, float, float, float]  # start, end, and their standard deviations, s


def segment_at_corners(
    series: Series, motion: Motion, moving: Mask, level: float, stated: float | None, measured: Measured | None
) -> PhaseSegmentation:
    """Lay out the phases between fitted corners, with the errors of their times; ``level`` is the stick speed."""
    moving = moving.copy()
    for piece in series.pieces:
        inside = _corners_inside(series, piece, motion.corners)
        if inside and inside[0].what == "start":
            moving[piece.start : np.searchsorted(series.time, inside[0].time)] = False
        if inside and inside[-1].what == "stop":
            moving[np.searchsorted(series.time, inside[-1].time) : piece.stop] = False
    sticks = sticks_at_corners(series, motion.corners)
    phases = lay_out_phases(series, moving, sticks)
    return PhaseSegmentation(reported_speed(stated, measured, level, bool(sticks)), phases, level)


def sticks_at_corners(series: Series, corners: Sequence[Corner]) -> list[Stick]:
    """Return the sticks between the corners, in order of time."""
    sticks: list[Stick] = []
    for piece in series.pieces:
        inside = _corners_inside(series, piece, corners)
        landed = Corner(float(series.time[piece.start]), math.inf, "land")
        stuck = bool(inside) and inside[0].what == "leave"
        for corner in inside:
            if corner.what == "land":
                landed, stuck = corner, True
            elif stuck:
                sticks.append((landed.time, corner.time, landed.sd, corner.sd))
                stuck = False
        if stuck:
            sticks.append((landed.time, float(series.time[piece.stop - 1]), landed.sd, math.inf))
    return sticks


def _corners_inside(series: Series, piece: slice, corners: Sequence[Corner]) -> list[Corner]:
    begin, end = series.time[piece.start], series.time[piece.stop - 1]
    return [corner for corner in corners if begin <= corner.time <= end]


def speed_of_sticks(series: Series, sticks: list[Stick], velocity: Array, window: int) -> float:
    """Return the belt's speed from the velocity in sticks, m/s: the mean, or that before the mass creeps.

    ``window`` is the length of the smoother, in samples.
    """
    firsts = np.searchsorted(series.time, [stick[0] for stick in sticks])
    ends = np.searchsorted(series.time, [stick[1] for stick in sticks], "right")
    return _mean_stick_speed([velocity[first:end] for first, end in zip(firsts, ends, strict=True)], window)


def _mean_stick_speed(velocity: list[Array], window: int) -> float:
    speeds = np.concatenate(velocity) if velocity else np.empty(0)
    if not speeds.size:
        return math.nan
    level = float(speeds[np.abs(speeds - np.median(speeds)) <= SAME_SPEED * abs(np.median(speeds))].mean())
    return speed_before_creep(velocity, window, level)


def find_plateau_corners(
    run: tuple[int, int], series: Series, size: Array, window: int, reach: int, tolerance: float, moving: Mask
) -> tuple[float, float]:
    """Return start and end of a stick, between samples, from |a|, which may rise for ``reach`` samples after it."""
    piece = next(part for part in series.pieces if part.start <= run[0] < part.stop)
    time = series.time
    first, last = run
    start, end = float(time[first]), float(time[last])
    low = max(first - window, piece.start)
    if low < first and moving[low]:
        peak = low + int(np.argmax(size[low:first]))
        half = 0.5 * size[peak]
        if half > tolerance:
            crossing = peak + int(np.argmax(size[peak:first] <= half)) if (size[peak:first] <= half).any() else first
            start = _interpolate_crossing(time, size, crossing, half)
    high = min(last + max(window, reach), piece.stop - 1)
    beyond = np.flatnonzero(size[last + 1 : high + 1] > 2 * tolerance)
    if last + 1 < piece.stop and beyond.size:
        first_crossing = _interpolate_crossing(time, size, last + 1, tolerance)
        second_crossing = _interpolate_crossing(time, size, last + 1 + int(beyond[0]), 2 * tolerance)
        end = max(2 * first_crossing - second_crossing, 0.5 * (start + end))
    return start, end


def extend_over_creep(series: Series, sticks: list[Stick], relative_velocity: Array, usual: float) -> list[Stick]:
    """Return the sticks, extended where most of a slip between two of them is creep or blur of the filter.

    The slip then is the part faster than `FAST` of its peak speed; a swing back is so for three quarters of its time,
    and is not changed.  Sticks are merged if the peak speed is below `SLOW` of the ``usual`` one, m/s.
    """
    extended: list[Stick] = sticks[:1]
    time = series.time
    starts = time[[piece.start for piece in series.pieces]]
    spans, fastest = _measure_slips(series, sticks, relative_velocity)
    for (i, j), most, (before, after) in zip(spans, fastest, pairwise(sticks), strict=True):
        same_piece = np.searchsorted(starts, before[1], side="right") == np.searchsorted(starts, after[0], side="right")
        fast = np.flatnonzero(np.abs(relative_velocity[i:j]) > FAST * most)
        if same_piece and most < SLOW * usual:
            extended[-1] = (*extended[-1][:1], after[1], extended[-1][2], after[3])
        elif same_piece and fast.size and fast[-1] - fast[0] < CREEP_SHARE * (j - i):
            extended[-1] = (extended[-1][0], float(time[i + fast[0]]), *extended[-1][2:])
            extended.append((float(time[i + fast[-1]]), *after[1:]))
        else:
            extended.append(after)
    return extended


def median_peak_speed(series: Series, sticks: list[Stick], relative_velocity: Array) -> float:
    """Return the median peak speed of slips between two sticks, m/s; 0 if there are few."""
    fastest = _measure_slips(series, sticks, relative_velocity)[1]
    return float(np.median(fastest)) if len(fastest) >= FEWEST else 0.0


def _measure_slips(
    series: Series, sticks: list[Stick], relative_velocity: Array
) -> tuple[list[tuple[int, int]], list[float]]:
    """Return the samples between each stick and the next, and the largest |v| relative to the belt among them."""
    ends, starts = [stick[1] for stick in sticks[:-1]], [stick[0] for stick in sticks[1:]]
    bounds = list(zip(*np.searchsorted(series.time, (ends, starts)).tolist(), strict=True))
    return bounds, [float(np.abs(relative_velocity[i:j]).max(initial=0.0)) for i, j in bounds]


def _interpolate_crossing(time: Array, size: Array, sample: int, level: float) -> float:
    """Return the time between ``sample`` and the one before it at which ``size`` passes ``level``."""
    before, after = size[sample - 1], size[sample]
    share = (level - before) / (after - before) if after != before else 1.0
    return float(time[sample - 1] + min(max(share, 0.0), 1.0) * (time[sample] - time[sample - 1]))


def lay_out_phases(series: Series, moving: Mask, sticks: list[Stick]) -> tuple[Phase, ...]:
    """Return sticks, and slips between them, in the pieces of the record that are in motion."""
    phases: list[Phase] = []
    for first, last in runs_in_pieces(moving, series.pieces):
        time = series.time[first : last + 1]
        begin = float(time[0])
        end = float(time[-1])
        inside = [stick for stick in sticks if time[0] <= stick[0] and stick[1] <= time[-1]]
        bounds = [(begin, begin, math.inf, math.inf), *inside, (end, end, math.inf, math.inf)]
        slips = [(before[1], stick[0], before[3], stick[2]) for before, stick in pairwise(bounds)]
        spans = [slips[0], *(stick for pair in zip(inside, slips[1:], strict=True) for stick in pair)]
        firsts = first + np.searchsorted(time, [span[0] for span in spans])
        lasts = first + np.searchsorted(time, [span[1] for span in spans], side="right") - 1
        rows = zip(spans, firsts.tolist(), lasts.tolist(), strict=True)
        for number, ((start, end, start_sd, end_sd), i, j) in enumerate(rows):
            if end > start and j >= i:
                phases.append(Phase("stick" if number % 2 else "slip", start, end, i, j, start_sd, end_sd))
    return tuple(phases)


def runs_in_pieces(mask: Mask, pieces: tuple[slice, ...]) -> Runs:
    """Return first and last sample of every run of True in ``mask``, each within one piece."""
    return [(piece.start + i, piece.start + j - 1) for piece in pieces for i, j in runs(mask[piece])]
