"""Plateaus of the velocity: where the mass stuck and where it slipped, and how fast the belt ran.

A stick is a plateau of the velocity: the acceleration stays near zero for a sixtieth of a cycle or more, at the belt's
speed.
Four rules distinguish it from similar stretches:

- the turning points of a swing are flat for a moment too, but their flat stretch grows fourfold when the tolerance
  does; a plateau hardly grows.  So laws 1 and 2, whose velocity only grazes the belt's, show no stick in the long run;
- rest is not stick: before the belt starts (and after it stops) the count does not move at all;
- sticks share one speed: a flat stretch at another one is left out;
- a belt holds the mass at its speed: where the mass is faster than the belt for longer than it sticks, the flat
  stretches are lulls and turning points of an oscillation, and none of them is a stick.

If the belt has an encoder, all this applies to the motion relative to the belt: a stick is then a plateau of the
relative velocity at zero, however the belt speed varies, and the belt speed is that of its counts.

Not modelled here: ripple of a belt without an encoder, and velocity steps of a belt joint, which split a stick in two
when they exceed the tolerance.
"""

import math
from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from processing.kalman import white_jerk
from processing.record.motion import BeltMotion, Motion, Phase, PhaseSegmentation
from processing.record.noise import position_noise
from processing.record.series import Series
from processing.record.stretches import moving_samples
from processing.segmentation.belt_speed import (
    SAME_SPEED,
    common_speed,
    median_value,
    reported_speed,
    speed_before_creep,
)
from processing.segmentation.phase_layout import (
    Runs,
    Stick,
    extend_over_creep,
    find_plateau_corners,
    lay_out_phases,
    median_peak_speed,
    runs_in_pieces,
)
from stickslip.compute.arrays import Array, Mask, runs
from stickslip.units import Measured

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
) -> tuple[PlateauRule, float]:
    """Return the rule of `learn_phases`, and the speed of the belt from the sticks, m/s, or NaN."""
    rule, phases, mass_motion = learn_phases(series, motion, stated, belt)
    stick_velocities = [mass_motion.velocity[phase.first : phase.last + 1] for phase in phases if phase.kind == "stick"]
    return rule, speed_before_creep(stick_velocities, motion.window, rule.speed)


def learn_phases(
    series: Series, motion: Motion, stated: float | None = None, belt: BeltMotion | None = None
) -> tuple[PlateauRule, tuple[Phase, ...], Motion]:
    """Return the rule of a record, its sticks and slips, and the motion of the mass that determines the stick speed.

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
        return replace(rule, speed=math.nan), lay_out_phases(series, moving, []), search.mass_motion
    return rule, lay_out_phases(series, moving, sticks), search.mass_motion


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
