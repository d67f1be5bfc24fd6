"""Belt speed without load, compliance and remaining variation of the belt, estimated from belt counts.

A belt that slows in proportion to its load loses ``compliance`` metres a second per metre of spring extension.  In
stick the load is the spring force, so the belt's measured velocity against the mass's position is a straight line of
slope -compliance, whatever the friction law: this calibration does not depend on the fit, which uses it as a prior.  In
the flow it is droop = compliance Fs/k (`rig_sim.flow.flow.Flow`).

Samples within half a smoothing window of a stick's ends are left out, where slip is blurred into it.  The error of the
line is the larger of two: for residuals that are correlated within a smoothing window, and for residuals that are
correlated within a stick (ripple, a joint).
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fitting.least_squares.linear import least_squares
from processing.record.kinematics import Kinematics
from stickslip.compute.arrays import Array
from stickslip.units import Measured

COMPLIANCE_SHOWN = 3.0  # standard errors of the slope: a belt with a smaller one is taken as stiff
LEAST_VARIATION = 2e-3  # residual variation, over the belt's speed, that gives a warning
VARIATION_SHOWN = 2.0  # residual variation over what counting alone shows: less is none


@dataclass(frozen=True)
class BeltLine:
    """The belt's velocity against the mass's position in stick, with the record's signs."""

    speed: Measured  # m/s, signed, at ``middle``: errors of speed and slope are then independent
    slope: Measured  # d(velocity)/d(position), 1/s; -compliance
    middle: float  # m, the mean position of the samples
    speed_variation: float  # m/s, root mean square of what the line leaves, less the noise of counting

    @property
    def slows_under_load(self) -> bool:
        return -self.slope.value > COMPLIANCE_SHOWN * self.slope.sd

    @property
    def is_unsteady(self) -> bool:
        return self.speed_variation > LEAST_VARIATION * abs(self.speed.value)

    def speed_without_load(self, rest: Measured) -> Measured:
        """Return the belt's speed where the spring is relaxed (``rest``, m), with its error."""
        reach = rest.value - self.middle
        value = self.speed.value + self.slope.value * reach
        return Measured(value, math.hypot(self.speed.sd, math.hypot(self.slope.sd * reach, self.slope.value * rest.sd)))


def fit_belt_line(kinematics: Kinematics) -> BeltLine | None:
    """Fit the belt's line; None where the belt was not counted or no stick is long enough.

    Not modelled: a belt whose compliance is not proportional to the load, or lags it.
    """
    velocity, errors = kinematics.belt_velocity, kinematics.belt_velocity_errors
    if velocity is None or errors is None:
        return None
    half = kinematics.window // 2
    parts = [np.arange(stick.first + half, stick.last + 1 - half) for stick in kinematics.sticks]
    parts = [part for part in parts if part.size > kinematics.window]
    if not parts:
        return None
    index = np.concatenate(parts)
    x, v = kinematics.steady_position[index], velocity[index]
    middle = float(x.mean())
    columns = np.c_[np.ones_like(x), x - middle]
    line, rest = least_squares(columns, v)
    spread = np.maximum(_alike_in_windows(columns, rest, kinematics.window), _alike_in_sticks(columns, rest, parts))
    noise = float(np.sqrt(np.mean(errors[index] ** 2)))
    seen = float(np.sqrt(np.mean(rest**2)))
    variation = math.sqrt(max(seen**2 - noise**2, 0.0)) if seen > VARIATION_SHOWN * noise else 0.0
    pitch = kinematics.recording.rig.belt_metres_per_count
    scale = 0.0 if pitch is None else abs(pitch.sd / pitch.value)
    speed = Measured(float(line[0]), math.hypot(float(spread[0]), scale * float(line[0])))
    return BeltLine(speed, Measured(float(line[1]), float(spread[1])), middle, variation)


def _alike_in_windows(columns: Array, rest: Array, window: int) -> Array:
    """Return a line's standard errors for residuals correlated over ``window`` samples; orthogonal columns."""
    square = float(np.sum(rest**2)) / max(rest.size / window - 2, 1)
    return np.asarray(np.sqrt(square / np.sum(columns**2, axis=0)))


def _alike_in_sticks(columns: Array, rest: Array, parts: list[NDArray[np.int64]]) -> Array:
    """Return a line's standard errors for residuals correlated within a stick; orthogonal columns."""
    ends = np.cumsum([part.size for part in parts])[:-1]
    pushes = np.array([np.sum(part, axis=0) for part in np.split(columns * rest[:, None], ends)])
    few = len(parts) / max(len(parts) - 1, 1)
    return np.asarray(np.sqrt(few * np.sum(pushes**2, axis=0)) / np.sum(columns**2, axis=0))
