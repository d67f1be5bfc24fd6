"""Ripple: a belt whose speed oscillates at one frequency, found in the sticks.

In stick the mass moves as the belt does: its velocity, less a straight line against its position (a ramp's, or a
belt's compliance), is the belt's ripple seen through the windows of the sticks.  Its strongest harmonic is looked for
by a Fourier transform with zeros where the mass slips, and settled by least squares.  In the fit amplitude, phase and
frequency are unknowns, with what the sticks show as a wide prior.

On a ramp the mass creeps in proportion to load over friction level, and the level is drawn anew at each landing: then
each stick has a slope of its own, and all lines pass through the belt's speed at the spring's rest position.

Not modelled: a second harmonic, a frequency that drifts.
"""

import math
from dataclasses import dataclass, fields, replace
from operator import itemgetter

import numpy as np
from numpy.typing import NDArray

from fitting.least_squares.elimination import least_squares
from fitting.record.cycles import BEFORE_BREAK_AWAY, CycleSegmentation
from fitting.record.motion import MeasuredMotion
from stickslip.compute.arrays import Array

VARIANCE_LEFT = 0.45  # share of the velocity's variance in stick that a ripple leaves at the most
SMALLEST_AMPLITUDE = 2e-3  # amplitude over the belt's speed: less is none
# Amplitude over the step of positions, of the strongest harmonic of the rounding error of a uniform motion, a sawtooth
# (W. R. Bennett, Bell System Technical Journal 27 (1948) 446): a ripple that is no larger may be that.
ROUNDING_WAVE = 1 / math.pi
AMPLITUDE_BESIDE_LINES = 0.25  # share of the amplitude that the lines do not take up; of true ripples 0.28 to 1.0
# Periods in a slip (`MeasuredMotion.slip_s`).  Slower, or below `SLOWEST_OF_FEW` with fewer periods, it may be wear or
# a drift; faster, smoothing has taken it away.
SLOWEST, SLOWEST_OF_FEW, FASTEST = 0.025, 0.1, 12.5
FEWEST_PERIODS = 2.0  # periods in the time that the sticks span: a single one cannot be distinguished from a drift
GRID_SAMPLES = 50.0  # samples a slip of the thinned record that is transformed: four of the fastest period
GRID_REFINEMENT = 4  # frequencies looked at for each of the transform's own
CANDIDATES = 5  # frequencies tried: the gaps between sticks make false peaks beside the true one
RIVAL_VARIANCE = 2.0  # mean square over what the likeliest frequency leaves, at which another is no longer tried
OUTLIER_ABOVE = 4.0  # distance in robust standard deviations: further off are corners that the cut left in
FEWEST_LONG_STICKS = 4  # sticks longer than the smoothing blurs: of fewer, none is used
LOG_ODDS = 5.0  # log of the odds against noise, beyond those of trying every frequency: 1 in 150
LEFT_ABOVE_NOISE = 1.5  # rms that a harmonic may leave where values are few, over the noise of a velocity
HARMONIC_UNKNOWNS = 3  # unknowns: amplitude, phase and frequency
FALLING_STICKS = 0.9  # share of sticks whose velocity falls: on a ramp all but those that noise hides, else half
POINTS_TRIED = 41  # places, over twice the travel, first tried for the point that lines of own slopes share
HALVINGS = 9  # steps of frequency and point, each half the last: to 1e-3 of a turn over the record
SETTLING_TIME = 0.04  # least time after a landing that is left out, in slips
LEFT_OUT_OF_STICK = 1 / 6  # share of a stick left out at the most at an end; else short sticks show no ripple


@dataclass(frozen=True)
class Ripple:
    """A ripple of the belt's speed, ``cosine`` cos(omega t) + ``sine`` sin(omega t)."""

    cosine: float  # m/s
    sine: float
    omega: float  # rad/s; 0 without one
    seen_s: float = math.inf  # s from the first to the last sample that shows it; inf where it is given

    @property
    def amplitude(self) -> float:
        return math.hypot(self.cosine, self.sine)

    def removed(self, motion: MeasuredMotion) -> MeasuredMotion:
        """Return the motion without the ripple in its smoothed velocity and acceleration, where corners show."""
        _, velocity, acceleration = self.belt_motion(motion.time)
        return replace(motion, velocity=motion.velocity - velocity, acceleration=motion.acceleration - acceleration)

    def belt_motion(self, time: Array) -> tuple[Array, Array, Array]:
        """Return the ripple's position (m), velocity and acceleration; 0 where omega is."""
        if self.omega == 0:
            return np.zeros_like(time), np.zeros_like(time), np.zeros_like(time)
        even, odd = np.cos(self.omega * time), np.sin(self.omega * time)
        speed, quarter = self.cosine * even + self.sine * odd, self.cosine * odd - self.sine * even
        return quarter / self.omega, speed, -self.omega * quarter


def find_ripple(motion: MeasuredMotion, cut: CycleSegmentation) -> Ripple | None:
    return next(iter(find_ripples(motion, cut)), None)


def find_ripples(motion: MeasuredMotion, cut: CycleSegmentation) -> list[Ripple]:
    """Return the ripples that the sticks, or the start-up drag of a grazing mass, may show; likeliest first."""
    sticks = _in_stick(motion, cut)
    drag = [np.arange(*cut.drag)] if not cut.sustained and cut.uses_start and cut.drag[1] > cut.drag[0] else []
    if not sticks:
        return _harmonics(motion, InStick.selected(motion, drag), None) if drag else []
    stuck = InStick.selected(motion, sticks)
    slopes = OwnSlopes.fitted(stuck, motion)
    if slopes.falling(stuck.v) > FALLING_STICKS:
        ripples = _harmonics(motion, stuck, slopes)
        if ripples:
            return ripples
    elif drag:
        # Among a few short sticks several frequencies do equally well; the drag is longer than all of them.
        stuck = InStick.selected(motion, [*drag, *sticks])
    return _harmonics(motion, stuck, None)


@dataclass(frozen=True, eq=False)
class InStick:
    time: Array  # (n,) s, m, m/s
    x: Array
    v: Array
    own: NDArray[np.int64]  # (n,) which stick a sample is in
    columns: Array  # (n, 2) of one line for all sticks
    rest: Array  # (n,) what that line leaves, m/s

    @classmethod
    def selected(cls, motion: MeasuredMotion, sticks: list[NDArray[np.int64]]) -> "InStick":
        """Return the samples of the sticks, without those off the others' line."""
        index = np.concatenate(sticks)
        x, v = motion.position[index], motion.velocity[index]
        own = np.repeat(np.arange(len(sticks)), [stick.size for stick in sticks])
        columns = np.c_[np.ones_like(x), x - x.mean()]
        kept = np.abs(v - np.median(v)) < 0.5 * motion.belt_speed
        for _ in range(3):
            rest = v - np.sum(columns * least_squares(columns[kept], v[kept])[0], axis=1)
            kept = np.abs(rest) <= OUTLIER_ABOVE * 1.4826 * np.median(np.abs(rest[kept]))
        return cls(motion.time[index][kept], x[kept], v[kept], own[kept], columns[kept], rest[kept])

    def thinned(self, thin: slice) -> "InStick":
        return InStick(*(getattr(self, field.name)[thin] for field in fields(self)))


@dataclass(frozen=True, eq=False)
class OwnSlopes:
    """Lines through one point with a separate slope in each stick."""

    lever: Array  # (n,) position from the point, m
    own: NDArray[np.int64]  # (n,) which stick a sample is in

    @classmethod
    def fitted(cls, stuck: InStick, motion: MeasuredMotion) -> "OwnSlopes":
        """Return the lines whose common point, near the spring's rest, leaves least."""
        middle = 0.5 * float(motion.position.max() + motion.position.min())

        def left(place: float) -> float:
            return float(np.sum(cls(stuck.x - place, stuck.own).left(stuck.v) ** 2))

        return cls(stuck.x - min(middle + _offsets(motion), key=left), stuck.own)

    def left(self, v: Array) -> Array:
        return least_squares(self.removed(np.ones_like(v))[:, None], self.removed(v))[1]

    def removed(self, values: Array) -> Array:
        """Return values (n,) less a multiple of the lever fitted in each stick."""
        square = np.bincount(self.own, self.lever**2)
        slope = np.bincount(self.own, self.lever * values) / np.maximum(square, 1e-300)
        return np.asarray(values - self.lever * slope[self.own])

    def falling(self, v: Array) -> float:
        """Return the share of the sticks in which velocities v (n,) fall with the position."""
        level = self.removed(np.ones_like(v))
        square = max(float(np.sum(level**2)), 1e-300)
        rest = v - float(np.sum(level * self.removed(v))) / square
        products = np.bincount(self.own, self.lever * rest)
        return float(np.mean(products[np.bincount(self.own) > 0] < 0))

    def thinned(self, thin: slice) -> "OwnSlopes":
        return OwnSlopes(self.lever[thin], self.own[thin])

    def moved(self, offset: float) -> "OwnSlopes":
        return OwnSlopes(self.lever - offset, self.own)


def _harmonics(motion: MeasuredMotion, stuck: InStick, slopes: OwnSlopes | None) -> list[Ripple]:
    """Return the significant harmonics of the velocities in stick; the point of ``slopes`` is searched anew."""
    rest, peaks = stuck.rest, _peaks(stuck.time, stuck.rest, motion.slip_s)
    if slopes is not None:
        rest = slopes.left(stuck.v)
        peaks += _peaks(stuck.time, rest, motion.slip_s)
    thin = slice(None, None, max(1, int(motion.time.size / motion.span * motion.slip_s / GRID_SAMPLES)))
    every, stuck, before = stuck, stuck.thinned(thin), float(np.mean(rest[thin] ** 2))
    time, v = stuck.time, stuck.v
    slopes = None if slopes is None else slopes.thinned(thin)
    origin = 0.5 * (time[0] + time[-1])  # far from it phase and frequency would trade against each other

    def harmonic(hertz: float, offset: float) -> tuple[float, Array]:
        omega = 2 * math.pi * hertz
        waves = (np.cos(omega * (time - origin)), np.sin(omega * (time - origin)))
        if slopes is None:
            coefficients, left = least_squares(np.c_[stuck.columns, *waves], v)
        else:
            lines = slopes.moved(offset)
            shapes = [lines.removed(shape) for shape in (np.ones_like(v), *waves)]
            coefficients, left = least_squares(np.stack(shapes, axis=1), lines.removed(v))
        return float(np.mean(left**2)), coefficients[-2:]

    def settled(hertz: float, offset: float) -> tuple[float, float]:
        width, step = 0.5 / (time[-1] - time[0]), motion.travel / POINTS_TRIED
        for _ in range(HALVINGS):
            hertz = min((hertz - width, hertz, hertz + width), key=lambda near: harmonic(near, offset)[0])
            if slopes is not None:
                offset = min((offset - step, offset, offset + step), key=lambda place: harmonic(hertz, place)[0])
            width, step = width / 2, step / 2
        return hertz, offset

    offsets = np.zeros(1) if slopes is None else _offsets(motion)
    starts = [min(((harmonic(peak, place)[0], peak, place) for place in offsets), key=itemgetter(0)) for peak in peaks]
    ripples: list[Ripple] = []
    least = math.inf
    for left, peak, place in sorted(starts, key=itemgetter(0)):
        if left > RIVAL_VARIANCE * least:
            break
        hertz, offset = settled(peak, place)
        after, (even, odd) = harmonic(hertz, offset)
        omega, amplitude = 2 * math.pi * hertz, math.hypot(even, odd)
        seen = (
            after <= min(VARIANCE_LEFT * before, RIVAL_VARIANCE * least)
            and amplitude >= max(SMALLEST_AMPLITUDE * motion.belt_speed, omega * ROUNDING_WAVE * motion.step)
            and 2 * (before - after) >= (AMPLITUDE_BESIDE_LINES * amplitude) ** 2
            and _gains(motion, every.own, before, after, slopes)
        )
        if not ripples and not seen:
            return []
        if not seen or any(abs(omega - one.omega) * one.seen_s < 2 * math.pi for one in ripples):
            continue
        cos, sin = math.cos(omega * origin), math.sin(omega * origin)
        seen_s = float(time[-1] - time[0])
        ripples.append(Ripple(float(even * cos - odd * sin), float(even * sin + odd * cos), omega, seen_s))
        least = min(least, after)
    return ripples


def _offsets(motion: MeasuredMotion) -> Array:
    """Return the displacements of the lines' common point to try, m."""
    return np.linspace(-1.0, 1.0, POINTS_TRIED) * motion.travel


def _gains(
    motion: MeasuredMotion, own: NDArray[np.int64], before: float, after: float, slopes: OwnSlopes | None
) -> bool:
    """Return whether a harmonic explains more than the best one explains in noise; mean squares in (m/s)^2."""
    window = max(2 * motion.half_window, SETTLING_TIME * motion.slip_s)
    samples = np.bincount(own)
    lengths = samples[samples > 0] * float(np.median(np.diff(motion.time)))
    independent = float(np.sum(np.maximum(lengths / window, 1.0)))
    lines = 2 if slopes is None else lengths.size
    needed = 2 * (math.log((FASTEST - SLOWEST) / motion.slip_s * motion.span) + LOG_ODDS)
    noise = motion.velocity_error**2
    if independent * (before - after) <= needed * noise:
        return False
    if (independent - lines - HARMONIC_UNKNOWNS) * math.log(before / max(after, 1e-300)) > needed:
        return True
    # Few values, but the harmonic leaves no more of them than their noise.
    return after < LEFT_ABOVE_NOISE**2 * noise


def _in_stick(motion: MeasuredMotion, cut: CycleSegmentation) -> list[NDArray[np.int64]]:
    """Return the samples of each stick, well away from corners; none where few sticks are long."""
    parts, long = [], 0
    for before, after in zip(cut.cycles[:-1], cut.cycles[1:], strict=True):
        stick_s = max(after.break_away - before.landing, 0.0)
        settle = max(motion.half_window, min(SETTLING_TIME * motion.slip_s, LEFT_OUT_OF_STICK * stick_s))
        first = int(np.searchsorted(motion.time, before.landing + settle))
        before_break_away = min(BEFORE_BREAK_AWAY * motion.slip_s, LEFT_OUT_OF_STICK * stick_s)
        end = int(np.searchsorted(motion.time, after.break_away - before_break_away))
        if end > first:
            parts.append(np.arange(first, end))
            long += motion.time[end - 1] - motion.time[first] > settle
    return parts if long >= FEWEST_LONG_STICKS else []


def strongest_frequencies(time: Array, rest: Array, slip_s: float, slowest: float, count: int) -> tuple[Array, float]:
    """Return at most ``count`` frequencies, Hz, strongest first, and their resolution, Hz; ``slowest`` is in Hz."""
    grid = np.bincount(((time - time[0]) * (GRID_SAMPLES / slip_s)).astype(np.int64), weights=rest)
    size = GRID_REFINEMENT * grid.size
    power = np.abs(np.fft.rfft(grid, size)) ** 2
    hertz = np.fft.rfftfreq(size, slip_s / GRID_SAMPLES)
    power[(hertz < slowest) | (hertz > FASTEST / slip_s)] = 0.0
    strongest: list[float] = []
    while len(strongest) < count and power.any():
        top = int(np.argmax(power))
        strongest.append(float(hertz[top]))
        power[max(top - GRID_REFINEMENT, 0) : top + GRID_REFINEMENT + 1] = 0.0
    return np.array(strongest), float(hertz[1])


def _peaks(time: Array, rest: Array, slip_s: float) -> list[float]:
    slowest = min(max(SLOWEST / slip_s, FEWEST_PERIODS / (time[-1] - time[0])), SLOWEST_OF_FEW / slip_s)
    found, _ = strongest_frequencies(time, rest, slip_s, slowest, CANDIDATES)
    return [float(hertz) for hertz in found]
