"""Noise levels of a motion that sticks and slips: what no record can show less of."""

import numpy as np
import pytest

import processing
from processing import methods
from processing.kalman import white_jerk
from processing.record import series
from processing.record.setting import Setting
from processing.stick_slip import noise, smoother


def test_a_reading_is_no_better_than_its_last_decimal(motion, imported, monkeypatch):
    """A belt that moves a whole number of nanometres a sample left sticks without any error: 1e-35 m^2."""
    true = motion(5, 60.0, 0.0, scatter=0.0)
    thin = slice(None, None, 40)
    printed = np.round(true.x[thin], 9)
    seen = []
    estimate = noise.reestimate_noise

    def kept(*arguments, **options):
        seen.append(estimate(*arguments, **options))
        return seen[-1]

    monkeypatch.setattr(smoother, "reestimate_noise", kept)
    data = series.from_recording(imported(np.round(true.time[thin], 9), printed, 25.0))
    found = methods.estimate("auto", data, Setting())
    assert found.method == "segment"
    least = 1e-18 / 12
    assert white_jerk.least_variance(data) == pytest.approx(least)
    assert seen
    assert min(levels.reading_variance.min() for levels in seen) >= 0.25 * least * (1 - 1e-9)


@pytest.mark.parametrize("rate", [1000 / 60, 20.0])
def test_sticks_that_are_read_far_better_than_slips_leave_variances_positive(motion, imported, rate):
    """Few samples of a slip without noise: 0.8 mm of misfit passed for noise there, sticks were read to a nanometre.

    The covariance that a stick took over from a slip was rounding: "invalid value encountered in log".
    """
    true = motion(5, 40.0, 0.0, scatter=0.0, belt=0.1)
    thin = slice(None, None, round(1000 / rate))
    found = processing.smooth(imported(np.round(true.time[thin], 9), np.round(true.x[thin], 9), rate))
    assert abs(len(found.sticks) - len(true.sticks)) <= 1
    assert np.isfinite(found.velocity).all()
