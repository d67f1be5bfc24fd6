"""The search for the parameter in which a form is not linear, and what follows a form."""

import math

import numpy as np
import pytest

from fitting.curve.forms import TRIED, best_bend, followed


def test_a_narrow_valley_is_found_beside_a_wide_one():
    # On a record of 7.67 um counts the true curve's valley lay between two values that were tried: the form ended with
    # Fs = -94 m/s^2 and chi 12 instead of 1.1.
    step = math.log(1e2 / 2e-3) / (TRIED - 1)
    true, false = 2e-3 * math.exp(20.5 * step), 2e-3 * math.exp(3 * step)

    def columns(value):
        narrow, wide = 4 * abs(math.log(value / true)), 0.3 + 0.2 * abs(math.log(value / false))
        angle = min(narrow, wide)
        return np.array([[math.cos(angle)], [math.sin(angle)], [0.0]])

    assert best_bend(columns, np.array([1.0, 0.0, 0.0]), 2e-3, 1e2) == pytest.approx(true, rel=1e-4)


def test_an_unknown_without_curvature_does_not_follow_a_form():
    """Where the search for the curve had failed (law 5, 10 samples a slip) a negative one made every form NaN."""
    curvature = np.array([[4.0, 1.0, 0.0], [1.0, 2.0, 0.0], [0.0, 0.0, -1e-3]])
    cross = np.array([[1.0, 2.0, 0.5], [0.0, 1.0, 3.0]])
    found = followed(curvature, cross)
    assert found[:2] == pytest.approx(np.linalg.inv(curvature[:2, :2]) @ cross[:, :2].T)
    assert not found[2].any()
