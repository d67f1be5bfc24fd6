"""Lines without a checksum, compared with their neighbours: which counts are damaged, and which times are wrong.

A flipped digit is still a digit, so a damaged line may look like a sound one.  Two rules find it:

- a count is damaged if it leaps away from the counts before and after it and back, or is by itself off the smooth
  course of its neighbours, whether their printed times or whole periods are the abscissa;
- a time is wrong if it is out of order, or by itself off the course of its neighbours and the count does not support
  it.  Then the count is kept and the time is interpolated: a timer that is occasionally 4 us late is not damage (63 of
  2400 correct lines were taken for damaged).

`daq.protocols.judge` applies them to a stream of lines; see there for how many neighbours each of them uses.

An isolated error has a signature: a value off by e is off the cubic through two neighbours on either side by e, and
they are off theirs by -2e/3 and e/6.  A jump, a velocity step, a gap or noise of the same size everywhere has another.
"""

import numpy as np
from numpy.typing import NDArray

from daq.wire.counters import diff_signed

LEAP_COUNTS = 32
LEAP_MOTIONS = 8  # a damaged count leaps so many times farther than the motion around it
SPIKE_LEAST = 3.0  # counts, or us: a wrong value is farther off the course of its neighbours than this
SPIKE_OVER_USUAL = 12  # and so many times the usual deviation around it
SPIKE_AMONG = 16  # lines on either side, without the nearest, that define the usual deviation
LOOK_AHEAD = 8  # lines within which one must follow the last good line, if times disagree
WIDEST = 6  # periods that five lines may span for their counts to be compared: two lines are missing


def time_ahead(first: np.int64 | NDArray[np.int64], ticks: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return how far n times modulo 2^32 are ahead of one, or each of another one, (n,); negative: behind."""
    return (ticks - first + 0x80000000 & 0xFFFFFFFF) - 0x80000000


def find_leaps(count: NDArray[np.int64], bits: int) -> NDArray[np.bool_]:
    """Return which counts (modulo 2^bits) leap away from both neighbours, by much more than the motion around them."""
    leaps = np.zeros(len(count), dtype=np.bool_)
    size = np.abs(diff_signed(count, bits))
    least = np.minimum(size[:-1], size[1:])
    half = 1 << (bits - 1)
    across = np.abs((count[2:] - count[:-2] + half & (1 << bits) - 1) - half)  # from one neighbour to the other
    candidates = np.flatnonzero((least > LEAP_COUNTS) & (across < least)) + 1
    if len(candidates) == 0:
        return leaps
    # The typical step of five lines on either side, whichever is more: a mass may stop dead or start at once.
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(size, 5, mode="edge"), 5)  # [i]: steps i - 5 ... i - 1
    motion = np.maximum(np.median(windows[candidates - 1], axis=1), np.median(windows[candidates + 6], axis=1))
    leaps[candidates] = least[candidates - 1] > LEAP_COUNTS + LEAP_MOTIONS * motion
    return leaps


def find_off_course(
    ticks: NDArray[np.int64],
    count: NDArray[np.int64],
    time: NDArray[np.int64],
    number: NDArray[np.int64],
    *,
    bits: int,
    period: float,
    resolution: int,
) -> tuple[NDArray[np.bool_], NDArray[np.int64], NDArray[np.int64]]:
    """Return which counts are damaged, (n,); the lines with wrong times, (m,), and their times by the course.

    ``time`` and ``number`` are the ticks without roll-over and the periods since the first line of the stream, (n,).  A
    time is a whole number of periods and a phase: missing lines do not disturb the course of the phases.
    """
    n = len(ticks)
    damaged = np.zeros(n, dtype=np.bool_)
    if n < 2 * SPIKE_AMONG:
        return damaged, np.zeros(0, dtype=np.int64), ticks[:0]
    line_number = np.arange(n)
    motion = sum_steps(diff_signed(count, bits))
    phase = time - period * number
    size = _size_residuals(phase)
    late = np.flatnonzero(size > SPIKE_LEAST)
    deviation, isolated = _find_isolated(line_number, phase, late, _allow_deviation(size, late))
    late, course = late[isolated], ticks[late[isolated]] - np.round(deviation[isolated]).astype(np.int64)

    size = _size_residuals(motion)
    near = np.ones(n, dtype=np.bool_)  # the five lines around it have at most two missing among them
    near[2:-2] = number[4:] - number[:-4] <= WIDEST
    to_check = size > SPIKE_LEAST
    to_check[late] = True
    candidates = np.flatnonzero(near & to_check)
    slack = _allow_deviation(size, candidates) + resolution * np.abs(
        motion[candidates + 1] - motion[candidates - 1]
    ) / (2 * period)
    by_number, off_number = _find_isolated(number, motion, candidates, slack)
    by_time, off_time = _find_isolated(time, motion, candidates, slack)
    back = sum_steps((np.diff(time) <= 0).astype(np.int64))  # steps so far that do not advance: they define no course
    damaged[candidates] = off_number & (off_time | (back[candidates + 3] > back[candidates - 3]))
    time_agrees = np.zeros(n, dtype=np.bool_)
    time_agrees[candidates] = np.abs(by_time) + 1 < np.abs(by_number)  # the count supports its printed time
    untrue = ~time_agrees[late]
    return damaged, late[untrue], course[untrue]


def sum_steps(step: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the running sum, (n,), of the steps between n values, from 0."""
    return np.concatenate((np.zeros(1, dtype=np.int64), np.cumsum(step)))


def _size_residuals(y: NDArray[np.int64] | NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the distance of each of n equidistant values from the cubic through its four neighbours; 0 at the ends."""
    size = np.zeros(len(y))
    size[2:-2] = np.abs(np.diff(y, 4)) / 6
    size[[2, -3]] = 0.0  # their neighbours' own residuals are not known
    return size


def _allow_deviation(size: NDArray[np.float64], lines: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return how far from its course the value of each of these lines may be.

    The usual deviation is the median of some on either side, whichever is more, without those that a spike disturbs.
    """
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(size, SPIKE_AMONG, mode="edge"), SPIKE_AMONG - 2)
    usual = np.maximum(np.median(windows[lines], axis=1), np.median(windows[lines + SPIKE_AMONG + 3], axis=1))
    return SPIKE_LEAST + SPIKE_OVER_USUAL * usual


def _find_isolated(
    x: NDArray[np.int64],
    y: NDArray[np.int64] | NDArray[np.float64],
    lines: NDArray[np.int64],
    slack: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return how far y of these lines is from the course of its neighbours, and whether it alone is."""
    with np.errstate(divide="ignore", invalid="ignore"):  # of equal x
        before, weight_before = _compute_residual(x, y, lines - 1)
        deviation, _ = _compute_residual(x, y, lines)
        after, weight_after = _compute_residual(x, y, lines + 1)
        trace = np.maximum(np.abs(before + weight_before[2] * deviation), np.abs(after + weight_after[1] * deviation))
        size = np.abs(deviation)
        # The neighbours of a kick are off by -1/2, those of a spike by -2/3.
        return deviation, (size > slack) & (trace < np.minimum(0.15 * size, 0.08 * size + 0.5))


def _compute_residual(
    x: NDArray[np.int64], y: NDArray[np.int64] | NDArray[np.float64], lines: NDArray[np.int64]
) -> tuple[NDArray[np.float64], list[NDArray[np.float64]]]:
    """Return y less the cubic in x through two neighbours on either side, and the weights of these four (Lagrange)."""
    neighbours = [lines + k for k in (-2, -1, 1, 2)]
    ahead = [(x[k] - x[lines]).astype(np.float64) for k in neighbours]
    weights = []
    for abscissa in ahead:
        weight = np.ones(len(lines))
        for other in ahead:
            if other is not abscissa:
                weight *= other / (other - abscissa)
        weights.append(weight)
    deviation = -sum(
        (weight * (y[k] - y[lines]) for weight, k in zip(weights, neighbours, strict=True)), np.zeros(len(lines))
    )
    return deviation, weights


def periods_between(ticks: NDArray[np.int64], period: float) -> NDArray[np.int64]:
    """Return the periods between neighbouring lines, (n - 1,): a line that is late by itself hides no missing one."""
    step = diff_signed(ticks, 32)
    number = np.round(step / period).astype(np.int64)
    number[(step > 0) & (number < 1)] = 1
    both = np.flatnonzero(np.abs(step[:-1] + step[1:] - 2 * period) < period / 2)
    number[both] = number[both + 1] = 1
    return number


def separate_times(
    ticks: NDArray[np.int64], stuck: NDArray[np.int64], fresh: NDArray[np.bool_], period: float, resolution: int
) -> None:
    """Separate lines, in place, whose times do not advance, if the time before them leaves room for as many.

    Printed with a coarse clock, a line that is late has the time of the next one.  No time is changed by more than the
    clock's resolution.  ``stuck``, (s,), are the lines whose time does not advance; ``fresh``, (n,), whether the board
    restarted before a line.
    """
    for line in stuck.tolist():
        for n_back in range(2, 2 * LOOK_AHEAD + 1):
            first = line - n_back
            begins = first < 0 or fresh[first + 1]  # nothing before the first line limits the room
            span = n_back * period if begins else int(time_ahead(ticks[first], ticks[line : line + 1])[0])
            spaced = ticks[line] - np.round(span * np.arange(n_back - 1, 0, -1) / n_back).astype(np.int64)
            room = round(span / period) >= n_back
            if room and np.abs(time_ahead(spaced, ticks[first + 1 : line])).max() <= resolution:
                ticks[first + 1 : line] = spaced & 0xFFFFFFFF
            if room or begins:
                break
