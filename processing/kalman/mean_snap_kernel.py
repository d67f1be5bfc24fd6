"""Kernel: how the mean snap before a landing moves what is expected of the samples around it.

Runs as written or compiled (`stickslip.compute.compile`).
"""

import math

import numpy as np
from numpy.typing import NDArray

from processing.kalman.motion_kernel import LINE, Order, Process, predict, turn, unpack, update
from stickslip.compute.arrays import Array
from stickslip.compute.compile import stack, stack_square

Labels = NDArray[np.uint8]


def accumulate_normal_equations(
    order: Order,
    time: Array,
    position: Array,
    state: Array,
    landing: float,
    edges: Array,
    parts: Labels,
    process: Process,
    loose: Array,
    gram: Array,
    rhs: Array,
) -> None:
    """Add a landing to the normal equations ``gram @ means = rhs`` of the mean snap of the parts before it.

    time, position: Samples around the landing, no other corner among them; NaN where a reading is missing.
    state: Of the filter before the first of them.
    landing: When, s.
    edges: Where parts begin, s from the landing; the last is 0.
    parts: Labels: far before, the k parts asked for, the stick.
    process: By label; the mean snap is taken as 0.
    loose: Variances gained at the landing, whose time is not known: of the velocity's step, m^2/s^2, and zeros.
    gram, rhs: Added to, the lower triangle alone of ``gram``.
    """
    q, r = process.density, process.reading_variance
    y, p = stack(order), stack_square(order)
    k = rhs.size
    unpack(order, state, y, p)
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
                predict(order, order, h, q[b], 0.0, y, p)
                for n in range(k):
                    u = 1.0 if part == n + 1 else 0.0
                    x[n] += h * (v[n] + h / 2 * (a[n] + h / 3 * (j[n] + h / 4 * u)))
                    v[n] += h * (a[n] + h / 2 * (j[n] + h / 3 * u))
                    a[n] += h * (j[n] + h / 2 * u)
                    j[n] += h * u
            else:
                predict(order, LINE, h, 0.0, 0.0, y, p)
                for n in range(k):
                    x[n] += h * v[n]
            if not corner:
                break
            ahead = False
            turn(order, 2, loose, y, p)
            part = edges.size
        if math.isnan(position[i]):
            continue
        s = 1.0 / (p[0] + r[parts[part]])
        e = position[i] - y[0]
        for n in range(k):
            rhs[n] += x[n] * e * s
            for m in range(n + 1):
                gram[n, m] += x[n] * x[m] * s
            g = x[n] * s
            x[n] -= p[0] * g
            v[n] -= p[1] * g
            a[n] -= p[2] * g
            j[n] -= p[3] * g
        if ahead:
            update(order, order, e, s, r[parts[part]], y, p)
        else:
            update(order, LINE, e, s, r[parts[part]], y, p)
