"""Plateaus of the velocity: where the mass stuck and where it slipped, how fast the belt ran, and the phases between.

A stick is a plateau of the velocity: the acceleration stays near zero for a sixtieth of a cycle or more, at the belt's
speed.  Four rules distinguish it from similar stretches:

- the turning points of a swing are flat for a moment too, but their flat stretch grows fourfold when the tolerance
  does; a plateau hardly grows.  So laws 1 and 2, whose velocity only grazes the belt's, show no stick in the long run;
- rest is not stick: before the belt starts (and after it stops) the count does not move at all;
- sticks share one speed: a flat stretch at another one is left out;
- a belt holds the mass at its speed: where the mass is faster than the belt for longer than it sticks, the flat
  stretches are lulls and turning points of an oscillation, and none of them is a stick.

If the belt has an encoder, all this applies to the motion relative to the belt: a stick is then a plateau of the
relative velocity at zero, however the belt speed varies.  The belt speed is then that of its counts: the mass may creep
against the belt inside a plateau (friction with a ramp).

Corners of a plateau: a landing is sharp, and lies where the acceleration has fallen to half of the slip's last peak; a
break-away is soft (only the jerk jumps), and is found by extrapolating the rise of the acceleration back to zero.
Corners fitted by a method (`processing.stick_slip.smoother`) are used unchanged, with their uncertainties.

Not modelled here: ripple of a belt without an encoder, and velocity steps of a belt joint, which split a stick in two
when they exceed the tolerance.
"""

import math
from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from processing.kalman import white_jerk
from processing.record.motion import BeltMotion, Corner, Motion, Phase, PhaseSegmentation
from processing.record.noise import position_noise
from processing.record.series import Series
from processing.record.setting import is_possible_speed
from processing.record.stretches import moving_samples
from stickslip.compute.arrays import Array, Mask, runs
from stickslip.units import Measured

SAME_SPEED = 0.4  # of the belt's speed: largest difference of a plateau, which a ramp can cause by its half-width
QUARTER = 8  # samples in a quarter of a stick, at least
FEWEST = 8  # sticks that are needed to detect creep
CREEP = 0.02  # of the belt's speed: least loss of the last quarter of a stick; an even belt loses less than 0.001
LEVEL = 1 / 3  # of that loss: largest difference of the first two quarters; 1/2 under friction with a ramp


def common_speed(motion: Motion, plateaus: list[tuple[int, int]]) -> float:
    """Return the common speed of the plateaus, m/s: the mean near the half-sample mode, or NaN."""
    if not plateaus:
        return math.nan
    velocity = np.concatenate([motion.velocity[i : j + 1] for i, j in plateaus])
    error = median_value(np.concatenate([motion.velocity_errors[i : j + 1] for i, j in plateaus]))
    # A long lull between swings must not outweigh the sticks: no plateau counts for more than the usual one.
    usual = int(np.median([j + 1 - i for i, j in plateaus]))
    strides = [max((j + 1 - i) // usual, 1) for i, j in plateaus]
    alike = np.concatenate([motion.velocity[i : j + 1 : by] for (i, j), by in zip(plateaus, strides, strict=True)])
    mode = half_sample_mode(alike[:: max(alike.size // 2**12, 1)])
    near_mode = np.abs(velocity - mode) <= 3 * error
    return float(velocity[near_mode].mean()) if near_mode.any() else mode


def speed_before_creep(velocity: list[Array], window: int, common: float) -> float:
    """Return the speed of the first halves of the sticks where the mass creeps before break-away, else ``common``.

    Paper, rubber and polymers slide ever faster before they break away, and the mean speed of a stick is then below the
    belt's.  Creep is detected in the median speeds of the quarters: the last is slower than the second, and the first
    two differ by far less.  (Under friction with a ramp the speed falls evenly through a stick.)  A quarter must be
    longer than two ``window`` lengths of the smoother, else it contains motion outside the stick.
    """
    sticks = [stick for stick in velocity if stick.size >= 4 * max(2 * window, QUARTER)]
    if len(sticks) < FEWEST:
        return common
    quarters = np.array([_median_quarters(stick) for stick in sticks]) / common
    first, second, _, last = np.median(quarters, axis=0)
    scatter = float(np.median(np.abs(quarters[:, 1] - quarters[:, 3] - (second - last)))) / 0.6745
    if second - last < max(CREEP, 4 * scatter / math.sqrt(len(sticks))) or abs(first - second) > LEVEL * (
        second - last
    ):
        return common
    return float(common * (first + second) / 2)


def _median_quarters(values: Array) -> list[float]:
    """Return the medians of four parts of equal length, to one value."""
    least, more = divmod(values.size, 4)
    edges = [k * least + min(k, more) for k in range(5)]
    return [median_value(values[i:j]) for i, j in pairwise(edges)]


def half_sample_mode(values: Array) -> float:
    """Return the mode of a sample: the shortest interval that holds half of it, halved again until two are left.

    Source: D. R. Bickel and R. Fruehwirth, Comput. Stat. Data Anal. 50 (2006) 3500.
    """
    x = np.sort(values)
    while x.size > 3:
        half = (x.size + 1) // 2
        widths = x[half - 1 :] - x[: x.size - half + 1]
        first = int(np.argmin(widths))
        x = x[first : first + half]
    if x.size == 3:
        x = x[:2] if x[1] - x[0] <= x[2] - x[1] else x[1:]
    return float(x.mean())


def median_value(values: Array) -> float:
    """Return the median; of very many values, that of some spread over them."""
    thinned = values[:: max(values.size // 2**8, 1)].copy()
    thinned.partition(thinned.size // 2)
    return float(thinned[thinned.size // 2])


def reported_speed(stated: float | None, measured: Measured | None, stick_speed: float, stuck: bool) -> float:
    """Return the belt speed to report, m/s; NaN when unknown.

    A speed ``stated`` by a person comes first, then one ``measured`` in the rig's calibration, unless the sticks
    contradict it.
    """
    if stated is not None:
        return stated
    if measured is None or (stuck and not is_possible_speed(measured, stick_speed)):
        return stick_speed if stuck else math.nan
    if stuck and abs(stick_speed - measured.value) <= max(4 * measured.sd, 0.02 * abs(measured.value)):
        return stick_speed
    return measured.value


FAST = 0.25  # of the peak speed of a slip: faster samples belong to it; noise and ringing reach 0.2 on paper
CREEP_SHARE = 0.5  # of a slip's time: a smaller fast part means creep; paper 0.1 to 0.3, the six laws 0.7 to 0.9
SLOW = 0.2  # of the peak speed of the usual slip: slower slips are creep

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
    stick_velocities = [velocity[first:end] for first, end in zip(firsts, ends, strict=True)]
    speeds = np.concatenate(stick_velocities) if stick_velocities else np.empty(0)
    if not speeds.size:
        return math.nan
    level = float(speeds[np.abs(speeds - np.median(speeds)) <= SAME_SPEED * abs(np.median(speeds))].mean())
    return speed_before_creep(stick_velocities, window, level)


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


FLAT = 0.05  # of the largest accelerations (95th percentile): smaller ones count as zero
SHARE = 0.017  # of a cycle: shortest stick; the turning points of a swing are flat for FLAT/pi = 0.016 of it
BROAD = 0.25  # of the window of the smoother: shorter plateaus are not resolved
ROUNDING = 1e-9  # of the fastest speed, gained in a sample: rounding error of a straight line
RESOLVED = 0.15  # of the largest accelerations: five standard errors must be below it, else smooth more
REACH = 8  # times the shortest stick, after a plateau: how long the acceleration may take to rise at a break-away
WIDER = 4.0  # ratio of the second tolerance of the plateau test to the first
PLATEAU = 0.5  # share of the wider stretch within the first tolerance: 1/4 for a swing, near 1 for a plateau


@dataclass(frozen=True)
class PlateauRule:
    """How to find the sticks of a record in its motion."""

    noise: white_jerk.Noise | None  # of the extra smoothing before plateaus are searched; None without one
    tolerance: float  # acceleration that counts as zero, m/s^2
    shortest: float  # shortest stick, s
    speed: float  # common speed of the plateaus, m/s; NaN if none is a stick
    fastest: float  # peak speed of the usual slip relative to the belt, m/s; 0 if slips are few


@dataclass(frozen=True, eq=False)
class _Search:
    """Plateaus, and the criteria for the sticks among them."""

    series: Series
    moving: Mask
    motion: Motion
    search_motion: Motion  # in which plateaus are searched: smoother, or relative to the belt
    mass_motion: Motion  # which determines the speed of sticks
    size: Array  # |a| of the search motion
    plateaus: Runs
    reach: int
    tolerance: float
    stated: float | None
    belt: BeltMotion | None

    def stick_speed(self, common: float) -> float:
        """Return the speed of sticks, m/s, or NaN if no plateau is a stick."""
        return common if self.stated is None or math.isnan(common) else self.stated

    def relative_velocity(self, common: float) -> Array:
        return self.motion.velocity - self.stick_speed(common) if self.belt is None else self.belt.motion.velocity

    def find_sticks(self, common: float) -> list[Stick]:
        """Return the plateaus at the belt's speed, with their corners."""
        sticks: list[Stick] = []
        for run in self.plateaus:
            speed = median_value(self.search_motion.velocity[run[0] : run[1] + 1])
            wanted_speed = reference = self.stick_speed(common)
            if self.belt is not None:  # relative to the belt, a stick has no speed
                wanted_speed, reference = 0.0 * wanted_speed, median_value(self.belt.velocity[run[0] : run[1] + 1])
            if abs(speed - wanted_speed) <= SAME_SPEED * abs(reference):
                start, end = find_plateau_corners(
                    run, self.series, self.size, self.search_motion.window, self.reach, self.tolerance, self.moving
                )
                sticks.append((start, end, math.inf, math.inf))
        return sticks


def learn(
    series: Series, motion: Motion, stated: float | None = None, belt: BeltMotion | None = None
) -> tuple[PlateauRule, tuple[Phase, ...], float]:
    """Return the rule of a record, its sticks and slips, and the speed of the belt from the sticks, m/s, or NaN.

    A ``stated`` belt speed, m/s, takes precedence over the motion of a ``belt`` with an encoder: only sticks at that
    speed are found.
    """
    belt = None if stated is not None else belt
    moving = in_motion(series)
    search_motion, noise, tolerance = _smooth_until_resolved(*_choose_motion(series, motion, belt), moving)
    rule = PlateauRule(noise, tolerance, _shortest_stick(series, search_motion, moving), math.nan, 0.0)
    search = _find_plateaus(series, motion, search_motion, rule, moving, stated, belt)
    common = common_speed(search.mass_motion, search.plateaus)
    sticks, relative_velocity = search.find_sticks(common), search.relative_velocity(common)
    rule = replace(rule, speed=common, fastest=median_peak_speed(series, sticks, relative_velocity))
    sticks = extend_over_creep(series, sticks, relative_velocity, rule.fastest)
    if sticks and _is_overtaken(search, common, sticks):
        rule, sticks = replace(rule, speed=math.nan), []
    phases, velocity = lay_out_phases(series, moving, sticks), search.mass_motion.velocity
    stick_velocities = [velocity[phase.first : phase.last + 1] for phase in phases if phase.kind == "stick"]
    return rule, phases, speed_before_creep(stick_velocities, motion.window, rule.speed)


def segment(
    series: Series,
    motion: Motion,
    rule: PlateauRule,
    level: float,
    measured: Measured | None = None,
    stated: float | None = None,
    belt: BeltMotion | None = None,
) -> PhaseSegmentation:
    """Find sticks, slips and belt speed in a record or a block of it, with ``rule`` and ``level`` from `learn`.

    ``measured`` is the belt speed in the rig's calibration.
    """
    belt = None if stated is not None else belt
    moving = in_motion(series)
    source, search_motion = _choose_motion(series, motion, belt)
    search_motion = search_motion if rule.noise is None else white_jerk.smooth(source, rule.noise)
    search = _find_plateaus(series, motion, search_motion, rule, moving, stated, belt)
    sticks = extend_over_creep(
        series, search.find_sticks(rule.speed), search.relative_velocity(rule.speed), rule.fastest
    )
    phases = lay_out_phases(series, moving, sticks)
    speed = reported_speed(stated, measured, level, bool(sticks)) if belt is None else belt.speed(moving)
    return PhaseSegmentation(speed, phases, rule.speed)


def _choose_motion(series: Series, motion: Motion, belt: BeltMotion | None) -> tuple[Series, Motion]:
    """Return the motion in which plateaus are searched, and its record: relative to the belt, if it has an encoder."""
    return (series, motion) if belt is None else (belt.series, belt.motion)


def _find_plateaus(
    series: Series,
    motion: Motion,
    search_motion: Motion,
    rule: PlateauRule,
    moving: Mask,
    stated: float | None,
    belt: BeltMotion | None,
) -> _Search:
    size = _replace_ends(search_motion, series.pieces)
    flat, wide = ((size <= factor * rule.tolerance) & moving for factor in (1.0, WIDER))
    least = max(round(rule.shortest / series.interval), 3)
    mass_motion = search_motion if belt is None else motion
    candidates = _join_runs(runs_in_pieces(flat, series.pieces), runs_in_pieces(wide, series.pieces))
    plateaus = [
        run
        for run, around in candidates
        if _is_plateau(run, around, least, search_motion.window) and _moves(run, mass_motion)
    ]
    return _Search(
        series, moving, motion, search_motion, mass_motion, size, plateaus, REACH * least, rule.tolerance, stated, belt
    )


def _is_overtaken(search: _Search, common: float, sticks: Sequence[Stick]) -> bool:
    """Return whether the mass is faster than the belt for longer than it sticks, except for noise within sticks.

    Friction brakes a mass that overtakes the belt, so after a landing it does so for a small part of a stick only.  An
    oscillation is faster most of the time, whatever the speed at its lulls and turning points.
    """
    time, search_motion, belt = search.series.time, search.search_motion, search.belt
    stuck = np.zeros(time.size, np.bool_)
    for start, end, *_ in sticks:
        stuck[np.searchsorted(time, start) : np.searchsorted(time, end, side="right")] = True
    level = search.stick_speed(common)
    # For a belt with an encoder, the motion is already relative to it.
    speed, ahead = (level, search_motion.velocity - level) if belt is None else (belt.velocity, search_motion.velocity)
    faster = search.moving & ~stuck & (np.sign(speed) * ahead > SAME_SPEED * np.abs(speed))
    return bool(np.count_nonzero(faster) > np.count_nonzero(stuck))


def in_motion(series: Series) -> Mask:
    """Return a mask that excludes rest at the beginning and at the end of the record (`slack_at_rest`)."""
    if series.moving is not None:
        begin, end = series.moving
        return np.asarray((series.time >= begin) & (series.time <= end))
    x, n = series.position, series.time.size
    slack = slack_at_rest(series.pitch, float(np.ptp(x)), 0.0 if series.pitch else position_noise(series))
    first, last = moving_samples(x.__getitem__, n, slack)
    mask = np.zeros(n, bool)
    mask[first : last + 1] = True
    return mask


def slack_at_rest(pitch: float, travel: float, noise: float) -> float:
    """Return by how much positions at rest may differ, m, from pitch, travel and noise of the record, m."""
    return 2.5 * pitch if pitch else max(1e-3 * travel, 5 * noise)


def _peak_acceleration(motion: Motion, moving: Mask) -> float:
    thinned = _thin(motion.acceleration, moving)
    return float(np.percentile(np.abs(thinned), 95)) if thinned.size else 0.0


def _thin(values: Array, moving: Mask) -> Array:
    """Return the values in motion, thinned if they are very many."""
    stride = max(values.size // 2**14, 1)
    return np.asarray(values[::stride][moving[::stride]])


def _plateau_noise(motion: Motion, moving: Mask) -> float:
    """Return the scatter of the acceleration of a plateau, m/s^2."""
    thinned = _thin(motion.acceleration_errors, moving)
    if not thinned.size:
        return 0.0
    # The error of a smoother also allows for motion, which a plateau does not have.
    share = math.sqrt(1 / 6) if motion.method == "rts" else 1.0
    return share * float(np.median(thinned))


def _shortest_stick(series: Series, search_motion: Motion, moving: Mask) -> float:
    """Return how long a plateau must last to be a stick, s, from the number of fast swings in the faster direction."""
    forth, back = np.percentile(search_motion.velocity[moving], (99, 1)) if moving.any() else (0.0, 0.0)
    speed = search_motion.velocity if forth > -back else -search_motion.velocity
    swings = max(len(runs(moving & (speed > 0.5 * max(forth, -back)))), 1)
    return series.interval * max(SHARE * float(moving.sum()) / swings, BROAD * search_motion.window)


def _smooth_until_resolved(
    series: Series, motion: Motion, moving: Mask
) -> tuple[Motion, white_jerk.Noise | None, float]:
    """Return a motion whose acceleration is clear enough of noise to show plateaus, its noise, and the tolerance.

    If ``motion`` is too rough for that, the record is smoothed again, only for the search, by
    `processing.kalman.white_jerk` with ever less jerk; otherwise the noise levels are None.
    """
    search_motion = motion
    longest = max(piece.stop - piece.start for piece in series.pieces) // 8
    longest -= 1 - longest % 2  # windows are odd
    noise = None
    for attempt in range(7):
        scatter, peak = _plateau_noise(search_motion, moving), _peak_acceleration(search_motion, moving)
        if search_motion.order >= 2 and (
            5 * scatter <= RESOLVED * peak or search_motion.window * 3 // 2 > longest or attempt == 6
        ):
            break
        if noise is None:
            noise = white_jerk.fit(series)
        if search_motion.order >= 2:
            while white_jerk.equivalent_window(noise.rho(series.interval), longest) < min(
                search_motion.window * 3 // 2, longest
            ):
                noise = white_jerk.Noise(noise.jerk / 2, noise.reading)
        search_motion = white_jerk.smooth(series, noise)
    rounding = ROUNDING * float(np.abs(search_motion.velocity).max()) / series.interval
    return search_motion, noise, max(FLAT * peak, 5 * scatter, rounding)


def _replace_ends(motion: Motion, pieces: tuple[slice, ...]) -> Array:
    """Return |a|, m/s^2, with the noisy one-sided fits at the ends of a piece replaced by the nearest centred fit."""
    size = np.abs(motion.acceleration)
    half = motion.window // 2
    for piece in pieces:
        if piece.stop - piece.start > 2 * half:
            size[piece.start : piece.start + half] = size[piece.start + half]
            size[piece.stop - half : piece.stop] = size[piece.stop - half - 1]
    return size


def _join_runs(flat: Runs, wide: Runs) -> list[tuple[tuple[int, int], tuple[int, int]]]:
    """Return, for each wide stretch with flat ones, the span from its first flat sample to its last, and the stretch.

    A burst of noise inside a stick exceeds the narrow tolerance but not the wide one.
    """
    joined = []
    starts = [run[0] for run in flat]
    for around in wide:
        inside = flat[bisect_left(starts, around[0]) : bisect_right(starts, around[1])]
        if inside:
            joined.append(((inside[0][0], inside[-1][1]), around))
    return joined


def _is_plateau(run: tuple[int, int], around: tuple[int, int], least: int, window: int) -> bool:
    length = run[1] - run[0] + 1
    # The filter blurs a sharp landing over half a window, which lengthens the wider stretch.
    return length >= least and length >= PLATEAU * (around[1] - around[0] + 1 - window // 4)


def _moves(run: tuple[int, int], motion: Motion) -> bool:
    """Return whether the mass moves within the run, by four standard errors of its mean speed.

    A run of several smoothing windows has as many independent speeds.
    """
    samples = slice(run[0], run[1] + 1)
    share = min(motion.window / (run[1] + 1 - run[0]), 1.0)
    return abs(median_value(motion.velocity[samples])) > 4 * math.sqrt(share) * median_value(
        motion.velocity_errors[samples]
    )
