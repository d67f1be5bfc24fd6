"""Straight lines through the sticks: the velocity of a stick on an even belt, and what its error is worth.

A line through a whole stick would be the most likely motion, but trusts the belt to keep its speed for that long: on a
belt that wanders by 0.02 mm/s, too little to be seen as uneven, its standard errors covered 6 % of the true velocities
instead of 95 %.  So a line spans at most a third of a slip's length, and by how much the lines of neighbouring windows
differ scales the errors.
"""

import numpy as np

from daq.compute.arrays import Array
from processing.polynomial.uneven import starts


def fit_lines(time: Array, position: Array, window: int, variance: float) -> tuple[Array, float]:
    """Fit a line around every sample of a stick, centred, or up against an end of the stick.

    Parameters
    ----------
    time, position : array of shape (n,)
        s and m.
    window : int
        Samples of each line, at most.
    variance : float
        Of a reading, m^2.

    Returns
    -------
    motion : array of shape (6, n)
        x, v, a and their variances.  The acceleration is 0; its error is the slope's over the length of the window.
    differing : float
        Mean square by which the slopes of neighbouring windows without a common sample differ, over what ``variance``
        makes them differ: 1 for a straight line; 0 where there is one window only.
    """
    n = time.size
    size = min(window, n)
    t, x = time - time.mean(), position - position.mean()
    speed = float(t @ x) / float(t @ t)
    rest = x - speed * t  # small, so that differences of running sums keep their digits
    low = starts(n, size)

    def summed(values: Array) -> Array:
        running = np.concatenate(([0.0], np.cumsum(values)))
        return np.asarray(running[low + size] - running[low])

    middle = summed(t) / size
    spread = summed(t * t) - size * middle**2
    slope = (summed(t * rest) - middle * summed(rest)) / spread
    away, known = t - middle, variance / spread
    fitted = position.mean() + speed * t + summed(rest) / size + slope * away
    motion = np.stack(
        (fitted, speed + slope, np.zeros(n), variance / size + known * away**2, known, known * size / spread)
    )
    apart = slice(size // 2, n - size + size // 2 + 1, size)
    differing = np.diff(slope[apart]) ** 2 / (known[apart][1:] + known[apart][:-1])
    return motion, float(differing.mean()) if differing.size else 0.0
