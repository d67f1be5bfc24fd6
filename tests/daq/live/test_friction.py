"""The quick friction curve: the force balance of a motion in closed form, its sign, and what is not known of it."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import daq
from daq.runfile.rig import Rig
from stickslip.units import Measured

from .motions import BELT, K_OVER_M, KINETIC, LEVER, analysed, stick_slip

SAMPLES = Path(__file__).resolve().parents[3] / "data_samples"
KNOWN = Rig(x0=Measured(0.0))


@pytest.mark.parametrize(("rate_hz", "noise"), [(1000.0, 2e-6), (1000.0, 5e-5), (400.0, 2e-4)])
def test_constant_friction_and_its_spring_are_found(rate_hz: float, noise: float) -> None:
    motion = stick_slip(14, rate_hz, noise)
    found = analysed(motion.time, motion.x, rate_hz, KNOWN).summarise()
    k_over_m = found["k_over_m"]
    assert abs(k_over_m["value"] - K_OVER_M) < 3 * k_over_m["stderr"]
    assert k_over_m["value"] == pytest.approx(K_OVER_M, rel=0.01)
    curve = found["friction"]
    speed, F, sd = (np.array(curve[name], float) for name in ("speed", "F", "sd"))
    assert F.size > 15
    off = np.abs(F - K_OVER_M * KINETIC * LEVER)
    assert np.all(off[np.isfinite(sd)] < 0.02 * F.max() + 3 * sd[np.isfinite(sd)])
    assert np.median(off) < 0.01 * F.max()
    assert np.ptp(speed) > BELT
    assert curve["break_away"] == pytest.approx(K_OVER_M * LEVER, rel=0.05)


def test_relative_speed_and_friction_are_positive_for_both_directions_of_the_belt_as_in_the_report() -> None:
    motion = stick_slip(8, 1000.0, 2e-6)
    for sign in (1.0, -1.0):
        curve = analysed(motion.time, sign * motion.x, 1000.0, KNOWN).summarise()["friction"]
        assert np.all(np.array(curve["speed"]) > 0)
        assert np.all(np.array(curve["F"]) > 0)
        assert curve["break_away"] > 0


def test_the_curve_is_the_law_of_the_record() -> None:
    """The scene `rig` with law 5: Fs = 1.396 N, gamma = 9.61 s/m (data_samples, README)."""
    run = daq.load(SAMPLES / "law5.h5")
    found = analysed(run.time, run.position, run.rate_hz, run.rig).summarise()
    assert found["k_over_m"]["value"] == pytest.approx(35.184, rel=0.005)
    speed, F = (np.array(found["friction"][name]) for name in ("speed", "F"))
    law = 1.396 / (1 + 9.61 * speed)
    own = speed > 0.05
    np.testing.assert_allclose(F[own], law[own], rtol=0.05)


def test_what_is_not_known_is_not_claimed() -> None:
    motion = stick_slip(10, 1000.0, 2e-6)
    bare = analysed(motion.time, motion.x, 1000.0).summarise()
    assert (bare["balance"]["mass"], bare["balance"]["level_known"]) == (None, 0.0)
    known = analysed(motion.time, motion.x + 0.03, 1000.0, Rig(x0=Measured(0.03))).summarise()
    assert known["balance"]["level_known"] == 1.0
    # Without x0 the curve is the same up to a constant.
    shift = np.array(bare["friction"]["F"]) - np.array(known["friction"]["F"])
    np.testing.assert_allclose(shift, shift[0], atol=1e-3)
    assert known["statistics"]["break_away"]["mean"] == pytest.approx(LEVER, rel=0.01)
    counted = analysed(motion.time, motion.x / 1e-5, 1000.0, Rig(mass=Measured(0.3)), "count").summarise()
    assert counted["balance"]["mass"] is None
    assert counted["k_over_m"]["value"] == pytest.approx(K_OVER_M, rel=0.01)
    few = analysed(motion.time[:3000], motion.x[:3000], 1000.0).summarise()
    assert few["k_over_m"]["value"] is None


def test_newtons_need_the_mass_or_the_stiffness() -> None:
    motion = stick_slip(10, 1000.0, 2e-6)
    by_mass, by_stiffness, by_both = (
        analysed(motion.time, motion.x, 1000.0, replace(KNOWN, **given)).summarise()
        for given in (
            {"mass": Measured(0.5)},
            {"stiffness": Measured(0.5 * K_OVER_M)},
            {"mass": Measured(0.5), "stiffness": Measured(20.0)},
        )
    )
    top = 0.5 * K_OVER_M * LEVER
    assert by_mass["friction"]["break_away"] == pytest.approx(top, rel=0.02)
    assert by_stiffness["friction"]["break_away"] == pytest.approx(top, rel=0.02)
    assert by_both["balance"]["k_over_m"] == 40.0  # of the calibration; that of the slips stands beside it
    assert by_both["k_over_m"]["value"] == pytest.approx(K_OVER_M, rel=0.01)


def test_known_damping_is_part_of_the_balance() -> None:
    motion = stick_slip(8, 1000.0, 2e-6)
    damped = replace(KNOWN, mass=Measured(0.5), damping=Measured(0.2))
    with_it, without = (
        analysed(motion.time, motion.x, 1000.0, rig).summarise()["friction"]
        for rig in (damped, replace(damped, damping=None))
    )
    v = BELT - np.array(with_it["speed"])
    difference = np.array(with_it["F"]) - np.array(without["F"])
    np.testing.assert_allclose(difference, 0.2 * v, atol=2e-3)
    assert not math.isclose(difference[0], difference[-1])
