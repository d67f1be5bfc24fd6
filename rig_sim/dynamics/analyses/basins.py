"""Attractors of a map of an interval and their basins, by cell mapping (Hsu).

The interval is divided into cells, and a cell goes where its centre goes.  Every cell so leads to a cycle of cells, or
to where the map is not defined.  A chaotic attractor appears as several cycles, and so may a slow transient: from each
cycle the map itself is iterated, and cycles that lead to a common cell are one attractor.
"""

from dataclasses import dataclass

import numpy as np

from rig_sim.dynamics.analyses.settling import settled
from rig_sim.dynamics.system.interface import OnInterval
from rig_sim.flow.modes import COMPLETED, OUTCOMES
from stickslip.compute.arrays import Array, Integers
from stickslip.compute.stages import Stages, parts, silent

# Iterates of the map itself from each cycle before its attractor counts as reached: twice as many double the cost of a
# sweep.  Near a period doubling an orbit may still be 1e-3 of the interval away after as many.
TRANSIENT = 1000
POINTS = 512  # kept of an attractor that is not periodic
SAME = 1e-9  # share of the interval to which the orbit of a periodic attractor repeats
NOWHERE = -1  # index of what has no attractor


@dataclass(frozen=True)
class Attractor:
    """An attractor.

    Attributes
    ----------
    points : tuple of float
        One period in the order in which they follow, from the smallest; or `POINTS` iterates where it is not periodic.
    period : int or None
        None for a chaotic one, or one whose period is above `rig_sim.dynamics.system.period.LONGEST_PERIOD`.
    share : float
        Of the cells that lead to it.
    """

    points: tuple[float, ...]
    period: int | None
    share: float


@dataclass(frozen=True)
class Basins:
    """Attractors, the largest basin first, and which of them each cell leads to.

    Attributes
    ----------
    attractors : tuple of Attractor
        May be empty.
    nowhere : float
        Share of the cells that lead to where the map is not defined.
    centres : (n,) float64
        Of the cells.
    fate : (n,) int64
        Index of the cell's attractor, or `NOWHERE`.
    cycles : int
        Cycles of cells before they were merged.
    """

    attractors: tuple[Attractor, ...]
    nowhere: float
    centres: Array
    fate: Integers
    cycles: int


def basins(f: OnInterval, cells: int, progress: Stages = silent) -> Basins:
    """Return the attractors of a map and their basins; ``progress`` is called with the stage and what is done of it.

    Raises
    ------
    ValueError
        Fewer than 2 cells.
    """
    if cells < 2:
        raise ValueError(f"{cells} cells; need 2 or more")
    width = (f.hi - f.lo) / cells
    centres: Array = f.lo + width * (np.arange(cells, dtype=np.float64) + 0.5)
    mapped = [f.images(centres[begin:end]) for begin, end in parts("mapping cells", cells, progress)]
    following = cell_of(np.concatenate(mapped), f, cells)
    cycle_of, entries = cell_cycles(following)
    cycles = parts("following cycles", len(entries), progress, 1)
    orbits = [attractor_from(f, float(centres[entries[number]])) for number, _ in cycles]
    visited = [set(cell_of(np.array(orbit[0]), f, cells).tolist()) for orbit in orbits]
    leader = merged(visited)
    kept = [index for index in range(len(entries)) if leader[index] == index and NOWHERE not in visited[index]]
    counts = dict.fromkeys(kept, 0)
    for index in range(len(entries)):
        if leader[index] in counts:
            counts[leader[index]] += int(np.count_nonzero(cycle_of == index))
    kept.sort(key=lambda index: (-counts[index], orbits[index][0]))
    place = {index: rank for rank, index in enumerate(kept)}
    fate_of_cycle = np.array([place.get(leader[index], NOWHERE) for index in range(len(entries))] + [NOWHERE])
    fate = fate_of_cycle[cycle_of]
    found = tuple(Attractor(*orbits[index], counts[index] / cells) for index in kept)
    return Basins(found, float(np.mean(fate == NOWHERE)), centres, fate, len(entries))


def cell_of(x: Array, f: OnInterval, cells: int) -> Integers:
    """Return the cell of each x, shape (n,), or `NOWHERE` outside the interval and where x is NaN."""
    inside = (x >= f.lo) & (x <= f.hi)
    place = np.where(inside, (x - f.lo) / (f.hi - f.lo), 0.0) * cells
    return np.where(inside, np.minimum(place.astype(np.int64), cells - 1), NOWHERE)


def cell_cycles(following: Integers) -> tuple[Integers, list[int]]:
    """Return the cycle that each cell leads to (-1: nowhere), and one cell of every cycle."""
    steps = following.tolist()
    cycle_of = [-2] * len(steps)  # not yet known
    entries: list[int] = []
    for first in range(len(steps)):
        path: list[int] = []
        at = first
        while at != NOWHERE and cycle_of[at] == -2:
            cycle_of[at] = -3  # on this path
            path.append(at)
            at = steps[at]
        if at == NOWHERE:
            found = NOWHERE
        elif cycle_of[at] == -3:
            found = len(entries)
            entries.append(at)
        else:
            found = cycle_of[at]
        for cell in path:
            cycle_of[cell] = found
    return np.array(cycle_of, dtype=np.int64), entries


def attractor_from(f: OnInterval, start: float) -> tuple[tuple[float, ...], int | None]:
    """Return the points of the attractor that ``start`` leads to, and its period; NaN where f is not defined."""
    end = settled(f.motion(np.array([start])), (TRANSIENT,), POINTS, SAME)
    points = end.states[:, 0]
    if end.outcome != OUTCOMES[COMPLETED]:
        points = np.append(points, np.nan)
    if end.period is None:
        return tuple(points.tolist()), None
    return tuple(np.roll(points, -int(np.argmin(points))).tolist()), end.period


def merged(visited: list[set[int]]) -> list[int]:
    """Return, for each set, the first set that it shares an element with, directly or through others."""
    leader = list(range(len(visited)))

    def find(index: int) -> int:
        while leader[index] != index:
            index = leader[index]
        return index

    for index, cells in enumerate(visited):
        for other in range(index):
            if not cells.isdisjoint(visited[other]):
                first, last = sorted((find(index), find(other)))
                leader[last] = first
    return [find(index) for index in range(len(visited))]
