"""The noise of measured positions, from the residual: rounding to a pitch, white noise, jitter of sample times.

The noise of a position is not the printed decimal.  A counter rounds; a camera adds white noise; sample times that
jitter move a position by velocity times the error of the time.  All three are estimated from fourth differences of the
residual, in which a smooth misfit cancels.

Not modelled: noise that changes slowly against the sample interval, as after a low-pass filter.
"""

import math
from dataclasses import dataclass

import numpy as np

from fitting.data.frame import MeasuredMotion
from fitting.model.windows import ShootingWindows
from stickslip.compute.arrays import Array, Mask

# Order of differences, and their weights (1, 4, 6, 4, 1) squared and summed.
DIFFERENCE_ORDER, SQUARED_WEIGHTS = 4, 70.0
ROUNDED_TWICE = 0.1  # pitches: counts printed with a few decimals are that near whole multiples of the pitch
# Distance from the belt's speed, over it, within which a reading is left out where counts are rounded.  At half a count
# a sample in the sticks the errors alternate, which the differences take for 1.4 times the noise; at whole counts for
# none.
STEADY_SPEED = 0.1
FASTEST_PATTERN = 0.8  # pitches a sample: slower readings repeat patterns, whose differences are not white
# Variance over that of rounding: less white noise beside it is not distinguished from it.  True encoders give up to 0.3
# by chance, because fast rounding is not quite white; noise as large as the rounding gives 1.
LEAST_WHITE_NOISE = 0.5
JITTER_SHOWN = 4.0  # variance of the jitter, in its standard errors, that is shown
FEWEST_DIFFERENCES = 50  # differences from which noise is estimated
ROUNDING = 1e-9  # distance over the range of the readings: nearer ones are the same


@dataclass(frozen=True)
class PositionNoise:
    pitch: float  # m, step to which readings are rounded; 0 for none
    white: float  # m, standard deviation of white noise before the rounding
    jitter: float  # s, standard deviation of a sample time

    def variance(self, velocity: Array) -> Array:
        """Return the variance (n,) at velocities (n,), m^2."""
        return np.asarray(self.pitch**2 / 12 + self.white**2 + (self.jitter * velocity) ** 2)

    def sd(self, velocity: Array) -> float:
        """Return the standard deviation of a position, m rms over the velocities."""
        return math.sqrt(float(np.mean(self.variance(velocity))))

    @property
    def rounded_alone(self) -> bool:
        return self.white == self.jitter == 0

    def draw(self, position: Array, velocity: Array, rng: np.random.Generator, shift: float) -> Array:
        """Draw position minus reading (n,), m, on a grid moved by ``shift`` pitches: repeated motion rounds alike."""
        spread = np.sqrt(self.white**2 + (self.jitter * velocity) ** 2)
        error = 0.0 if self.rounded_alone else spread * rng.standard_normal(position.size)
        if self.pitch == 0:
            return np.asarray(-error + np.zeros(position.size))
        moved = position + self.pitch * shift
        return np.asarray(moved - (np.floor((moved + error) / self.pitch) + 0.5) * self.pitch)


def estimate_noise(
    windows: ShootingWindows, residual: Array, inliers: Mask, motion: MeasuredMotion, run: int = 0
) -> PositionNoise:
    """Estimate the noise of a run from the residual (N,), m, of its inlier cycles; windows are those of all runs."""
    pitch = reading_pitch(motion.measured)
    rounding = pitch**2 / 12
    interval = float(np.median(np.diff(motion.time)))
    slowest = FASTEST_PATTERN * pitch / interval if motion.resolution < pitch else 0.0
    squares, speeds = [], []
    for k, _, first, count, _, own in windows.table:
        if own == run and inliers[k] and count > DIFFERENCE_ORDER:
            part = slice(first, first + count)
            speed = motion.velocity[windows.source[part]][DIFFERENCE_ORDER // 2 : -DIFFERENCE_ORDER // 2]
            fast = np.abs(speed) >= slowest
            if slowest > 0:
                fast &= np.abs(speed - motion.belt_speed) > STEADY_SPEED * abs(motion.belt_speed)
            squares.append((np.diff(residual[part], DIFFERENCE_ORDER) ** 2 / SQUARED_WEIGHTS)[fast])
            speeds.append(speed[fast] ** 2)
    square, v2 = (np.concatenate(parts) if parts else np.empty(0) for parts in (squares, speeds))
    if square.size < FEWEST_DIFFERENCES:
        return PositionNoise(pitch, math.sqrt(max(motion.resolution**2 - rounding, 0.0)), 0.0)
    middle = v2 - v2.mean()
    slope = float(np.sum(middle * square) / max(np.sum(middle**2), 1e-300))
    white2 = max(float(square.mean()) - max(slope, 0.0) * float(v2.mean()) - rounding, 0.0)
    if white2 < LEAST_WHITE_NOISE * rounding:
        white2 = 0.0
    excess = square - rounding - white2
    scale = max(float(np.sum(v2**2)), 1e-300)
    jitter2 = float(np.sum(excess * v2)) / scale
    error = math.sqrt(float(np.sum(((excess - jitter2 * v2) * v2) ** 2))) / scale
    return PositionNoise(pitch, math.sqrt(white2), math.sqrt(jitter2) if jitter2 > JITTER_SHOWN * error else 0.0)


def reading_pitch(reading: Array) -> float:
    """Return the pitch to which readings (n,) are rounded, m, even one finer than the printed step; 0 without one."""
    values = np.unique(reading)
    gaps = np.diff(values)
    apart = gaps[gaps > ROUNDING * (values[-1] - values[0])]
    if apart.size < FEWEST_DIFFERENCES:
        return 0.0
    place = values - values.mean()
    for least in (float(apart.min()), float(np.quantile(apart, 0.2))):  # a few stray readings spoil the smallest gap
        pitch = float(np.median(apart[apart <= 1.5 * least]))
        number = np.concatenate([[0.0], np.cumsum(np.rint(gaps / pitch))])
        number -= number.mean()
        pitch = float(np.sum(number * place) / np.sum(number**2))
        if float(np.median(np.abs(place - pitch * number))) < ROUNDED_TWICE * pitch:
            return pitch
    return 0.0
