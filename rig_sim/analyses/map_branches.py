"""Periodic orbits of a map over a parameter, and where they appear, vanish or change stability.

Orbits of periods 1 and 2 are found at every value and matched from value to value.  Between neighbouring values:

    period-doubling   the slope of an orbit passes -1
    fold              a stable and an unstable orbit, present at one value, are gone at the next: the map touches the
                      diagonal where they meet
    crisis            an extremum of the map inside the interval that an unstable orbit of period 2 bounds passes one of
                      its ends, so that a chaotic attractor within it ends (a boundary crisis)
"""

from collections.abc import Callable, Iterator, Sequence
from functools import partial

import numpy as np

from rig_sim.analyses.basins import follow_to_attractor
from rig_sim.analyses.periodic_points import PeriodicPoint, find_orbits_up_to, find_periodic_orbits
from rig_sim.analyses.special_points import (
    Branch,
    BranchPoint,
    Continuation,
    SpecialPoint,
    find_zero,
    minimise,
)
from rig_sim.systems.interface import OnInterval

MapAt = Callable[[float], OnInterval]
PERIODS = 2  # orbits of periods 1 to this are followed
LARGEST_STEP = 0.08  # share of the interval: an orbit moves less from value to value
PLACES = 400  # at which an orbit is searched for around its last position
HALVINGS = 6  # of the step in which two orbits vanish, before the search for the point where they meet
STEEPEST = 0.5  # of the interval between two orbits' points: a rise between neighbouring places that counts as a jump


def map_continuation(
    map_at: MapAt, values: Sequence[float], *, progress: Callable[[float], None] = lambda _: None
) -> Continuation:
    """Return the branches of periodic orbits and the special points between the values, in increasing order."""
    branches: list[Branch] = []
    points: list[SpecialPoint] = []
    open_branches: dict[PeriodicPoint, Branch] = {}
    previous_orbits: list[PeriodicPoint] = []
    previous = values[0]
    for done, value in enumerate(values, 1):
        f = map_at(value)
        orbits = find_orbits_up_to(f, PERIODS)
        pairs = match_orbits(previous_orbits, orbits, LARGEST_STEP * (f.hi - f.lo))
        points += find_special_points(map_at, (previous, value), previous_orbits, orbits, pairs)
        earlier = {id(new): old for old, new in pairs}
        branches_here: dict[PeriodicPoint, Branch] = {}
        for orbit in orbits:
            old = earlier.get(id(orbit))
            branch = open_branches.get(old) if old else None
            if branch is None or branch.stable != orbit.stable:
                branch = Branch(f"period {orbit.period}", orbit.stable)
                branches.append(branch)
            branch.rows.append(BranchPoint(value, orbit))
            branches_here[orbit] = branch
        open_branches, previous_orbits, previous = branches_here, orbits, value
        progress(done)
    return Continuation(tuple(branches), tuple(sorted(points, key=lambda point: point.value)))


def match_orbits(
    before: Sequence[PeriodicPoint], after: Sequence[PeriodicPoint], near: float
) -> list[tuple[PeriodicPoint, PeriodicPoint]]:
    """Return pairs of an orbit before and after: the closest pairs of one period first."""
    distances = sorted(
        (orbit_distance(old, new), i, j)
        for i, old in enumerate(before)
        for j, new in enumerate(after)
        if old.period == new.period
    )
    pairs: dict[int, int] = {}
    for apart, i, j in distances:
        if apart <= near and i not in pairs and j not in pairs.values():
            pairs[i] = j
    return [(before[i], after[j]) for i, j in pairs.items()]


def orbit_distance(orbit: PeriodicPoint, other: PeriodicPoint) -> float:
    """Return the largest distance between the points of two orbits of one period, each in order of size."""
    return max(abs(a - b) for a, b in zip(sorted(orbit.points), sorted(other.points), strict=True))


def find_special_points(
    map_at: MapAt,
    span: tuple[float, float],
    before: Sequence[PeriodicPoint],
    after: Sequence[PeriodicPoint],
    pairs: Sequence[tuple[PeriodicPoint, PeriodicPoint]],
) -> Iterator[SpecialPoint]:
    """Yield the special points between two neighbouring values."""
    for old, new in pairs:
        if (old.slope < -1.0) != (new.slope < -1.0):
            value = find_zero(partial(slope_excess, map_at, span, old, new), *span)
            if value is not None:
                yield SpecialPoint("period-doubling", value)
        if old.period == 2 and not old.stable and not new.stable:
            value = find_zero(partial(chaos_margin, map_at, span, old, new), *span)
            if value is not None and is_chaotic_inside(map_at, span, old, new, value):
                yield SpecialPoint("crisis", value)
    ended = [orbit for orbit in before if all(orbit is not old for old, _ in pairs)]
    started = [orbit for orbit in after if all(orbit is not new for _, new in pairs)]
    for orbits, (existing, missing) in ((ended, span), (started, span[::-1])):
        for stable in orbits:
            partners = [other for other in orbits if other.period == stable.period and other.slope > 1.0]
            if stable.stable and partners:
                partner = min(partners, key=partial(orbit_distance, stable))
                value = find_fold(map_at, stable, partner, existing, missing)
                if value is not None:
                    yield SpecialPoint("fold", value)


def interpolate_orbit(
    map_at: MapAt, span: tuple[float, float], old: PeriodicPoint, new: PeriodicPoint, value: float
) -> PeriodicPoint | None:
    """Return the orbit at a value between two values at which it is known."""
    share = (value - span[0]) / (span[1] - span[0])
    guess = (1.0 - share) * min(old.points) + share * min(new.points)
    f = map_at(value)
    reach = 1.5 * abs(min(old.points) - min(new.points)) + 1e-4 * (f.hi - f.lo)
    orbits = find_periodic_orbits(f, old.period, places=PLACES, within=(guess - reach, guess + reach))
    return min(orbits, key=lambda orbit: abs(min(orbit.points) - guess)) if orbits else None


def slope_excess(
    map_at: MapAt, span: tuple[float, float], old: PeriodicPoint, new: PeriodicPoint, value: float
) -> float | None:
    orbit = interpolate_orbit(map_at, span, old, new, value)
    return None if orbit is None else orbit.slope + 1.0


def chaos_margin(
    map_at: MapAt, span: tuple[float, float], old: PeriodicPoint, new: PeriodicPoint, value: float
) -> float | None:
    """Return by how much the map's extrema between the two points of an orbit stay inside the points.

    None without an extremum, or where the map jumps between the points.
    """
    orbit = interpolate_orbit(map_at, span, old, new, value)
    if orbit is None:
        return None
    lo, hi = sorted(orbit.points)
    f = map_at(value)
    x = np.linspace(lo, hi, PLACES)
    y = f.images(x)
    rises = np.diff(y)
    if not np.all(np.abs(rises) < STEEPEST * (hi - lo)):
        return None
    turns = np.flatnonzero(rises[:-1] * rises[1:] < 0.0)
    if len(turns) == 0:
        return None
    extrema = [find_extremum(f, 1, 1.0 if rises[i] > 0.0 else -1.0, x[i], x[i + 2])[1] for i in turns]
    return min(hi - max(extrema), min(extrema) - lo)


def is_chaotic_inside(
    map_at: MapAt, span: tuple[float, float], old: PeriodicPoint, new: PeriodicPoint, value: float
) -> bool:
    """Return whether the motion between the two points of an orbit is chaotic just where it is still confined there."""
    step = 1e-6 * (span[1] - span[0])
    inside = max(
        (value - step, value + step), key=lambda candidate: chaos_margin(map_at, span, old, new, candidate) or -np.inf
    )
    orbit = interpolate_orbit(map_at, span, old, new, inside)
    return orbit is not None and follow_to_attractor(map_at(inside), float(np.mean(orbit.points)))[1] is None


def find_extremum(f: OnInterval, times: int, sign: float, lo: float, hi: float) -> tuple[float, float]:
    """Return where f^times is largest (``sign`` 1) or smallest (-1) between lo and hi, and its value there."""

    def falling(x: float) -> float:
        return -sign * float(f.images(np.array([x]), times)[0])

    x, value = minimise(falling, lo, hi, 1e-9 * (hi - lo))
    return x, -sign * value


def find_fold(
    map_at: MapAt, stable: PeriodicPoint, unstable: PeriodicPoint, existing: float, missing: float
) -> float | None:
    """Return where two orbits that exist at one value and not at the other meet; None where they end otherwise."""
    period = stable.period
    for _ in range(HALVINGS):
        middle = 0.5 * (existing + missing)
        f = map_at(middle)
        orbits = find_periodic_orbits(f, period)
        near = LARGEST_STEP * (f.hi - f.lo)
        pairs = {id(old): new for old, new in match_orbits([stable, unstable], orbits, near)}
        if id(stable) in pairs and id(unstable) in pairs and pairs[id(stable)].slope < 1.0 < pairs[id(unstable)].slope:
            stable, unstable, existing = pairs[id(stable)], pairs[id(unstable)], middle
        else:
            missing = middle
    x_stable, x_unstable = min(
        ((a, b) for a, b in zip(sorted(stable.points), sorted(unstable.points), strict=True)),
        key=lambda pair: abs(pair[0] - pair[1]),
    )
    centre = 0.5 * (x_stable + x_unstable)
    sign = 1.0 if float(map_at(existing).images(np.array([centre]), period)[0]) > centre else -1.0
    half = abs(x_stable - x_unstable)

    def touch(value: float) -> float | None:
        f = map_at(value)

        def shortfall(x: float) -> float:
            return -sign * (float(f.images(np.array([x]), period)[0]) - x)

        return -minimise(shortfall, centre - half, centre + half, 1e-9 * half)[1]

    return find_zero(touch, existing, missing)
