"""Representative stretches of a long record, for what is learned from it without reading all of it."""

from bisect import bisect_left, bisect_right
from collections.abc import Callable
from itertools import pairwise

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from daq.compute.arrays import Array, Integers
from processing.record.series import Series

LEARNED = 2**17  # samples that the estimates of a longer record are made from: 40 slips of the published 376 s
PARTS = 4  # stretches of them: each must hold some sticks and slips; with 8 of half the length slow ones are cut
ACTIVE = 0.2  # of the travel within the most active stretches: less is rest, and says nothing about sticks
STRIDE = 4  # of the samples whose percentiles are a stretch's travel
SHORTEST = 16  # samples: a stretch below this is left out (third differences of fewer say little)


def representative_stretches(series: Series, most: int, parts: int = 8) -> list[slice]:
    """Return the stretches without holes from the first motion on.

    A record of more than ``most`` samples is represented by ``parts`` windows of ``most // parts`` samples, spread
    evenly; a hole inside a window divides it.

    Parameters
    ----------
    series : Series
        The record.
    most : int
        Samples returned at most.
    parts : int
        Windows of a longer record.

    Returns
    -------
    list of slice
        In order of time within each run without holes; each of at least `SHORTEST` samples.
    """
    # At rest the count does not move, so those samples carry no information about the noise.
    moving = np.flatnonzero(np.abs(series.position) > 1.5 * series.pitch)
    begin = max(int(moving[0]) - 1, 0) if moving.size else 0
    cuts = {own.start for own in series.pieces if own.start > begin}
    steps = np.diff(series.time[begin:])
    usual = max(series.interval, float(np.percentile(steps, 90))) if steps.size else series.interval
    cut = sorted(cuts | set((np.flatnonzero(steps > 1.5 * usual) + 1 + begin).tolist()))
    edges = [begin, *cut, series.time.size]
    runs = [slice(first, last) for first, last in pairwise(edges) if last - first >= SHORTEST]
    if sum(run.stop - run.start for run in runs) <= most:
        return runs
    length = most // parts
    at = np.linspace(begin, series.time.size - length, parts).astype(int)
    windows = [(int(first), int(first) + length) for first in at]
    starts, stops = ([getattr(run, end) for run in runs] for end in ("start", "stop"))
    inside = [
        slice(max(run.start, low), min(run.stop, high))
        for low, high in windows
        for run in runs[bisect_right(stops, low) : bisect_left(starts, high)]
    ]
    return [own for own in inside if own.stop - own.start >= SHORTEST]


def learning_stretches(positions: Callable[[slice], Array], n: int) -> tuple[list[slice], float]:
    """Return the stretches of a record that its noise levels, thresholds and speeds are estimated from, and its travel.

    They are spread evenly over the parts of the record in which the mass moves.

    Parameters
    ----------
    positions : callable
        Returns the positions of a slice of samples, m.
    n : int
        Samples of the record.

    Returns
    -------
    list of slice
        In order of time, `LEARNED` samples at most.
    float
        Between the percentiles 1 and 99 of the positions in any stretch, m.
    """
    length = LEARNED // PARTS
    starts = list(range(0, n, length)) if n <= LEARNED else [*range(0, n - length, length), n - length]
    ends = [np.percentile(positions(slice(at, at + length))[::STRIDE], (1, 99)) for at in starts]
    low, high = np.array(ends).T
    travel = float(high.max() - low.min())
    if n <= LEARNED:
        return [slice(0, n)], travel
    travels = high - low
    active = np.flatnonzero(travels >= ACTIVE * np.median(np.sort(travels)[-PARTS:]))
    picked = active[np.unique(np.linspace(0, active.size - 1, PARTS).astype(int))].tolist()
    # The last one ends with the record, and may begin within the one before it.
    begins = [starts[k] for k in picked]
    if len(begins) > 1 and begins[-1] < begins[-2] + length:
        begins[-2] = begins[-1] - length
    return [slice(at, at + length) for at in sorted(set(begins))], travel


def moving_samples(positions: Callable[[slice], Array], n: int, slack: float) -> tuple[int, int]:
    """Return the first and the last sample between rest at the beginning and at the end; (n, -1) if nothing moves.

    At rest the medians of five positions differ by ``slack``, m, at most.
    """
    length = LEARNED // PARTS
    starts = list(range(0, max(n - 4, 1), length))

    def away(at: int, rest: float) -> Integers:
        x = positions(slice(at, min(at + length + 4, n)))
        middle = np.median(sliding_window_view(x, 5), axis=1) if x.size >= 5 else x
        return np.flatnonzero(np.abs(middle - rest) > slack) + at + 2

    begin, end = float(np.median(positions(slice(0, 5)))), float(np.median(positions(slice(max(n - 5, 0), n))))
    first = next((int(found[0]) for at in starts if (found := away(at, begin)).size), n)
    last = next((int(found[-1]) for at in reversed(starts) if (found := away(at, end)).size), -1)
    return first, last
