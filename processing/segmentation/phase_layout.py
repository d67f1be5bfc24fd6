"""From the times of corners to phases: sticks, and the slips between them.

Corners of a plateau: a landing is sharp, and lies where the acceleration has fallen to half of the slip's last peak; a
break-away is soft (only the jerk jumps), and is found by extrapolating the acceleration's rise back to zero.  Corners
that a method fitted itself (`processing.segmentation.smoother`) are used as they are, uncertainties included.
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

FAST = 0.25  # of the fastest in a slip: what belongs to it; noise and ringing of the smoother reach 0.2 on paper
CREEP_SHARE = (
    0.5  # of a slip's time: a smaller fast part shows creep; paper 0.1 to 0.3, swings of the six laws 0.7 to 0.9
)
SLOW = 0.2  # of the fastest of the usual slip; those of paper that the force of 0.01 falls in all reach 0.22
FEWEST = 8  # slips: with fewer there is no usual one

Runs = list[tuple[int, int]]  # first and last sample, both included
Stick = tuple[float, float, float, float]  # start, end, and their standard deviations, s


def segment_at_corners(
    series: Series, motion: Motion, moving: Mask, level: float, stated: float | None, measured: Measured | None
) -> PhaseSegmentation:
    """Lay out the phases between the corners that a method has fitted, with the uncertainties of their times.

    ``level`` is the speed of the record's sticks, m/s.
    """
    moving = moving.copy()
    for piece in series.pieces:
        inside = _corners_inside(series, piece, motion.corners)
        if inside and inside[0].what == "start":
            moving[piece.start : np.searchsorted(series.time, inside[0].time)] = False
        if inside and inside[-1].what == "stop":
            moving[np.searchsorted(series.time, inside[-1].time) : piece.stop] = False
    sticks = sticks_at_corners(series, motion.corners)
    phases = phases_from_sticks(series, moving, sticks)
    return PhaseSegmentation(reported_speed(stated, measured, level, bool(sticks)), phases, level)


def sticks_at_corners(series: Series, corners: Sequence[Corner]) -> list[Stick]:
    """Return the sticks that begin and end with the corners, in order of time."""
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
    """Return the speed of the belt by the velocity, (n,), in sticks, m/s: their mean, or that before the mass creeps.

    ``window`` is the length of the smoother that made it, in samples.
    """
    firsts = np.searchsorted(series.time, [own[0] for own in sticks])
    ends = np.searchsorted(series.time, [own[1] for own in sticks], "right")
    return _common([velocity[first:end] for first, end in zip(firsts, ends, strict=True)], window)


def _common(velocity: list[Array], window: int) -> float:
    held = np.concatenate(velocity) if velocity else np.empty(0)
    if not held.size:
        return math.nan
    level = float(held[np.abs(held - np.median(held)) <= SAME_SPEED * abs(np.median(held))].mean())
    return speed_before_creep(velocity, window, level)


def corners_of_plateau(
    run: tuple[int, int], series: Series, size: Array, window: int, reach: int, tolerance: float, moving: Mask
) -> tuple[float, float]:
    """Return start and end of a stick, between samples, from the size of the acceleration.

    ``reach`` is for how many samples behind the plateau the acceleration may rise.
    """
    piece = next(own for own in series.pieces if own.start <= run[0] < own.stop)
    time = series.time
    first, last = run
    start, end = float(time[first]), float(time[last])
    low = max(first - window, piece.start)
    if low < first and moving[low]:
        peak = low + int(np.argmax(size[low:first]))
        half = 0.5 * size[peak]
        if half > tolerance:
            crossing = peak + int(np.argmax(size[peak:first] <= half)) if (size[peak:first] <= half).any() else first
            start = _crossing(time, size, crossing, half)
    high = min(last + max(window, reach), piece.stop - 1)
    beyond = np.flatnonzero(size[last + 1 : high + 1] > 2 * tolerance)
    if last + 1 < piece.stop and beyond.size:
        one = _crossing(time, size, last + 1, tolerance)
        two = _crossing(time, size, last + 1 + int(beyond[0]), 2 * tolerance)
        end = max(2 * one - two, 0.5 * (start + end))
    return start, end


def without_creep(series: Series, sticks: list[Stick], apart: Array, usual: float) -> list[Stick]:
    """Return the sticks, longer where most of a slip between two of them is creep or the smear of the filter.

    A slip is then the part in which the mass is faster than `FAST` of its fastest.  A swing back is so for three
    quarters of its time, and is left as it is.  Where the fastest is below `SLOW` of that of the usual slip the mass
    creeps throughout, and both sticks are one.

    sticks: In order of time.
    apart: Velocity relative to the belt, m/s.
    usual: What `usual_fastest` returned for the record, m/s.
    """
    found: list[Stick] = sticks[:1]
    time = series.time
    starts = time[[piece.start for piece in series.pieces]]
    spans, fastest = _between(series, sticks, apart)
    for (i, j), most, (before, behind) in zip(spans, fastest, pairwise(sticks), strict=True):
        same_piece = np.searchsorted(starts, before[1], side="right") == np.searchsorted(
            starts, behind[0], side="right"
        )
        fast = np.flatnonzero(np.abs(apart[i:j]) > FAST * most)
        if same_piece and most < SLOW * usual:
            found[-1] = (*found[-1][:1], behind[1], found[-1][2], behind[3])
        elif same_piece and fast.size and fast[-1] - fast[0] < CREEP_SHARE * (j - i):
            found[-1] = (found[-1][0], float(time[i + fast[0]]), *found[-1][2:])
            found.append((float(time[i + fast[-1]]), *behind[1:]))
        else:
            found.append(behind)
    return found


def usual_fastest(series: Series, sticks: list[Stick], apart: Array) -> float:
    """Return how fast the usual slip between two sticks gets, m/s; 0 where there are few.

    ``apart`` is the velocity relative to the belt, m/s, (n,).
    """
    fastest = _between(series, sticks, apart)[1]
    return float(np.median(fastest)) if len(fastest) >= FEWEST else 0.0


def _between(series: Series, sticks: list[Stick], apart: Array) -> tuple[list[tuple[int, int]], list[float]]:
    """Return the samples between each stick and the next, and the largest size of ``apart`` among them."""
    ends, starts = [own[1] for own in sticks[:-1]], [own[0] for own in sticks[1:]]
    bounds = list(zip(*np.searchsorted(series.time, (ends, starts)).tolist(), strict=True))
    return bounds, [float(np.abs(apart[i:j]).max(initial=0.0)) for i, j in bounds]


def _crossing(time: Array, size: Array, at: int, level: float) -> float:
    """Return the time between samples at-1 and at where ``size`` passes ``level``."""
    before, after = size[at - 1], size[at]
    share = (level - before) / (after - before) if after != before else 1.0
    return float(time[at - 1] + min(max(share, 0.0), 1.0) * (time[at] - time[at - 1]))


def phases_from_sticks(series: Series, moving: Mask, sticks: list[Stick]) -> tuple[Phase, ...]:
    """Lay out sticks, and slips between them, over the pieces of the record that are in motion."""
    phases: list[Phase] = []
    for first, last in runs_in_pieces(moving, series.pieces):
        time = series.time[first : last + 1]
        at = float(time[0])
        end = float(time[-1])
        inside = [own for own in sticks if time[0] <= own[0] and own[1] <= time[-1]]
        bounds = [(at, at, math.inf, math.inf), *inside, (end, end, math.inf, math.inf)]
        slips = [(before[1], own[0], before[3], own[2]) for before, own in pairwise(bounds)]
        spans = [slips[0], *(own for pair in zip(inside, slips[1:], strict=True) for own in pair)]
        firsts = first + np.searchsorted(time, [span[0] for span in spans])
        lasts = first + np.searchsorted(time, [span[1] for span in spans], side="right") - 1
        rows = zip(spans, firsts.tolist(), lasts.tolist(), strict=True)
        for number, ((start, end, start_sd, end_sd), i, j) in enumerate(rows):
            if end > start and j >= i:
                phases.append(Phase("stick" if number % 2 else "slip", start, end, i, j, start_sd, end_sd))
    return tuple(phases)


def runs_in_pieces(mask: Mask, pieces: tuple[slice, ...]) -> Runs:
    """Return first and last sample of every run of True in ``mask`` (n,), each within one piece."""
    return [(piece.start + i, piece.start + j - 1) for piece in pieces for i, j in runs(mask[piece])]
