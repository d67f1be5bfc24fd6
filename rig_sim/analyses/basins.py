"""Attractors of a map of an interval and their basins, by cell mapping (Hsu).

The interval is divided into cells, and a cell goes where its centre goes.  Every cell so leads to a cycle of cells, or
to where the map is not defined.  A chaotic attractor appears as several cycles, and so may a slow transient: from each
cycle the map itself is iterated, and cycles that lead to a common cell are one attractor.
"""

from dataclasses import dataclass, field

import numpy as np

from rig_sim.analyses.settling import settle
from rig_sim.flow.modes import COMPLETED, OUTCOMES
from rig_sim.systems.interface import OnInterval
from stickslip.compute.arrays import Array, Integers
from stickslip.compute.stages import Stages, parts, silent

# Iterates of the map itself from each cycle before its attractor counts as reached.  Near a period doubling an orbit
# may still be 1e-3 of the interval away.
TRANSIENT = 1000
POINTS = 512  # of an attractor that is not periodic
SAME = 1e-9  # share of the interval within which the orbit of a periodic attractor repeats
NOWHERE = -1  # index for cells without an attractor


@dataclass(frozen=True)
class Attractor:
    # one period in the order of the orbit, from the smallest; or `POINTS` iterates where it is not periodic
    points: tuple[float, ...]
    # None for a chaotic one, or a period above `LONGEST_PERIOD`
    period: int | None
    share: float  # of the cells that lead to it


@dataclass(frozen=True)
class Basins:
    """Attractors of a map of an interval, the largest basin first, and their basins.

    Attributes
    ----------
    range : tuple of float
        The interval, m.
    shares : tuple of float
        Of the interval that lead to each attractor.
    attractors : tuple of Attractor
        Points, period (None where it is not periodic) and share.
    nowhere : float
        Share that leads to no global stick, or to where the map is not defined.
    cells, cycles : int
        Cells of the interval, and cycles of cells before they were merged.
    centres, fate : (cells,) arrays
        Of each cell, and the index of its attractor, or -1.
    """

    range: tuple[float, float]
    shares: tuple[float, ...]
    attractors: tuple[Attractor, ...]
    nowhere: float
    cells: int
    cycles: int
    centres: Array = field(repr=False, compare=False)
    fate: Integers = field(repr=False, compare=False)


def basins(f: OnInterval, cells: int, progress: Stages = silent) -> Basins:
    """Return the attractors of a map and their basins; ``progress`` is called with the stage and its number done."""
    if cells < 2:
        raise ValueError(f"the number of cells must be 2 or more, not {cells}")
    width = (f.hi - f.lo) / cells
    centres: Array = f.lo + width * (np.arange(cells, dtype=np.float64) + 0.5)
    mapped = [f.images(centres[begin:end]) for begin, end in parts("mapping cells", cells, progress)]
    following = find_cells(np.concatenate(mapped), f, cells)
    cycle_of, entries = find_cell_cycles(following)
    cycles = parts("following cycles", len(entries), progress, 1)
    orbits = [follow_to_attractor(f, float(centres[entries[number]])) for number, _ in cycles]
    visited = [set(find_cells(np.array(orbit[0]), f, cells).tolist()) for orbit in orbits]
    leader = merge_sets(visited)
    leaders = [index for index in range(len(entries)) if leader[index] == index and NOWHERE not in visited[index]]
    counts = dict.fromkeys(leaders, 0)
    for index in range(len(entries)):
        if leader[index] in counts:
            counts[leader[index]] += int(np.count_nonzero(cycle_of == index))
    leaders.sort(key=lambda index: (-counts[index], orbits[index][0]))
    ranks = {index: rank for rank, index in enumerate(leaders)}
    fate_of_cycle = np.array([ranks.get(leader[index], NOWHERE) for index in range(len(entries))] + [NOWHERE])
    fate = fate_of_cycle[cycle_of]
    attractors = tuple(Attractor(*orbits[index], counts[index] / cells) for index in leaders)
    shares, nowhere = tuple(attractor.share for attractor in attractors), float(np.mean(fate == NOWHERE))
    return Basins((f.lo, f.hi), shares, attractors, nowhere, cells, len(entries), centres, fate)


def find_cells(x: Array, f: OnInterval, cells: int) -> Integers:
    """Return the cell of each x, shape (n,), or `NOWHERE` outside the interval and where x is NaN."""
    inside = (x >= f.lo) & (x <= f.hi)
    position = np.where(inside, (x - f.lo) / (f.hi - f.lo), 0.0) * cells
    return np.where(inside, np.minimum(position.astype(np.int64), cells - 1), NOWHERE)


def find_cell_cycles(following: Integers) -> tuple[Integers, list[int]]:
    """Return the cycle that each cell leads to (-1: nowhere), and one cell of every cycle."""
    steps = following.tolist()
    cycle_of = [-2] * len(steps)  # not yet known
    entries: list[int] = []
    for first in range(len(steps)):
        path: list[int] = []
        cell = first
        while cell != NOWHERE and cycle_of[cell] == -2:
            cycle_of[cell] = -3  # on this path
            path.append(cell)
            cell = steps[cell]
        if cell == NOWHERE:
            cycle = NOWHERE
        elif cycle_of[cell] == -3:
            cycle = len(entries)
            entries.append(cell)
        else:
            cycle = cycle_of[cell]
        for visited in path:
            cycle_of[visited] = cycle
    return np.array(cycle_of, dtype=np.int64), entries


def follow_to_attractor(f: OnInterval, start: float) -> tuple[tuple[float, ...], int | None]:
    """Return the points of the attractor that ``start`` leads to, and its period; NaN where f is not defined."""
    end = settle(f.motion(np.array([start])), (TRANSIENT,), POINTS, SAME)
    points = end.states[:, 0]
    if end.outcome != OUTCOMES[COMPLETED]:
        points = np.append(points, np.nan)
    if end.period is None:
        return tuple(points.tolist()), None
    return tuple(np.roll(points, -int(np.argmin(points))).tolist()), end.period


def merge_sets(visited: list[set[int]]) -> list[int]:
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
