"""Representative stretches of a long record, to learn its model without reading all of it."""

import math
from bisect import bisect_left, bisect_right
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from processing.record.series import Series, Units, power_of_two
from stickslip.compute.arrays import Array, Integers

WINDOW = 2**11  # samples: the length of stretches is a multiple of it
WHOLE = 2**16  # samples: a shorter record is learned from as a whole
LEAST, MOST = 2**14, 2**17  # samples that the model of a longer record is learned from
PART = 2**15  # samples of one stretch, at least, because its ends cut sticks
SHARE = 1 / 8  # of a record that is learned from, between those limits
SWINGS = 12  # slips, or swings to and fro, that the stretches contain if the record has them
ACTIVE = 0.2  # of the travel within the most active stretches: less is rest, without information on sticks
STRIDE = 4  # of the samples whose percentiles are the travel of a window
READ = 2**15  # samples read at a time
REST = 8  # samples of the shortest rest, which has few medians of five
# Times the slack, and times as long: a mass that turns is four times as far away after twice the time, or 1.25 times
# where it passes its first position once more; a stick takes four times as long.
FARTHER, TURNING = 4.0, 1.25
SHORTEST = 16  # samples of a stretch: fewer third differences determine no noise


def representative_stretches(series: Series, most: int, parts: int = 8) -> list[slice]:
    """Return the stretches without holes from the first motion on, each of at least `SHORTEST` samples.

    A record of more than ``most`` samples is represented by ``parts`` windows of ``most // parts`` samples, spread
    evenly; a hole inside a window divides it.
    """
    # At rest the count is constant, so those samples contain no information about the noise.
    moving = np.flatnonzero(np.abs(series.position) > 1.5 * series.pitch)
    begin = max(int(moving[0]) - 1, 0) if moving.size else 0
    cuts = {piece.start for piece in series.pieces if piece.start > begin}
    steps = np.diff(series.time[begin:])
    usual = max(series.interval, float(np.percentile(steps, 90))) if steps.size else series.interval
    cut = sorted(cuts | set((np.flatnonzero(steps > 1.5 * usual) + 1 + begin).tolist()))
    edges = [begin, *cut, series.time.size]
    runs = [slice(first, last) for first, last in pairwise(edges) if last - first >= SHORTEST]
    if sum(run.stop - run.start for run in runs) <= most:
        return runs
    length = most // parts
    starts_of_windows = np.linspace(begin, series.time.size - length, parts).astype(int)
    windows = [(int(first), int(first) + length) for first in starts_of_windows]
    starts, stops = ([getattr(run, end) for run in runs] for end in ("start", "stop"))
    inside = [
        slice(max(run.start, low), min(run.stop, high))
        for low, high in windows
        for run in runs[bisect_right(stops, low) : bisect_left(starts, high)]
    ]
    return [piece for piece in inside if piece.stop - piece.start >= SHORTEST]


@dataclass(frozen=True, eq=False)
class Survey:
    """Range and swings of a record."""

    low: Array  # percentile 1 of the positions in each window, m
    high: Array  # percentile 99
    swings: int
    cubed_steps: float  # sum of the cubes of the steps, whose sign is the direction of fast motion
    n: int  # samples

    @property
    def travel(self) -> float:
        """Range of the positions, m."""
        return float(self.high.max() - self.low.min())

    def units(self, interval: float, start: float) -> Units:
        """Return the units of a record with this sample interval, s, and time counted from about ``start``, s.

        The start is rounded down to a multiple of the unit of time, so that no time is rounded.
        """
        unit = power_of_two(interval)
        return Units(math.copysign(power_of_two(self.travel), -self.cubed_steps), unit, math.floor(start / unit) * unit)

    def stretches(self, least: int) -> list[slice]:
        """Return the stretches that the model of the record is learned from, in order of time.

        They are spread evenly over the parts in which the mass moves, and have ``least`` to `MOST` samples in total,
        more for a record that swings slowly and for a long one.
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
        low, high = (column[: slots * windows].reshape(slots, windows) for column in (self.low, self.high))
        travels = high.max(axis=1) - low.min(axis=1)
        active = np.flatnonzero(travels >= ACTIVE * np.median(np.sort(travels)[-parts:]))
        middles = (np.arange(parts) + 0.5) / parts  # of equal parts of what moves
        picked = np.unique(active[(middles * active.size).astype(int)]).tolist()
        return [slice(k * windows * WINDOW, (k + 1) * windows * WINDOW) for k in picked]


def survey(positions: Callable[[slice], Array], n: int) -> Survey:
    """Survey a record of n samples; ``positions`` returns those of a slice of it, m."""
    ends, swings, cubed_steps = [], 0, 0.0
    for first in range(0, n, READ):
        x = positions(slice(first, min(first + READ, n)))[::STRIDE]
        whole = x[: x.size // (WINDOW // STRIDE) * (WINDOW // STRIDE)].reshape(-1, WINDOW // STRIDE)
        ends += [_range_of_rows(block) for block in (whole, x[None, whole.size :]) if block.size]
        swings += _count_swings(x, *_range_of_rows(x[None])[0])
        cubed_steps += float(np.sum(np.diff(x) ** 3))
    low, high = np.vstack(ends).T
    return Survey(low, high, swings, cubed_steps, n)


def _range_of_rows(x: Array) -> Array:
    """Return about the percentiles 1 and 99 of each row of (k, m), symmetric under mirroring, (k, 2)."""
    few = x.shape[1] // 100
    return np.partition(x, (few, x.shape[1] - 1 - few), axis=1)[:, [few, x.shape[1] - 1 - few]]


def _count_swings(x: Array, low: float, high: float) -> int:
    """Return how often the positions go from the lower quarter of the range low..high to the upper one and back."""
    side = np.sign(np.round(2 * (x - (low + high) / 2) / max(high - low, 1e-300)))
    turns = np.diff(side[side != 0])
    return int(min(np.count_nonzero(turns > 0), np.count_nonzero(turns < 0)))


def moving_samples(positions: Callable[[slice], Array], n: int, slack: float) -> tuple[int, int]:
    """Return the first and the last sample between rest at the beginning and at the end; (n, -1) if nothing moves.

    At rest the medians of five positions differ by at most ``slack``.  A mass that turns round also stays near one
    position, but needs up to twice as long to be four times as far away; after rest it needs hardly longer.
    """
    starts = list(range(0, max(n - 4, 1), WINDOW))

    def find_away(window_start: int, rest_position: float, least: float) -> Integers:
        x = positions(slice(window_start, min(window_start + WINDOW + 4, n)))
        middle = np.median(sliding_window_view(x, 5), axis=1) if x.size >= 5 else x
        return np.flatnonzero(np.abs(middle - rest_position) > least) + window_start + 2

    def find_leaving(rest_position: float, ahead: list[int], nearest: int, least: float) -> int | None:
        return next(
            (int(samples[nearest]) for start in ahead if (samples := find_away(start, rest_position, least)).size), None
        )

    begin, end = float(np.median(positions(slice(0, 5)))), float(np.median(positions(slice(max(n - 5, 0), n))))
    first, last = find_leaving(begin, starts, 0, slack), find_leaving(end, starts[::-1], -1, slack)
    if first is None or last is None or first > last:
        return n, -1
    far = find_leaving(begin, starts[first // WINDOW :], 0, FARTHER * slack)
    # The mass left its position within the sample interval before.
    if first <= REST or (far is not None and far > TURNING * (first - 1)):
        first = 0
    far = find_leaving(end, starts[last // WINDOW :: -1], -1, FARTHER * slack)
    if n - 1 - last <= REST or (far is not None and n - 1 - far > TURNING * (n - 2 - last)):
        last = n - 1
    return first, last
