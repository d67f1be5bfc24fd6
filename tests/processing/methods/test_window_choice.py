"""The window: chosen without truth close to the best one known with it, and read as people write it."""

import re

import numpy as np
import pytest

from processing import methods
from processing.record import series
from processing.record.setting import Setting, parse_window
from stickslip.errors import InputError


def rms(data, true, setting):
    found = methods.estimate("sg", data, setting)
    return float(np.sqrt(np.mean((found.velocity - true.v)[400:-400] ** 2)))


@pytest.mark.parametrize(
    ("pitch", "jitter", "times"),
    [
        (1e-6, 0.0, "recorded"),
        (1e-6, 30e-6, "nominal"),
        (7.67e-6, 30e-6, "recorded"),
        (50e-6, 30e-6, "nominal"),
        (200e-6, 0.0, "recorded"),
        (200e-6, 30e-6, "recorded"),
    ],
)
def test_the_chosen_window_is_close_to_the_best_one(motion, recorded, pitch, jitter, times):
    true = motion(5, 30.0, jitter)
    data = series.from_recording(recorded(true, pitch), times)
    chosen = methods.choose_window(data)
    error = rms(data, true, Setting(chosen.window, chosen.order))
    ladder = sorted({max(int(chosen.window * factor) | 1, 7) for factor in np.geomspace(0.5, 1.6, 9)})
    best = min(rms(data, true, Setting(length, order)) for order in (4, 6) for length in ladder if length > order)
    assert error < 1.08 * best


def test_the_reading_error_of_an_encoder_is_found(motion, recorded):
    for pitch in (7.67e-6, 50e-6):
        found = methods.choose_window(series.from_recording(recorded(motion(5, 30.0), pitch)))
        assert found.reading_error == pytest.approx(pitch / np.sqrt(12), rel=0.12)


def test_white_noise_on_a_swing_is_found(imported):
    time = np.arange(20_000) * 1e-3
    noise = 3e-5 * np.random.default_rng(8).standard_normal(time.size)
    found = methods.choose_window(series.from_recording(imported(time, 0.1 * np.sin(6 * time) + noise)))
    assert found.reading_error == pytest.approx(3e-5, rel=0.03)


def test_an_oversampled_record_gets_a_window_of_the_same_duration(imported):
    rng = np.random.default_rng(9)
    spans = []
    for rate in (1e3, 2e4):
        time = np.arange(int(8 * rate)) / rate
        noise = 3e-5 * np.sqrt(rate / 1e3) * rng.standard_normal(time.size)  # equal per unit of time
        found = methods.choose_window(series.from_recording(imported(time, 0.1 * np.sin(6 * time) + noise, rate)), 4)
        spans.append(found.window / rate)
    assert spans[1] == pytest.approx(spans[0], rel=0.4)


def test_rest_tells_nothing_and_gets_a_plain_window(imported):
    found = methods.choose_window(series.from_recording(imported(np.arange(500) * 1e-3, np.full(500, 0.2))))
    assert (found.window, found.order, found.reading_error) == (41, 4, 0.0)


@pytest.mark.parametrize(("text", "samples"), [("41", 41), (41, 41), ("20ms", 21), ("0.02 s", 21), ("20000us", 21)])
def test_a_window_is_read_as_people_write_it(imported, text, samples):
    data = series.from_recording(imported(np.arange(100) * 1e-3, np.arange(100.0)))
    assert parse_window(text, None, data) == Setting(samples, None)


@pytest.mark.parametrize(
    ("window", "order", "message"),
    [
        ("3", None, "the window must be an odd number above the order (4), not 3; use 5"),
        ("2ms", None, "the window must be an odd number above the order (4), not 3"),
        ("0.2ms", None, "the window of 0.2ms is shorter than two sample intervals"),
        ("4.5", None, "use a whole number of samples, or a duration"),
        ("101", None, "101 samples, but the longest uninterrupted part of the record has 100; choose a shorter window"),
        ("1e9ms", None, "1e9ms long, but the longest uninterrupted part of the record lasts 0.1 s; choose a shorter"),
        ("1e400s", None, "1e400s long, but the longest uninterrupted part of the record lasts 0.1 s"),
        ("auto", 21, "the order is 21; it must be from 1 to 20"),
    ],
)
def test_an_impossible_window_is_refused_with_the_remedy(imported, window, order, message):
    data = series.from_recording(imported(np.arange(100) * 1e-3, np.arange(100.0)))
    with pytest.raises(InputError, match=re.escape(message)):
        parse_window(window, order, data)
