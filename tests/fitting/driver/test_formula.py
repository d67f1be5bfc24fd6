"""Starting values of formulas, found on another friction."""

import numpy as np
import pytest

from daq.base.errors import InputError
from fitting.driver.formula import FormulaCurve, Target, start_values
from fitting.law import PUBLISHED, Law

FASTEST = 0.7
TRUE = {
    "stribeck": {"Fc": 1.7, "Fs": 4.6, "v_s": 0.08},
    "stribeck-viscous": {"Fc": 1.7, "Fs": 4.6, "v_s": 0.08, "Fv": 0.4},
    "stribeck-gaussian-viscous": {"Fc": 2.0, "Fs": 4.6, "v_s": 0.15, "Fv": 0.5},
    "logarithmic": {"Fs": 4.6, "b": 0.5, "v_0": 0.03},
    "power": {"Fs": 4.6, "b": 3.0, "p": 0.4},
}


def of(law, values):
    whole = dict(law.fix or {}) | values
    return Target.of(lambda s: law.curve.value(s, whole), FASTEST)


@pytest.mark.parametrize("name", list(TRUE))
def test_a_published_curve_is_found_without_starting_values(name):
    found = start_values(PUBLISHED[name], of(PUBLISHED[name], TRUE[name])).values
    for parameter, true in TRUE[name].items():
        assert found[parameter] == pytest.approx(true, rel=1e-4)


def test_values_stay_within_their_bounds():
    law = Law("mine", "Fc + (Fs - Fc)*exp(-s/v_s)", bounds={"Fs": (0.0, 4.0), "v_s": (0.0, None), "Fc": (0.0, None)})
    found = start_values(law, of(PUBLISHED["stribeck"], TRUE["stribeck"])).values
    assert 0 <= found["Fs"] <= 4.0


def test_a_parameter_that_bends_the_curve_only_beside_others_is_seen_to():
    """With equal first values of Fs and Fc the speed v_s seemed to act not, and was taken for a linear parameter."""
    bends = start_values(PUBLISHED["stribeck"], of(PUBLISHED["stribeck"], TRUE["stribeck"])).bends
    assert bends == {"Fc": False, "Fs": False, "v_s": True}


def test_a_formula_that_is_nowhere_finite_is_refused():
    law = Law("mine", "a*log(s - 100)")
    with pytest.raises(InputError, match="finite"):
        start_values(law, of(PUBLISHED["stribeck"], TRUE["stribeck"]))


def test_derivatives_of_the_friction_are_differences():
    law = PUBLISHED["stribeck-viscous"]
    curve = FormulaCurve(law, FASTEST, of(law, TRUE["stribeck-viscous"]))
    s, step = np.linspace(0.0, FASTEST, 7), 1e-6
    found = curve.slopes(curve.start, s)
    for k in range(curve.size):
        theta = np.tile(curve.start, (2, 1))
        theta[:, k] += [-step, step]
        low, high = (curve.at_speeds(one, s) for one in theta)
        assert found[:, k] == pytest.approx((high - low) / (2 * step), abs=1e-6)
