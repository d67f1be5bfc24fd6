"""Kernels: the Kalman filter of a motion of white jerk on any times, and its fixed-interval smoother.

State x, v, a; between samples h apart

    x += h v + h^2/2 a,  v += h a,  a += noise of variance q h   (q: density of the white jerk, m^2/s^5)

and a reading is x + noise of variance r.  The covariance p is kept as its six numbers p00 p01 p02 p11 p12 p22.
The filter writes down what it expected of every sample; the smoother goes back over that and needs no inverse:

    l = F'l - h (e/s + k'l),   smoothed state = expected - p l,   its covariance = p - p m p

with the adjoint state l and its information m (F the step above, h = (1,0,0), e the innovation, s its variance, k the
gain).  In what is stored s stands for 1/s.

Every function runs as written or compiled (`daq.compute.compile`).
Source: G. J. Bierman, Automatica 9 (1973) 503 (the modified Bryson-Frazier smoother); Q of the integrated Wiener
process: Wahba, J. R. Stat. Soc. B 40 (1978) 364.
"""

import math

from daq.compute.arrays import Array, Integers

State = tuple[float, ...]  # x v a, and the six of p
Sums = tuple[float, float, float]

STATE = 10  # numbers in a filter's state: x v a, the six of p, and the time they hold for
STORED = 11  # numbers kept of a sample: x v a and p as expected, 1/s, e/s
SETTLED = 36.0  # natural logarithm of how far a start must have faded: 2e-16


def predict(h: float, q: float, S: State) -> State:
    """Carry the state over h seconds."""
    x, v, a, p00, p01, p02, p11, p12, p22 = S
    h2 = 0.5 * h * h
    b00 = p00 + h * p01 + h2 * p02
    b01 = p01 + h * p11 + h2 * p12
    b02 = p02 + h * p12 + h2 * p22
    b11 = p11 + h * p12
    b12 = p12 + h * p22
    q1 = q * h
    q2 = q1 * h
    q3 = q2 * h
    return (
        x + h * v + h2 * a,
        v + h * a,
        a,
        b00 + h * b01 + h2 * b02 + q3 * h * h * (1 / 20),
        b01 + h * b02 + q3 * h * (1 / 8),
        b02 + q3 * (1 / 6),
        b11 + h * b12 + q3 * (1 / 3),
        b12 + q2 * (1 / 2),
        p22 + q1,
    )


def update(e: float, s: float, r: float, S: State) -> State:
    """Take in a reading with innovation e; s = 1/(p00 + r)."""
    x, v, a, p00, p01, p02, p11, p12, p22 = S
    g, k1, k2, f = e * s, p01 * s, p02 * s, r * s
    return (
        x + p00 * g,
        v + p01 * g,
        a + p02 * g,
        p00 * f,
        p01 * f,
        p02 * f,
        p11 - k1 * p01,
        p12 - k1 * p02,
        p22 - k2 * p02,
    )


def forward(time: Array, position: Array, q: float, r: float, state: Array, stored: Array) -> None:
    """Filter from ``state`` on, which ends behind the last sample; write what was expected of each, (n, STORED)."""
    S: State = (state[0], state[1], state[2], state[3], state[4], state[5], state[6], state[7], state[8])
    last = state[9]
    for i in range(time.size):
        S = predict(time[i] - last, q, S)
        last = time[i]
        s = 1.0 / (S[3] + r)
        e = position[i] - S[0]
        w = stored[i]
        w[0], w[1], w[2], w[3], w[4], w[5], w[6], w[7], w[8] = S
        w[9], w[10] = s, e * s
        S = update(e, s, r, S)
    state[0], state[1], state[2], state[3], state[4], state[5], state[6], state[7], state[8] = S
    state[9] = last


def backward(time: Array, stored: Array, wanted: int, motion: Array, begin: int) -> None:
    """Smooth from the last sample back; write x v a and their variances of the first ``wanted``.

    They go into ``motion``, (6, n), from its column ``begin`` on.
    """
    l0 = l1 = l2 = 0.0
    m00 = m01 = m02 = m11 = m12 = m22 = 0.0
    for i in range(time.size - 1, -1, -1):
        w = stored[i]
        p00, p01, p02, p11, p12, p22, s = w[3], w[4], w[5], w[6], w[7], w[8], w[9]
        k0, k1, k2 = p00 * s, p01 * s, p02 * s
        u0 = k0 * m00 + k1 * m01 + k2 * m02
        u1 = k0 * m01 + k1 * m11 + k2 * m12
        u2 = k0 * m02 + k1 * m12 + k2 * m22
        l0 -= k0 * l0 + k1 * l1 + k2 * l2 + w[10]
        m00 += k0 * u0 + k1 * u1 + k2 * u2 + s - 2 * u0
        m01 -= u1
        m02 -= u2
        if i < wanted:
            motion[0, begin + i] = w[0] - (p00 * l0 + p01 * l1 + p02 * l2)
            motion[1, begin + i] = w[1] - (p01 * l0 + p11 * l1 + p12 * l2)
            motion[2, begin + i] = w[2] - (p02 * l0 + p12 * l1 + p22 * l2)
            motion[3, begin + i] = p00 - quadratic_form(p00, p01, p02, m00, m01, m02, m11, m12, m22)
            motion[4, begin + i] = p11 - quadratic_form(p01, p11, p12, m00, m01, m02, m11, m12, m22)
            motion[5, begin + i] = p22 - quadratic_form(p02, p12, p22, m00, m01, m02, m11, m12, m22)
        if i > 0:
            h = time[i] - time[i - 1]
            h2 = 0.5 * h * h
            l2 += h * l1 + h2 * l0
            l1 += h * l0
            b02 = m02 + h * m01 + h2 * m00
            b12 = m12 + h * m11 + h2 * m01
            b22 = m22 + h * m12 + h2 * m02
            m01 += h * m00
            m11 += h * m01 + h * (m01 - h * m00)
            m02 = b02
            m12 = b12 + h * b02
            m22 = b22 + h * b12 + h2 * b02


def quadratic_form(
    a: float, b: float, c: float, m00: float, m01: float, m02: float, m11: float, m12: float, m22: float
) -> float:
    """Return the square of (a, b, c) under the matrix m."""
    return a * (a * m00 + 2 * (b * m01 + c * m02)) + b * (b * m11 + 2 * c * m12) + c * c * m22


def sum_likelihood(time: Array, position: Array, edges: Integers, every: int, q: float, states: Array) -> Sums:
    """Filter the stretches of samples edges[k]..edges[k + 1] - 1 of every ``every``-th k, for readings of variance 1.

    Each begins in its own of the ``states``, (k, STATE).  Returned are sums over all samples but the first four of a
    stretch, which only set its filter up: of the logarithm of the innovation's variance, of its square over that
    variance, and of 1.
    """
    logarithms = squares = samples = 0.0
    product = 1.0
    for k in range(0, edges.size - 1, every):
        w = states[k]
        S: State = (w[0], w[1], w[2], w[3], w[4], w[5], w[6], w[7], w[8])
        last = w[9]
        for i in range(edges[k], edges[k + 1]):
            S = predict(time[i] - last, q, S)
            last = time[i]
            s = 1.0 / (S[3] + 1.0)
            e = position[i] - S[0]
            if i >= edges[k] + 4:
                product *= s
                squares += e * e * s
                samples += 1.0
                if product < 1e-200:
                    logarithms -= math.log(product)
                    product = 1.0
            S = update(e, s, 1.0, S)
    return logarithms - math.log(product), squares, samples
