"""Estimates while a recording runs: exact on a parabola, near the truth on stick-slip, unknown across a gap."""

import math
from dataclasses import replace

import numpy as np
import pytest

from daq.base.measured import Measured
from daq.live.motion import LiveFilter, parabolas
from daq.live.tail import NewSamples
from daq.runfile.rig import Rig

K_OVER_M, BELT = 35.0, 0.22


def stick_slip(cycles: int, rate_hz: float) -> tuple[np.ndarray, np.ndarray]:
    """Return times and positions of a mass on a belt without friction in the slip: arcs of a sine, then the belt."""
    omega, lever = math.sqrt(K_OVER_M), 0.12
    phase = math.atan2(BELT / omega, lever)
    slip, stick = (math.pi + 2 * phase) / omega, 2 * lever / BELT
    t = np.arange(0, cycles * (slip + stick), 1 / rate_hz)
    within = np.mod(t, slip + stick)
    swing = math.hypot(BELT / omega, lever) * np.cos(omega * within - phase)
    return t, np.where(within < slip, swing, -lever + BELT * (within - slip))


def fed(t: np.ndarray, x: np.ndarray, rate_hz: float, rig: Rig, fresh_at: tuple[int, ...] = (0,)) -> tuple:
    live = LiveFilter(rate_hz)
    fresh = np.isin(np.arange(t.size), fresh_at)
    made = [live.feed(NewSamples(t[k : k + 37], x[k : k + 37], fresh[k : k + 37])) for k in range(0, t.size, 37)]
    live.estimate(rig)
    names = ("time", "x", "v", "a", "stick")
    return live, *(np.concatenate([getattr(part, name) for part in made]) for name in names)


def test_a_parabola_is_found_exactly_at_uneven_times() -> None:
    t = np.cumsum(np.random.default_rng(1).uniform(0.5e-3, 1.5e-3, 60)) + 500.0
    u = t - t[30]
    found = parabolas(t, 0.3 - 0.7 * u + 2.5 * u * u, 21, 1.0)
    assert found.shape == (4, 40)
    middle = found[0] - t[30]
    np.testing.assert_array_equal(found[0], t[10:50])
    np.testing.assert_allclose(found[1], 0.3 - 0.7 * middle + 2.5 * middle**2, rtol=1e-9)
    np.testing.assert_allclose(found[2], -0.7 + 5 * middle, rtol=1e-6)
    np.testing.assert_allclose(found[3], 5.0, rtol=1e-4)


def test_belt_speed_and_spring_are_read_from_the_motion() -> None:
    t, x = stick_slip(6, 1000.0)
    noise = np.random.default_rng(2).normal(0, 2e-6, t.size)
    live, _, _, v, _, _ = fed(t, x + noise, 1000.0, Rig())
    assert live.belt_speed == pytest.approx(BELT, rel=2e-3)
    assert live.k_over_m == pytest.approx(K_OVER_M, rel=0.02)
    again = live.feed(
        NewSamples(t[-1] + np.arange(1, 100) / 1000, x[-1] + BELT * np.arange(1, 100) / 1000, np.zeros(99, bool))
    )
    assert again.stick[30:].all()
    assert np.nanmax(np.abs(v)) < 2 * 0.8


def test_a_calibration_is_used_where_there_is_one() -> None:
    t, x = stick_slip(3, 500.0)
    rig = Rig(mass=Measured(0.5), stiffness=Measured(20.0), belt_speed=Measured(0.2))
    live, *_ = fed(t, x, 500.0, replace(rig, metres_per_count=Measured(1e-5)))
    assert (live.belt_speed, live.k_over_m) == (0.2, 40.0)
    live, *_ = fed(t, x, 500.0, rig)  # positions in counts: 0.2 m/s was taken for 0.2 count/s
    assert live.belt_speed == pytest.approx(BELT, rel=0.01)


def test_what_cannot_be_known_is_not_claimed() -> None:
    t = np.arange(2000) / 1000
    live, _, _, v, _, stick = fed(t, np.zeros(2000), 1000.0, Rig())
    assert math.isnan(live.belt_speed)
    assert math.isnan(live.k_over_m)
    assert not stick.any()
    assert np.abs(v).max() == 0


def test_windows_across_a_gap_are_unknown_and_segments_are_not_joined() -> None:
    t = np.arange(1000) / 1000.0
    t[500:] += 0.3
    x = 0.1 * t
    _, time, _, v, _, _ = fed(t, x, 1000.0, Rig())
    assert np.isnan(v).sum() == 20
    np.testing.assert_allclose(v[~np.isnan(v)], 0.1, rtol=1e-6)
    _, time, _, v, _, _ = fed(t, np.where(t < 0.5, x, x + 7), 1000.0, Rig(), (0, 500))
    assert time.size == 1000 - 2 * 20
    np.testing.assert_allclose(v, 0.1, rtol=1e-6)
