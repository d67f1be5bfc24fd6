"""Ripple: a belt whose speed oscillates at one frequency, found in the sticks.

In stick the mass moves as the belt does: its velocity, less a straight line against its position (a ramp's, or a
belt's compliance), is the belt's ripple seen through the windows of the sticks.  The strongest harmonics are looked for
by a Fourier transform with zeros where the mass slips, and settled by least squares together with the line.  In the fit
amplitude, phase and frequency are unknowns, with what the sticks show as a wide prior.

On a ramp the mass creeps in proportion to load over friction level, and the level is drawn anew at each landing: then
each stick has a slope of its own, and all lines pass through the belt's speed at the spring's rest position.  Both
are tried, and compared by an information criterion (G. Schwarz, Ann. Statist. 6 (1978) 461).

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

VARIANCE_LEFT = 0.35  # share of the velocity's variance in stick that a ripple leaves at the most; true ones leave 0.32
AMPLITUDE_BESIDE_LINES = 0.27  # share of the amplitude that the lines do not take up; of true ripples 0.28 to 1.0
# Periods in a slip (`MeasuredMotion.slip_s`).  Slower, or below `SLOWEST_OF_FEW` with fewer periods, it may be wear or
# a drift; faster, smoothing has taken it away.
SLOWEST, SLOWEST_OF_FEW, FASTEST = 0.025, 0.1, 12.5
FEWEST_PERIODS = 2.0  # periods in the time that the sticks span: a single one cannot be distinguished from a drift
GRID_SAMPLES = 50.0  # samples a slip of the record that is transformed: four of the fastest period
GRID_REFINEMENT = 4  # frequencies looked at for each of the transform's own
CANDIDATES = 5  # frequencies tried: the gaps between sticks make false peaks beside the true one
LOG_ODDS = 5.0  # log of the odds against noise, beyond those of trying every frequency: 1 in 150
NOISE_VALUES = 10.0  # values that the known noise of a velocity counts as: beside few others it decides
HARMONIC_UNKNOWNS = 3  # unknowns: amplitude, phase and frequency
ENOUGH_SAMPLES = 5_000  # samples from which frequencies are settled
POINTS_TRIED = 41  # places, over twice the travel, first tried for the point that lines of own slopes share
STEPS, SLOPE_STEP = 6, 1e-3  # Gauss-Newton steps in frequency and point, and the step, over the first, of their slopes
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
    """Return the ripple that the sticks, or the start-up drag of a grazing mass, show."""
    # Among a few short sticks several frequencies do equally well; the drag is longer than all of them.
    drag = [np.arange(*cut.drag)] if not cut.sustained and cut.uses_start and cut.drag[1] > cut.drag[0] else []
    parts = [*drag, *_in_stick(motion, cut)]
    if not parts:
        return None
    own = Sticks.selected(motion, parts)
    both = replace(own, line=np.zeros_like(own.line)), own
    peaks = sorted({peak for sticks in both for peak in _peaks(motion, sticks)})
    if not peaks:
        return None
    return min((_find_harmonic(motion, sticks, peaks) for sticks in both), key=itemgetter(0))[1]


@dataclass(frozen=True, eq=False)
class Sticks:
    """Velocities in stick, and lines against the position through one point: of one slope, or of one each."""

    time: Array  # (n,) s, m, m/s
    lever: Array  # position from the point
    v: Array
    line: NDArray[np.int64]  # (n,) which line a sample is on
    values: float  # number of independent samples

    @classmethod
    def selected(cls, motion: MeasuredMotion, sticks: list[NDArray[np.int64]]) -> "Sticks":
        """Return the samples of the sticks but those off the others' common line, with a line of each stick."""
        index = np.concatenate(sticks)
        line = np.repeat(np.arange(len(sticks)), [stick.size for stick in sticks])
        lever = motion.position[index] - 0.5 * float(motion.position.max() + motion.position.min())
        v, columns = motion.velocity[index], np.c_[np.ones_like(lever), lever]
        kept = np.abs(v - np.median(v)) < 0.5 * motion.belt_speed
        for _ in range(3):
            rest = v - np.sum(columns * least_squares(columns[kept], v[kept])[0], axis=1)
            kept = np.abs(rest) <= noise_levels.SHOWN * 1.4826 * np.median(np.abs(rest[kept]))
        samples = np.bincount(line[kept])
        window = max(2 * motion.half_window, SETTLING_TIME * motion.slip_s) / float(np.median(np.diff(motion.time)))
        values = float(np.sum(np.maximum(samples[samples > 0] / window, 1.0)))
        return cls(motion.time[index][kept], lever[kept], v[kept], line[kept], values)

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
    """Return the strongest frequencies, Hz, of what the lines leave."""
    few, span = sticks.thinned(motion.slip_s), float(sticks.time[-1] - sticks.time[0])
    point = min(sticks.points(motion), key=lambda point: float(np.sum(few.fit(point)[1] ** 2)))
    slowest = min(max(SLOWEST / motion.slip_s, FEWEST_PERIODS / span), SLOWEST_OF_FEW / motion.slip_s)
    peaks, _ = strongest_frequencies(sticks.time, sticks.fit(point)[1], motion.slip_s, slowest, CANDIDATES)
    return [float(hertz) for hertz in peaks]


def _find_harmonic(motion: MeasuredMotion, every: Sticks, peaks: list[float]) -> tuple[float, Ripple | None]:
    """Return the likeliest harmonic and its information criterion; inf and None unless it is significant."""
    sticks = every.thinned(motion.slip_s)
    time, seen_s = sticks.time, float(sticks.time[-1] - sticks.time[0])
    origin = 0.5 * (time[0] + time[-1])  # far from it phase and frequency would trade against each other
    directions = np.diag([0.5 / seen_s, motion.travel / POINTS_TRIED])[: sticks.points(motion).size]

    def harmonic(at: Array) -> tuple[Array, Array]:
        turns = 2 * math.pi * at[0] * (time - origin)
        return sticks.fit(at[1], np.cos(turns), np.sin(turns))

    def left(at: Array) -> float:
        return float(np.mean(harmonic(at)[1] ** 2))

    def settled(at: Array) -> Array:
        for _ in range(STEPS):
            rest = harmonic(at)[1]
            slopes = [(harmonic(at + SLOPE_STEP * along)[1] - rest) / SLOPE_STEP for along in directions]
            share = np.clip(least_squares(np.stack(slopes, axis=1), -rest)[0], -1.0, 1.0)
            step = np.einsum("i,ij->j", share, directions)
            at = min((at + part * step for part in (1.0, 0.3, 0.1, 0.0)), key=left)
        return at

    def information(variance: float) -> float:
        count = sticks.values + NOISE_VALUES
        whole = sticks.values * variance + NOISE_VALUES * motion.velocity_error**2
        return (count - sticks.lines - HARMONIC_UNKNOWNS) * math.log(whole / count)

    needed = 2 * (math.log((FASTEST - SLOWEST) / motion.slip_s * motion.span) + LOG_ODDS)
    ends = (settled(min((np.array([peak, point]) for point in sticks.points(motion)), key=left)) for peak in peaks)
    end = min(ends, key=left)
    after, before, (even, odd) = left(end), float(np.mean(sticks.fit(end[1])[1] ** 2)), harmonic(end)[0]
    if (
        after > VARIANCE_LEFT * before
        or 2 * (before - after) < (AMPLITUDE_BESIDE_LINES * math.hypot(even, odd)) ** 2
        or information(before) - information(after) < needed
    ):
        return math.inf, None
    omega = 2 * math.pi * float(end[0])
    cos, sin = math.cos(omega * origin), math.sin(omega * origin)
    return information(after), Ripple(float(even * cos - odd * sin), float(even * sin + odd * cos), omega, seen_s)


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
