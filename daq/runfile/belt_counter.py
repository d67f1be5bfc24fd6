"""The belt's own encoder: its count without roll-over, and the belt's speed computed from it.

One up-and-down counter, as wide as the board's others.  Between two readings it is taken to have moved the shorter way
round, which is right as long as it moves by less than half its range.

The speed is a difference quotient over `SPAN_S`, no filter: what is known, not what is likely.  `processing` smooths
the counts as it smooths those of the mass.
"""

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from daq.runfile.spill import BLOCK
from daq.wire import counters

# Time over which counts are subtracted: a 7.7 um count then reads to 0.3 mm/s, and a corner is blurred by 10 ms.
SPAN_S = 0.02


class BeltCount:
    """The belt's count without roll-over, each segment starting at its own first reading, piece by piece."""

    def __init__(self) -> None:
        self._last: tuple[int, int] | None = None  # reading and count

    def take(
        self, values: NDArray[np.integer], begins: NDArray[np.bool_], bits: NDArray[np.int64]
    ) -> NDArray[np.int64]:
        """Return the count of the next readings, (n,), sent modulo 2^bits; ``begins`` marks the first of a segment."""
        readings = values.astype(np.int64)
        first, begins = readings.copy(), begins.copy()
        if self._last is not None:
            readings, begins = np.concatenate(([self._last[0]], readings)), np.concatenate(([True], begins))
            first, bits = np.concatenate(([self._last[1]], first)), np.concatenate((bits[:1], bits))
        if len(readings) == 0:
            return readings
        count = counters.running_sum(begins, counters.diff_signed(readings, bits[1:]), first)
        new_counts = count[0 if self._last is None else 1 :]
        self._last = int(readings[-1]), int(count[-1])
        return new_counts


def unwrap_count(values: NDArray[np.integer], bits: int, starts: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the belt's count without roll-over, (n,); each segment starts at its own first reading."""
    begins = np.zeros(len(values), dtype=np.bool_)
    begins[starts] = True
    return BeltCount().take(values, begins, np.full(len(values), bits))


def yield_velocities(
    count: NDArray[np.int64],
    time: NDArray[np.float64],
    starts: NDArray[np.int64],
    rate_hz: float,
    metres_per_count: float,
) -> Iterator[NDArray[np.float64]]:
    """Yield the belt's mean speed over `SPAN_S` around each sample, m/s, shorter at the ends of a segment, in pieces.

    ``count`` and ``time`` may be `daq.runfile.spill.Column`.
    """
    half = max(1, round(SPAN_S * rate_hz / 2))
    for first, last in pairwise([*starts.tolist(), len(count)]):
        if last - first < 2:
            yield np.zeros(last - first)
            continue
        for begin in range(first, last, BLOCK):
            samples = np.arange(begin, min(begin + BLOCK, last))
            low, high = np.maximum(samples - half, first), np.minimum(samples + half, last - 1)
            base = int(low[0])
            counts, times = count[base : int(high[-1]) + 1], time[base : int(high[-1]) + 1]
            low, high = low - base, high - base
            yield (counts[high] - counts[low]) * metres_per_count / (times[high] - times[low])
