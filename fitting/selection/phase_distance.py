"""How far a law's orbit runs from the measured one in the phase plane: the comparison by eye, as a number.

It ranks with tiny margins (laws that differ tenfold in error lie on one line to the eye): a figure beside the evidence,
not a part of it.
"""

import math

import numpy as np

from daq.compute.arrays import Array
from fitting.data.frame import MeasuredMotion
from fitting.estimation.fit import Fit

MOST_POINTS = 4000


def orbit_distance(fit: Fit, motion: MeasuredMotion) -> float:
    """Return the rms distance of a law's orbit to the nearest points of the measured one.

    Parameters
    ----------
    fit : Fit
        Of this one run (`Fit.for_run`).
    motion : MeasuredMotion

    Returns
    -------
    float
        In units of the orbit's size: positions are divided by the spread between their smallest and largest, velocities
        by theirs.  What differs in time alone, such as a slip that comes late, does not count.
    """
    from scipy.spatial import KDTree

    size = np.array([np.ptp(motion.position), np.ptp(motion.velocity)])
    tree = KDTree(np.stack([motion.position, motion.velocity], axis=1) / size)
    own = model(fit) / size
    found, _ = tree.query(own[:: max(1, len(own) // MOST_POINTS)])
    return math.sqrt(float(np.mean(found**2)))


def model(fit: Fit) -> Array:
    """Return position and velocity of a law in every window, one after the other; shape (samples, 2)."""
    x = fit.windows.position + fit.residual
    parts = []
    for _, _, first, count, *_ in fit.windows.table:
        if count >= 3:
            own = slice(first, first + count)
            parts.append(np.stack([x[own], np.gradient(x[own], fit.windows.time[own])], axis=1))
    return np.concatenate(parts)
