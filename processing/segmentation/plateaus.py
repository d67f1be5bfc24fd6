"""Where the mass stuck and where it slipped, and how fast the belt ran.

A stick is a plateau of the velocity: the acceleration stays near zero for 30 ms or more, at the belt's speed.
Three rules tell it from what only looks like one:

- the turning points of a swing are flat for a moment too, but their flat stretch grows fourfold when the tolerance
  does; a plateau hardly grows.  So laws 1 and 2, whose velocity only grazes the belt's, show no stick in the long run;
- rest is not stick: before the belt starts (and after it stops) the count does not move at all;
- sticks share one speed: a flat stretch at another one is left out.

The mass may creep against the belt inside a plateau (friction with a ramp): the plateau's speed is then not the
belt's, and where the belt's own was measured, that one is reported.

Where the belt has an encoder of its own, all this is asked of the mass as the belt sees it: a stick is then a plateau
of their relative velocity at zero, however the belt swings or slows, and its speed is what its counts say.

Corners: a landing is sharp, and lies where the acceleration has fallen to half of the slip's last peak; an onset is
soft (only the jerk jumps), and is found by carrying the acceleration's rise back to zero.  A method that fits corners
itself (`processing.segmentation.smoother`) is taken at its word, uncertainties included.  Not modelled here: ripple of
a belt that is not counted, and kicks of a belt joint, which split a stick in two when they exceed the tolerance.
"""

import math
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from daq.compute.arrays import Array, runs
from daq.errors import InputError
from daq.runfile.rig import Measured
from processing.belt_motion import Belt
from processing.kalman import white_jerk
from processing.methods.differences import reading_error
from processing.methods.registry import Corner, Motion
from processing.record.kinematics import Phase
from processing.record.series import Series

Runs = list[tuple[int, int]]  # first and last sample, both included
Stick = tuple[float, float, float, float]  # start, end, and their standard deviations, s

LEAST_STICK = 0.03  # s
FLAT = 0.05  # of the largest accelerations: what counts as none
ROUNDING = 1e-9  # of the fastest speed, gained in a sample: what rounded numbers make of a straight line
CLEAR = 0.15  # of the largest accelerations: five standard errors must stay below it
WIDER = 4.0  # the second tolerance of the plateau test
PLATEAU = 0.5  # share of the wider stretch that must be flat already: 1/4 for a swing, near 1 for a plateau
SAME_SPEED = 0.4  # of the belt's speed: a ramp's creep is allowed for


@dataclass(frozen=True, eq=False)
class Found:
    """Belt speed (m/s, NaN when unknown), stick mask (n,), phases in order of time, plateaus' own speed (or NaN)."""

    belt_speed: float
    stick: NDArray[np.bool_]
    phases: tuple[Phase, ...]
    plateau_speed: float


def find(
    series: Series,
    motion: Motion,
    measured: Measured | None = None,
    belt_speed: float | str = "auto",
    belt: Belt | None = None,
) -> Found:
    """Find sticks, slips and belt speed.

    Parameters
    ----------
    series, motion
        The record and the motion made from it.
    measured : Measured, optional
        The belt speed as the rig's calibration has it.
    belt_speed : float or "auto"
        m/s, signed: a number settles it, and sticks are looked for at that speed alone.
    belt : Belt, optional
        The belt's own motion, where it was counted; a number in ``belt_speed`` goes before it.

    Raises
    ------
    InputError
        When ``belt_speed`` is neither "auto" nor a finite number.
    """
    stated = given(belt_speed)
    if stated is not None:
        belt = None
    moving = in_motion(series)
    if motion.corners:
        cut = _cut_at_corners(series, motion, motion.corners, moving, stated, measured)
        return cut if belt is None else replace(cut, belt_speed=belt.speed(moving))
    seen, tolerance = _clear(series, motion, moving) if belt is None else _clear(belt.series, belt.motion, moving)
    rides = seen if belt is None else motion
    size = _centred(seen, series.pieces)
    flat = (size <= tolerance) & moving
    wide = (size <= WIDER * tolerance) & moving
    least = max(round(LEAST_STICK / series.interval), 3)
    candidates = _joined(_runs(flat, series.pieces), _runs(wide, series.pieces))
    plateaus = [
        run for run, around in candidates if _is_plateau(run, around, least, seen.window) and _travels(run, rides)
    ]
    common = _level(rides, plateaus)
    level = stated if stated is not None else common
    sticks: list[Stick] = []
    for run in plateaus:
        speed = _middle(seen.velocity[run[0] : run[1] + 1])
        # Seen from the belt, a mass that rides on it stands.
        aim, slack = (level, level) if belt is None else (0.0, _middle(belt.velocity[run[0] : run[1] + 1]))
        if abs(speed - aim) <= SAME_SPEED * abs(slack):
            start, end = _corners(run, series, size, seen.window, tolerance, moving)
            sticks.append((start, end, math.inf, math.inf))
    phases, stick = _phases(series, moving, sticks)
    speed = _speed(stated, measured, level, bool(sticks)) if belt is None else belt.speed(moving)
    return Found(speed, stick, phases, common)


def _cut_at_corners(
    series: Series,
    motion: Motion,
    corners: tuple[Corner, ...],
    moving: NDArray[np.bool_],
    stated: float | None,
    measured: Measured | None,
) -> Found:
    """Lay out the phases between corners that a method has fitted, with the uncertainties of their times."""
    moving = moving.copy()
    sticks: list[Stick] = []
    time = series.time
    for piece in series.pieces:
        begin, end = float(time[piece.start]), float(time[piece.stop - 1])
        inside = [corner for corner in corners if begin <= corner.time <= end]
        if inside and inside[0].what == "start":
            moving[piece.start : np.searchsorted(time, inside[0].time)] = False
        if inside and inside[-1].what == "stop":
            moving[np.searchsorted(time, inside[-1].time) : piece.stop] = False
        landed = Corner(begin, math.inf, "land")
        stuck = bool(inside) and inside[0].what == "leave"
        for corner in inside:
            if corner.what == "land":
                landed, stuck = corner, True
            elif stuck:
                sticks.append((landed.time, corner.time, landed.sd, corner.sd))
                stuck = False
        if stuck:
            sticks.append((landed.time, end, landed.sd, math.inf))
    velocity = [motion.velocity[(time >= stick[0]) & (time <= stick[1])] for stick in sticks]
    held = np.concatenate(velocity) if velocity else np.empty(0)
    level = math.nan
    if held.size:
        level = float(held[np.abs(held - np.median(held)) <= SAME_SPEED * abs(np.median(held))].mean())
    phases, stick = _phases(series, moving, sticks)
    return Found(_speed(stated, measured, level, bool(sticks)), stick, phases, level)


def given(belt_speed: float | str) -> float | None:
    """Return the belt speed a person states, m/s, or None for "auto"; InputError unless it is a finite number."""
    if belt_speed == "auto":
        return None
    try:
        value = float(belt_speed)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(f"belt speed is {belt_speed!r}", "--belt-speed", "give auto, or a speed in m/s with its sign")
    return value


def in_motion(series: Series) -> NDArray[np.bool_]:
    """Return a mask that leaves out rest at the beginning and at the end of the record.

    Rest lasts until the position has left its first value by more than two and a half counts (without counts: by a
    thousandth of the record's travel, or five reading errors where that is more).
    """
    x = series.position
    slack = 2.5 * series.pitch if series.pitch else max(1e-3 * float(np.ptp(x)), 5 * reading_error(series))
    away = np.flatnonzero(np.abs(x - x[0]) > slack)
    back = np.flatnonzero(np.abs(x - x[-1]) > slack)
    mask = np.zeros(x.size, bool)
    if away.size and back.size:
        mask[away[0] : back[-1] + 1] = True
        if away[0] * series.interval < LEAST_STICK:
            mask[: away[0]] = True
        if (x.size - 1 - back[-1]) * series.interval < LEAST_STICK:
            mask[back[-1] :] = True
    return mask


def _peak(motion: Motion, moving: NDArray[np.bool_]) -> float:
    some = _some(motion.acceleration, moving)
    return float(np.percentile(np.abs(some), 95)) if some.size else 0.0


def _some(values: Array, moving: NDArray[np.bool_]) -> Array:
    """Return the values in motion; of very many, some."""
    stride = max(values.size // 2**14, 1)
    return np.asarray(values[::stride][moving[::stride]])


def _noise(motion: Motion, moving: NDArray[np.bool_]) -> float:
    """Return how much the acceleration of a plateau scatters, m/s^2."""
    some = _some(motion.acceleration_errors, moving)
    if not some.size:
        return 0.0
    # A smoother's error also allows for motion that a plateau does not have.
    share = math.sqrt(1 / 6) if motion.method == "rts" else 1.0
    return share * float(np.median(some))


def _clear(series: Series, motion: Motion, moving: NDArray[np.bool_]) -> tuple[Motion, float]:
    """Return a motion whose acceleration is clear enough of noise to show a plateau, and what counts as none, m/s^2.

    What is best for the velocity can be too rough for that, and differences never show one: then the record is
    smoothed again, for the search alone, by `processing.kalman.white_jerk` with ever less jerk.
    """
    seen = motion
    longest = max(own.stop - own.start for own in series.pieces) // 8
    noise = None
    for attempt in range(7):
        scatter, peak = _noise(seen, moving), _peak(seen, moving)
        if seen.order >= 2 and (5 * scatter <= CLEAR * peak or seen.window * 3 // 2 > longest or attempt == 6):
            break
        if noise is None:
            noise = white_jerk.fit(series)
        if seen.order >= 2:
            while white_jerk.equivalent_window(noise.rho(series.interval), longest) < min(
                seen.window * 3 // 2, longest
            ):
                noise = white_jerk.Noise(noise.jerk / 2, noise.reading)
        seen = white_jerk.smooth(series, noise)
    rounding = ROUNDING * float(np.abs(seen.velocity).max()) / series.interval
    return seen, max(FLAT * peak, 5 * scatter, rounding)


def _centred(motion: Motion, pieces: tuple[slice, ...]) -> Array:
    """Return |a|, m/s^2, with the noisy one-sided fits at the ends of a piece replaced by the nearest centred one."""
    size = np.abs(motion.acceleration)
    half = motion.window // 2
    for piece in pieces:
        if piece.stop - piece.start > 2 * half:
            size[piece.start : piece.start + half] = size[piece.start + half]
            size[piece.stop - half : piece.stop] = size[piece.stop - half - 1]
    return size


def _runs(mask: NDArray[np.bool_], pieces: tuple[slice, ...]) -> Runs:
    return [(p.start + first, p.start + end - 1) for p in pieces for first, end in runs(mask[p])]


def _joined(flat: Runs, wide: Runs) -> list[tuple[tuple[int, int], tuple[int, int]]]:
    """Return each wider stretch that holds flat ones, with the span from its first flat sample to its last.

    A burst of noise inside a stick leaves the narrow tolerance but not the wide one.
    """
    found = []
    for around in wide:
        inside = [run for run in flat if around[0] <= run[0] and run[1] <= around[1]]
        if inside:
            found.append(((inside[0][0], inside[-1][1]), around))
    return found


def _is_plateau(run: tuple[int, int], around: tuple[int, int], least: int, window: int) -> bool:
    length = run[1] - run[0] + 1
    # The filter smears a sharp landing over half a window: that much of the wider stretch is the filter's own.
    return length >= least and length >= PLATEAU * (around[1] - around[0] + 1 - window // 4)


def _travels(run: tuple[int, int], motion: Motion) -> bool:
    """Tell whether the mass moves at all within the run, by four standard errors of its speed."""
    own = slice(run[0], run[1] + 1)
    return abs(_middle(motion.velocity[own])) > 4 * _middle(motion.velocity_errors[own])


def _middle(values: Array) -> float:
    """Return the middle one of the values; of very many, of some spread over them."""
    some = values[:: max(values.size // 2**8, 1)]
    return float(np.partition(some, some.size // 2)[some.size // 2])


def _level(motion: Motion, plateaus: Runs) -> float:
    """Return the plateaus' common speed, m/s: the half-sample mode, then the mean of what lies about it; else NaN."""
    if not plateaus:
        return math.nan
    velocity = np.concatenate([motion.velocity[i : j + 1] for i, j in plateaus])
    error = _middle(np.concatenate([motion.velocity_errors[i : j + 1] for i, j in plateaus]))
    mode = half_sample_mode(velocity[:: max(velocity.size // 2**12, 1)])
    about = np.abs(velocity - mode) <= 3 * error
    return float(velocity[about].mean()) if about.any() else mode


def half_sample_mode(values: Array) -> float:
    """Return the mode of a sample: the shortest interval that holds half of it, halved again until two are left.

    Source: D. R. Bickel and R. Fruehwirth, Comput. Stat. Data Anal. 50 (2006) 3500.
    """
    x = np.sort(values)
    while x.size > 3:
        half = (x.size + 1) // 2
        widths = x[half - 1 :] - x[: x.size - half + 1]
        at = int(np.argmin(widths))
        x = x[at : at + half]
    if x.size == 3:
        x = x[:2] if x[1] - x[0] <= x[2] - x[1] else x[1:]
    return float(x.mean())


def _corners(
    run: tuple[int, int], series: Series, size: Array, window: int, tolerance: float, moving: NDArray[np.bool_]
) -> tuple[float, float]:
    """Return start and end of a stick, s, between samples, from the size of the acceleration."""
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
    high = min(last + max(window, round(0.25 / series.interval)), piece.stop - 1)
    beyond = np.flatnonzero(size[last + 1 : high + 1] > 2 * tolerance)
    if last + 1 < piece.stop and beyond.size:
        one = _crossing(time, size, last + 1, tolerance)
        two = _crossing(time, size, last + 1 + int(beyond[0]), 2 * tolerance)
        end = max(2 * one - two, 0.5 * (start + end))
    return start, end


def _crossing(time: Array, size: Array, at: int, level: float) -> float:
    """Return the time between samples at-1 and at where ``size`` passes ``level``."""
    before, after = size[at - 1], size[at]
    share = (level - before) / (after - before) if after != before else 1.0
    return float(time[at - 1] + min(max(share, 0.0), 1.0) * (time[at] - time[at - 1]))


def _phases(
    series: Series, moving: NDArray[np.bool_], sticks: list[Stick]
) -> tuple[tuple[Phase, ...], NDArray[np.bool_]]:
    """Lay out sticks, and slips between them, over the pieces of the record that are in motion."""
    stick = np.zeros(series.time.size, bool)
    phases: list[Phase] = []
    for first, last in _runs(moving, series.pieces):
        time = series.time[first : last + 1]
        at = float(time[0])
        end = float(time[-1])
        inside = [own for own in sticks if time[0] <= own[0] and own[1] <= time[-1]]
        bounds = [(at, at, math.inf, math.inf), *inside, (end, end, math.inf, math.inf)]
        for before, own in pairwise(bounds):
            phases += _phase("slip", (before[1], own[0], before[3], own[2]), series.time, first, last)
            if own is not bounds[-1]:
                phases += _phase("stick", own, series.time, first, last)
    for phase in phases:
        if phase.kind == "stick":
            stick[phase.first : phase.last + 1] = True
    return tuple(phases), stick


def _phase(kind: str, span: Stick, time: Array, first: int, last: int) -> list[Phase]:
    start, end, start_sd, end_sd = span
    i = max(int(np.searchsorted(time, start)), first)
    j = min(int(np.searchsorted(time, end, side="right")) - 1, last)
    if end <= start or j < i:
        return []
    return [Phase("stick" if kind == "stick" else "slip", start, end, i, j, start_sd, end_sd)]


def _speed(given: float | None, measured: Measured | None, level: float, stuck: bool) -> float:
    if given is not None:
        return given
    if measured is None:
        return level if stuck else math.nan
    if stuck and abs(level - measured.value) <= max(4 * measured.sd, 0.02 * abs(measured.value)):
        return level
    return measured.value
