"""Velocity on the bench, where the truth is known: errors beside the published ones, and whether they are stated."""

import numpy as np
import pytest

from processing import methods
from processing.polynomial import savgol
from processing.record import series
from processing.record.setting import Setting


def velocity_error(found, true):
    error = 1e3 * (found.velocity - true.v)
    return float(np.sqrt(np.mean(error**2))), float(np.abs(error).max())


# RMS and largest velocity error in mm/s: (pitch, jitter, times, method, setting) and the limits, which are the
# published figures of each method on this bench with a tenth to spare for the seed.
PUBLISHED = [
    (7.67e-6, 0.0, "recorded", "fd", Setting(), 4.0, 12.0),
    (7.67e-6, 30e-6, "nominal", "fd", Setting(), 17.0, 130.0),
    (7.67e-6, 30e-6, "recorded", "sg", Setting(31, 4), 0.42, 11.0),
    (7.67e-6, 30e-6, "nominal", "sg", Setting(), 0.70, 13.0),
    (7.67e-6, 30e-6, "recorded", "sg", Setting(), 0.32, 8.0),
    (50e-6, 30e-6, "recorded", "sg", Setting(), 0.76, 15.0),
]


@pytest.mark.parametrize(("pitch", "jitter", "times", "method", "setting", "rms", "largest"), PUBLISHED)
def test_velocity_errors_are_the_published_ones_or_smaller(
    motion, recorded, pitch, jitter, times, method, setting, rms, largest
):
    true = motion(5, 60.0, jitter)
    found = methods.estimate(method, series.from_recording(recorded(true, pitch), times), setting)
    error = velocity_error(found, true)
    assert error[0] < rms
    assert error[1] < largest


@pytest.mark.parametrize(("pitch", "setting"), [(7.67e-6, Setting()), (7.67e-6, Setting(41, 4)), (50e-6, Setting())])
def test_two_standard_errors_cover_the_truth(motion, recorded, pitch, setting):
    true = motion(5, 60.0)
    found = methods.estimate("sg", series.from_recording(recorded(true, pitch)), setting)
    landings = np.searchsorted(true.time, [start for start, _ in true.sticks[1:]])
    near = np.isin(np.arange(true.time.size), landings[:, None] + np.arange(-10, 11))
    for values, errors, exact in (
        (found.position, found.position_errors, true.x),
        (found.velocity, found.velocity_errors, true.v),
    ):
        covered = np.abs(values - exact) < 2 * errors
        assert 0.93 < covered.mean() < 0.995
        assert covered[near].mean() > 0.85


def test_an_even_grid_and_explicit_times_give_the_same_fit():
    rng = np.random.default_rng(3)
    time, position = np.arange(500) * 1e-3, rng.standard_normal(500)
    by_convolution = savgol.fit(time, position, 41, 4)
    by_times = savgol.fit_uneven(time, position, 41, 4)
    for one, two in zip(by_convolution, by_times, strict=True):
        assert np.abs(one - two).max(axis=1) == pytest.approx([0, 0, 0], abs=1e-9 * np.abs(two).max())


def test_uneven_times_agree_with_a_polynomial_fitted_to_each_window():
    rng = np.random.default_rng(4)
    time = np.cumsum(rng.uniform(0.5, 1.5, 120)) * 1e-3
    position = rng.standard_normal(120)
    values, norms = savgol.fit_uneven(time, position, 15, 3)
    for i in (0, 3, 60, 119):
        first = min(max(i - 7, 0), 105)
        own = slice(first, first + 15)
        u = (time[own] - time[i]) * 1e3
        expected = np.polynomial.polynomial.polyfit(u, position[own], 3)[:3] * [1, 1e3, 2e6]
        assert values[:, i] == pytest.approx(expected, rel=1e-9)
        weights = np.linalg.pinv(np.vander(u, 4, increasing=True))[:3] * [[1], [1e3], [2e6]]
        assert norms[:, i] == pytest.approx(np.linalg.norm(weights, axis=1), rel=1e-9)
