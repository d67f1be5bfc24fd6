"""The departures that are tried, a file and a row each: its module, with ``DEPARTURE``.

To admit one, add its file to this folder and its row here.  To remove one, remove both: nothing else names it.
"""

from functools import cache
from importlib import import_module

from fitting.forces.departure import Departure

ROWS = (
    "spring_nonlinear",
    "drag_quadratic",
    "guide_friction",
    "eccentricity",
    "belt_drift",
    "belt_ripple",
    "stiffness_drift",
    "second_mode",
    "friction_by_belt_position",
    "friction_by_mass_position",
)


@cache
def departures(rows: tuple[str, ...] = ROWS) -> tuple[Departure, ...]:
    every = []
    for row in rows:
        departure: Departure = import_module(f"{__name__}.{row}").DEPARTURE
        every.append(departure)
    return tuple(every)
