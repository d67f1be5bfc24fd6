"""Velocity and acceleration while a recording runs: exact on a parabola, unknown across a gap, a window that suits."""

import math

import numpy as np
import pytest

from daq.live.motion import LiveFilter, count_samples, estimate_noise_density, fit_parabolas
from daq.live.tail import NewSamples

from .motions import pieces, samples


def test_parabolas_are_those_of_polyfit_at_uneven_times() -> None:
    draw = np.random.default_rng(3)
    t, x = np.cumsum(draw.uniform(0.5, 1.5, 30)), draw.normal(size=30)
    v, a = fit_parabolas(t, x, 9, 100.0)
    found = np.array([np.polyfit(t[k : k + 9] - t[k + 4], x[k : k + 9], 2) for k in range(22)])
    np.testing.assert_allclose(v, found[:, 1], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(a, 2 * found[:, 0], rtol=1e-9, atol=1e-12)


def fed(live: LiveFilter, whole: NewSamples, size: int = 37) -> tuple[np.ndarray, ...]:
    made = [live.feed(piece) for piece in pieces(whole, size)]
    return tuple(np.concatenate([getattr(part, name) for part in made]) for name in ("time", "x", "v", "a", "fresh"))


def test_windows_across_a_gap_are_unknown_and_segments_are_not_joined() -> None:
    t = np.arange(1000) / 1000.0
    t[500:] += 0.3
    x = 0.1 * t
    _, readings, v, _, _ = fed(LiveFilter(1000.0), samples(t, x))
    assert np.isnan(v).sum() == 20
    assert not np.isnan(readings).any()
    np.testing.assert_allclose(v[~np.isnan(v)], 0.1, rtol=1e-6)
    time, _, v, _, fresh = fed(LiveFilter(1000.0), samples(t, np.where(t < 0.5, x, x + 7), (0, 500)))
    assert time.size == 1000 - 2 * 20
    assert np.flatnonzero(fresh).tolist() == [0, 480]
    np.testing.assert_allclose(v, 0.1, rtol=1e-6)


def test_the_window_that_suits_a_slip_errs_least() -> None:
    rate_hz, noise, slip_s, drop = 1000.0, 2e-5, 0.6, 0.2
    omega = math.pi / slip_s
    t = np.arange(20_000) / rate_hz
    x = drop / 2 * np.sin(omega * t) + np.random.default_rng(4).normal(0, noise, t.size)
    live = LiveFilter(rate_hz)
    live.fit_window_to_slips(estimate_noise_density(t, x), slip_s, drop, slip_s)
    errors = {}
    for window in (live.window // 2 | 1, live.window, 2 * live.window + 1):
        _, a = fit_parabolas(t, x, window, 1.0)
        at = t[window // 2 : t.size - window // 2]
        errors[window] = float(np.sqrt(np.mean((a + drop / 2 * omega**2 * np.sin(omega * at)) ** 2)))
    assert min(errors, key=errors.__getitem__) == live.window
    assert live.window > count_samples(0.02, rate_hz)


def test_the_errors_of_the_motion_are_those_of_white_noise() -> None:
    rate_hz, noise = 500.0, 3e-6
    t = np.arange(100_000) / rate_hz
    x = 0.2 * t + np.random.default_rng(5).normal(0, noise, t.size)
    density = estimate_noise_density(t, x)
    assert density == pytest.approx(noise**2 / rate_hz, rel=0.03)
    live = LiveFilter(rate_hz, 31)
    v, a = fit_parabolas(t, x, 31, 1.0)
    errors = live.estimate_errors(density)
    assert (np.std(v), np.std(a)) == pytest.approx((errors.v, errors.a), rel=0.05)


def test_the_noise_of_counts_that_mostly_repeat_is_that_of_their_changes() -> None:
    t = np.arange(20_000) / 1000.0
    x = 1e-5 * np.round(1e-4 * t / 1e-5)  # ten counts a second
    assert estimate_noise_density(t, x) == pytest.approx(1e-10 / 12 / 10, rel=0.02)
