"""Kernels: the Kalman filter of a motion whose n-th derivative is white noise, on any times, and its smoother.

State: x and its first n - 1 derivatives.  Between samples h apart the n-th derivative has a mean u and white noise of
density q; a reading is x + noise of variance r.  The label of a sample selects all of these (`Process`), and the number
of derivatives that are alive: 2 where only x and v go on, without noise, else n.  At a corner between samples the
derivatives from ``keep`` on become 0, and each gains the variance ``jump``.  The filter stores its prediction of every
sample; the smoother goes back over these and needs no inverse:

    l = F'l - h (e/s + k'l),   smoothed state = expected - p l,   its covariance = p - p m p

with the adjoint state l and its information m (F the step of the state, h = (1, 0, ...), e the innovation, s its
variance, k the gain).  The stored s is 1/s.  On its way back the smoother sums the evidence on each noise level:
sum(l^2)/sum(m) of the last derivative is 1 at the level of greatest likelihood, and the level times that ratio comes
closer to it.

``order`` is a tuple of n numbers of any value, and ``part`` one with as many as are alive: lengths of tuples are
constants of the compiled code, so that the loops unroll, and the state is held in arrays of n and n n numbers on the
stack.  The upper triangle of p and the lower one of m are kept, each updated in place.  Every function runs as written
or compiled (`stickslip.compute.compile`).

A reading that is NaN is missing: its variance is infinite, and s and e/s are 0.

The adjoint state gives the auxiliary residuals, unexplained by the motion: just before a sample l_d^2/m_dd is the
square of the t statistic of a step of the d-th derivative there, and l_d/m_dd the estimate of that step; u^2/d is that
of an outlying reading, of size u/d, with the score u of the sample and its variance d.

Source: G. J. Bierman, Automatica 9 (1973) 503 (the modified Bryson-Frazier smoother); Q of the integrated Wiener
process: Wahba, J. R. Stat. Soc. B 40 (1978) 364; the fixed point: J. Burridge, Commun. Stat. 16 (1987); D. MacKay,
Neural Comput. 4 (1992) 415; auxiliary residuals: P. de Jong and J. Penzer, J. Am. Stat. Assoc. 93 (1998) 796.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from stickslip.compute.arrays import Array, Integers
from stickslip.compute.compile import stack, stack_square

Labels = NDArray[np.uint8]
Order = tuple[float, ...]
Sums = tuple[float, float, float, float]

LINE = (0.0, 0.0)  # order of a motion in which only x and v are alive
SETTLED = 36.0  # natural logarithm of how far a start must have faded: 2e-16
INVERSE = (0.0, *(1 / k for k in range(1, 10)))
OVER_FACTORIAL = tuple(1 / math.factorial(k) for k in range(10))


class Process(NamedTuple):
    """The noise of a motion of order n by label, and of its corners by kind."""

    density: Array  # of the n-th derivative
    mean: Array
    reading_variance: Array  # m^2
    alive: Integers  # derivatives that go on, x included: 2 or n
    keep: Integers  # derivatives that go on at a corner
    jump: Array  # variance that each gains there


def state_size(n: int) -> int:
    """Return how many numbers a state has: x and derivatives, the upper triangle of p by rows, and its time."""
    return n + n * (n + 1) // 2 + 1


def stored_size(n: int) -> int:
    """Return how many numbers are stored for a sample: x and p as predicted, 1/s, e/s."""
    return n + n * (n + 1) // 2 + 2


def predict(order: Order, part: Order, h: float, q: float, u: float, x: Any, p: Any) -> None:
    """Predict the state h seconds later."""
    n, alive = len(order), len(part)
    for i in range(alive):
        t = 0.0
        for m in range(alive - 1, i, -1):
            t = (t + x[m]) * (h * INVERSE[m - i])
        x[i] += t
    for i in range(alive):
        for c in range(i, alive):
            t = 0.0
            for m in range(alive - 1, i, -1):
                t = (t + p[min(m, c) * n + max(m, c)]) * (h * INVERSE[m - i])
            p[i * n + c] += t
    for c in range(alive):
        for i in range(c + 1):
            t = 0.0
            for m in range(alive - 1, c, -1):
                t = (t + p[i * n + m]) * (h * INVERSE[m - c])
            p[i * n + c] += t
    if alive == n:
        g = q * h
        for s in range(2 * n - 2, -1, -1):  # g is q h^(2 n - 1 - s)
            for i in range(n):
                j = s - i
                if i <= j < n:
                    p[i * n + j] += g * (INVERSE[2 * n - 1 - s] * OVER_FACTORIAL[n - 1 - i] * OVER_FACTORIAL[n - 1 - j])
            g *= h
        g = u * h
        for i in range(n - 1, -1, -1):
            x[i] += g * OVER_FACTORIAL[n - i]
            g *= h


def update(order: Order, part: Order, e: float, s: float, r: float, x: Any, p: Any) -> None:
    """Update the state with a reading of innovation e and s = 1/(p00 + r).

    A variance keeps at least the fraction r s, since p01^2 <= p00 p11; where r is 1e-16 of p00 the difference is only
    rounding, of either sign.
    """
    n, alive = len(order), len(part)
    g, f = e * s, r * s
    for i in range(alive):
        x[i] += p[i] * g
    for i in range(1, alive):
        t = p[i] * s
        p[i * n + i] = max(p[i * n + i] - t * p[i], p[i * n + i] * f)
        for c in range(i + 1, alive):
            p[i * n + c] -= t * p[c]
    for c in range(alive):
        p[c] *= f


def pass_corner(order: Order, keep: int, jump: Array, x: Any, p: Any) -> None:
    n = len(order)
    for d in range(n):
        if d >= keep:
            x[d] = 0.0
            for m in range(n):
                p[d * n + m] = 0.0
                p[m * n + d] = 0.0
        p[d * n + d] += jump[d]


def unpack(order: Order, w: Array, x: Any, p: Any) -> None:
    """Copy the state ``w`` into x and p."""
    n = len(order)
    k = n
    for i in range(n):
        x[i] = w[i]
        for c in range(i, n):
            p[i * n + c] = w[k]
            k += 1


def pack(order: Order, w: Array, x: Any, p: Any) -> None:
    """Copy x and p into the state ``w``."""
    n = len(order)
    k = n
    for i in range(n):
        w[i] = x[i]
        for c in range(i, n):
            w[k] = p[i * n + c]
            k += 1


def forward(
    order: Order,
    time: Array,
    position: Array,
    label: Labels,
    corner_times: Array,
    kind: Labels,
    process: Process,
    state: Array,
    stored: Array,
) -> None:
    """Filter from ``state`` on, which is moved past the last sample, and store the predictions, (n, stored_size)."""
    n = len(order)
    q, u, r, alive = process.density, process.mean, process.reading_variance, process.alive
    x, p = stack(order), stack_square(order)
    unpack(order, state, x, p)
    end = n + n * (n + 1) // 2
    last = state[end]
    c = 0
    for i in range(time.size):
        while c < corner_times.size and corner_times[c] <= time[i]:
            b = label[max(i - 1, 0)]
            predict(order, order, corner_times[c] - last, q[b], u[b], x, p)
            pass_corner(order, process.keep[kind[c]], process.jump[kind[c]], x, p)
            last = corner_times[c]
            c += 1
        b = label[i]
        straight = alive[b] < n
        if straight:
            predict(order, LINE, time[i] - last, 0.0, 0.0, x, p)
        else:
            predict(order, order, time[i] - last, q[b], u[b], x, p)
        last = time[i]
        w = stored[i]
        pack(order, w, x, p)
        if math.isnan(position[i]):
            w[end], w[end + 1] = 0.0, 0.0
            continue
        s = 1.0 / (p[0] + r[b])
        e = position[i] - x[0]
        w[end], w[end + 1] = s, e * s
        if straight:
            update(order, LINE, e, s, r[b], x, p)
        else:
            update(order, order, e, s, r[b], x, p)
    pack(order, state, x, p)
    state[end] = last


def add_reading(
    order: Order, part: Order, w: Array, adjoint: Any, information: Any, gain: Any, v: Any
) -> tuple[float, float]:
    """Add the reading of a sample to the adjoint state and its information; return its score and its variance."""
    n, alive = len(order), len(part)
    end = n + n * (n + 1) // 2
    s = w[end]
    for i in range(alive):
        gain[i] = w[n + i] * s
    d, u = s, w[end + 1]
    for i in range(alive):
        t = 0.0
        for c in range(alive):
            t += information[max(i, c) * n + min(i, c)] * gain[c]
        v[i] = t
        d += gain[i] * t
        u += gain[i] * adjoint[i]
    adjoint[0] -= u
    information[0] += d - 2 * v[0]
    for i in range(1, alive):
        information[i * n] -= v[i]
    return u, d


def write_motion(
    order: Order, part: Order, w: Array, adjoint: Any, information: Any, row: Any, motion: Array, column: int
) -> None:
    n, alive = len(order), len(part)
    for i in range(3):
        if i >= alive:
            motion[i, column] = motion[3 + i, column] = 0.0
            continue
        for c in range(alive):
            low, high = min(i, c), max(i, c)
            row[c] = w[n + low * n - low * (low - 1) // 2 + high - low]
        t, z = 0.0, 0.0
        for c in range(alive):
            t += row[c] * adjoint[c]
            y = 0.0
            for m in range(c + 1, alive):
                y += row[m] * information[m * n + c]
            z += row[c] * (row[c] * information[c * n + c] + 2 * y)
        motion[i, column] = w[i] - t
        motion[3 + i, column] = row[i] - z


def carry_back(order: Order, part: Order, h: float, adjoint: Any, information: Any) -> None:
    """Propagate the adjoint state and its information back over h seconds."""
    n, alive = len(order), len(part)
    for i in range(alive - 1, -1, -1):
        t = 0.0
        for m in range(i):
            t = (t + adjoint[m]) * (h * INVERSE[i - m])
        adjoint[i] += t
    for i in range(alive - 1, -1, -1):
        for c in range(i, -1, -1):
            t = 0.0
            for m in range(i):
                t = (t + information[max(m, c) * n + min(m, c)]) * (h * INVERSE[i - m])
            information[i * n + c] += t
    for c in range(alive - 1, -1, -1):
        for i in range(c, alive):
            t = 0.0
            for m in range(c):
                t = (t + information[i * n + m]) * (h * INVERSE[c - m])
            information[i * n + c] += t


def backward(
    order: Order,
    time: Array,
    label: Labels,
    corner_times: Array,
    kind: Labels,
    process: Process,
    stored: Array,
    wanted: int,
    motion: Array,
    begin: int,
    noise: Array,
    steps: Array,
    scores: Array,
) -> None:
    """Smooth from the last sample back.

    ``motion`` (6, n) receives x, v, a and their variances of the first ``wanted`` samples, from column ``begin`` on.
    sum(l^2) and sum(m) of the last derivative and of the readings are added to ``noise`` (labels, 4), those of the
    jumps at corners to ``steps`` (kinds, n, 2).  ``scores`` (k, 2 + 2 n) receives, for the first k samples, the score
    of the reading and its variance, then those of a step of each derivative just before the sample.
    """
    n = len(order)
    alive, keep = process.alive, process.keep
    adjoint, information, row, v = stack(order), stack_square(order), stack(order), stack(order)
    for i in range(n):
        adjoint[i] = 0.0
    for i in range(n * n):
        information[i] = 0.0
    c = corner_times.size - 1
    for i in range(time.size - 1, -1, -1):
        w = stored[i]
        b = label[i]
        straight = alive[b] < n
        if straight:
            u, d = add_reading(order, LINE, w, adjoint, information, row, v)
        else:
            u, d = add_reading(order, order, w, adjoint, information, row, v)
        noise[b, 2] += u * u
        noise[b, 3] += d
        if i < scores.shape[0]:
            scores[i, 0], scores[i, 1] = u, d
            for m in range(n):
                scores[i, 2 + 2 * m], scores[i, 3 + 2 * m] = -adjoint[m], information[m * n + m]
        if i < wanted:
            if straight:
                write_motion(order, LINE, w, adjoint, information, row, motion, begin + i)
            else:
                write_motion(order, order, w, adjoint, information, row, motion, begin + i)
        if i == 0:
            break
        if straight and (c < 0 or corner_times[c] <= time[i - 1]):
            carry_back(order, LINE, time[i] - time[i - 1], adjoint, information)
            continue
        now = time[i]
        while True:
            # Back over the interval; corners in it, the latest first, cut it into parts.
            corner = c >= 0 and corner_times[c] > time[i - 1]
            h = now - (corner_times[c] if corner else time[i - 1])
            noise[b, 0] += h * (adjoint[n - 1] * adjoint[n - 1] + h * adjoint[n - 2] * adjoint[n - 1])
            noise[b, 1] += h * (information[n * n - 1] + h * information[n * n - 2])
            carry_back(order, order, h, adjoint, information)
            if not corner:
                break
            now = corner_times[c]
            corner_kind = kind[c]
            b = label[i - 1]
            c -= 1
            for m in range(n):
                if m >= keep[corner_kind]:
                    adjoint[m] = 0.0
                    for j in range(n):
                        information[m * n + j] = 0.0
                        information[j * n + m] = 0.0
                else:
                    steps[corner_kind, m, 0] += adjoint[m] * adjoint[m]
                    steps[corner_kind, m, 1] += information[m * n + m]


def sum_likelihood(
    order: Order, time: Array, position: Array, edges: Integers, every: int, q: float, states: Array, most: float
) -> Sums:
    """Sum the likelihood of every ``every``-th stretch edges[k]..edges[k + 1] - 1, for readings of variance 1.

    The sums are of the logarithm of the innovation's variance, of the square over the variance, of samples, and of
    samples whose square exceeds ``most``; the first four of a stretch are not counted.  Such squares are clipped and
    up to three such readings in a row are kept out of the filter, as outliers.
    """
    n = len(order)
    logarithms = squares = samples = clipped = 0.0
    product = 1.0
    x, p = stack(order), stack_square(order)
    for k in range(0, edges.size - 1, every):
        unpack(order, states[k], x, p)
        last = states[k, n + n * (n + 1) // 2]
        skipped = 0
        for i in range(edges[k], edges[k + 1]):
            predict(order, order, time[i] - last, q, 0.0, x, p)
            last = time[i]
            s = 1.0 / (p[0] + 1.0)
            e = position[i] - x[0]
            if i >= edges[k] + 4:
                product *= s
                squares += min(e * e * s, most)
                clipped += e * e * s > most
                samples += 1.0
                if product < 1e-200:
                    logarithms -= math.log(product)
                    product = 1.0
            if e * e * s > most and skipped < 3:
                skipped += 1
                continue
            skipped = 0
            update(order, order, e, s, 1.0, x, p)
    return logarithms - math.log(product), squares, samples, clipped
