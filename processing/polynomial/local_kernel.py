"""Kernel: least-squares polynomials on the sample times of each window, `LANES` windows side by side.

The recurrence is that of `processing.polynomial.savgol`.  Windows lie in the fast index of every array: vector
instructions then process several at once, and no sum depends on how many.

Runs as written or compiled (`stickslip.compute.compile`).
"""

import math

import numpy as np
from numpy.typing import NDArray

from stickslip.compute.arrays import Array

LANES = 32  # windows whose sums run side by side


def fit(
    time: Array,
    position: Array,
    first: NDArray[np.int64],
    window: int,
    order: int,
    span: float,
    values: Array,
    norms: Array,
) -> None:
    """Fit around every sample, whose window begins at ``first``, with time u in units of ``span``, s.

    ``values`` (3, n) receives x, dx/du and d2x/du2 at the sample, ``norms`` the root sums of squares of the weights.
    """
    n = time.size
    u, x = np.empty((window, LANES)), np.empty((window, LANES))
    p, p_last = np.empty((window, LANES)), np.empty((window, LANES))
    g, g_last, a, b = np.empty(LANES), np.empty(LANES), np.empty(LANES), np.empty(LANES)
    total, square = np.empty(LANES), np.empty(LANES)
    e, e_last = np.empty((3, LANES)), np.empty((3, LANES))
    value, variance = np.empty((3, LANES)), np.empty((3, LANES))
    for begin in range(0, n, LANES):
        for lane in range(LANES):
            i = min(begin + lane, n - 1)
            for j in range(window):
                u[j, lane] = (time[first[i] + j] - time[i]) / span
                x[j, lane] = position[first[i] + j] - position[i]
        p[:, :] = 1.0
        p_last[:, :] = 0.0
        e[:, :] = 0.0
        e[0, :] = 1.0
        e_last[:, :] = 0.0
        g[:] = window
        b[:] = 0.0
        value[:, :] = 0.0
        variance[:, :] = 0.0
        for k in range(order + 1):
            total[:] = 0.0
            a[:] = 0.0
            for j in range(window):
                for lane in range(LANES):
                    total[lane] += p[j, lane] * x[j, lane]
                    a[lane] += u[j, lane] * p[j, lane] * p[j, lane]
            for d in range(3):
                for lane in range(LANES):
                    value[d, lane] += total[lane] / g[lane] * e[d, lane]
                    variance[d, lane] += e[d, lane] * e[d, lane] / g[lane]
            if k == order:
                break
            square[:] = 0.0
            for lane in range(LANES):
                a[lane] /= g[lane]
                if k > 0:
                    b[lane] = g[lane] / g_last[lane]
            for j in range(window):
                for lane in range(LANES):
                    up = (u[j, lane] - a[lane]) * p[j, lane] - b[lane] * p_last[j, lane]
                    p_last[j, lane] = p[j, lane]
                    p[j, lane] = up
                    square[lane] += up * up
            for lane in range(LANES):
                zeroth = -a[lane] * e[0, lane] - b[lane] * e_last[0, lane]
                second = 2 * e[1, lane] - a[lane] * e[2, lane] - b[lane] * e_last[2, lane]
                slope = e[0, lane] - a[lane] * e[1, lane] - b[lane] * e_last[1, lane]
                for d in range(3):
                    e_last[d, lane] = e[d, lane]
                e[0, lane], e[1, lane], e[2, lane] = zeroth, slope, second
                g_last[lane] = g[lane]
                g[lane] = square[lane]
        for lane in range(min(LANES, n - begin)):
            for d in range(3):
                values[d, begin + lane] = value[d, lane]
                norms[d, begin + lane] = math.sqrt(variance[d, lane])
