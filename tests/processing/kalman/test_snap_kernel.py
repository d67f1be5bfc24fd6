"""The covariance of the motion of white snap beside readings that are next to free of noise."""

import numpy as np
import pytest

from processing.kalman.snap_kernel import line_predict, line_update, update

NOISE = 1e-22  # variance of a reading over that of the position that is expected


def states(count=200):
    """Return states whose velocity follows from their position: all that a reading leaves of p11 is its own noise."""
    rng = np.random.default_rng(3)
    for p00, slope in 10 ** rng.uniform(-8, 0, (count, 2)):
        p01, p11 = slope * p00, slope**2 * p00
        yield (0.0, 0.0, 0.0, 0.0, p00, p01, 0.0, 0.0, p11, 0.0, 0.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize("take_in", [update, line_update])
def test_a_variance_stays_one_beside_readings_without_noise(take_in):
    """Rounding left p11 negative; variances of a landing at 6 samples a slip were negative, and their logarithm NaN."""
    for state in states():
        r = NOISE * state[4]
        after = take_in(0.0, 1.0 / (state[4] + r), r, state)
        assert after[4] > 0
        assert after[8] >= state[8] * NOISE * (1 - 1e-12)
        assert after[5] ** 2 <= after[4] * after[8] * (1 + 1e-9)
        for h in (1e-4, 1e-2, 1.0):
            assert line_predict(h, after)[4] > 0


@pytest.mark.parametrize("take_in", [update, line_update])
def test_the_velocity_keeps_its_exact_variance_where_rounding_does_not_count(take_in):
    for p00, p01, p11, r in ((2.0, 0.5, 3.0, 0.7), (1e-6, 3e-5, 2e-3, 1e-9)):
        after = take_in(0.0, 1.0 / (p00 + r), r, (0.0, 0.0, 0.0, 0.0, p00, p01, 0.0, 0.0, p11, *[0.0] * 5))
        assert after[8] == pytest.approx(p11 - p01**2 / (p00 + r), rel=1e-14)
