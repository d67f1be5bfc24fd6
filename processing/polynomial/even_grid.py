"""Readings moved onto an even grid, for estimates that need one; smoothing itself never uses this.

Where times scatter about the grid by less than half an interval, a reading moves by v dt with a rough velocity: at
30 us of jitter the next term, a dt^2/2, is 5 nm.  Wilder times are interpolated linearly.
"""

import numpy as np

from processing.polynomial.even_fit import coefficients, convolve
from stickslip.compute.arrays import Array

ROUGH = 31, 4  # window and order of the rough velocity


def even_grid(time: Array, position: Array) -> Array:
    """Return the positions on the even grid from the first to the last sample; ``position`` itself if times are even.

    The times, s, increase and have no gaps.
    """
    n = time.size
    step = (time[-1] - time[0]) / (n - 1)
    grid = time[0] + step * np.arange(n)
    offset = time - grid
    if np.abs(offset).max() <= 1e-6 * step:
        return position
    if np.abs(offset).max() > 0.5 * step or n < ROUGH[0]:
        return np.asarray(np.interp(grid, time, position))
    half = ROUGH[0] // 2
    inner = convolve(position, coefficients(*ROUGH))[1]
    return np.asarray(position - offset / step * np.pad(inner, half, mode="edge"))


def is_even(time: Array) -> bool:
    """Return whether the times lie on an even grid, to a millionth of an interval."""
    n = time.size
    if n < 3:
        return True
    step = (time[-1] - time[0]) / (n - 1)
    return bool(np.abs(time - (time[0] + step * np.arange(n))).max() <= 1e-6 * step)
