"""Savitzky-Golay on an even grid against 50-digit arithmetic, and fits one by one."""

from functools import cache

import mpmath
import numpy as np
import pytest

from processing.polynomial.even import coefficients, fit


@cache
def reference(window, order, at):
    """Return the same weights in 50 digits, by orthonormal Gram polynomials."""
    with mpmath.workdps(50):
        half, at = window // 2, mpmath.mpf(at)
        grid = [mpmath.mpf(j) for j in range(-half, half + 1)]
        p_last, p = [mpmath.mpf(0)] * window, [1 / mpmath.sqrt(window)] * window
        e_last, e = [mpmath.mpf(0)] * 3, [p[0], mpmath.mpf(0), mpmath.mpf(0)]
        weights = [[e[d] * q for q in p] for d in range(3)]
        b_last = mpmath.mpf(0)
        for k in range(1, order + 1):
            b = mpmath.mpf(k) / 2 * mpmath.sqrt(mpmath.mpf(window**2 - k**2) / (4 * k**2 - 1))
            p_last, p = p, [(j * q - b_last * r) / b for j, q, r in zip(grid, p, p_last, strict=True)]
            new = [
                (at * e[0] - b_last * e_last[0]) / b,
                (at * e[1] + e[0] - b_last * e_last[1]) / b,
                (at * e[2] + 2 * e[1] - b_last * e_last[2]) / b,
            ]
            e_last, e, b_last = e, new, b
            weights = [[w + e[d] * q for w, q in zip(weights[d], p, strict=True)] for d in range(3)]
        return np.array([[float(w) for w in row] for row in weights])


def worst(found, exact):
    """Largest error relative to the largest weight of each derivative."""
    size = np.abs(exact).max(axis=1)
    return float((np.abs(found - exact).max(axis=1)[size > 0] / size[size > 0]).max())


CASES = [
    (5, 2),
    (5, 4),
    (21, 2),
    (21, 4),
    (21, 14),
    (21, 20),
    (23, 20),
    (25, 20),
    (41, 6),
    (51, 14),
    (101, 10),
    (301, 8),
    (1001, 6),
]


@pytest.mark.parametrize(("window", "order"), CASES)
@pytest.mark.parametrize("place", [0.0, 0.5, -1.0, 1.0])
def test_weights_agree_with_50_digits_anywhere_in_the_window(window, order, place):
    at = round(place * (window // 2))
    assert worst(coefficients(window, order, at), reference(window, order, at)) < 1e-13


def test_the_longest_window_and_highest_order_agree_with_50_digits():
    assert worst(coefficients(3001, 20, -1500), reference(3001, 20, -1500)) < 1e-13


@pytest.mark.parametrize("window", [0, 2, 40, -3])
def test_an_even_window_is_refused(window):
    with pytest.raises(ValueError, match=f"odd number above the order .2., not {window}"):
        coefficients(window, 2)


@pytest.mark.parametrize("order", [-1, 5, 9])
def test_an_order_that_the_window_cannot_carry_is_refused(order):
    with pytest.raises(ValueError, match="the order must be from 0 to 4"):
        coefficients(5, order)


@pytest.mark.parametrize(("window", "order"), [(1, 0), (5, 2), (7, 0), (41, 4), (301, 7), (1001, 4)])
@pytest.mark.parametrize("extra", [0, 1, 5000])
def test_every_sample_gets_the_polynomial_of_its_own_window(window, order, extra):
    """Weights in 50 digits applied to whole numbers of counts: only the sum is rounded."""
    n = window + extra
    rng = np.random.default_rng(window)
    position = np.floor(300 * np.sin(np.arange(n) / 40) + np.cumsum(rng.standard_normal(n)))
    values, norms = fit(position, window, order, 0.5)
    for i in {0, 1, window // 3, n // 2, n - 1 - window // 4, n - 1}:
        if i >= n:
            continue
        first = min(max(i - window // 2, 0), n - window)
        weights = reference(window, order, i - first - window // 2) * [[1], [2], [4]]
        own = position[first : first + window]
        size = np.abs(weights).sum(axis=1) * np.abs(position).max()
        assert (np.abs(values[:, i] - [np.sum(row * own) for row in weights]) <= 1e-13 * size).all()
        assert norms[:, i] == pytest.approx(np.linalg.norm(weights, axis=1), rel=1e-13, abs=1e-300)


@pytest.mark.parametrize(("window", "order"), [(41, 4), (7, 3), (31, 6), (1501, 4), (3001, 4)])
def test_a_part_of_the_record_gives_what_the_whole_gives(window, order):
    position = np.cumsum(np.random.default_rng(2).standard_normal(12_000))
    whole = fit(position, window, order, 1.0)[0]
    half, begin, end = window // 2, 500, 500 + window + 700
    part = fit(position[begin:end], window, order, 1.0)[0]
    size = np.abs(coefficients(window, order)).sum(axis=1) * np.abs(position).max()
    apart = np.abs(part[:, half:-half] - whole[:, begin + half : end - half]).max(axis=1)
    assert (apart <= 1e-14 * size).all()
