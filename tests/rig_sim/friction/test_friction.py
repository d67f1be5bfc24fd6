"""The laws and their force: odd, continuous where they should be, and one definition for simulation and fits."""

import numpy as np
import pytest

from rig_sim.flow.contact_state import force as force_in_mode
from rig_sim.flow.contact_state import initial_mode
from rig_sim.flow.flow import Flow
from rig_sim.friction.contact import force
from rig_sim.friction.curve import magnitude
from rig_sim.friction.law import LAWS

SETTINGS = {"Fs": 1.3, "G_slip": 0.05, "gamma": 3.0, "d": 0.2}


@pytest.mark.parametrize("number", [2, 4, 6])
def test_ramp_is_continuous_and_linear_inside(number):
    law = LAWS[number]
    below, above = (force(law, 0.2 * factor, **SETTINGS) for factor in (1.0 - 1e-12, 1.0 + 1e-12))
    assert below == pytest.approx(above, abs=1e-10)
    assert force(law, -0.05, **SETTINGS) == pytest.approx(1.3 / 0.2 * 0.05, rel=1e-15)


@pytest.mark.parametrize("number", LAWS)
def test_scatter_multiplies_the_whole_curve(number):
    w = np.linspace(-1.0, 1.0, 100)
    scaled = force(LAWS[number], w, factor=1.25, **SETTINGS)
    assert np.allclose(scaled, 1.25 * force(LAWS[number], w, **SETTINGS), rtol=1e-15, atol=0)


@pytest.mark.parametrize("number", LAWS)
@pytest.mark.parametrize("static", [1.0, 1.4])
def test_kernels_use_the_same_force_as_fits(number, static):
    law = LAWS[number]
    flow = Flow(curve=law.curve_code, ramp=law.ramp, static=static, factor=0.9, x0=0.3, c=0.1, **SETTINGS)
    for w in (-2.1, -0.7, -0.13, 0.05, 0.19, 0.6):
        mode = initial_mode(flow, 0.4, w + flow.v_belt, 0.0)
        expected = force(law, w, static=static, factor=0.9, **SETTINGS)
        assert force_in_mode(flow, mode, 0.4, w, 0.0) == pytest.approx(expected, rel=1e-14)


def test_ramp_without_width_and_unknown_curve_are_refused():
    with pytest.raises(ValueError, match="d must be above 0 m/s, not 0"):
        force(LAWS[6], 0.1, gamma=3.0)
    with pytest.raises(ValueError, match="the curve must be 0"):
        magnitude(9, 0.1, 1.0)
