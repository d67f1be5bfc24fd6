"""Kernel: how the mean snap before a landing shifts the predicted samples around it.

Runs as written or compiled (`stickslip.compute.compile`).
"""

import math

import numpy as np
from numpy.typing import NDArray

from processing.kalman.motion_kernel import LINE, Order, Process, pass_corner, predict, unpack, update
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
    landing_variance: Array,
    gram: Array,
    rhs: Array,
) -> None:
    """Add a landing to the normal equations ``gram @ means = rhs`` of the mean snap of the k parts before it.

    ``parts`` are the labels far before, of the k parts and of the stick, which change at ``edges``, s from the landing;
    ``landing_variance`` allows for the uncertain time of the landing.  Only the lower triangle of ``gram`` is filled.
    """
    q, r = process.density, process.reading_variance
    y, p = stack(order), stack_square(order)
    k = rhs.size
    unpack(order, state, y, p)
    x, v, a, j = np.zeros(k), np.zeros(k), np.zeros(k), np.zeros(k)
    last = time[0]
    part = 0
    before_landing = True
    for i in range(time.size):
        while True:
            corner = before_landing and landing <= time[i]
            until = landing if corner else time[i]
            while not corner and part < edges.size and time[i] - landing >= edges[part]:
                part += 1
            h = until - last
            last = until
            b = parts[part]
            if before_landing:
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
            before_landing = False
            pass_corner(order, 2, landing_variance, y, p)
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
        if before_landing:
            update(order, order, e, s, r[parts[part]], y, p)
        else:
            update(order, LINE, e, s, r[parts[part]], y, p)
