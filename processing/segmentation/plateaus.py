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

Where the belt has an encoder of its own, all this applies to the motion relative to the belt: a stick is then a plateau
of the relative velocity at zero, however the belt speed varies, and the belt speed is that of its counts.

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
    corners_of_plateau,
    phases_from_sticks,
    runs_in_pieces,
    usual_fastest,
    without_creep,
)
from stickslip.compute.arrays import Array, Mask, runs
from stickslip.units import Measured

# Of the largest accelerations (95th percentile): what counts as none.  With half of it 26 records are smoothed alike;
# with twice, parameters move by up to 0.7 standard errors.
FLAT = 0.05
# Of a cycle: shorter plateaus are no sticks.  The turning points of a swing are flat for FLAT/pi = 0.016 of it.
SHARE = 0.017
BROAD = 0.25  # of the window of the smoother: what is flat for less is not resolved
ROUNDING = 1e-9  # of the fastest speed, gained in a sample: what rounded numbers make of a straight line
# Of the largest accelerations: five standard errors must stay below it, else smooth more.  With half of it parameters
# move by up to 0.6 standard errors on 26 records; with twice, a true law of one does not describe it.
RESOLVED = 0.15
REACH = 8  # times the shortest stick, behind a plateau: how long the acceleration may take to rise at a break-away
WIDER = 4.0  # the second tolerance of the plateau test
PLATEAU = 0.5  # share of the wider stretch that must be flat already: 1/4 for a swing, near 1 for a plateau


@dataclass(frozen=True)
class PlateauRule:
    """How the sticks of a record show in a motion made from it."""

    # of the smoother motion in which plateaus are looked for; None: in the motion itself
    noise: white_jerk.Noise | None
    tolerance: float  # what counts as no acceleration, m/s^2
    shortest: float  # plateau that is a stick, s
    speed: float  # common speed of the plateaus, m/s; NaN where none is a stick
    fastest: float  # speed relative to the belt that the usual slip reaches, m/s; 0: there is no usual one


@dataclass(frozen=True, eq=False)
class _Search:
    """Plateaus, first and last sample each, of a motion ``seen``, and what the sticks among them are told by.

    ``size`` is |a| of the motion, ``rides`` the motion of the mass, ``own`` that whose corners are looked for.
    """

    series: Series
    moving: Mask
    own: Motion
    seen: Motion
    rides: Motion
    size: Array
    plateaus: Runs
    reach: int
    tolerance: float
    stated: float | None
    belt: BeltMotion | None

    def aim(self, common: float) -> float:
        """Return the speed that sticks have, m/s, or NaN where no plateau is one."""
        return common if self.stated is None or math.isnan(common) else self.stated

    def apart(self, common: float) -> Array:
        """Return the velocity relative to the belt, m/s, (n,)."""
        return self.own.velocity - self.aim(common) if self.belt is None else self.belt.motion.velocity

    def sticks(self, common: float) -> list[Stick]:
        """Return the plateaus at the belt's speed, with their corners."""
        found: list[Stick] = []
        for run in self.plateaus:
            speed = median_value(self.seen.velocity[run[0] : run[1] + 1])
            aim = slack = self.aim(common)
            if self.belt is not None:  # relative to the belt, a stick has no speed
                aim, slack = 0.0 * aim, median_value(self.belt.velocity[run[0] : run[1] + 1])
            if abs(speed - aim) <= SAME_SPEED * abs(slack):
                start, end = corners_of_plateau(
                    run, self.series, self.size, self.seen.window, self.reach, self.tolerance, self.moving
                )
                found.append((start, end, math.inf, math.inf))
        return found


def learn(
    series: Series, motion: Motion, stated: float | None = None, belt: BeltMotion | None = None
) -> tuple[PlateauRule, float]:
    """Return the rule of a record, and the speed of its belt by its sticks, m/s, NaN without one.

    The parameters are those of `learn_phases`.
    """
    rule, phases, rides = learn_phases(series, motion, stated, belt)
    held = [rides.velocity[phase.first : phase.last + 1] for phase in phases if phase.kind == "stick"]
    return rule, speed_before_creep(held, motion.window, rule.speed)


def learn_phases(
    series: Series, motion: Motion, stated: float | None = None, belt: BeltMotion | None = None
) -> tuple[PlateauRule, tuple[Phase, ...], Motion]:
    """Return the rule of a record, its sticks and slips, and the motion of the mass that shows its speed in sticks.

    series, motion: The record and the motion made from it.
    stated: Belt speed that a person stated, m/s, signed: sticks are looked for at that speed alone.
    belt: The belt's own motion, where it has an encoder; ``stated`` takes precedence over it.
    """
    belt = None if stated is not None else belt
    moving = in_motion(series)
    seen, noise, tolerance = _smooth_until_resolved(*_source(series, motion, belt), moving)
    rule = PlateauRule(noise, tolerance, _shortest_stick(series, seen, moving), math.nan, 0.0)
    search = _searched(series, motion, seen, rule, moving, stated, belt)
    common = common_speed(search.rides, search.plateaus)
    sticks, apart = search.sticks(common), search.apart(common)
    rule = replace(rule, speed=common, fastest=usual_fastest(series, sticks, apart))
    sticks = without_creep(series, sticks, apart, rule.fastest)
    if sticks and _is_overtaken(search, common, sticks):
        return replace(rule, speed=math.nan), phases_from_sticks(series, moving, []), search.rides
    return rule, phases_from_sticks(series, moving, sticks), search.rides


def segment(
    series: Series,
    motion: Motion,
    rule: PlateauRule,
    level: float,
    measured: Measured | None = None,
    stated: float | None = None,
    belt: BeltMotion | None = None,
) -> PhaseSegmentation:
    """Find sticks, slips and belt speed in a record or a block of it.

    series, motion, stated, belt: As `learn` takes them.
    rule, level: What `learn` returned.
    measured: The belt speed as the rig's calibration has it.
    """
    belt = None if stated is not None else belt
    moving = in_motion(series)
    source, seen = _source(series, motion, belt)
    seen = seen if rule.noise is None else white_jerk.smooth(source, rule.noise)
    search = _searched(series, motion, seen, rule, moving, stated, belt)
    sticks = without_creep(series, search.sticks(rule.speed), search.apart(rule.speed), rule.fastest)
    phases = phases_from_sticks(series, moving, sticks)
    speed = reported_speed(stated, measured, level, bool(sticks)) if belt is None else belt.speed(moving)
    return PhaseSegmentation(speed, phases, rule.speed)


def _source(series: Series, motion: Motion, belt: BeltMotion | None) -> tuple[Series, Motion]:
    """Return the motion in which plateaus are looked for, and its record: relative to the belt, if that is known."""
    return (series, motion) if belt is None else (belt.series, belt.motion)


def _searched(
    series: Series,
    motion: Motion,
    seen: Motion,
    rule: PlateauRule,
    moving: Mask,
    stated: float | None,
    belt: BeltMotion | None,
) -> _Search:
    """Return the plateaus of the motion ``seen``."""
    size = _centred(seen, series.pieces)
    flat, wide = ((size <= factor * rule.tolerance) & moving for factor in (1.0, WIDER))
    least = max(round(rule.shortest / series.interval), 3)
    rides = seen if belt is None else motion
    candidates = _joined(runs_in_pieces(flat, series.pieces), runs_in_pieces(wide, series.pieces))
    found = [run for run, around in candidates if _is_plateau(run, around, least, seen.window) and _travels(run, rides)]
    return _Search(series, moving, motion, seen, rides, size, found, REACH * least, rule.tolerance, stated, belt)


def _is_overtaken(search: _Search, common: float, sticks: Sequence[Stick]) -> bool:
    """Return whether the mass is faster than the belt for longer than it sticks, noise within the sticks left out.

    Friction brakes what overtakes the belt: after a landing the mass does so for a small part of a stick.  A swing of
    an oscillation is faster for most of its way, whatever speed its lulls and turning points have.
    """
    time, seen, belt = search.series.time, search.seen, search.belt
    stuck = np.zeros(time.size, np.bool_)
    for start, end, *_ in sticks:
        stuck[np.searchsorted(time, start) : np.searchsorted(time, end, side="right")] = True
    level = search.aim(common)
    # Relative to a belt with an encoder, `seen` is the motion already.
    speed, ahead = (level, seen.velocity - level) if belt is None else (belt.velocity, seen.velocity)
    faster = search.moving & ~stuck & (np.sign(speed) * ahead > SAME_SPEED * np.abs(speed))
    return bool(np.count_nonzero(faster) > np.count_nonzero(stuck))


def in_motion(series: Series) -> Mask:
    """Return a mask that leaves out rest at the beginning and at the end of the record.

    Rest lasts until the position has left its first value by more than two and a half counts (without counts: by a
    thousandth of the record's travel, or five standard deviations of a position where that is more).
    """
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
    """Return what positions at rest may differ by, m, from the pitch, the record's travel and its noise, all in m."""
    return 2.5 * pitch if pitch else max(1e-3 * travel, 5 * noise)


def _peak(motion: Motion, moving: Mask) -> float:
    some = _some(motion.acceleration, moving)
    return float(np.percentile(np.abs(some), 95)) if some.size else 0.0


def _some(values: Array, moving: Mask) -> Array:
    """Return the values in motion; of very many, some."""
    stride = max(values.size // 2**14, 1)
    return np.asarray(values[::stride][moving[::stride]])


def _noise(motion: Motion, moving: Mask) -> float:
    """Return how much the acceleration of a plateau scatters, m/s^2."""
    some = _some(motion.acceleration_errors, moving)
    if not some.size:
        return 0.0
    # A smoother's error also allows for motion that a plateau does not have.
    share = math.sqrt(1 / 6) if motion.method == "rts" else 1.0
    return share * float(np.median(some))


def _shortest_stick(series: Series, seen: Motion, moving: Mask) -> float:
    """Return how long a plateau must last to be a stick: by the number of fast swings in the faster direction."""
    forth, back = np.percentile(seen.velocity[moving], (99, 1)) if moving.any() else (0.0, 0.0)
    speed = seen.velocity if forth > -back else -seen.velocity
    swings = max(len(runs(moving & (speed > 0.5 * max(forth, -back)))), 1)
    return series.interval * max(SHARE * float(moving.sum()) / swings, BROAD * seen.window)


def _smooth_until_resolved(
    series: Series, motion: Motion, moving: Mask
) -> tuple[Motion, white_jerk.Noise | None, float]:
    """Return a motion whose acceleration is clear enough of noise to show a plateau, and the tolerance of the search.

    Between them are the noise levels that made it, None if it is ``motion``; the tolerance is what counts as no
    acceleration, m/s^2.  What is best for the velocity can be too rough for that, and differences never show one: then
    the record is smoothed again, for the search alone, by `processing.kalman.white_jerk` with ever less jerk.
    """
    seen = motion
    longest = max(own.stop - own.start for own in series.pieces) // 8
    longest -= 1 - longest % 2  # windows are odd
    noise = None
    for attempt in range(7):
        scatter, peak = _noise(seen, moving), _peak(seen, moving)
        if seen.order >= 2 and (5 * scatter <= RESOLVED * peak or seen.window * 3 // 2 > longest or attempt == 6):
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
    return seen, noise, max(FLAT * peak, 5 * scatter, rounding)


def _centred(motion: Motion, pieces: tuple[slice, ...]) -> Array:
    """Return |a|, m/s^2, with the noisy one-sided fits at the ends of a piece replaced by the nearest centred one."""
    size = np.abs(motion.acceleration)
    half = motion.window // 2
    for piece in pieces:
        if piece.stop - piece.start > 2 * half:
            size[piece.start : piece.start + half] = size[piece.start + half]
            size[piece.stop - half : piece.stop] = size[piece.stop - half - 1]
    return size


def _joined(flat: Runs, wide: Runs) -> list[tuple[tuple[int, int], tuple[int, int]]]:
    """Return each wider stretch that holds flat ones, with the span from its first flat sample to its last.

    A burst of noise inside a stick leaves the narrow tolerance but not the wide one.
    """
    found = []
    starts = [run[0] for run in flat]
    for around in wide:
        inside = flat[bisect_left(starts, around[0]) : bisect_right(starts, around[1])]
        if inside:
            found.append(((inside[0][0], inside[-1][1]), around))
    return found


def _is_plateau(run: tuple[int, int], around: tuple[int, int], least: int, window: int) -> bool:
    length = run[1] - run[0] + 1
    # The filter smears a sharp landing over half a window: that much of the wider stretch is the filter's own.
    return length >= least and length >= PLATEAU * (around[1] - around[0] + 1 - window // 4)


def _travels(run: tuple[int, int], motion: Motion) -> bool:
    """Tell whether the mass moves at all within the run, by four standard errors of its mean speed.

    A run of several smoothing windows has as many independent speeds.
    """
    own = slice(run[0], run[1] + 1)
    share = min(motion.window / (run[1] + 1 - run[0]), 1.0)
    return abs(median_value(motion.velocity[own])) > 4 * math.sqrt(share) * median_value(motion.velocity_errors[own])
