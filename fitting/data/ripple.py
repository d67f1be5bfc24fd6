"""Ripple: a belt whose speed oscillates at one frequency, found in the sticks.

In stick the mass moves as the belt does, so its velocity, less a straight line against its position (a ramp's, or a
belt's compliance), is the belt's ripple seen through the windows of the sticks.  Its strongest harmonic is looked
for on a grid by a Fourier transform with zeros where the mass slips, and settled by least squares on the samples
themselves.  In the fit amplitude, phase and frequency are unknowns, with
what the sticks show as a wide prior.

On a ramp the mass creeps in proportion to load over friction level, and the level is drawn anew at each landing: then
each stick has a slope of its own, and all lines pass through the belt's speed at the spring's rest position.

Not modelled: a second harmonic, a frequency that drifts.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from daq.compute.arrays import Array
from daq.compute.least_squares import least_squares
from fitting.data.cycles import BEFORE_BREAK_AWAY_S, CycleSegmentation
from fitting.data.frame import MeasuredMotion

LEFT = 0.45  # of the velocity's variance in stick: a ripple worth the name leaves no more than this
SMALLEST = 2e-3  # of the belt's speed
SLOWEST_HZ, FASTEST_HZ = 0.2, 25.0  # slower than sticks are long it is no ripple; faster, smoothing has taken it away
GRID_HZ = 100.0  # rate of the thinned record that is transformed
FINER = 4  # times the transform's own grid of frequencies
CANDIDATES = 5  # the gaps between sticks make false peaks beside the true one
OUTLYING = 4.0  # robust standard deviations: corners that the cut left in
FEWEST = 4  # sticks
SURE_LOG = 5.0  # log of the odds against noise, beyond those of trying every frequency: 1 in 150
NOISE_ALONE = 1.5  # times the noise of a velocity: so much a harmonic may leave where values are few
HARMONIC = 3  # unknowns: amplitude, phase and frequency
RAMP_LIKE = 0.9  # of the sticks have velocities that fall: on a ramp all but those that noise hides, else half
PLACES = 41  # of the point that lines of own slopes share, over twice the travel: nearer than 5 % gains nothing
SETTLED_S = 0.02  # after a landing, at the least


@dataclass(frozen=True)
class Ripple:
    """The belt's speed ripples by ``cosine`` cos(omega t) + ``sine`` sin(omega t); m/s, m/s, rad/s, t as recorded."""

    cosine: float
    sine: float
    omega: float

    @property
    def amplitude(self) -> float:
        """m/s."""
        return math.hypot(self.cosine, self.sine)

    def removed(self, motion: MeasuredMotion) -> MeasuredMotion:
        """Return the motion with the ripple taken off its smoothed velocity and acceleration, where corners show."""
        _, velocity, acceleration = self.belt_motion(motion.time)
        return replace(motion, velocity=motion.velocity - velocity, acceleration=motion.acceleration - acceleration)

    def belt_motion(self, time: Array) -> tuple[Array, Array, Array]:
        """Return position (m), velocity and acceleration of the belt beside its steady run; 0 where omega is."""
        if self.omega == 0:
            return np.zeros_like(time), np.zeros_like(time), np.zeros_like(time)
        even, odd = np.cos(self.omega * time), np.sin(self.omega * time)
        speed, quarter = self.cosine * even + self.sine * odd, self.cosine * odd - self.sine * even
        return quarter / self.omega, speed, -self.omega * quarter


def find_ripple(motion: MeasuredMotion, cut: CycleSegmentation) -> Ripple | None:
    """Return the ripple that the sticks show; None where they are few or show none to speak of.

    Parameters
    ----------
    motion, cut : MeasuredMotion, CycleSegmentation
        In the fit's frame.
    """
    sticks = _in_stick(motion, cut)
    if sticks is None:
        return None
    index = np.concatenate(sticks)
    time, x, v = motion.time[index], motion.position[index], motion.velocity[index]
    own = np.repeat(np.arange(len(sticks)), [stick.size for stick in sticks])
    columns = np.c_[np.ones_like(x), x - x.mean()]
    middle = np.median(v)
    kept = np.abs(v - middle) < 0.5 * motion.belt_speed
    for _ in range(3):
        rest = v - np.sum(columns * least_squares(columns[kept], v[kept])[0], axis=1)
        kept = np.abs(rest) <= OUTLYING * 1.4826 * np.median(np.abs(rest[kept]))
    time, x, v, own, columns, rest = time[kept], x[kept], v[kept], own[kept], columns[kept], rest[kept]
    peaks = _peaks(time, rest)
    slopes = OwnSlopes.fitted(x, v, own, motion)
    if slopes.falling(v) > RAMP_LIKE:
        level, flat = slopes.removed(np.ones_like(v))[:, None], slopes.removed(v)
        beside = least_squares(level, flat)[1]
        found = _harmonic(motion, cut, time, flat, level, beside, [*peaks, *_peaks(time, beside)], slopes)
        if found is not None:
            return found
    return _harmonic(motion, cut, time, v, columns, rest, peaks, None)


@dataclass(frozen=True, eq=False)
class OwnSlopes:
    """Lines through one point with a slope of their own in each stick.

    Attributes
    ----------
    lever : (n,) f8
        Position from the point, m.
    own : (n,) i8
        Which stick a sample is in.
    """

    lever: Array
    own: NDArray[np.int64]

    @classmethod
    def fitted(cls, x: Array, v: Array, own: NDArray[np.int64], motion: MeasuredMotion) -> "OwnSlopes":
        """Return the lines whose common point, the spring's rest position or near it, leaves least of velocities v."""
        reach = np.linspace(-1.0, 1.0, PLACES) * motion.travel
        middle = 0.5 * float(motion.position.max() + motion.position.min())

        def left(place: float) -> float:
            lines = cls(x - place, own)
            return float(np.sum(least_squares(lines.removed(np.ones_like(v))[:, None], lines.removed(v))[1] ** 2))

        return cls(x - min(middle + reach, key=left), own)

    def removed(self, values: Array) -> Array:
        """Return values (n,) less, in each stick, their own multiple of the lever."""
        square = np.bincount(self.own, self.lever**2)
        slope = np.bincount(self.own, self.lever * values) / np.maximum(square, 1e-300)
        return np.asarray(values - self.lever * slope[self.own])

    def falling(self, v: Array) -> float:
        """Return the share of the sticks in which velocities v (n,) less their common level fall with the position."""
        level = self.removed(np.ones_like(v))
        square = max(float(np.sum(level**2)), 1e-300)
        rest = v - float(np.sum(level * self.removed(v))) / square
        products = np.bincount(self.own, self.lever * rest)
        return float(np.mean(products[np.bincount(self.own) > 0] < 0))

    def thinned(self, thin: slice) -> "OwnSlopes":
        """Return the same lines of fewer samples."""
        return OwnSlopes(self.lever[thin], self.own[thin])


def _harmonic(
    motion: MeasuredMotion,
    cut: CycleSegmentation,
    time: Array,
    v: Array,
    columns: Array,
    rest: Array,
    peaks: list[float],
    slopes: OwnSlopes | None,
) -> Ripple | None:
    """Return the harmonic that velocities (n,) in stick show beside their lines, if it is worth the name.

    Parameters
    ----------
    motion, cut : MeasuredMotion, CycleSegmentation
    time, v : (n,) f8
    columns : (n, k) f8
        Of the lines that are also fitted.
    rest : (n,) f8
        What the lines alone leave.
    peaks : list of float
        Frequencies near which to look, Hz.
    slopes : OwnSlopes or None
        Have been taken off the velocities and the columns, and are taken off the harmonics.
    """
    if not peaks:
        return None
    thin = slice(None, None, max(1, int(motion.time.size / motion.span / GRID_HZ)))
    time, columns, v, rest = time[thin], columns[thin], v[thin], rest[thin]
    slopes = None if slopes is None else slopes.thinned(thin)
    before = float(np.sum(rest**2))
    origin = 0.5 * (time[0] + time[-1])  # far from it phase and frequency would trade against each other

    def harmonic(hertz: float) -> tuple[float, Array]:
        omega = 2 * math.pi * hertz
        waves = (np.cos(omega * (time - origin)), np.sin(omega * (time - origin)))
        if slopes is not None:
            waves = (slopes.removed(waves[0]), slopes.removed(waves[1]))
        found, left = least_squares(np.c_[columns, *waves], v)
        return float(np.sum(left**2)), found[-2:]

    best = min(peaks, key=lambda hertz: harmonic(hertz)[0])
    width = 0.5 / (time[-1] - time[0])
    while width > 1e-3 / (time[-1] - time[0]):
        best = min((best - width, best, best + width), key=lambda hertz: harmonic(hertz)[0])
        width /= 2
    after, (even, odd) = harmonic(best)
    if after > LEFT * before or math.hypot(even, odd) < SMALLEST * motion.belt_speed:
        return None
    lines = len(cut.cycles) if slopes is not None else 2
    sampled_s = time.size * float(np.median(np.diff(time)))
    if not _gains(motion, cut, sampled_s, before / v.size, after / v.size, math.hypot(even, odd), lines):
        return None
    omega = 2 * math.pi * best
    cos, sin = math.cos(omega * origin), math.sin(omega * origin)
    return Ripple(float(even * cos - odd * sin), float(even * sin + odd * cos), omega)


def _gains(
    motion: MeasuredMotion,
    cut: CycleSegmentation,
    sampled_s: float,
    before: float,
    after: float,
    amplitude: float,
    lines: int,
) -> bool:
    """Return whether a harmonic explains more than the best of as many frequencies explains in noise.

    Velocities are independent over a smoothing window.  Where sticks are shorter than that each gives one.

    Parameters
    ----------
    motion, cut : MeasuredMotion, CycleSegmentation
    sampled_s : float
        Time spent in the sticks that were looked at, s.
    before, after : float
        Mean squares of the residuals without and with the harmonic, (m/s)^2.
    amplitude : float
        Of the harmonic, m/s.
    lines : int
        Unknowns beside the harmonic.
    """
    window = max(2 * motion.half_window, SETTLED_S)
    sticks = zip(cut.cycles[:-1], cut.cycles[1:], strict=True)
    usual = float(np.median([later.break_away - earlier.landing for earlier, later in sticks]))
    independent = sampled_s / window if window < usual else float(len(cut.cycles))
    needed = 2 * (math.log((FASTEST_HZ - SLOWEST_HZ) * motion.span) + SURE_LOG)
    noise = motion.velocity_error**2
    if independent * amplitude**2 / 2 <= needed * noise:
        return False
    if (independent - lines - HARMONIC) * math.log(before / max(after, 1e-300)) > needed:
        return True
    # Few values, but the harmonic leaves no more of them than their noise.
    return after < NOISE_ALONE**2 * noise and independent * (before - after) > needed * noise


def _in_stick(motion: MeasuredMotion, cut: CycleSegmentation) -> list[NDArray[np.int64]] | None:
    """Return the samples of each stick, well away from corners; None with too few sticks."""
    settle = max(motion.half_window, SETTLED_S)
    parts = []
    for before, after in zip(cut.cycles[:-1], cut.cycles[1:], strict=True):
        first = int(np.searchsorted(motion.time, before.landing + settle))
        end = int(np.searchsorted(motion.time, after.break_away - BEFORE_BREAK_AWAY_S))
        if end > first:
            parts.append(np.arange(first, end))
    return parts if len(parts) >= FEWEST else None


def _peaks(time: Array, rest: Array) -> list[float]:
    """Return the strongest frequencies of what is left in stick, Hz."""
    grid = np.bincount(((time - time[0]) * GRID_HZ).astype(np.int64), weights=rest)
    size = FINER * grid.size
    power = np.abs(np.fft.rfft(grid, size)) ** 2
    hertz = np.fft.rfftfreq(size, 1 / GRID_HZ)
    power[(hertz < SLOWEST_HZ) | (hertz > FASTEST_HZ)] = 0.0
    found: list[float] = []
    while len(found) < CANDIDATES and power.any():
        top = int(np.argmax(power))
        found.append(float(hertz[top]))
        power[max(top - FINER, 0) : top + FINER + 1] = 0.0
    return found
