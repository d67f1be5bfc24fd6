"""Representative stretches of a long record, for what is learned from it without reading all of it."""

from bisect import bisect_left, bisect_right
from collections.abc import Callable
from itertools import pairwise

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from daq.compute.arrays import Array, Integers
from processing.record.series import Series

WINDOW = 2**11  # samples: stretches are so long, or multiples of it
LEAST, MOST = 2**14, 2**17  # samples that the model of a longer record is learned from
SHARE = 1 / 8  # of a record, between those: it costs little, and a record changes
SWINGS = 8  # slips, or swings to and fro, that they hold where the record has them: fewer make no usual one
PARTS, PART = 4, 2**13  # stretches of them at most, and samples of one at least
ACTIVE = 0.2  # of the travel within the most active stretches: less is rest, and says nothing about sticks
STRIDE = 4  # of the samples whose percentiles are a window's travel
READ = 2**15  # samples read at a time
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
    """Return the stretches that the model of a record is learned from, and how far the record travels.

    They are spread evenly over the parts of the record in which the mass moves.  A mass that swings slowly needs longer
    ones.

    Parameters
    ----------
    positions : callable
        Returns the positions of a slice of samples, m.
    n : int
        Samples of the record.

    Returns
    -------
    list of slice
        In order of time, of `LEAST` to `MOST` samples together.
    float
        Between the percentiles 1 and 99 of the positions in any window, m.
    """
    ends, swings = [], 0
    for at in range(0, n, READ):
        x = positions(slice(at, min(at + READ, n)))[::STRIDE]
        whole = x[: x.size // (WINDOW // STRIDE) * (WINDOW // STRIDE)].reshape(-1, WINDOW // STRIDE)
        ends += [np.percentile(own, (1, 99), axis=-1).T for own in (whole, x[whole.size :]) if own.size]
        swings += _swings(x, *np.percentile(x, (1, 99)))
    low, high = np.vstack(ends).T
    travel = float(high.max() - low.min())
    wanted = min(max(LEAST, round(SHARE * n), round(SWINGS * n / swings) if swings else n), MOST)
    parts = min(wanted // PART, PARTS)
    windows = -(-wanted // (parts * WINDOW))  # of each stretch
    slots = n // (windows * WINDOW)
    if slots <= parts:
        return [slice(0, n)], travel
    low, high = (own[: slots * windows].reshape(slots, windows) for own in (low, high))
    travels = high.max(axis=1) - low.min(axis=1)
    active = np.flatnonzero(travels >= ACTIVE * np.median(np.sort(travels)[-parts:]))
    picked = active[np.unique(np.linspace(0, active.size - 1, parts).astype(int))].tolist()
    return [slice(k * windows * WINDOW, (k + 1) * windows * WINDOW) for k in picked], travel


def _swings(x: Array, low: float, high: float) -> int:
    """Return how often the positions go from their lower quarter, of the range low..high, to the upper one and back."""
    side = np.sign(np.round(2 * (x - (low + high) / 2) / max(high - low, 1e-300)))
    turns = np.diff(side[side != 0])
    return int(min(np.count_nonzero(turns > 0), np.count_nonzero(turns < 0)))


def moving_samples(positions: Callable[[slice], Array], n: int, slack: float) -> tuple[int, int]:
    """Return the first and the last sample between rest at the beginning and at the end; (n, -1) if nothing moves.

    At rest the medians of five positions differ by ``slack``, m, at most.
    """
    starts = list(range(0, max(n - 4, 1), WINDOW))

    def away(at: int, rest: float) -> Integers:
        x = positions(slice(at, min(at + WINDOW + 4, n)))
        middle = np.median(sliding_window_view(x, 5), axis=1) if x.size >= 5 else x
        return np.flatnonzero(np.abs(middle - rest) > slack) + at + 2

    begin, end = float(np.median(positions(slice(0, 5)))), float(np.median(positions(slice(max(n - 5, 0), n))))
    first = next((int(found[0]) for at in starts if (found := away(at, begin)).size), n)
    last = next((int(found[-1]) for at in reversed(starts) if (found := away(at, end)).size), -1)
    return first, last
