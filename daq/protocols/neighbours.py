"""Lines without a checksum, held against their neighbours: which counts cannot be true, and which times.

A flipped digit is still a digit, so a damaged line may look like a sound one.  Two rules find it:

- a count is damaged when it leaps away from the counts before and after it and back, or stands alone off the smooth
  course of its neighbours, whether their printed times or whole periods are taken as the course's abscissa;
- a time is not true when it is out of order, or stands alone off the course of its neighbours and the count does not
  bear it out.  Then the count is kept and the time is interpolated: a timer that is 4 us late now and then is no
  damage (63 of 2400 correct lines were taken for damaged).

`daq.protocols.judge` applies them to a stream of lines; see there for how far each of them looks.

What stands alone leaves a trace: a value off by e is off the cubic through two neighbours on either side by e, and they
are off theirs by -2e/3 and e/6.  A jump, a velocity step, a gap or noise that is as large all about leaves another.
"""

import numpy as np
from numpy.typing import NDArray

from daq.wire.counters import diff_signed

LEAP_COUNTS = 32
LEAP_MOTIONS = 8  # how much farther than the motion about it a count must leap to be damaged
SPIKE_LEAST = 3.0  # counts, or us: how far off the course of its neighbours a value is not true
SPIKE_OVER_USUAL = 12  # and over what is usual about it
SPIKE_AMONG = 16  # lines on either side, without the nearest, that define what is usual
LOOK_AHEAD = 8  # lines among which the one must be that follows the last good one, where times disagree
WIDEST = 6  # periods that five lines may span for their counts to be held against each other: two lines are missing


def time_ahead(first: np.int64 | NDArray[np.int64], ticks: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return by how much n times modulo 2^32 are ahead of one, or each of another one, (n,); negative: behind."""
    return (ticks - first + 0x80000000 & 0xFFFFFFFF) - 0x80000000


def leaps(count: NDArray[np.int64], bits: int) -> NDArray[np.bool_]:
    """Return which counts (modulo 2^bits) leap away from both their neighbours, by far more than the motion about."""
    leaps = np.zeros(len(count), dtype=np.bool_)
    size = np.abs(diff_signed(count, bits))
    least = np.minimum(size[:-1], size[1:])
    half = 1 << (bits - 1)
    across = np.abs((count[2:] - count[:-2] + half & (1 << bits) - 1) - half)  # from one neighbour to the other
    maybe = np.flatnonzero((least > LEAP_COUNTS) & (across < least)) + 1
    if len(maybe) == 0:
        return leaps
    # The typical step of five lines on either side, whichever is more: a mass may stop dead or start at once.
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(size, 5, mode="edge"), 5)  # [i]: steps i - 5 ... i - 1
    motion = np.maximum(np.median(windows[maybe - 1], axis=1), np.median(windows[maybe + 6], axis=1))
    leaps[maybe] = least[maybe - 1] > LEAP_COUNTS + LEAP_MOTIONS * motion
    return leaps


def off_course(
    ticks: NDArray[np.int64],
    count: NDArray[np.int64],
    time: NDArray[np.int64],
    number: NDArray[np.int64],
    *,
    bits: int,
    period: float,
    resolution: int,
) -> tuple[NDArray[np.bool_], NDArray[np.int64], NDArray[np.int64]]:
    """Return which counts are damaged, (n,); the lines whose times are not true, (m,), and their times by the course.

    ``time`` and ``number`` are the ticks without roll-over and the periods since the first line of the stream, (n,).  A
    time is a whole number of periods and a phase: missing lines do not disturb the course of the phases.
    """
    n = len(ticks)
    damaged = np.zeros(n, dtype=np.bool_)
    if n < 2 * SPIKE_AMONG:
        return damaged, np.zeros(0, dtype=np.int64), ticks[:0]
    place = np.arange(n)
    motion = running(diff_signed(count, bits))
    phase = time - period * number
    size = _size(phase)
    late = np.flatnonzero(size > SPIKE_LEAST)
    off, alone = _alone(place, phase, late, _slack(size, late))
    late, course = late[alone], ticks[late[alone]] - np.round(off[alone]).astype(np.int64)

    size = _size(motion)
    near = np.ones(n, dtype=np.bool_)  # five lines about it follow each other, with two missing at most
    near[2:-2] = number[4:] - number[:-4] <= WIDEST
    asked = size > SPIKE_LEAST
    asked[late] = True
    at = np.flatnonzero(near & asked)
    slack = _slack(size, at) + resolution * np.abs(motion[at + 1] - motion[at - 1]) / (2 * period)
    by_number, off_number = _alone(number, motion, at, slack)
    by_time, off_time = _alone(time, motion, at, slack)
    back = running((np.diff(time) <= 0).astype(np.int64))  # steps so far that do not advance: they make no course
    damaged[at] = off_number & (off_time | (back[at + 3] > back[at - 3]))
    true = np.zeros(n, dtype=np.bool_)
    true[at] = np.abs(by_time) + 1 < np.abs(by_number)  # the count bears its printed time out
    untrue = ~true[late]
    return damaged, late[untrue], course[untrue]


def running(step: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the running sum of the steps between n values, (n,), from 0."""
    return np.concatenate((np.zeros(1, dtype=np.int64), np.cumsum(step)))


def _size(y: NDArray[np.int64] | NDArray[np.float64]) -> NDArray[np.float64]:
    """Return how far each of n equidistant values is off the cubic through its four neighbours; 0 at the ends."""
    size = np.zeros(len(y))
    size[2:-2] = np.abs(np.diff(y, 4)) / 6
    size[[2, -3]] = 0.0  # their neighbours' own residuals are not known
    return size


def _slack(size: NDArray[np.float64], at: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return how far off its course a value may be, for each of the lines ``at``.

    What is usual is the median of some on either side, whichever is more, those that a spike disturbs left out.
    """
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(size, SPIKE_AMONG, mode="edge"), SPIKE_AMONG - 2)
    usual = np.maximum(np.median(windows[at], axis=1), np.median(windows[at + SPIKE_AMONG + 3], axis=1))
    return SPIKE_LEAST + SPIKE_OVER_USUAL * usual


def _alone(
    x: NDArray[np.int64], y: NDArray[np.int64] | NDArray[np.float64], at: NDArray[np.int64], slack: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return how far y of the lines ``at`` is off the course of its neighbours, and where it alone is."""
    with np.errstate(divide="ignore", invalid="ignore"):  # of equal x
        before, weight_before = _residual(x, y, at - 1)
        off, _ = _residual(x, y, at)
        after, weight_after = _residual(x, y, at + 1)
        trace = np.maximum(np.abs(before + weight_before[2] * off), np.abs(after + weight_after[1] * off))
        size = np.abs(off)
        # A kick has -1/2 beside it where a spike has -2/3.
        return off, (size > slack) & (trace < np.minimum(0.15 * size, 0.08 * size + 0.5))


def _residual(
    x: NDArray[np.int64], y: NDArray[np.int64] | NDArray[np.float64], at: NDArray[np.int64]
) -> tuple[NDArray[np.float64], list[NDArray[np.float64]]]:
    """Return y less the cubic in x through two neighbours on either side, and the weights of these four (Lagrange)."""
    beside = [at + k for k in (-2, -1, 1, 2)]
    ahead = [(x[k] - x[at]).astype(np.float64) for k in beside]
    weights = []
    for own in ahead:
        weight = np.ones(len(at))
        for other in ahead:
            if other is not own:
                weight *= other / (other - own)
        weights.append(weight)
    off = -sum((weight * (y[k] - y[at]) for weight, k in zip(weights, beside, strict=True)), np.zeros(len(at)))
    return off, weights


def periods_between(ticks: NDArray[np.int64], period: float) -> NDArray[np.int64]:
    """Return the periods between neighbouring lines, (n - 1,): a line that is late alone hides no missing one."""
    step = diff_signed(ticks, 32)
    number = np.round(step / period).astype(np.int64)
    number[(step > 0) & (number < 1)] = 1
    both = np.flatnonzero(np.abs(step[:-1] + step[1:] - 2 * period) < period / 2)
    number[both] = number[both + 1] = 1
    return number


def spread(
    ticks: NDArray[np.int64], stuck: NDArray[np.int64], fresh: NDArray[np.bool_], period: float, resolution: int
) -> None:
    """Set lines apart, in place, whose printed times do not advance, where the time before them has room for as many.

    Printed with a coarse clock, a line that is late has the time of the next one.  No time is changed by more than the
    clock's resolution.  ``stuck`` are the lines whose time does not advance, (s,); the board has started anew with a
    ``fresh`` one, (n,).
    """
    for line in stuck.tolist():
        for back in range(2, 2 * LOOK_AHEAD + 1):
            first = line - back
            begins = first < 0 or fresh[first + 1]  # nothing before the first line limits the room
            span = back * period if begins else int(time_ahead(ticks[first], ticks[line : line + 1])[0])
            even = ticks[line] - np.round(span * np.arange(back - 1, 0, -1) / back).astype(np.int64)
            room = round(span / period) >= back
            if room and np.abs(time_ahead(even, ticks[first + 1 : line])).max() <= resolution:
                ticks[first + 1 : line] = even & 0xFFFFFFFF
            if room or begins:
                break
