"""Ring-downs: exact motions come back, damping not biased by friction, what is none is reported."""

import numpy as np
import pytest

from daq.calibration import ring_down
from stickslip.errors import DataError

W, X0 = 5.9316, 12_000.0  # rad/s; counts


def recorded(zeta=0.01, friction=100.0, rest=37.25, g=0.0, hold_s=1.0, seconds=20.0, rate=1000, w=W):
    """Return time and counts, in the middle of their cells, of a mass that is held and let go."""
    t = np.arange(0, seconds, 1 / rate) + 0.0003 * np.sin(np.arange(round(seconds * rate)))
    held = t < hold_s
    x = np.full(t.shape, X0)
    x[~held] = ring_down.predict_motion(t[~held] - hold_s, w, zeta, friction, rest, X0, 0.0, g)
    return t, np.floor(x) + 0.5


def test_a_mass_that_rounding_holds_rests():
    rest, a, x = 43.91491627785106, 114.98006706877551, 158.8949833466266
    assert x - rest > a
    assert np.all(ring_down.predict_motion(np.linspace(0, 1, 5), W, 0.01, a, rest, x, 0.0) == x)


@pytest.mark.parametrize("friction", [5.0, *(pytest.param(level, marks=pytest.mark.slow) for level in (100.0, 900.0))])
@pytest.mark.parametrize("zeta", [0.002, 0.02])
def test_damping_is_not_biased_by_friction(zeta, friction):
    found = ring_down.fit_ring_down(*recorded(zeta, friction), 1.0)
    assert found.velocity_weakening is None
    assert not found.poor
    for measured, true in (
        (found.omega0, W),
        (found.zeta, zeta),
        (found.friction, friction),
        (found.equilibrium, 37.25),
    ):
        assert abs(measured.value - true) < 4 * measured.sd
    assert found.zeta.sd < 0.01 * zeta
    assert found.omega0.sd < 1e-4 * W


def test_friction_that_weakens_with_speed_is_seen_and_does_not_bias_either():
    g = 6e-5  # per count/s: at the fastest it is a fifth
    found = ring_down.fit_ring_down(*recorded(0.01, 300.0, g=g), 1.0)
    assert found.velocity_weakening is not None
    assert found.velocity_weakening.value == pytest.approx(g, rel=0.05)
    assert found.zeta.value == pytest.approx(0.01, rel=0.01)
    assert found.friction.value == pytest.approx(300, rel=0.01)
    assert found.omega0.value == pytest.approx(W, rel=5e-5)


@pytest.mark.slow
def test_a_hand_that_pulls_first_is_not_taken_for_the_motion():
    t, x = recorded(hold_s=3.0)
    x[t < 2] = np.floor(37.25 + (X0 - 37.25) * np.clip(t[t < 2] - 0.5, 0, 1)) + 0.5
    found = ring_down.fit_ring_down(t, x, 1.0)
    assert found.zeta.value == pytest.approx(0.01, rel=0.01)


@pytest.mark.slow
def test_a_motion_of_another_kind_is_called_poor():
    t, x = recorded()
    found = ring_down.fit_ring_down(t, np.floor(x + 400 * np.sin(2.1 * t) * (t > 1)) + 0.5, 1.0)
    assert found.poor


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: (np.arange(0, 5, 1e-3), np.full(5000, 3.5)), "not moved"),
        (lambda: recorded(friction=9000.0), "too few"),
        (lambda: recorded(zeta=0.8), "too few"),
    ],
)
def test_what_is_no_ring_down_is_said_to_be_none(make, said):
    with pytest.raises(DataError, match=said):
        ring_down.fit_ring_down(*make(), 1.0)
