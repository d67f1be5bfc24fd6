"""Published forms are laws that are projected on the measured curve, and the lowest coefficients follow them."""

import numpy as np
import pytest

from fitting.curve.forms import FORMS
from fitting.curve.metric import followed
from fitting.driver.start_search import StartSearch, Target

SPEEDS = np.linspace(0.0, 0.5, 200)
TRUE = {
    "constant": {"Fs": 4.6},
    "linear": {"Fs": 4.6, "G": 2.0},
    "hyperbolic": {"Fs": 4.6, "gamma": 9.6},
    "stribeck-exponential": {"Fs": 4.6, "Fc": 1.7, "v_s": 0.004},
    "stribeck-exponential-viscous": {"Fs": 4.6, "Fc": 1.7, "v_s": 0.08, "Fv": 0.4},
    "stribeck-gaussian": {"Fs": 4.6, "Fc": 1.7, "v_s": 0.4},
    "stribeck-gaussian-viscous": {"Fs": 4.6, "Fc": 1.7, "v_s": 0.15, "Fv": 0.5},
    "logarithmic": {"Fs": 9.0, "b": 0.3, "v_0": 1e-7},
    "power": {"Fs": 4.6, "b": 3.0, "p": 0.4},
    "polynomial": {"a0": 4.6, "a1": -9.0, "a2": 20.0, "a3": -16.0},
}


@pytest.mark.parametrize("form", FORMS, ids=lambda form: form.name)
def test_a_form_is_found_on_its_own_curve(form):
    law = form.on(3.0, 0.5)
    friction = law.curve.value(SPEEDS, TRUE[form.name] | dict(law.fix or {}))
    found = StartSearch(law, Target.of(SPEEDS, friction, 1e-3)).nearest()
    assert found.values == pytest.approx(TRUE[form.name], rel=1e-4)
    assert found.misfit < 1e-3


def test_an_unknown_without_curvature_does_not_follow_a_form():
    """Where the search for the curve had failed (law 5, 10 samples a slip) a negative one made every form NaN."""
    curvature = np.array([[4.0, 1.0, 0.0], [1.0, 2.0, 0.0], [0.0, 0.0, -1e-3]])
    cross = np.array([[1.0, 2.0, 0.5], [0.0, 1.0, 3.0]])
    found = followed(curvature, cross)
    assert found[:2] == pytest.approx(np.linalg.inv(curvature[:2, :2]) @ cross[:, :2].T)
    assert not found[2].any()
