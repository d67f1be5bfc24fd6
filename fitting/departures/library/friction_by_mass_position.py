"""Friction that depends on where the mass is: F (1 + a sin(2 pi x/L + phase)), x over ground.

a is relative.  The wavelength L is scanned up to the travel: longer ones look like another spring.  Source: worn
tracks, as in E. Rabinowicz, Friction and Wear of Materials, 1995, ch. 4.
"""

from fitting.forces.departure import Departure, Forcing, harmonic, spaced, speed_of_wave
from fitting.forces.fitted_motion import FittedMotion
from stickslip.compute.arrays import Array

SHORTEST_WAVELENGTH = 0.08  # wavelength over the travel: what repeats more often in a slip averages out


def forcing(trajectory: FittedMotion, wavelength: float) -> Forcing:
    phase = speed_of_wave(wavelength) * trajectory.position
    return Forcing(acceleration=harmonic(phase, trajectory.friction))


def wavelengths(trajectory: FittedMotion) -> Array:
    return spaced(SHORTEST_WAVELENGTH * trajectory.travel, trajectory.travel, trajectory.travel)


DEPARTURE = Departure(
    name="friction-by-mass-position",
    text="friction that changes along the travel of the mass",
    parameter="a",
    unit="",
    columns=2,
    scale="wavelength",
    scale_unit="m",
    scales=wavelengths,
    forcing=forcing,
)
