"""Straight lines through the sticks: the velocity of a stick on an even belt, and the scale of its error.

A line through a whole stick would be the most likely motion, but assumes that the belt keeps its speed for that long:
on a belt that wanders by 0.02 mm/s, too little to be detected as uneven, its standard errors covered 6 % of the true
velocities instead of 95 %.  So a line spans at most a third of a slip's length, and the difference between the lines of
neighbouring windows scales the errors.

The kernel runs as written or compiled (`stickslip.compute.compile`).
"""

import math

from stickslip.compute.arrays import Array

FEWEST = 3  # readings of a line


def fit_lines(time: Array, position: Array, begin: int, end: int, window: int, variance: float, motion: Array) -> float:
    """Fit a line around every sample begin..end-1 of a stick, centred or at an end of it, and write it into ``motion``.

    Samples with fewer than three readings around them are skipped.  The acceleration is 0; its error is that of the
    slope over the length of the window.  Return the mean square difference of the slopes of neighbouring windows over
    that expected from ``variance``, 1 for a straight line; 0 if there is one window only.
    """
    n = end - begin
    size = min(window, n)
    low, middle_one, high = begin, begin + n // 2, end - 1
    while low < high and math.isnan(position[low]):
        low += 1
    while high > low and math.isnan(position[high]):
        high -= 1
    while middle_one > low and math.isnan(position[middle_one]):
        middle_one -= 1
    if high == low:
        return 0.0
    t0, x0 = time[middle_one], position[middle_one]
    speed = (position[high] - position[low]) / (time[high] - time[low])
    first, last = begin, begin  # samples in the sums, which are of the small residuals of a chord, to avoid rounding
    st = sx = stt = stx = 0.0
    readings = 0
    differing = pairs = slope_before = error_before = 0.0
    for i in range(begin, end):
        low = min(max(i - size // 2, begin), end - size)
        while last < low + size:
            if not math.isnan(position[last]):
                t = time[last] - t0
                x = position[last] - x0 - speed * t
                st, sx, stt, stx = st + t, sx + x, stt + t * t, stx + t * x
                readings += 1
            last += 1
        while first < low:
            if not math.isnan(position[first]):
                t = time[first] - t0
                x = position[first] - x0 - speed * t
                st, sx, stt, stx = st - t, sx - x, stt - t * t, stx - t * x
                readings -= 1
            first += 1
        if readings < FEWEST:
            continue
        middle = st / readings
        spread = stt - st * middle
        slope = (stx - middle * sx) / spread
        error = variance / spread
        t = time[i] - t0
        away = t - middle
        motion[0, i] = x0 + speed * t + sx / readings + slope * away
        motion[1, i] = speed + slope
        motion[2, i] = 0.0
        motion[3, i] = variance / readings + error * away * away
        motion[4, i] = error
        motion[5, i] = error * readings / spread
        if (i - begin) % size == size // 2 and low == i - size // 2:
            if error_before > 0.0:
                differing += (slope - slope_before) ** 2 / (error + error_before)
                pairs += 1
            slope_before, error_before = slope, error
    return differing / pairs if pairs else 0.0
