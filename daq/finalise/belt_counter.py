"""The belt's own encoder: its count without roll-over, and the belt's speed computed from it.

One up-and-down counter, as wide as the board's others.  Between two readings it is taken to have moved the shorter way
round, which is right as long as it moves by less than half its range.

The speed is a difference quotient over `SPAN_S`, no filter: what is known, not what is likely.  `processing` smooths
the counts as it smooths those of the mass.
"""

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from daq.runfile.rig import Rig
from daq.wire import counters

SPAN_S = 0.02  # of the difference: a 7.7 um count then reads to 0.3 mm/s, and a corner is blurred by 10 ms


def decoded(
    values: NDArray[np.integer] | None,
    time: NDArray[np.float64],
    starts: NDArray[np.int64],
    rate_hz: float,
    rig: Rig,
) -> tuple[NDArray[np.int64], NDArray[np.float64]] | tuple[None, None]:
    """Return the belt's count and speed, as `unwrapped` and `velocity` do.

    Both are None if the board sends no belt counts, or if their metres per count are unknown; the data sent remain in
    the raw columns.
    """
    pitch = rig.belt_metres_per_count
    if values is None or pitch is None:
        return None, None
    count = unwrapped(values, rig.counter_bits, starts)
    return count, velocity(count, time, starts, rate_hz, pitch.value)


def unwrapped(values: NDArray[np.integer], bits: int, starts: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the belt's count without roll-over, (n,), each segment beginning at its own first reading.

    Parameters
    ----------
    values : (n,) integers
        As sent, modulo 2^bits.
    bits : int
        Width of the counter.
    starts : (s,) int64
        First sample of each segment: nothing is carried over.
    """
    count = np.empty(len(values), dtype=np.int64)
    for first, last in pairwise([*starts.tolist(), len(values)]):
        count[first] = int(values[first])
        count[first + 1 : last] = count[first] + np.cumsum(counters.moves(values[first:last], bits))
    return count


def velocity(
    count: NDArray[np.int64],
    time: NDArray[np.float64],
    starts: NDArray[np.int64],
    rate_hz: float,
    metres_per_count: float,
) -> NDArray[np.float64]:
    """Return the belt's mean speed over `SPAN_S` about each sample, m/s, signed, (n,).

    At the ends of a segment the span is cut short; a segment of one sample has speed 0.
    """
    half = max(1, round(SPAN_S * rate_hz / 2))
    speed = np.zeros(len(count))
    for first, last in pairwise([*starts.tolist(), len(count)]):
        if last - first < 2:
            continue
        at = np.arange(first, last)
        low, high = np.maximum(at - half, first), np.minimum(at + half, last - 1)
        speed[first:last] = (count[high] - count[low]) * metres_per_count / (time[high] - time[low])
    return speed
