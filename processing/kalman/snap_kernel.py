"""Kernels: the Kalman filter of a motion of white snap that sticks and slips, its smoother, and its noise.

State x, v, a, j (jerk); between samples the snap is a mean u (m/s^4) and white noise of density q (m^2/s^7), a reading
is x + noise of variance r, and all change with the part of the motion a sample lies in (its label).  Between samples
lie corners:

    LAND    onto a belt that runs evenly: x and v go on, a and j are 0 from here
    LEAVE   the belt: x and v go on, a and j change by an unknown step of variance jump[0], jump[1]
    MEET    a belt that does not run evenly: as LEAVE, of variance jump[2], jump[3]
    KICK    v, a and j all step: jump[4], jump[5], jump[6]
    START   from rest: as LEAVE, of variance jump[7], jump[8]
    STOP    to rest: as LAND
    OVERTAKE  the mass comes up to the belt's speed and runs ahead of it: as MEET; it lands behind that

The covariance p is kept as its ten numbers p00 p01 p02 p03 p11 p12 p13 p22 p23 p33; the smoother is the one of
`processing.kalman.jerk_kernel`.  On its way back it sums what says how well each noise level was chosen: with l the
adjoint state and m its information, sum(l3^2)/sum(m33) is 1 at the level of greatest likelihood, and the level times
that ratio comes closer to it.

Every function runs as written or compiled (`daq.compute.compile`).
Source: as for `processing.kalman.jerk_kernel`; the fixed point: J. Burridge, Commun. Stat. 16 (1987); D. MacKay, Neural
Comput. 4 (1992) 415.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from daq.compute.arrays import Array

State = tuple[float, ...]  # x v a j, and the ten of p
Labels = NDArray[np.uint8]

STATE = 15  # numbers in a filter's state: x v a j, the ten of p, and the time they hold for
STORED = 16  # numbers kept of a sample: the state as expected, 1/s, e/s
LAND, LEAVE, MEET, KICK, START, STOP, OVERTAKE = 1, 2, 3, 4, 5, 6, 7
STICK, LANDING, SLIP, ONSET, RIDE, MET, LEAVING, REST = 0, 1, 5, 6, 10, 11, 12, 13  # LANDING and ONSET: four each
CUT = 14  # four: where a slip is cut off
LABELS = 18
NEAR_LANDING = (1 / 128, 1 / 48, 1 / 24, 1 / 8)  # of a slip's length: where its parts near a landing begin
NEAR_ONSET = (1 / 32, 1 / 16, 1 / 8, 1 / 4)
JUMPS = 9  # variances: LEAVE a j, MEET a j, KICK v a j, START a j


class NoiseLevels(NamedTuple):
    """Noise of each part of the motion, by its label, and of the resets at corners.

    Attributes
    ----------
    process_density, mean_snap : array of shape (LABELS,)
        Density, m^2/s^7, and mean, m/s^4, of the snap.
    reading_variance : array of shape (LABELS,)
        m^2.
    reset_variance : array of shape (JUMPS,)
        Of the steps at corners: LEAVE a j, MEET a j, KICK v a j, START a j, in (m/s)^2, (m/s^2)^2, (m/s^3)^2.
    peak : float
        About the largest acceleration, m/s^2.
    """

    process_density: Array
    mean_snap: Array
    reading_variance: Array
    reset_variance: Array
    peak: float


def predict(h: float, q: float, u: float, S: State) -> State:
    """Carry the state over h seconds, in which the snap has mean u and density q."""
    x, v, a, j, p00, p01, p02, p03, p11, p12, p13, p22, p23, p33 = S
    h2 = 0.5 * h * h
    h3 = h2 * h * (1 / 3)
    b00 = p00 + h * p01 + h2 * p02 + h3 * p03
    b01 = p01 + h * p11 + h2 * p12 + h3 * p13
    b02 = p02 + h * p12 + h2 * p22 + h3 * p23
    b03 = p03 + h * p13 + h2 * p23 + h3 * p33
    b11 = p11 + h * p12 + h2 * p13
    b12 = p12 + h * p22 + h2 * p23
    b13 = p13 + h * p23 + h2 * p33
    b22 = p22 + h * p23
    b23 = p23 + h * p33
    q1 = q * h
    q2 = q1 * h
    q3 = q2 * h
    q4 = q3 * h
    q5 = q4 * h
    return (
        x + h * v + h2 * a + h3 * (j + 0.25 * h * u),
        v + h * a + h2 * (j + (1 / 3) * h * u),
        a + h * (j + 0.5 * h * u),
        j + h * u,
        b00 + h * b01 + h2 * b02 + h3 * b03 + q5 * h * h * (1 / 252),
        b01 + h * b02 + h2 * b03 + q5 * h * (1 / 72),
        b02 + h * b03 + q5 * (1 / 30),
        b03 + q4 * (1 / 24),
        b11 + h * b12 + h2 * b13 + q5 * (1 / 20),
        b12 + h * b13 + q4 * (1 / 8),
        b13 + q3 * (1 / 6),
        b22 + h * b23 + q3 * (1 / 3),
        b23 + q2 * (1 / 2),
        p33 + q1,
    )


def update(e: float, s: float, r: float, S: State) -> State:
    """Take in a reading with innovation e; s = 1/(p00 + r).

    A variance keeps at least the part r s of itself, since p01^2 <= p00 p11: where r is 1e-16 of p00, as beside a
    reading without noise, the difference is rounding, of either sign.
    """
    x, v, a, j, p00, p01, p02, p03, p11, p12, p13, p22, p23, p33 = S
    g, k1, k2, k3, f = e * s, p01 * s, p02 * s, p03 * s, r * s
    return (
        x + p00 * g,
        v + p01 * g,
        a + p02 * g,
        j + p03 * g,
        p00 * f,
        p01 * f,
        p02 * f,
        p03 * f,
        max(p11 - k1 * p01, p11 * f),
        p12 - k1 * p02,
        p13 - k1 * p03,
        max(p22 - k2 * p02, p22 * f),
        p23 - k2 * p03,
        max(p33 - k3 * p03, p33 * f),
    )


def line_predict(h: float, S: State) -> State:
    """As `predict`, on an even belt or at rest, where a = j = 0 are known and there is no noise."""
    p01 = S[5] + h * S[8]
    return (S[0] + h * S[1], S[1], 0.0, 0.0, S[4] + h * (S[5] + p01), p01, 0.0, 0.0, S[8], 0.0, 0.0, 0.0, 0.0, 0.0)


def line_update(e: float, s: float, r: float, S: State) -> State:
    """As `update`, where a = j = 0 are known."""
    g, f = e * s, r * s
    p11 = max(S[8] - S[5] * s * S[5], S[8] * f)
    return (S[0] + S[4] * g, S[1] + S[5] * g, 0.0, 0.0, S[4] * f, S[5] * f, 0.0, 0.0, p11, 0.0, 0.0, 0.0, 0.0, 0.0)


def turn(kind: int | np.int64, jump: Array, S: State) -> State:
    """Go through a corner."""
    x, v, a, j, p00, p01, p02, p03, p11, p12, p13, p22, p23, p33 = S
    if kind == LAND or kind == STOP:
        return (x, v, 0.0, 0.0, p00, p01, 0.0, 0.0, p11, 0.0, 0.0, 0.0, 0.0, 0.0)
    if kind == LEAVE:
        return (x, v, a, j, p00, p01, p02, p03, p11, p12, p13, p22 + jump[0], p23, p33 + jump[1])
    if kind == MEET or kind == OVERTAKE:
        return (x, v, a, j, p00, p01, p02, p03, p11, p12, p13, p22 + jump[2], p23, p33 + jump[3])
    if kind == START:
        return (x, v, a, j, p00, p01, p02, p03, p11, p12, p13, p22 + jump[7], p23, p33 + jump[8])
    return (x, v, a, j, p00, p01, p02, p03, p11 + jump[4], p12, p13, p22 + jump[5], p23, p33 + jump[6])


def unpacked(w: Array) -> State:
    """Return the numbers of a state."""
    return (w[0], w[1], w[2], w[3], w[4], w[5], w[6], w[7], w[8], w[9], w[10], w[11], w[12], w[13])


def pack(w: Array, S: State) -> None:
    """Write the numbers of a state."""
    x, v, a, j, p00, p01, p02, p03, p11, p12, p13, p22, p23, p33 = S
    w[0], w[1], w[2], w[3], w[4], w[5], w[6] = x, v, a, j, p00, p01, p02
    w[7], w[8], w[9], w[10], w[11], w[12], w[13] = p03, p11, p12, p13, p22, p23, p33


def forward(
    time: Array,
    position: Array,
    label: Labels,
    at: Array,
    kind: Labels,
    levels: NoiseLevels,
    state: Array,
    stored: Array,
) -> None:
    """Filter from ``state`` on; write what was expected of each sample, (n, STORED).

    ``label`` (n,) picks the noise levels; ``at`` and ``kind`` (c,) are the corners among them, in order.
    """
    q, u, r = levels.process_density, levels.mean_snap, levels.reading_variance
    S = unpacked(state)
    last = state[14]
    c = 0
    for i in range(time.size):
        while c < at.size and at[c] <= time[i]:
            b = label[max(i - 1, 0)]
            S = predict(at[c] - last, q[b], u[b], S)
            S = turn(np.int64(kind[c]), levels.reset_variance, S)
            last = at[c]
            c += 1
        b = label[i]
        w = stored[i]
        still = b == STICK or b == REST
        S = line_predict(time[i] - last, S) if still else predict(time[i] - last, q[b], u[b], S)
        last = time[i]
        pack(w, S)
        s = 1.0 / (S[4] + r[b])
        e = position[i] - S[0]
        w[14], w[15] = s, e * s
        S = line_update(e, s, r[b], S) if still else update(e, s, r[b], S)


def backward(
    time: Array,
    label: Labels,
    at: Array,
    kind: Labels,
    stored: Array,
    wanted: bool,
    motion: Array,
    begin: int,
    noise: Array,
    steps: Array,
) -> None:
    """Smooth from the last sample back.

    ``motion`` (6, n) gets x v a and their variances, if ``wanted``, from its column ``begin`` on; ``noise``
    (labels, 4) is added sum(l3^2), sum(m33), and the same for the readings; ``steps`` (JUMPS, 2) likewise for the
    corners' steps.
    """
    l0 = l1 = l2 = l3 = 0.0
    m00 = m01 = m02 = m03 = m11 = m12 = m13 = m22 = m23 = m33 = 0.0
    c = at.size - 1
    for i in range(time.size - 1, -1, -1):
        w = stored[i]
        b = label[i]
        if b == STICK or b == REST:
            # a and j are known: what would be learned of them is not asked for.
            p00, p01, s = w[4], w[5], w[14]
            k0, k1 = p00 * s, p01 * s
            u0, u1 = k0 * m00 + k1 * m01, k0 * m01 + k1 * m11
            u, d = k0 * l0 + k1 * l1 + w[15], k0 * u0 + k1 * u1 + s
            l0 -= u
            m00 += d - 2 * u0
            m01 -= u1
            noise[b, 2] += u * u
            noise[b, 3] += d
            if wanted:
                motion[0, begin + i] = w[0] - (p00 * l0 + p01 * l1)
                motion[1, begin + i] = w[1] - (p01 * l0 + w[8] * l1)
                motion[2, begin + i] = 0.0
                motion[3, begin + i] = p00 - (p00 * p00 * m00 + 2 * p00 * p01 * m01 + p01 * p01 * m11)
                motion[4, begin + i] = w[8] - (p01 * p01 * m00 + 2 * p01 * w[8] * m01 + w[8] * w[8] * m11)
                motion[5, begin + i] = 0.0
            if i > 0 and (c < 0 or at[c] <= time[i - 1]):
                h = time[i] - time[i - 1]
                l1 += h * l0
                m11 += h * (2 * m01 + h * m00)
                m01 += h * m00
                continue
        else:
            p00, p01, p02, p03, p11, p12, p13 = w[4], w[5], w[6], w[7], w[8], w[9], w[10]
            p22, p23, s = w[11], w[12], w[14]
            k0, k1, k2, k3 = p00 * s, p01 * s, p02 * s, p03 * s
            u0 = k0 * m00 + k1 * m01 + k2 * m02 + k3 * m03
            u1 = k0 * m01 + k1 * m11 + k2 * m12 + k3 * m13
            u2 = k0 * m02 + k1 * m12 + k2 * m22 + k3 * m23
            u3 = k0 * m03 + k1 * m13 + k2 * m23 + k3 * m33
            u = k0 * l0 + k1 * l1 + k2 * l2 + k3 * l3 + w[15]
            d = k0 * u0 + k1 * u1 + k2 * u2 + k3 * u3 + s
            l0 -= u
            m00 += d - 2 * u0
            m01 -= u1
            m02 -= u2
            m03 -= u3
            noise[b, 2] += u * u
            noise[b, 3] += d
            if wanted:
                motion[0, begin + i] = w[0] - (p00 * l0 + p01 * l1 + p02 * l2 + p03 * l3)
                motion[1, begin + i] = w[1] - (p01 * l0 + p11 * l1 + p12 * l2 + p13 * l3)
                motion[2, begin + i] = w[2] - (p02 * l0 + p12 * l1 + p22 * l2 + p23 * l3)
                c0 = p00 * m00 + p01 * m01 + p02 * m02 + p03 * m03
                c1 = p00 * m01 + p01 * m11 + p02 * m12 + p03 * m13
                c2 = p00 * m02 + p01 * m12 + p02 * m22 + p03 * m23
                c3 = p00 * m03 + p01 * m13 + p02 * m23 + p03 * m33
                motion[3, begin + i] = p00 - (p00 * c0 + p01 * c1 + p02 * c2 + p03 * c3)
                c0 = p01 * m00 + p11 * m01 + p12 * m02 + p13 * m03
                c1 = p01 * m01 + p11 * m11 + p12 * m12 + p13 * m13
                c2 = p01 * m02 + p11 * m12 + p12 * m22 + p13 * m23
                c3 = p01 * m03 + p11 * m13 + p12 * m23 + p13 * m33
                motion[4, begin + i] = p11 - (p01 * c0 + p11 * c1 + p12 * c2 + p13 * c3)
                c0 = p02 * m00 + p12 * m01 + p22 * m02 + p23 * m03
                c1 = p02 * m01 + p12 * m11 + p22 * m12 + p23 * m13
                c2 = p02 * m02 + p12 * m12 + p22 * m22 + p23 * m23
                c3 = p02 * m03 + p12 * m13 + p22 * m23 + p23 * m33
                motion[5, begin + i] = p22 - (p02 * c0 + p12 * c1 + p22 * c2 + p23 * c3)
        if i == 0:
            break
        now = time[i]
        while True:
            # Back over the interval; corners in it, the latest first, cut it into parts.
            corner = c >= 0 and at[c] > time[i - 1]
            h = now - (at[c] if corner else time[i - 1])
            h2 = 0.5 * h * h
            h3 = h2 * h * (1 / 3)
            noise[b, 0] += h * (l3 * l3 + h * l2 * l3)
            noise[b, 1] += h * (m33 + h * m23)
            l3 += h * l2 + h2 * l1 + h3 * l0
            l2 += h * l1 + h2 * l0
            l1 += h * l0
            b01 = h * m00 + m01
            b02 = h2 * m00 + h * m01 + m02
            b03 = h3 * m00 + h2 * m01 + h * m02 + m03
            b11 = h * m01 + m11
            b12 = h2 * m01 + h * m11 + m12
            b13 = h3 * m01 + h2 * m11 + h * m12 + m13
            b22 = h2 * m02 + h * m12 + m22
            b23 = h3 * m02 + h2 * m12 + h * m22 + m23
            b33 = h3 * m03 + h2 * m13 + h * m23 + m33
            m01 = b01
            m02 = b02
            m03 = b03
            m11 = h * b01 + b11
            m12 = h * b02 + b12
            m13 = h * b03 + b13
            m22 = h2 * b02 + h * b12 + b22
            m23 = h2 * b03 + h * b13 + b23
            m33 = h3 * b03 + h2 * b13 + h * b23 + b33
            if not corner:
                break
            now = at[c]
            what = kind[c]
            b = label[i - 1]
            c -= 1
            if what == LAND or what == STOP:
                l2 = l3 = 0.0
                m02 = m03 = m12 = m13 = m22 = m23 = m33 = 0.0
                continue
            first = 0 if what == LEAVE else 2 if what == MEET or what == OVERTAKE else 5 if what == KICK else 7
            steps[first, 0] += l2 * l2
            steps[first, 1] += m22
            steps[first + 1, 0] += l3 * l3
            steps[first + 1, 1] += m33
            if what == KICK:
                steps[4, 0] += l1 * l1
                steps[4, 1] += m11
