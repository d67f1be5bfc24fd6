"""Periodic points of a map of an interval: where f^n(x) = x, and the slope of f^n there."""

from dataclasses import dataclass

import numpy as np

from rig_sim.systems.interface import OnInterval, slope, survey
from stickslip.compute.arrays import Array

# Places at which f^n(x) - x is compared with 0; two periodic points between neighbouring places are missed.
PLACES = 2000
FEW = 200  # places at which the map is tried first: where it is defined nowhere, each takes the most steps
SAME = 1e-9  # share of the interval: roots closer than this are one point; also how well f^n(x) = x holds at a root


@dataclass(frozen=True)
class PeriodicPoint:
    """A periodic orbit of a map."""

    points: tuple[float, ...]  # in the order of the orbit, from the smallest
    slope: float  # derivative of f^period, the same at every point

    @property
    def period(self) -> int:
        return len(self.points)

    @property
    def stable(self) -> bool:
        return abs(self.slope) < 1.0


def find_periodic_orbits(
    f: OnInterval, period: int = 1, *, places: int = PLACES, within: tuple[float, float] | None = None
) -> tuple[PeriodicPoint, ...]:
    """Return the orbits of exactly this period with a point in the interval ``within``, by their smallest point."""
    if period < 1:
        raise ValueError(f"the period must be 1 or more, not {period}")
    lo, hi = within or (f.lo, f.hi)
    if within is None and np.all(np.isnan(survey(f, np.linspace(f.lo, f.hi, FEW)))):
        return ()
    x = np.linspace(max(lo, f.lo), min(hi, f.hi), places)
    return find_orbits_between(f, period, x, survey(f, x, period))


def find_orbits_up_to(f: OnInterval, periods: int) -> list[PeriodicPoint]:
    """Return the orbits of periods 1 to ``periods``, as by `find_periodic_orbits`, at the cost of the longest.

    A place from which no stick follows, the costliest one, is tried once.
    """
    if np.all(np.isnan(survey(f, np.linspace(f.lo, f.hi, FEW)))):
        return []
    places = iterate = np.linspace(f.lo, f.hi, PLACES)
    orbits: list[PeriodicPoint] = []
    for period in range(1, periods + 1):
        iterate = survey(f, iterate)
        orbits += find_orbits_between(f, period, places, iterate)
    return orbits


def find_orbits_between(f: OnInterval, period: int, x: Array, iterate: Array) -> tuple[PeriodicPoint, ...]:
    """Return the orbits of exactly this period with a point between neighbours of ``x``, given its iterates."""
    gain = iterate - x
    orbits: list[PeriodicPoint] = []
    for i in np.flatnonzero(np.sign(gain[:-1]) * np.sign(gain[1:]) <= 0.0):
        root = solve_return(f, period, float(x[i]), float(x[i + 1]))
        if root is None or any(
            abs(root - point) <= SAME * (f.hi - f.lo) for points in orbits for point in points.points
        ):
            continue
        points = f.orbit(root, period)
        if any(period % n == 0 and abs(points[n - 1] - root) <= SAME * (f.hi - f.lo) for n in range(1, period)):
            continue
        first = int(np.argmin(points))
        orbits.append(PeriodicPoint(tuple(np.roll(points, -first).tolist()), float(np.prod(slope(f, points)))))
    return tuple(sorted(orbits, key=lambda point: point.points))


def solve_return(f: OnInterval, period: int, first: float, last: float) -> float | None:
    """Return where f^period(x) = x between two places where the gain f^period(x) - x has opposite signs.

    None where the sign changes by a jump of the map.
    """
    from scipy.optimize import brentq

    def gain(x: float) -> float:
        return float(f.images(np.array([x]), period)[0]) - x

    if gain(first) == 0.0:
        return first
    try:
        root = float(brentq(gain, first, last, xtol=1e-15 * (f.hi - f.lo), rtol=8.9e-16))
    except ValueError:  # a place where the map is not defined
        return None
    steepness = max(abs(gain(first)), abs(gain(last))) / (last - first)
    return root if abs(gain(root)) <= SAME * (f.hi - f.lo) * max(1.0, steepness) else None
