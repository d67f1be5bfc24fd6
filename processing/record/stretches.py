"""Representative stretches of a long record, for what is learned from it without reading all of it."""

import math
from bisect import bisect_left, bisect_right
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from processing.record.series import Series
from processing.record.units import Units, power_of_two
from stickslip.compute.arrays import Array, Integers

WINDOW = 2**11  # samples: stretches are so long, or multiples of it
# Samples of a record that is learned from as a whole: it is smoothed in one block, from what was found on the way.
WHOLE = 2**16
LEAST, MOST = 2**14, 2**17  # samples that the model of a longer record is learned from
PART = 2**15  # samples of one stretch of them at least: the sticks that its ends cut are odd ones
SHARE = 1 / 8  # of a record, between those: it costs little, and a record changes
SWINGS = 12  # slips, or swings to and fro, that they hold where the record has them: of fewer, landings are told late
ACTIVE = 0.2  # of the travel within the most active stretches: less is rest, and says nothing about sticks
STRIDE = 4  # of the samples whose percentiles are a window's travel
READ = 2**15  # samples read at a time
REST = 8  # samples: the medians of five of a shorter rest are few
# Times the slack, and times as long.  A mass that turns leaves the place of its turn four times as far in twice the
# time.  Where it turned a little before, it passes its first place once more: in (1 + sqrt(5))/(1 + sqrt(2)) = 1.34 of
# the time at least, 1.25 where readings are whole counts.  A stick takes four times as long.
FARTHER, TURNING = 4.0, 1.25
SHORTEST = 16  # samples: a stretch below this is left out (third differences of fewer say little)


def representative_stretches(series: Series, most: int, parts: int = 8) -> list[slice]:
    """Return the stretches without holes from the first motion on.

    A record of more than ``most`` samples is represented by ``parts`` windows of ``most // parts`` samples, spread
    evenly; a hole inside a window divides it.

    series: The record.
    most: Samples returned at most.
    parts: Windows of a longer record.
    Returns: In order of time within each run without holes; each of at least `SHORTEST` samples.
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


@dataclass(frozen=True, eq=False)
class Survey:
    """How a record of n samples moves: the percentiles 1 and 99 of the positions in each window, m, and its swings.

    ``way`` is the sum of the cubes of its steps: its sign is the way in which it moves fast.
    """

    low: Array
    high: Array
    swings: int
    way: float
    n: int

    @property
    def travel(self) -> float:
        """How far the record travels, m."""
        return float(self.high.max() - self.low.min())

    def units(self, interval: float, start: float) -> Units:
        """Return the units of the record, of this sample interval, s, whose time is counted from about ``start``, s.

        That is a multiple of the unit of time: no time is rounded.
        """
        unit = power_of_two(interval)
        return Units(math.copysign(power_of_two(self.travel), -self.way), unit, math.floor(start / unit) * unit)

    def stretches(self, least: int) -> list[slice]:
        """Return the stretches that the model of the record is learned from, in order of time.

        They are spread evenly over the parts of the record in which the mass moves, and have ``least`` to `MOST`
        samples together: of a record that swings slowly, and of a long one, more.  A record of `WHOLE` samples is one.
        """
        if self.n <= WHOLE:
            return [slice(0, self.n)]
        slow = round(SWINGS * self.n / self.swings) if self.swings else self.n
        wanted = min(max(least, round(SHARE * self.n), slow), MOST)
        parts = max(wanted // PART, 1)
        windows = -(-wanted // (parts * WINDOW))  # of each stretch
        slots = self.n // (windows * WINDOW)
        if slots <= parts:
            return [slice(0, self.n)]
        low, high = (own[: slots * windows].reshape(slots, windows) for own in (self.low, self.high))
        travels = high.max(axis=1) - low.min(axis=1)
        active = np.flatnonzero(travels >= ACTIVE * np.median(np.sort(travels)[-parts:]))
        middles = (np.arange(parts) + 0.5) / parts  # of equal parts of what moves
        picked = np.unique(active[(middles * active.size).astype(int)]).tolist()
        return [slice(k * windows * WINDOW, (k + 1) * windows * WINDOW) for k in picked]


def survey(positions: Callable[[slice], Array], n: int) -> Survey:
    """Look through a record; ``positions`` returns those of a slice of its n samples, m."""
    ends, swings, way = [], 0, 0.0
    for at in range(0, n, READ):
        x = positions(slice(at, min(at + READ, n)))[::STRIDE]
        whole = x[: x.size // (WINDOW // STRIDE) * (WINDOW // STRIDE)].reshape(-1, WINDOW // STRIDE)
        ends += [_ends(own) for own in (whole, x[None, whole.size :]) if own.size]
        swings += _swings(x, *_ends(x[None])[0])
        way += float(np.sum(np.diff(x) ** 3))
    low, high = np.vstack(ends).T
    return Survey(low, high, swings, way, n)


def _ends(x: Array) -> Array:
    """Return about the percentiles 1 and 99 of each row of (k, m): of the mirror image the same, (k, 2)."""
    few = x.shape[1] // 100
    return np.partition(x, (few, x.shape[1] - 1 - few), axis=1)[:, [few, x.shape[1] - 1 - few]]


def _swings(x: Array, low: float, high: float) -> int:
    """Return how often the positions go from their lower quarter, of the range low..high, to the upper one and back."""
    side = np.sign(np.round(2 * (x - (low + high) / 2) / max(high - low, 1e-300)))
    turns = np.diff(side[side != 0])
    return int(min(np.count_nonzero(turns > 0), np.count_nonzero(turns < 0)))


def moving_samples(positions: Callable[[slice], Array], n: int, slack: float) -> tuple[int, int]:
    """Return the first and the last sample between rest at the beginning and at the end; (n, -1) if nothing moves.

    At rest the medians of five positions differ by ``slack`` at most.  A mass that turns round stays as near its place
    for a while, too, and needs up to twice as long to leave it four times as far; one that rested hardly longer.
    """
    starts = list(range(0, max(n - 4, 1), WINDOW))

    def away(at: int, place: float, least: float) -> Integers:
        x = positions(slice(at, min(at + WINDOW + 4, n)))
        middle = np.median(sliding_window_view(x, 5), axis=1) if x.size >= 5 else x
        return np.flatnonzero(np.abs(middle - place) > least) + at + 2

    def leaves(place: float, ahead: list[int], nearest: int, least: float) -> int | None:
        return next((int(found[nearest]) for at in ahead if (found := away(at, place, least)).size), None)

    begin, end = float(np.median(positions(slice(0, 5)))), float(np.median(positions(slice(max(n - 5, 0), n))))
    first, last = leaves(begin, starts, 0, slack), leaves(end, starts[::-1], -1, slack)
    if first is None or last is None or first > last:
        return n, -1
    far = leaves(begin, starts[first // WINDOW :], 0, FARTHER * slack)
    # The place was left within the sample interval before.
    if first <= REST or (far is not None and far > TURNING * (first - 1)):
        first = 0
    far = leaves(end, starts[last // WINDOW :: -1], -1, FARTHER * slack)
    if n - 1 - last <= REST or (far is not None and n - 1 - far > TURNING * (n - 2 - last)):
        last = n - 1
    return first, last
