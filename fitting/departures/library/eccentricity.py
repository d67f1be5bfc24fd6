"""An eccentric encoder wheel: the reading has an error e sin(2 pi x/L + phase), once per revolution L of travel.

A camera or a laser has no wheel: there an error that repeats along the travel is its lens or its scale.

e in m.  The revolution is the record's own calibration (counts per revolution times metres per count) where it has one;
else it is scanned.  Source: encoder makers' notes on eccentricity error; the first harmonic of the angle.
"""

import numpy as np

from fitting.forces.departure import Departure, Forcing, harmonic, spaced, speed_of_wave
from fitting.forces.fitted_motion import FittedMotion
from stickslip.compute.arrays import Array

SMALLEST_REVOLUTION = 0.04  # revolution over the travel: a smaller wheel would turn 25 times in a slip


def forcing(trajectory: FittedMotion, revolution: float) -> Forcing:
    angle = speed_of_wave(revolution) * trajectory.position[trajectory.samples]
    return Forcing(reading=harmonic(angle))


def revolutions(trajectory: FittedMotion) -> Array:
    """Return the calibrated length of one revolution, m, or those up to the travel."""
    if trajectory.revolution is not None:
        return np.array([trajectory.revolution])
    return spaced(SMALLEST_REVOLUTION * trajectory.travel, trajectory.travel, trajectory.travel)


DEPARTURE = Departure(
    name="eccentricity",
    text="an eccentric encoder wheel",
    text_of_positions="lens distortion or an uneven scale",
    parameter="e",
    unit="m",
    columns=2,
    scale="revolution",
    scale_unit="m",
    scales=revolutions,
    forcing=forcing,
)
