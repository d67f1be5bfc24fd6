"""The standard deviation of one position, from the record: cameras, encoders, printed decimals, uneven times."""

import numpy as np
import pytest

from processing.record import series
from processing.record.noise import position_noise, reading_step, smallest_step

CAMERA = {"duration": 30.0, "jitter": 0.0, "rate": 400.0}


@pytest.fixture
def noise_of(imported):
    return lambda time, position: position_noise(series.from_recording(imported(time, position, 400.0)))


@pytest.mark.parametrize("sigma", [2e-4, 1e-3])
def test_printed_decimals_add_their_rounding_and_no_more(motion, noise_of, sigma):
    """It used to be the last printed decimal, whatever the noise."""
    true = motion(5, **CAMERA)
    seen = true.x + sigma * np.random.default_rng(2).standard_normal(true.x.size)
    for step in (1e-3, 1e-4, 1e-5, 1e-6):
        printed = np.round(seen / step) * step
        assert noise_of(true.time, printed) == pytest.approx(np.hypot(sigma, step / np.sqrt(12)), rel=0.12)


def test_uneven_times_do_not_look_like_noise(noise_of):
    """A swing seen at times that scatter by a third of an interval, one reading in twenty missing."""
    rng = np.random.default_rng(5)
    time = (np.arange(12_000) + rng.uniform(-1 / 3, 1 / 3, 12_000))[rng.random(12_000) > 0.05] / 400
    readings = 0.1 * np.sin(6 * time) + 1e-5 * rng.standard_normal(time.size)
    assert noise_of(time, readings) == pytest.approx(1e-5, rel=0.06)


@pytest.mark.parametrize("pitch", [7.67e-6, 5e-5, 2e-4])
@pytest.mark.parametrize("jitter", [0.0, 30e-6])
def test_counts_err_by_their_rounding(motion, recorded, pitch, jitter):
    """Neighbouring roundings of a steady stick follow a pattern, which used to look like twice as much."""
    data = series.from_recording(recorded(motion(5, 30.0, jitter), pitch))
    assert pitch / np.sqrt(12) <= position_noise(data) < 1.3 * pitch / np.sqrt(12)


@pytest.mark.parametrize("decimal", [1e-9, 1e-7, 1e-6])
def test_counts_that_were_printed_in_metres_still_err_by_their_rounding(motion, noise_of, decimal):
    """They used to pass for readings without a step; every count was then a step of the position."""
    true = motion(5, **CAMERA)
    pitch = 0.22 / 400 / 25.0154  # the belt moves by hardly a whole number of counts a sample
    printed = np.round(np.floor(true.x / pitch) * pitch / decimal) * decimal
    assert smallest_step(printed) == pytest.approx(pitch, rel=1e-3)
    assert noise_of(true.time, printed) == pytest.approx(pitch / np.sqrt(12), rel=0.1)


def test_counts_at_rest_err_by_their_rounding(motion, recorded):
    data = series.from_recording(recorded(motion(5, 0.4, start=0.5)))
    assert position_noise(data) == data.pitch / np.sqrt(12)


def test_rest_before_and_after_the_motion_says_nothing(motion, noise_of):
    """A sensor that holds its first and last value for nine tenths of the record."""
    true = motion(5, **CAMERA)
    seen = true.x[:1500] + 2e-4 * np.random.default_rng(3).standard_normal(1500)
    held = np.concatenate((np.full(10_000, seen[0]), seen, np.full(5000, seen[-1])))
    assert noise_of(np.arange(held.size) / 400, held) == pytest.approx(2e-4, rel=0.1)
    assert noise_of(np.arange(100) / 400, np.full(100, 0.3)) == 0.0


@pytest.mark.parametrize("origin", [0.0, -3.7, 1000.0])
@pytest.mark.parametrize("decimals", [3, 6, 9])
def test_the_step_of_a_table_is_its_last_decimal_however_far_the_mass_moves_in_a_sample(origin, decimals):
    """Where it moves by a million of these steps a sample, none was found, and readings passed for exact."""
    time = np.arange(600) / 250
    printed = np.round(origin + 0.1 * np.sin(40 * time) + 0.03 * np.sin(17.3 * time), decimals)
    data = series.Series(time, printed - printed[0], float(printed[0]), 0.0, 1 / 250, (slice(0, 600),))
    assert reading_step(data) == pytest.approx(10.0**-decimals, rel=1e-3)
    assert position_noise(data) >= 10.0**-decimals / np.sqrt(12) * 0.999


def test_readings_of_all_digits_have_no_step():
    time = np.arange(600) / 250
    exact = 0.1 * np.sin(40 * time)
    assert reading_step(series.Series(time, exact, 0.0, 0.0, 1 / 250, (slice(0, 600),))) == 0.0
