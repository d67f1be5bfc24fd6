"""The even grid of a long import, learned in one pass over its times, equal to that of `series.nominal_times`.

An import has no sample numbers: intervals are multiples of the usual one, and the grid runs from the first
time to the last.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from daq.runfile.store import RunReader
from processing.record.series import count_intervals
from stickslip.compute.arrays import Array


@dataclass(frozen=True)
class ImportGrid:
    start: float  # first time, s
    step: float  # s
    usual: float  # interval of the recorded times, s
    numbers: dict[int, int]  # number on the grid of some samples

    def times(self, low: int, recorded: Array) -> Array:
        """Return the times on the grid of the samples from ``low`` on, which `numbers` must contain."""
        steps = np.concatenate(([0], np.cumsum(count_intervals(np.diff(recorded), self.usual))))
        return np.asarray(self.start + (self.numbers[low] + steps) * self.step)


def learn(run: RunReader, lows: Sequence[int]) -> ImportGrid:
    """Learn the grid of a run, with the numbers of the samples ``lows``, which increase from 0.

    The usual interval is the median over the stretches between ``lows``.
    """
    edges = [*lows, run.samples - 1]
    usual = float(np.median([np.median(np.diff(_times(run, samples))) for samples in _stretches(edges)]))
    numbers, number, start, end = {0: 0}, 0, 0.0, 0.0
    for first, last in _stretches(edges):
        time = _times(run, (first, last))
        start = float(time[0]) if first == 0 else start
        end = float(time[-1])
        number += int(count_intervals(np.diff(time), usual).sum())
        numbers[last] = number
    return ImportGrid(start, (end - start) / number, usual, numbers)


def _stretches(edges: Sequence[int]) -> list[tuple[int, int]]:
    return [(first, last) for first, last in pairwise(edges) if last > first]


def _times(run: RunReader, samples: tuple[int, int]) -> Array:
    return run.load(slice(samples[0], samples[1] + 1)).time
