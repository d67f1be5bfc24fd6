"""Ripple: a belt whose speed oscillates at one frequency, estimated from the sticks.

In stick the mass moves with the belt: its velocity, less a straight line against its position (of a ramp, or of a
belt's compliance), is the belt's ripple.  Candidate frequencies are the peaks of a Fourier transform with zeros where
the mass slips.  They are refined by least squares together with the line.  In the fit amplitude, phase and frequency
are unknowns, with a wide prior from the sticks.

On a ramp the mass creeps in proportion to load over friction level, and the level is new after each landing.  Then each
stick has its own slope, and all lines pass through the belt's speed at the spring's rest position.  Both models are
fitted, and compared by an information criterion (G. Schwarz, Ann. Statist. 6 (1978) 461).

Not modelled: a second harmonic, a frequency that drifts.
"""

import math
from dataclasses import dataclass, replace
from operator import itemgetter

import numpy as np
from numpy.typing import NDArray

from fitting import noise_levels
from fitting.least_squares.elimination import least_squares
from fitting.record.cycles import BEFORE_BREAK_AWAY, CycleSegmentation
from fitting.record.motion import MeasuredMotion
from stickslip.compute.arrays import Array

RESIDUAL_VARIANCE = 0.35  # largest residual variance over that of the velocity in stick; true ripples have 0.32
# Periods in a slip (`MeasuredMotion.slip_s`).  A slower ripple, or one below `SLOWEST_OF_FEW` with fewer periods, may
# be wear or drift; smoothing removes a faster one.
SLOWEST, SLOWEST_OF_FEW, FASTEST = 0.025, 0.1, 12.5
FEWEST_PERIODS = 2.0  # periods within the sticks: a single one cannot be distinguished from a drift
GRID_SAMPLES = 50.0  # samples a slip of the record that is transformed: four of the fastest period
GRID_REFINEMENT = 4  # frequencies for each one of the transform
CANDIDATES = 5  # frequencies tried: the gaps between sticks cause false peaks near the true one
LOG_ODDS = 5.0  # log of the odds against noise, beyond those of trying every frequency: 1 in 150
NOISE_VALUES = 10.0  # number of values that the known noise of a velocity is worth
HARMONIC_UNKNOWNS = 3  # unknowns: amplitude, phase and frequency
ENOUGH_SAMPLES = 5_000  # samples from which frequencies are refined
POINTS_TRIED = 41  # first candidates, over twice the travel, for the common point of lines with separate slopes
STEPS, SLOPE_STEP = 6, 1e-3  # Gauss-Newton steps in frequency and point, and the step, over the first, of their slopes
SETTLING_TIME = 0.04  # shortest time omitted after a landing, in slips
OMITTED_OF_STICK = 1 / 6  # largest share of a stick omitted at each end, so that short sticks are used too


@dataclass(frozen=True)
class Ripple:
    """A ripple of the belt's speed, ``cosine`` cos(omega t) + ``sine`` sin(omega t)."""

    cosine: float  # m/s
    sine: float
    omega: float  # rad/s; 0 without one
    seen_s: float = math.inf  # s from the first to the last sample that it was estimated from; inf where it is given

    @property
    def amplitude(self) -> float:
        return math.hypot(self.cosine, self.sine)

    def remove_from(self, motion: MeasuredMotion) -> MeasuredMotion:
        """Return the motion without the ripple in its smoothed velocity and acceleration, to find corners."""
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
    """Estimate the ripple from the sticks, or from the start-up drag of a grazing mass."""
    # Several frequencies fit a few short sticks equally well; the drag is longer than all of them.
    drag = [np.arange(*cut.drag)] if not cut.sustained and cut.uses_start and cut.drag[1] > cut.drag[0] else []
    parts = [*drag, *_list_sticks(motion, cut)]
    if not parts:
        return None
    separate = Sticks.select(motion, parts)
    shared_and_separate = replace(separate, line=np.zeros_like(separate.line)), separate
    peaks = sorted({peak for sticks in shared_and_separate for peak in _peaks(motion, sticks)})
    if not peaks:
        return None
    return min((_find_harmonic(motion, sticks, peaks) for sticks in shared_and_separate), key=itemgetter(0))[1]


@dataclass(frozen=True, eq=False)
class Sticks:
    """Velocities in stick, and lines against the position through one point, with a common slope or one slope each."""

    time: Array  # (n,) s, m, m/s
    lever: Array  # position from the point
    v: Array
    line: NDArray[np.int64]  # (n,) which line a sample is on
    values: float  # number of independent samples

    @classmethod
    def select(cls, motion: MeasuredMotion, sticks: list[NDArray[np.int64]]) -> "Sticks":
        """Return the samples of the sticks without outliers of a common line, with one line for each stick."""
        index = np.concatenate(sticks)
        line = np.repeat(np.arange(len(sticks)), [stick.size for stick in sticks])
        lever = motion.position[index] - 0.5 * float(motion.position.max() + motion.position.min())
        v, columns = motion.velocity[index], np.c_[np.ones_like(lever), lever]
        near_line = np.abs(v - np.median(v)) < 0.5 * motion.belt_speed
        for _ in range(3):
            rest = v - np.sum(columns * least_squares(columns[near_line], v[near_line])[0], axis=1)
            near_line = np.abs(rest) <= noise_levels.SHOWN * 1.4826 * np.median(np.abs(rest[near_line]))
        samples = np.bincount(line[near_line])
        window = max(2 * motion.half_window, SETTLING_TIME * motion.slip_s) / float(np.median(np.diff(motion.time)))
        values = float(np.sum(np.maximum(samples[samples > 0] / window, 1.0)))
        return cls(motion.time[index][near_line], lever[near_line], v[near_line], line[near_line], values)

    @property
    def lines(self) -> int:
        """Number of unknowns of the lines."""
        return max(np.unique(self.line).size, 2)

    def thinned(self, slip_s: float) -> "Sticks":
        interval = float(np.median(np.diff(self.time)))
        thin = slice(None, None, max(1, int(slip_s / GRID_SAMPLES / interval), self.time.size // ENOUGH_SAMPLES))
        return Sticks(self.time[thin], self.lever[thin], self.v[thin], self.line[thin], self.values)

    def points(self, motion: MeasuredMotion) -> Array:
        """Return the displacements of the lines' common point to try, m; a single line goes through any."""
        return np.linspace(-1.0, 1.0, POINTS_TRIED) * motion.travel if self.line[-1] else np.zeros(1)

    def fit(self, offset: float, *waves: Array) -> tuple[Array, Array]:
        """Fit waves and lines through the point ``offset`` m further; return the waves' coefficients and the rest."""
        lever = self.lever - offset
        square = np.maximum(np.bincount(self.line, lever**2), 1e-300)

        def remove_slopes(values: Array) -> Array:
            slope = np.bincount(self.line, lever * values) / square
            return np.asarray(values - lever * slope[self.line])

        shapes = np.stack([remove_slopes(shape) for shape in (np.ones_like(lever), *waves)], axis=1)
        coefficients, rest = least_squares(shapes, remove_slopes(self.v))
        return coefficients[1:], rest


def _peaks(motion: MeasuredMotion, sticks: Sticks) -> list[float]:
    """Return the strongest frequencies, Hz, in the residual of the lines."""
    thinned, span = sticks.thinned(motion.slip_s), float(sticks.time[-1] - sticks.time[0])
    point = min(sticks.points(motion), key=lambda point: float(np.sum(thinned.fit(point)[1] ** 2)))
    slowest = min(max(SLOWEST / motion.slip_s, FEWEST_PERIODS / span), SLOWEST_OF_FEW / motion.slip_s)
    peaks, _ = strongest_frequencies(sticks.time, sticks.fit(point)[1], motion.slip_s, slowest, CANDIDATES)
    return [float(hertz) for hertz in peaks]


def _find_harmonic(motion: MeasuredMotion, all_sticks: Sticks, peaks: list[float]) -> tuple[float, Ripple | None]:
    """Return the information criterion of the best harmonic, and its ripple; inf and None unless it is significant."""
    sticks = all_sticks.thinned(motion.slip_s)
    time, seen_s = sticks.time, float(sticks.time[-1] - sticks.time[0])
    origin = 0.5 * (time[0] + time[-1])  # in the middle, so that phase and frequency are not correlated
    directions = np.diag([0.5 / seen_s, motion.travel / POINTS_TRIED])[: sticks.points(motion).size]

    def harmonic(point: Array) -> tuple[Array, Array]:
        turns = 2 * math.pi * point[0] * (time - origin)
        return sticks.fit(point[1], np.cos(turns), np.sin(turns))

    def mean_square(point: Array) -> float:
        return float(np.mean(harmonic(point)[1] ** 2))

    def refine(point: Array) -> Array:
        for _ in range(STEPS):
            rest = harmonic(point)[1]
            slopes = [(harmonic(point + SLOPE_STEP * along)[1] - rest) / SLOPE_STEP for along in directions]
            share = np.clip(least_squares(np.stack(slopes, axis=1), -rest)[0], -1.0, 1.0)
            step = np.einsum("i,ij->j", share, directions)
            point = min((point + factor * step for factor in (1.0, 0.3, 0.1, 0.0)), key=mean_square)
        return point

    def information(variance: float) -> float:
        count = sticks.values + NOISE_VALUES
        total = sticks.values * variance + NOISE_VALUES * motion.velocity_error**2
        return (count - sticks.lines - HARMONIC_UNKNOWNS) * math.log(total / count)

    needed = 2 * (math.log((FASTEST - SLOWEST) / motion.slip_s * motion.span) + LOG_ODDS)
    ends = (
        refine(min((np.array([peak, point]) for point in sticks.points(motion)), key=mean_square)) for peak in peaks
    )
    end = min(ends, key=mean_square)
    after, before, (even, odd) = mean_square(end), float(np.mean(sticks.fit(end[1])[1] ** 2)), harmonic(end)[0]
    if after > RESIDUAL_VARIANCE * before or information(before) - information(after) < needed:
        return math.inf, None
    omega = 2 * math.pi * float(end[0])
    cos, sin = math.cos(omega * origin), math.sin(omega * origin)
    return information(after), Ripple(float(even * cos - odd * sin), float(even * sin + odd * cos), omega, seen_s)


def _list_sticks(motion: MeasuredMotion, cut: CycleSegmentation) -> list[NDArray[np.int64]]:
    """Return the samples of each stick, away from corners; none if few sticks are long."""
    parts, long = [], 0
    for before, after in zip(cut.cycles[:-1], cut.cycles[1:], strict=True):
        stick_s = max(after.break_away - before.landing, 0.0)
        settle = max(motion.half_window, min(SETTLING_TIME * motion.slip_s, OMITTED_OF_STICK * stick_s))
        first = int(np.searchsorted(motion.time, before.landing + settle))
        before_break_away = min(BEFORE_BREAK_AWAY * motion.slip_s, OMITTED_OF_STICK * stick_s)
        end = int(np.searchsorted(motion.time, after.break_away - before_break_away))
        if end > first:
            parts.append(np.arange(first, end))
            long += motion.time[end - 1] - motion.time[first] > settle
    return parts if long >= noise_levels.FEWEST else []


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
