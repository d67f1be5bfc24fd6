"""The departures that are tried, one row each; a departure is a module with ``DEPARTURE``.

To admit one, add its file to `fitting.departures.library` and its row here.  To remove one, remove both: nothing else
names it.
"""

from functools import cache
from importlib import import_module

from fitting.forces.departure import Departure

LIBRARY = "fitting.departures.library"
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
    """Return the departures of the rows."""
    found = []
    for row in rows:
        departure: Departure = import_module(f"{LIBRARY}.{row}").DEPARTURE
        found.append(departure)
    return tuple(found)
