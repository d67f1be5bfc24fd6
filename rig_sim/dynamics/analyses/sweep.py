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
# How long a task, which a process takes at a time, is to take, s.  To send one, and its results, takes 0.2 ms with
# processes and 7 ms with dask: 3 % here, 7 % with half as much.  With twice as much a killed process loses twice as
# much.  0.1 to 0.8 s share out 400 values equally well.
TASK_S = 0.2
# Where fewer tasks are left, they are halved: so the processes end closer together.
LAST_TASKS = 16
# Of the number of values in a task: the next value may take 1000 times longer than one without a drive, done at once.
MOST_GROWTH = 2

Spread = Callable[[Callable[[Any], Any], Iterable[Any]], Iterable[Any]]


@dataclass(frozen=True)
class AttractorAt:
    """An attractor at one value of the parameter."""

    value: float  # of the parameter
    attractor: int  # its number, from 1; at the first value by the size of the basin
    points: tuple[float, ...]  # d in global stick, or x1 on the section; m
    # of the map's orbit, or of a driven mass after how many points of the section the motion repeats; None for one that
    # is not periodic, and where there is no global stick
    period: int | None
    share: float  # of the interval of d that leads to it
    # smallest and largest point; of a driven mass at phase 0 of the drive, whatever the section
    extent: tuple[float, float]
    drive_periods: int | None = None  # of a driven mass: after how many drive periods the motion repeats
    # 'completed'; else what the motion lacks, or, with the number 0 and no points, why no attractor was found
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

    find: The attractors at a value of the parameter, the largest basin first; pickled where ``spread`` uses processes.
    values: Of the parameter.
    spread: The ``map`` that shares out the work, and takes items as it needs them; results do not depend on it.
    progress: Called with the number of values done.
    finished: What ``keep`` was given before an interruption; these values are not computed again.
    keep: Called with a value and what ``find`` returned for it, as soon as it is known.
    """
    known = dict(finished or {})
    missing = [value for value in values if value not in known]
    done = len(values) - len(missing)
    progress(done)
    for value, rows in each_value(find, missing, spread):
        keep(value, rows)
        known[value] = rows
        done += 1
        progress(done)
    found: list[AttractorAt] = []
    last: list[AttractorAt] = []
    for value in values:
        last = numbered(known[value], last) or last
        found += last if known[value] else []
    return found


def each_value(
    find: Callable[[float], list[AttractorAt]], values: Sequence[float], spread: Spread
) -> Iterator[tuple[float, list[AttractorAt]]]:
    """Yield each value with its attractors, in order; for other processes the values are put into tasks of `TASK_S`.

    How many values a task takes follows from how long the last task took that came back.
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

    for results, seconds in spread(partial(timed, find), tasks()):
        fitting = len(results) * TASK_S / max(seconds, 1e-9)
        growing = fitting > MOST_GROWTH * len(results)
        size = max(1, min(round(fitting), MOST_GROWTH * len(results)))
        yield from results


def timed(
    find: Callable[[float], list[AttractorAt]], values: Sequence[float]
) -> tuple[list[tuple[float, list[AttractorAt]]], float]:
    """Return each value with its attractors, and the time that all took, s."""
    begun = time.perf_counter()
    return [(value, find(value)) for value in values], time.perf_counter() - begun


def distinct(points: list[float], tolerance: float) -> tuple[float, ...]:
    """Return the points in increasing order, those within ``tolerance`` of the one before left out."""
    kept: list[float] = []
    for point in sorted(points):
        if not kept or point - kept[-1] > tolerance:
            kept.append(point)
    return tuple(kept)


def numbered(rows: list[AttractorAt], before: list[AttractorAt]) -> list[AttractorAt]:
    """Return attractors with the numbers of the closest ones at the value before; others get numbers not yet in use."""
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
    named = [replace(row, attractor=numbers[i]) for i, row in enumerate(rows)]
    return sorted(named, key=lambda row: row.attractor)
