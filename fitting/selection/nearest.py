"""Kernel: distances of points of the plane to the nearest of many others."""

import math

import numpy as np

from daq.compute.arrays import Array


def nearest_distances(x: Array, y: Array, at_x: Array, at_y: Array, out: Array) -> None:
    """Store the distance of each point (k,) to the nearest of the points (x, y), n of them in ascending order of x.

    Each search leaves from the point's own x to both sides, as far as the nearest one found so far.
    """
    n = x.size
    for k in range(at_x.size):
        begin = np.searchsorted(x, at_x[k])
        best = math.inf
        left, right = begin - 1, begin
        while left >= 0 or right < n:
            if right < n:
                dx = x[right] - at_x[k]
                if dx * dx >= best:
                    right = n
                else:
                    best = min(best, dx * dx + (y[right] - at_y[k]) ** 2)
                    right += 1
            if left >= 0:
                dx = at_x[k] - x[left]
                if dx * dx >= best:
                    left = -1
                else:
                    best = min(best, dx * dx + (y[left] - at_y[k]) ** 2)
                    left -= 1
        out[k] = math.sqrt(best)
