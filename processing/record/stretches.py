"""Representative stretches of a long record, for what is learned from it without reading all of it."""

from bisect import bisect_left, bisect_right
from itertools import pairwise

import numpy as np

from processing.record.series import Series

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
