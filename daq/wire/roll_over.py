"""Counters that roll over or restart: detected where a record shows it beyond doubt, and undone exactly.

A counter of 16 bits jumps by 2^16 when it rolls over; others are set to zero at a limit, or by an index pulse once a
revolution.  The jumps have one size but for an ordinary step, and begin and end at the limits of the readings.  A torn
or lost reading jumps too, but from anywhere.  Not undone: a counter that moves by half its range within a sample.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

BITS = range(8, 33)
# Times the longest ordinary step: how far a jump may be from its usual size or from a limit.  The fastest motion may
# fall on a jump, and its neighbours be slower.
SLACK = 2.0
PIECE = 1 << 18  # readings examined together; each takes 50 bytes


@dataclass(frozen=True)
class RollOver:
    """A counter's range and how often it rolled over."""

    counts: int
    times: int

    def __str__(self) -> str:
        bits = self.counts.bit_length() - 1
        size = f"2^{bits}" if self.counts == 1 << bits else f"{self.counts}"
        return f"{self.times} time{'s' if self.times > 1 else ''} by {size} counts"


def find_roll_over(count: NDArray[np.int64]) -> RollOver | None:
    """Return the range of a counter from its readings; None if it does not roll over."""
    step = np.diff(count)
    size = np.abs(step)
    if step.size < 3 or not size.any():
        return None
    largest = int(size.max())
    jumps = np.flatnonzero(size > largest / 2)
    ordinary = int(np.max(np.delete(size, jumps), initial=0))
    reach = SLACK * ordinary + 1
    if 2 * jumps.size > step.size or largest / 2 <= reach or np.ptp(size[jumps]) > 2 * reach:
        return None
    # The neighbours of a jump show how far the counter would have moved.
    motion = 0.5 * (step[np.maximum(jumps - 1, 0)] + step[np.minimum(jumps + 1, step.size - 1)])
    motion = np.where(np.abs(motion) > ordinary, 0.0, motion)
    sizes = np.sign(step[jumps]) * (step[jumps] - motion)

    def roughness(counts: float) -> float:
        return float(np.sum(np.abs(sizes - counts))) + 1.0

    usual = round(float(np.median(sizes)))
    low, high = int(count.min()), int(count.max())
    # Ranges that a counter may have: a power of two, a round number of counts a revolution, the limits that it reached;
    # one that restarts from zero on either side reaches its limits.
    limits = [*(1 << bits for bits in BITS), round(usual, -2), high - low + 1]
    limits = [high + 1, 1 - low, *limits] if high - low > usual + reach else [*limits, high + 1, 1 - low]
    near_usual = [limit for limit in limits if abs(limit - usual) <= reach]
    least = min(map(roughness, [usual, *near_usual]))
    likely = [limit for limit in near_usual if roughness(limit) <= least * (1 + 1 / math.sqrt(jumps.size))]
    counts = likely[0] if likely else usual
    ends = np.stack([count[jumps], count[jumps + 1]])
    edges = np.array([low, high, 0, counts, -counts])
    at_edges = np.min(np.abs(ends[:, :, np.newaxis] - edges), axis=2) <= reach
    outside = high - low > counts + reach and max(high, -low) > counts + reach
    return None if outside or not at_edges.all() else RollOver(counts, int(jumps.size))


def unroll(count: NDArray[np.int64], roll_over: RollOver) -> NDArray[np.int64]:
    turns = np.rint(np.diff(count) / roll_over.counts).astype(np.int64)
    jumps = roll_over.counts * np.concatenate(([0], np.cumsum(turns)))
    return np.asarray(count - jumps, np.int64)


def survey_roll_over(count: NDArray[np.int64], segment: NDArray[np.unsignedinteger]) -> RollOver | None:
    """Return the most frequent roll-over within the segments of a long run."""
    times: dict[int, int] = {}
    for begin in range(0, count.size, PIECE):
        piece = slice(begin, begin + PIECE + 1)
        ends = np.flatnonzero(np.diff(np.asarray(segment[piece]).astype(np.int64))) + 1
        for readings in np.split(np.asarray(count[piece]), ends):
            roll_over = find_roll_over(readings)
            if roll_over is not None:
                times[roll_over.counts] = times.get(roll_over.counts, 0) + roll_over.times
    counts = max(times, key=times.__getitem__, default=None)
    return None if counts is None else RollOver(counts, times[counts])
