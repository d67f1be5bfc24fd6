"""Attractors over a parameter: a bifurcation diagram.

At every value the attractors are found anew, so that none is lost where another one has the larger basin, and values
can be shared out over processes.  Attractors of neighbouring values are then numbered alike where they lie closest.
"""

import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

SAME_POINT = 1e-7  # share of the interval: points of the section closer than this are drawn as one
# Duration of a task for one process, s.  To send one, and its results, takes 0.2 ms with processes, 7 ms with dask.
TASK_S = 0.2
# Where fewer tasks remain, they are halved, so that the processes end closer together.
LAST_TASKS = 16
# Of the number of values in a task: the next value may take 1000 times longer than one without a drive.
MOST_GROWTH = 2

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
    for value, attractors in find_each(find, missing, spread):
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


def find_each(
    find: Callable[[float], list[AttractorAt]], values: Sequence[float], spread: Spread
) -> Iterator[tuple[float, list[AttractorAt]]]:
    """Yield each value with its attractors, in order; for other processes the values are grouped in tasks of `TASK_S`.

    The number of values in a task follows from the duration of the last task that came back.
    """
    if spread is map:  # in this process: each value is at hand as soon as it is found
        yield from ((value, find(value)) for value in values)
        return
    size, growing = 1, True

    def tasks() -> Iterator[Sequence[float]]:
        first = 0
        while first < len(values):
            number = size
            if not growing:
                number = max(min(size, (len(values) - first) // LAST_TASKS), (size + 1) // 2)
            task = values[first : first + number]
            first += len(task)
            yield task

    for results, seconds in spread(partial(find_timed, find), tasks()):
        fitting = len(results) * TASK_S / max(seconds, 1e-9)
        growing = fitting > MOST_GROWTH * len(results)
        size = max(1, min(round(fitting), MOST_GROWTH * len(results)))
        yield from results


def find_timed(
    find: Callable[[float], list[AttractorAt]], values: Sequence[float]
) -> tuple[list[tuple[float, list[AttractorAt]]], float]:
    """Return each value with its attractors, and the time that all took, s."""
    started = time.perf_counter()
    return [(value, find(value)) for value in values], time.perf_counter() - started


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
