"""The search for the parameter in which a form is not linear."""

import math

import numpy as np
import pytest

from fitting.curve.forms import TRIED, best_bend


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
