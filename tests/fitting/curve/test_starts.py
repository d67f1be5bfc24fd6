"""Published laws are found on their own curves."""

import numpy as np
import pytest

from fitting.laws import PUBLISHED
from fitting.search.formula import Target, find_starts

SPEEDS = np.linspace(0.0, 0.5, 200)
TRUE = {
    "stribeck": {"Fs": 4.6, "Fc": 1.7, "v_s": 0.004},
    "stribeck-viscous": {"Fs": 4.6, "Fc": 1.7, "v_s": 0.08, "Fv": 0.4},
    "stribeck-gaussian": {"Fs": 4.6, "Fc": 1.7, "v_s": 0.4},
    "stribeck-gaussian-viscous": {"Fs": 4.6, "Fc": 1.7, "v_s": 0.15, "Fv": 0.5},
    "logarithmic": {"Fs": 9.0, "b": 0.3, "v_0": 1e-7},
    "power": {"Fs": 4.6, "b": 3.0, "p": 0.4},
}


@pytest.mark.parametrize("law", PUBLISHED.values(), ids=lambda law: law.name)
def test_a_published_law_is_found_on_its_own_curve(law):
    friction = law.curve.value(SPEEDS, TRUE[law.name] | dict(law.fix or {}))
    found = find_starts(law, Target.of(SPEEDS, friction, 1e-3))[0]
    assert found.values == pytest.approx(TRUE[law.name], rel=1e-3)
    assert found.misfit < 1e-2
