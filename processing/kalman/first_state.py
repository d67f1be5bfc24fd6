"""The state of a filter before its first sample: about as fast as over the first nine, else unknown."""

import math

import numpy as np

from daq.compute.arrays import Array


def first_state(time: Array, position: Array, variance: float, derivatives: int) -> Array:
    """Return the state of a filter of the first ``derivatives`` derivatives before its first sample.

    Parameters
    ----------
    time, position : array of shape (n,), n >= 2
        s and m.
    variance : float
        Of a reading, m^2.
    derivatives : int
        2 for x, v, a (`jerk_kernel`), 3 for x, v, a, j (`snap_kernel`), 1 for x, v and zeros as in `snap_kernel`.

    Returns
    -------
    array
        The state, the upper triangle of its covariance row by row, and the time it holds for, s.
    """
    near = slice(0, min(time.size, 9))
    t, x = time[near], position[near]
    h = (t[-1] - t[0]) / (t.size - 1)
    slope = (x[-1] - x[0]) / (t[-1] - t[0])
    spread = 2 * max(math.sqrt(variance) / h, float(np.abs(np.diff(x) / np.diff(t) - slope).max()))
    size = 3 if derivatives == 2 else 4
    sd = spread * h ** (1.0 - np.arange(size))
    sd[derivatives + 1 :] = 0.0
    covariance = np.diag(sd**2)[np.triu_indices(size)]
    return np.concatenate(([x[0], slope], np.zeros(size - 2), covariance, [time[0]]))
