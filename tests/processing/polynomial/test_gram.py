"""Savitzky-Golay coefficients against 50-digit arithmetic and against what is known of them in closed form."""

import mpmath
import numpy as np
import pytest

from processing.polynomial.gram import coefficients


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


def test_between_samples_too():
    assert worst(coefficients(41, 6, 0.37), reference(41, 6, 0.37)) < 1e-13


def test_the_published_quadratic_of_five_points():
    assert coefficients(5, 2)[0] * 35 == pytest.approx([-3, 12, 17, 12, -3], abs=1e-13)
    assert coefficients(5, 2)[1] * 10 == pytest.approx([-2, -1, 0, 1, 2], abs=1e-14)
    assert coefficients(5, 2)[2] * 7 == pytest.approx([2, -1, -2, -1, 2], abs=1e-14)


def test_the_far_end_mirrors_the_near_end():
    near, far = coefficients(31, 5, -15), coefficients(31, 5, 15)
    assert far[:, ::-1] * [[1], [-1], [1]] == pytest.approx(near, rel=1e-13, abs=1e-16)


def test_a_derivative_above_the_order_is_zero():
    assert not coefficients(11, 1)[2].any()
    assert not coefficients(11, 0)[1:].any()


@pytest.mark.parametrize("window", [0, 2, 40, -3])
def test_an_even_window_is_refused(window):
    with pytest.raises(ValueError, match=f"window is {window}; need an odd number above order 2"):
        coefficients(window, 2)


@pytest.mark.parametrize("order", [-1, 5, 9])
def test_an_order_that_the_window_cannot_carry_is_refused(order):
    with pytest.raises(ValueError, match=f"order is {order}; need 0 to 4"):
        coefficients(5, order)
