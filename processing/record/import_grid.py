"""The even grid of a long import, learned in one pass over its times: the same as `series.nominal` gives.

An import has no sample numbers: intervals are multiples of the usual one, and the grid runs from the first
time to the last.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from daq.runfile.store import RunReader
from processing.record.series import interval_numbers
from stickslip.compute.arrays import Array


@dataclass(frozen=True)
class ImportGrid:
    """First time and step of the grid, s, the usual interval, and the numbers on the grid of the samples asked for."""

    start: float
    step: float
    usual: float
    numbers: dict[int, int]

    def times(self, low: int, recorded: Array) -> Array:
        """Return the grid's times of the samples from ``low`` on, one of those that were asked for."""
        steps = np.concatenate(([0], np.cumsum(interval_numbers(np.diff(recorded), self.usual))))
        return np.asarray(self.start + (self.numbers[low] + steps) * self.step)


def learn(run: RunReader, lows: Sequence[int]) -> ImportGrid:
    """Learn the grid of a run's samples; ``lows`` are increasing sample numbers, the first of them 0.

    The usual interval is the median of those of the stretches between ``lows``.
    """
    edges = [*lows, run.samples - 1]
    usual = float(np.median([np.median(np.diff(_times(run, own))) for own in _stretches(edges)]))
    numbers, number, start, end = {0: 0}, 0, 0.0, 0.0
    for first, last in _stretches(edges):
        time = _times(run, (first, last))
        start = float(time[0]) if first == 0 else start
        end = float(time[-1])
        number += int(interval_numbers(np.diff(time), usual).sum())
        numbers[last] = number
    return ImportGrid(start, (end - start) / number, usual, numbers)


def _stretches(edges: Sequence[int]) -> list[tuple[int, int]]:
    return [(first, last) for first, last in pairwise(edges) if last > first]


def _times(run: RunReader, own: tuple[int, int]) -> Array:
    return run.load(slice(own[0], own[1] + 1)).time
