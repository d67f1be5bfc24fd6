"""Kernels: corners of a motion of white snap: the labels they give the samples, and their most likely times.

Every function runs as written or compiled (`stickslip.compute.compile`).
"""

import math

import numpy as np
from numpy.typing import NDArray

from processing.kalman.motion_kernel import LINE, Order, Process, predict, turn, unpack, update
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
    OVERTAKE,
    REST,
    RIDE,
    SLIP,
    STICK,
    STOP,
)
from stickslip.compute.arrays import Array, Integers
from stickslip.compute.compile import stack, stack_square

Labels = NDArray[np.uint8]

# Steps of a grid of times: those nearer to each other are the same.  Rounding makes 1e-10; any number below 1 does.
SAME = 1e-6
# Of a sample interval: how far from a sample a corner is put whose time is only known to be beside it.  On a sample,
# rounding of its time would decide on which side the corner lies; a simple fraction meets the grid of times tried.
BETWEEN = 0.381966


def label_samples(time: Array, at: Array, kind: Labels, first: int, unit: float, label: Labels) -> None:
    """Name the part of the motion every sample lies in (the interval that ends there), for `forward`.

    ``first`` is the label before the first corner: SLIP, STICK, RIDE or REST; the parts of a slip near its ends, and
    of a stick on an uneven belt, follow from the time to the corner in fractions of ``unit`` (s), a slip's length.
    """
    c = 0
    state = first
    # Where a slip is cut off a landing may lie within the last samples, unseen: as rough as there.
    ended = time[time.size - 1]
    behind, before = -math.inf, math.inf
    ahead = False  # of the belt: a slip without parts, since friction hardly changes so close to the belt's speed
    for i in range(time.size):
        while c < at.size and at[c] <= time[i]:
            behind = at[c]
            k = kind[c]
            ahead = k == OVERTAKE
            state = STICK if k == LAND else RIDE if k == MEET else REST if k == STOP else SLIP
            c += 1
        before = at[c] if c < at.size else ended
        label[i] = state
        since, left = (time[i] - behind) / unit, (before - time[i]) / unit
        if state == SLIP and not ahead:
            for part in range(4):
                if left < NEAR_LANDING[part]:
                    label[i] = (LANDING if c < at.size else CUT) + part
                    break
                if since < NEAR_ONSET[part]:
                    label[i] = ONSET + part
                    break
        elif state == RIDE:
            if since < NEAR_ONSET[0]:
                label[i] = MET
            elif left < NEAR_ONSET[0]:
                label[i] = LEAVING


def refine_switching_times(
    order: Order,
    time: Array,
    position: Array,
    stored: Array,
    what: int,
    at: Array,
    bounds: Array,
    spans: Integers,
    steps: tuple[float, float],
    edges: Array,
    parts: Labels,
    corner: int,
    process: Process,
    found: Array,
) -> None:
    """Move corners of one kind to where they are most likely.

    time, position: s and m, NaN where a reading is missing.
    stored: What the filter expected of each sample.
    what: Kind of the corners.
    at, bounds, spans: Their times, s; how early and late each may lie, s; the samples each is judged by, first and end.
    steps: (float, float) First step of the grid of times, s, and the step below which it is not refined any more.
    edges, parts, corner: Labels around the corner, cut at ``edges`` (s from it), of which number ``corner`` is the
        corner itself (0).
    process: By label.
    found: Gets mean and standard deviation of each time, s.

    Notes
    -----
    The grid of 9 times is refined threefold until the likelihood is wider than its step; it is moved first where its
    best time is an end of it.  A third of the times of a finer grid, and half of those of one that was moved, were
    tried before.
    """
    q, u, r, alive = process.density, process.mean, process.reading_variance, process.alive
    x, p = stack(order), stack_square(order)
    n = 4
    gain, tried = np.empty(2 * n + 1), np.empty(2 * n + 1)
    gained, seen = np.empty(2 * n + 1), np.empty(2 * n + 1)  # those of the grid before
    for k in range(at.size):
        middle, step = at[k], steps[0]
        begin, end = spans[k, 0], spans[k, 1]
        found[k, 0], found[k, 1] = middle, n * step
        if end - begin < 8:
            continue
        least = max(bounds[k, 0], time[begin] + BETWEEN * (time[begin + 1] - time[begin]))
        most = min(bounds[k, 1], time[end - 1] - BETWEEN * (time[end - 1] - time[end - 2]))
        seen[:] = math.inf
        for _ in range(12):
            best = 0
            for g in range(2 * n + 1):
                tried[g] = min(max(middle + (g - n) * step, least), most)
                known = False
                for m in range(2 * n + 1):
                    if abs(tried[g] - seen[m]) < SAME * step:
                        tried[g], gain[g], known = seen[m], gained[m], True
                if g and tried[g] == tried[g - 1]:  # at a bound
                    gain[g], known = gain[g - 1], True
                if known:
                    if gain[g] > gain[best]:
                        best = g
                    continue
                # The log likelihood of the corner there, up to a constant.  Not a function of its own: numba would
                # compile the functions it calls a second time.
                unpack(order, stored[begin], x, p)
                last = time[begin]
                total, product = 0.0, 1.0
                ahead = True
                part = 0
                for i in range(begin, end):
                    if ahead and tried[g] <= time[i]:
                        part = max(part, corner)
                        b = parts[part]
                        predict(order, order, tried[g] - last, q[b], u[b], x, p)
                        turn(order, process.keep[what], process.jump[what], x, p)
                        last = tried[g]
                        ahead = False
                    while part < edges.size and time[i] - tried[g] >= edges[part]:
                        part += 1
                    b = parts[part]
                    two = alive[b] < len(order)
                    if two:
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
                    if two:
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
            found[k, 0], found[k, 1] = middle + mean, max(spread, 0.3 * step)
            if spread > 1.2 * step or step < steps[1]:
                break
            seen[:], gained[:] = tried, gain
            middle = tried[best]
            if 0 < best < 2 * n:
                step /= 3
