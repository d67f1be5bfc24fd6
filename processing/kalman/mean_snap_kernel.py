"""Kernel: how the mean snap before a landing moves what is expected of the samples around it.

Runs as written or compiled (`daq.compute.compile`).
"""

import numpy as np
from numpy.typing import NDArray

from daq.compute.arrays import Array
from processing.kalman.snap_kernel import (
    NoiseLevels,
    line_predict,
    line_update,
    predict,
    unpacked,
    update,
)

Labels = NDArray[np.uint8]


def accumulate_normal_equations(
    time: Array,
    position: Array,
    state: Array,
    landing: float,
    edges: Array,
    parts: Labels,
    levels: NoiseLevels,
    loose: float,
    gram: Array,
    rhs: Array,
) -> None:
    """Add a landing to the normal equations ``gram @ means = rhs`` of the mean snap of the parts before it.

    Parameters
    ----------
    time, position : array of shape (n,)
        Samples around the landing, no other corner among them.
    state : array of shape (STATE,)
        Of the filter before the first of them.
    landing : float
        When, s.
    edges : array of shape (k + 1,)
        Where parts begin, s from the landing; the last is 0.
    parts : array of shape (k + 2,)
        Labels: far before, the k parts asked for, the stick.
    levels : NoiseLevels
        By label; the mean snap is taken as 0.
    loose : float
        Variance, m^2/s^2, of the velocity's step at a landing whose time is not known.
    gram, rhs : array of shape (k, k), (k,)
        Added to, the lower triangle alone of ``gram``.
    """
    q, r = levels.process_density, levels.reading_variance
    k = rhs.size
    S = unpacked(state)
    x, v, a, j = np.zeros(k), np.zeros(k), np.zeros(k), np.zeros(k)
    last = time[0]
    part = 0
    ahead = True
    for i in range(time.size):
        while True:
            corner = ahead and landing <= time[i]
            to = landing if corner else time[i]
            while not corner and part < edges.size and time[i] - landing >= edges[part]:
                part += 1
            h = to - last
            last = to
            b = parts[part]
            if ahead:
                S = predict(h, q[b], 0.0, S)
                for n in range(k):
                    u = 1.0 if part == n + 1 else 0.0
                    x[n] += h * (v[n] + h / 2 * (a[n] + h / 3 * (j[n] + h / 4 * u)))
                    v[n] += h * (a[n] + h / 2 * (j[n] + h / 3 * u))
                    a[n] += h * (j[n] + h / 2 * u)
                    j[n] += h * u
            else:
                S = line_predict(h, S)
                for n in range(k):
                    x[n] += h * v[n]
            if not corner:
                break
            ahead = False
            S = (S[0], S[1], 0.0, 0.0, S[4], S[5], 0.0, 0.0, S[8] + loose, 0.0, 0.0, 0.0, 0.0, 0.0)
            part = edges.size
        s = 1.0 / (S[4] + r[parts[part]])
        e = position[i] - S[0]
        for n in range(k):
            rhs[n] += x[n] * e * s
            for m in range(n + 1):
                gram[n, m] += x[n] * x[m] * s
            g = x[n] * s
            x[n] -= S[4] * g
            v[n] -= S[5] * g
            a[n] -= S[6] * g
            j[n] -= S[7] * g
        S = update(e, s, r[parts[part]], S) if ahead else line_update(e, s, r[parts[part]], S)
