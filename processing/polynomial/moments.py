"""Kernel: Savitzky-Golay on counts at an even rate, in a time that does not depend on the window.

The weights of a fit of order up to 4, taken at its centre, are polynomials in j = -M..M, so position, velocity and
acceleration are sums over the moments M_p = sum_j j^p c_{i+j}, p = 0..4.  From one sample to the next these follow by

    M_p' = sum_k C(p, k) (-1)^(p-k) M_k + M^p c_{i+1+M} - (-M-1)^p c_{i-M}

in whole numbers: nothing is rounded, so nothing piles up, and a stream gives what the whole record gives, bit for bit.
Whole numbers of 64 bits may overflow on the way: seen from the count at the centre the moments are small, and the rest
cancels modulo 2^64.  In windows too long for that the fourth moment alone is not small, but changes little from
one sample to the next: how often it went round 2^64 is counted, and it is exact again.

Runs as written on Python integers that wrap, which are slow, or compiled (`daq.compute.compile`); only the latter is
used.
"""

import numpy as np

from daq.compute.arrays import Array, Integers
from processing.polynomial.gram import coefficients

HIGHEST = 4  # order
LARGEST = 2.0**62  # of a moment
ENOUGH = 128.0  # counts per sample
WHOLE = 2.0**64


def wide(window: int) -> bool:
    """Tell whether the fourth moment, seen from its centre, may need more than 64 bits."""
    return 3 * LARGEST / max(window // 2, 1) ** 6 < ENOUGH


def fastest(window: int, order: int) -> float:
    """Return the most counts per sample at which every moment, seen from its centre, is known exactly; 0 for none.

    A window that could not take `ENOUGH` takes none, so that hardly any record has windows of both kinds.
    """
    half = max(window // 2, 1)
    most = 1.25 * LARGEST / half**5 if wide(window) else 3 * LARGEST / half**6
    return most if order <= HIGHEST and most >= ENOUGH else 0.0


def fits(count: Integers, window: int, order: int) -> bool:
    """Tell whether the record can be filtered in whole numbers."""
    return count.size >= window and float(np.abs(np.diff(count)).max(initial=0)) <= fastest(window, order)


def power_weights(window: int, order: int) -> Array:
    """Return the weights of the moments in x, dx/dj and d2x/dj2, (3, 5) (`gram.coefficients`)."""
    half = window // 2
    weights = coefficients(window, order)
    if half < 2:  # too few samples for five powers; none above the window's own is asked for
        powers = np.vander(np.arange(-half, half + 1.0), window, increasing=True)
        found = np.linalg.solve(powers, weights.T).T
        return np.asarray(np.pad(found, ((0, 0), (0, 5 - window))))
    # An even polynomial through its values at 0, M/2, M and an odd one through M/2, M: exact to the last digits.
    rows = np.zeros((3, 5))
    mid = max(half // 2, 1)
    a, b = float(mid), float(half)
    for d in range(3):
        w0, wa, wb = (float(weights[d, half + k]) for k in (0, mid, half))
        va, vb = (0.5 * (float(weights[d, half + k]) - float(weights[d, half - k])) for k in (mid, half))
        if d == 1:
            cubic = (vb / b - va / a) / (b * b - a * a)
            rows[d, 3] = cubic
            rows[d, 1] = va / a - cubic * a * a
        else:
            one, two = (wa - w0) / (a * a), (wb - w0) / (b * b)
            quartic = (two - one) / (b * b - a * a)
            rows[d] = (w0, 0.0, one - quartic * a * a, 0.0, quartic)
    return rows


def sums(window: int) -> Integers:
    """Return the sums of j^2 and j^4 over the window."""
    squares = [j * j for j in range(-(window // 2), window // 2 + 1)]
    return np.array([sum(squares), sum(square * square for square in squares)], np.int64)


def slide(count: Integers, half: int, weights: Array, even: Integers, values: Array) -> None:
    """Fit around every sample that has ``half`` to either side; ``values`` (3, n) gets x (from c_i on), dx/dj, d2x/dj2.

    ``weights`` is `power_weights`, ``even`` `sums`.
    """
    n = count.size
    window = np.int64(2 * half + 1)
    m0 = m1 = m2 = m3 = m4 = np.int64(0)
    rounded = 0.0  # the fourth moment, seen from the centre
    for k in range(2 * half + 1):
        j, c = np.int64(k - half), count[k]
        m0 += c
        m1 += j * c
        m2 += j * j * c
        m3 += j * j * j * c
        m4 += j * j * j * j * c
        rounded += float(j * j * j * j) * float(c - count[half])
    high, low = np.int64(half), np.int64(-half - 1)
    high2, low2 = high * high, low * low
    high3, low3, high4, low4 = high2 * high, low2 * low, high2 * high2, low2 * low2
    s2, s4 = even[0], even[1]
    last = float(m4 - s4 * count[half])
    over = np.rint((rounded - last) / WHOLE)
    w00, w02, w04 = weights[0, 0], weights[0, 2], weights[0, 4]
    w11, w13 = weights[1, 1], weights[1, 3]
    w20, w22, w24 = weights[2, 0], weights[2, 2], weights[2, 4]
    for i in range(half, n - half):
        c = count[i]
        f0, f2 = float(m0 - window * c), float(m2 - s2 * c)
        left = float(m4 - s4 * c)
        # The moment itself changes by less than a quarter of 2^64: where its 64 bits change by more, they went round.
        if left - last > 0.5 * WHOLE:
            over -= 1.0
        elif last - left > 0.5 * WHOLE:
            over += 1.0
        last = left
        f4 = WHOLE * over + left
        values[0, i] = w00 * f0 + w02 * f2 + w04 * f4
        values[1, i] = w11 * float(m1) + w13 * float(m3)
        values[2, i] = w20 * f0 + w22 * f2 + w24 * f4
        if i + 1 + half < n:
            new, old = count[i + 1 + half], count[i - half]
            m4 += 6 * m2 - 4 * (m3 + m1) + m0 + high4 * new - low4 * old
            m3 += 3 * (m1 - m2) - m0 + high3 * new - low3 * old
            m2 += m0 - 2 * m1 + high2 * new - low2 * old
            m1 += high * new - low * old - m0
            m0 += new - old
