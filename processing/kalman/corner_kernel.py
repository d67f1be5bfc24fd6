"""Kernels: labels of the samples between the corners of a motion of white snap, and the most likely times of corners.

Also how the mean snap before a landing shifts the predicted samples around it.  Every function runs as written or
compiled (`stickslip.compute.compile`).
"""

import math

import numpy as np
from numpy.typing import NDArray

from processing.kalman.motion_kernel import LINE, Order, Process, pass_corner, predict, unpack, update
from processing.kalman.stick_slip import (
    CUT,
    LAND,
    LANDING,
    LEAVING,
    MEET,
    MET,
    NEAR_LANDING,
    NEAR_ONSET,
    ONSET,
    REST,
    RIDE,
    SLIP,
    STICK,
    STOP,
)
from stickslip.compute.arrays import Array, Integers
from stickslip.compute.compile import stack, stack_square

Labels = NDArray[np.uint8]

SAME = 1e-6  # steps of a grid of times: times closer than this are equal; rounding makes 1e-10
# Of a sample interval: distance from a sample of a corner next to it, whose side rounding would decide on the sample
# itself; not a simple fraction, which could meet the grid of times tried.
BETWEEN = 0.381966


def label_samples(time: Array, corner_times: Array, kind: Labels, first: int, unit: float, label: Labels) -> None:
    """Label every sample with the part of the motion in the interval that ends there, for `forward`.

    ``first`` is the label before the first corner; parts near corners begin at fractions of ``unit``, the length of a
    slip, s.
    """
    c = 0
    state = first
    # The last samples of a slip that is cut off may hide a landing, so they get the noise of one.
    ended = time[time.size - 1]
    previous, following = -math.inf, math.inf
    for i in range(time.size):
        while c < corner_times.size and corner_times[c] <= time[i]:
            previous = corner_times[c]
            k = kind[c]
            state = STICK if k == LAND else RIDE if k == MEET else REST if k == STOP else SLIP
            c += 1
        following = corner_times[c] if c < corner_times.size else ended
        label[i] = state
        since, remaining = (time[i] - previous) / unit, (following - time[i]) / unit
        if state == SLIP:
            for part in range(4):
                if remaining < NEAR_LANDING[part]:
                    label[i] = (LANDING if c < corner_times.size else CUT) + part
                    break
                if since < NEAR_ONSET[part]:
                    label[i] = ONSET + part
                    break
        elif state == RIDE:
            if since < NEAR_ONSET[0]:
                label[i] = MET
            elif remaining < NEAR_ONSET[0]:
                label[i] = LEAVING


def refine_switching_times(
    order: Order,
    time: Array,
    position: Array,
    stored: Array,
    kind: int,
    corner_times: Array,
    bounds: Array,
    spans: Integers,
    steps: tuple[float, float],
    edges: Array,
    parts: Labels,
    corner: int,
    process: Process,
    estimates: Array,
) -> None:
    """Write mean and standard deviation, s, of the most likely time of each corner of one kind into ``estimates``.

    Each time is searched within ``bounds``, s, by the likelihood of the samples in ``spans``, on a grid of 9 times that
    starts with ``steps[0]``, s, and is refined threefold until the likelihood is wider than its step or the step is
    below ``steps[1]``.  The grid is moved first where its best time is at its end.  ``parts`` are the labels around the
    corner, which change at ``edges``, s from it; edge ``corner`` is the corner itself.
    """
    q, u, r, alive = process.density, process.mean, process.reading_variance, process.alive
    x, p = stack(order), stack_square(order)
    n = 4
    gain, tried = np.empty(2 * n + 1), np.empty(2 * n + 1)
    previous_gain, previous_tried = np.empty(2 * n + 1), np.empty(2 * n + 1)  # those of the grid before
    for k in range(corner_times.size):
        middle, step = corner_times[k], steps[0]
        begin, end = spans[k, 0], spans[k, 1]
        estimates[k, 0], estimates[k, 1] = middle, n * step
        if end - begin < 8:
            continue
        least = max(bounds[k, 0], time[begin] + BETWEEN * (time[begin + 1] - time[begin]))
        most = min(bounds[k, 1], time[end - 1] - BETWEEN * (time[end - 1] - time[end - 2]))
        previous_tried[:] = math.inf
        for _ in range(12):
            best = 0
            for g in range(2 * n + 1):
                tried[g] = min(max(middle + (g - n) * step, least), most)
                tried_before = False
                for m in range(2 * n + 1):
                    if abs(tried[g] - previous_tried[m]) < SAME * step:
                        tried[g], gain[g], tried_before = previous_tried[m], previous_gain[m], True
                if g and tried[g] == tried[g - 1]:  # at a bound
                    gain[g], tried_before = gain[g - 1], True
                if tried_before:
                    if gain[g] > gain[best]:
                        best = g
                    continue
                # The log likelihood of the corner there, up to a constant.  Inline, because numba would compile the
                # functions that a separate function calls a second time.
                unpack(order, stored[begin], x, p)
                last = time[begin]
                total, product = 0.0, 1.0
                before_corner = True
                part = 0
                for i in range(begin, end):
                    if before_corner and tried[g] <= time[i]:
                        part = max(part, corner)
                        b = parts[part]
                        predict(order, order, tried[g] - last, q[b], u[b], x, p)
                        pass_corner(order, process.keep[kind], process.jump[kind], x, p)
                        last = tried[g]
                        before_corner = False
                    while part < edges.size and time[i] - tried[g] >= edges[part]:
                        part += 1
                    b = parts[part]
                    straight = alive[b] < len(order)
                    if straight:
                        predict(order, LINE, time[i] - last, 0.0, 0.0, x, p)
                    else:
                        predict(order, order, time[i] - last, q[b], u[b], x, p)
                    last = time[i]
                    if math.isnan(position[i]):
                        continue
                    s = 1.0 / (p[0] + r[b])
                    e = position[i] - x[0]
                    total -= e * e * s
                    product *= s
                    if product > 1e200 or product < 1e-200:
                        total += math.log(product)
                        product = 1.0
                    if straight:
                        update(order, LINE, e, s, r[b], x, p)
                    else:
                        update(order, order, e, s, r[b], x, p)
                gain[g] = 0.5 * (total + math.log(product))
                if gain[g] > gain[best]:
                    best = g
            weight, mean, square = 0.0, 0.0, 0.0
            for i in range(2 * n + 1):
                w = math.exp(gain[i] - gain[best])
                weight += w
                mean += w * (tried[i] - middle)
                square += w * (tried[i] - middle) ** 2
            mean /= weight
            spread = math.sqrt(max(square / weight - mean * mean, 0.0))
            estimates[k, 0], estimates[k, 1] = middle + mean, max(spread, 0.3 * step)
            if spread > 1.2 * step or step < steps[1]:
                break
            for g in range(2 * n + 1):  # an assignment of arrays, with its check of shapes, compiles for 2 s
                previous_tried[g], previous_gain[g] = tried[g], gain[g]
            middle = tried[best]
            if 0 < best < 2 * n:
                step /= 3


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
