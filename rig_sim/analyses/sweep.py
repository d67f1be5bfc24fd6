"""Attractors over a parameter: a bifurcation diagram.

At every value the attractors are found anew, so that none is lost where another one has the larger basin, and values
can be shared out over processes.  Attractors of neighbouring values are then numbered alike where they lie closest.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

SAME_POINT = 1e-7  # share of the interval: points of the section closer than this are drawn as one

Spread = Callable[[Callable[[Any], Any], Iterable[Any]], Iterable[Any]]


@dataclass(frozen=True)
class AttractorAt:
    """An attractor at one value of the parameter."""

    value: float  # of the parameter
    attractor: int  # its number, from 1; at the first value by the size of the basin
    points: tuple[float, ...]  # d in global stick, or x1 on the section; m
    # of the map's orbit, or points of the section in one period of a driven mass; None where not periodic, or no stick
    period: int | None
    share: float  # of the interval of d that leads to it
    # smallest and largest point; of a driven mass at phase 0 of the drive, whatever the section
    extent: tuple[float, float]
    drive_periods: int | None = None  # of a driven mass: drive periods in one period of the motion
    # 'completed', or why the motion has no points, or, with the number 0, why there is no attractor
    outcome: str = "completed"


def sweep(
    find: Callable[[float], list[AttractorAt]],
    values: Sequence[float],
    *,
    spread: Spread = map,
    progress: Callable[[float], None] = lambda _: None,
    finished: Mapping[float, list[AttractorAt]] | None = None,
    keep: Callable[[float, list[AttractorAt]], None] = lambda *_: None,
) -> list[AttractorAt]:
    """Return the attractors at every value, in order.

    ``find`` returns the attractors at a value, the largest basin first; it is pickled where ``spread``, a ``map`` that
    shares out the work, uses processes.  ``keep`` is called with a value and its attractors as soon as they are known;
    ``finished`` are those kept before an interruption, which are not computed again.
    """
    results = dict(finished or {})
    missing = [value for value in values if value not in results]
    done = len(values) - len(missing)
    progress(done)
    for value, attractors in zip(missing, spread(find, missing), strict=True):
        keep(value, attractors)
        results[value] = attractors
        done += 1
        progress(done)
    rows_in_order: list[AttractorAt] = []
    previous: list[AttractorAt] = []
    for value in values:
        previous = number_as_before(results[value], previous) or previous
        rows_in_order += previous if results[value] else []
    return rows_in_order


def merge_close_points(points: list[float], tolerance: float) -> tuple[float, ...]:
    """Return the points in increasing order, without those within ``tolerance`` of the one before."""
    distinct: list[float] = []
    for point in sorted(points):
        if not distinct or point - distinct[-1] > tolerance:
            distinct.append(point)
    return tuple(distinct)


def number_as_before(rows: list[AttractorAt], before: list[AttractorAt]) -> list[AttractorAt]:
    """Return attractors with the numbers of the closest ones at the value before; new ones get unused numbers."""
    if not before or not rows or rows[0].attractor == 0:
        return rows
    previous = [row for row in before if row.value == before[-1].value and row.attractor > 0]
    pairs = sorted(
        (sum(abs(a - b) for a, b in zip(row.extent, old.extent, strict=True)), i, old.attractor)
        for i, row in enumerate(rows)
        for old in previous
    )
    numbers: dict[int, int] = {}
    for _, i, number in pairs:
        if i not in numbers and number not in numbers.values():
            numbers[i] = number
    for i in range(len(rows)):
        if i not in numbers:
            numbers[i] = next(n for n in range(1, len(rows) + len(previous) + 1) if n not in numbers.values())
    renumbered = [replace(row, attractor=numbers[i]) for i, row in enumerate(rows)]
    return sorted(renumbered, key=lambda row: row.attractor)
