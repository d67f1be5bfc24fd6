"""The distance of a law's orbit from the measured one in the phase plane: the comparison by eye, as a number.

Its margins are tiny (laws with tenfold errors look the same): it is shown with the evidence, not part of it.
"""

import math
from dataclasses import dataclass

import numpy as np

from fitting.data.frame import MeasuredMotion
from fitting.driver.fit import Fit
from stickslip.compute.arrays import Array
from stickslip.compute.compile import compiled

MOST_POINTS = 4000  # points of each curve


@dataclass(frozen=True, eq=False)
class MeasuredOrbit:
    """The measured motion in the phase plane, in ascending order of position."""

    size: Array  # (2,) between smallest and largest position (m) and velocity (m/s)
    position: Array  # (n,) over their sizes
    velocity: Array

    @classmethod
    def of(cls, motion: MeasuredMotion) -> "MeasuredOrbit":
        size = np.array([np.ptp(motion.position), np.ptp(motion.velocity)])
        order = np.argsort(motion.position, kind="stable")
        return cls(size, motion.position[order] / size[0], motion.velocity[order] / size[1])

    def distance(self, fit: Fit) -> float:
        """Return the rms distance of one run's law orbit to the measured one, of the orbit's size in each axis.

        Differences in time alone, such as a late slip, do not count.
        """
        own = model(fit) / self.size
        x, v = np.ascontiguousarray(own[:: max(1, len(own) // MOST_POINTS)].T)
        found = np.empty(x.size)
        compiled(nearest_distances, (nearest_distances.__module__,))(self.position, self.velocity, x, v, found)
        return math.sqrt(float(np.mean(found**2)))


def model(fit: Fit) -> Array:
    """Return position and velocity of a law in all windows; shape (samples, 2)."""
    x = fit.windows.position + fit.residual
    parts = []
    for _, _, first, count, *_ in fit.windows.table:
        if count >= 3:
            own = slice(first, first + count)
            parts.append(np.stack([x[own], np.gradient(x[own], fit.windows.time[own])], axis=1))
    return np.concatenate(parts)


def nearest_distances(x: Array, y: Array, at_x: Array, at_y: Array, out: Array) -> None:
    """Store the distance of each point (k,) to the nearest of n points (x, y), in ascending order of x.

    A kernel: each search proceeds from the point's x to both sides, as far as the nearest one so far.
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
