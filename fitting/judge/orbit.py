"""The distance of a law's orbit from the measured orbit in the phase plane: the comparison by eye, as a number.

Laws whose errors differ tenfold have nearly the same distance, so it is reported but is not part of the evidence.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from fitting.record.motion import MeasuredMotion
from fitting.search.fit import Fit
from stickslip.compute.arrays import Array

MOST_POINTS = 4000  # points of each curve


@dataclass(frozen=True, eq=False)
class MeasuredOrbit:
    size: Array  # (2,) between smallest and largest position (m) and velocity (m/s)
    tree: Any  # `scipy.spatial.cKDTree` of positions and velocities over their sizes

    @classmethod
    def of(cls, motion: MeasuredMotion) -> "MeasuredOrbit":
        from scipy.spatial import cKDTree

        points = np.c_[motion.position, motion.velocity]
        size = np.ptp(points, axis=0)
        return cls(size, cKDTree(points / size))

    def distance(self, fit: Fit) -> float:
        """Return the rms distance in the phase plane, over the orbit's size: differences in time do not count."""
        points = orbit(fit) / self.size
        distances, _ = self.tree.query(points[:: max(1, len(points) // MOST_POINTS)])
        return float(np.sqrt(np.mean(distances**2)))


def orbit(fit: Fit) -> Array:
    """Return position and velocity of a law in all windows, shape (samples, 2)."""
    x = fit.windows.position + fit.residual
    parts = []
    for _, _, first, count, *_ in fit.windows.table:
        if count >= 3:
            rows = slice(first, first + count)
            parts.append(np.stack([x[rows], np.gradient(x[rows], fit.windows.time[rows])], axis=1))
    return np.concatenate(parts)
