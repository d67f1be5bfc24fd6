"""Straight lines through the sticks: the velocity of a stick on an even belt, and what its error is worth.

A line through a whole stick would be the most likely motion, but trusts the belt to keep its speed for that long: on a
belt that wanders by 0.02 mm/s, too little to be seen as uneven, its standard errors covered 6 % of the true velocities
instead of 95 %.  So a line spans at most a third of a slip's length, and by how much the lines of neighbouring windows
differ scales the errors.

The kernel runs as written or compiled (`stickslip.compute.compile`).
"""

import math

from stickslip.compute.arrays import Array

FEWEST = 3  # readings of a line


def fit_lines(time: Array, position: Array, begin: int, end: int, window: int, variance: float, motion: Array) -> float:
    """Fit a line around every sample of a stick, centred, or up against an end of the stick.

    time, position: Of the record, s and m, NaN where a reading is missing.
    begin, end: The stick's samples: begin..end-1.
    window: Samples of each line, at most.
    variance: Of a reading, m^2.
    motion: Gets x, v, a and their variances of the stick's samples, but for those around which fewer than three
        readings are there.  The acceleration is 0; its error is the slope's over the length of the window.
    Returns: Mean square by which the slopes of neighbouring windows without a common sample differ, over what
        ``variance`` makes them differ: 1 for a straight line; 0 where there is one window only.
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
    first, last = begin, begin  # samples in the sums; they sum what is left of a chord, small, to keep their digits
    st = sx = stt = stx = 0.0
    known = 0
    differing = pairs = slope_before = error_before = 0.0
    for i in range(begin, end):
        low = min(max(i - size // 2, begin), end - size)
        while last < low + size:
            if not math.isnan(position[last]):
                t = time[last] - t0
                x = position[last] - x0 - speed * t
                st, sx, stt, stx = st + t, sx + x, stt + t * t, stx + t * x
                known += 1
            last += 1
        while first < low:
            if not math.isnan(position[first]):
                t = time[first] - t0
                x = position[first] - x0 - speed * t
                st, sx, stt, stx = st - t, sx - x, stt - t * t, stx - t * x
                known -= 1
            first += 1
        if known < FEWEST:
            continue
        middle = st / known
        spread = stt - st * middle
        slope = (stx - middle * sx) / spread
        error = variance / spread
        t = time[i] - t0
        away = t - middle
        motion[0, i] = x0 + speed * t + sx / known + slope * away
        motion[1, i] = speed + slope
        motion[2, i] = 0.0
        motion[3, i] = variance / known + error * away * away
        motion[4, i] = error
        motion[5, i] = error * known / spread
        if (i - begin) % size == size // 2 and low == i - size // 2:
            if error_before > 0.0:
                differing += (slope - slope_before) ** 2 / (error + error_before)
                pairs += 1
            slope_before, error_before = slope, error
    return differing / pairs if pairs else 0.0
