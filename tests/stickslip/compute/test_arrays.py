"""The integrated autocorrelation time."""

import numpy as np
import pytest

from stickslip.compute.arrays import autocorrelation_time


def test_autocorrelation_time_of_a_first_order_process_is_its_closed_form():
    draw, rho = np.random.default_rng(2), 0.8
    pieces = []
    for n in (60_000, 41_001):
        r = np.zeros(n)
        e = draw.standard_normal(n)
        for k in range(1, n):
            r[k] = rho * r[k - 1] + e[k]
        pieces.append(r)
    assert autocorrelation_time(pieces) == pytest.approx((1 + rho) / (1 - rho), rel=0.15)


def test_autocorrelation_time_is_never_below_one():
    assert autocorrelation_time([np.tile([1.0, -1.0], 50)]) == 1.0
    assert autocorrelation_time([np.zeros(9)]) == 1.0
    assert autocorrelation_time([]) == 1.0
