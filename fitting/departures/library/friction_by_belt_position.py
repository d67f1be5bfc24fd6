"""Friction that depends on the place on the belt: F (1 + a sin(2 pi (b - x)/L + phase)), b the belt's travel.

a is relative, L the length of the belt, scanned: from a fraction of a slip to the way of the belt in the whole record.
What changes from one slip to the next only is a scatter of the friction level; what changes within a slip is seen here.
"""

from fitting.forces.departure import Departure, Forcing, harmonic, spaced, speed_of_wave
from fitting.forces.fitted_motion import FittedMotion
from stickslip.compute.arrays import Array

# Length over the way between mass and belt in a cycle: a shorter belt turns more than once in a cycle.
SHORTEST_BELT = 0.7
LONGEST_BELT = 0.7  # length over the way in the whole record: on a longer one a place that does not come back is wear


def forcing(trajectory: FittedMotion, length: float) -> Forcing:
    phase = speed_of_wave(length) * (trajectory.belt_position - trajectory.position)
    return Forcing(acceleration=harmonic(phase, trajectory.friction))


def lengths(trajectory: FittedMotion) -> Array:
    way = trajectory.belt_way
    return spaced(SHORTEST_BELT * way / trajectory.cycles, LONGEST_BELT * way, way)


DEPARTURE = Departure(
    name="friction-by-belt-position",
    text="friction that changes along the belt",
    parameter="a",
    unit="",
    columns=2,
    scale="belt length",
    scale_unit="m",
    scales=lengths,
    forcing=forcing,
)
