"""The compiled kernels are the interpreted ones: same source, same bits; and the cache follows the source."""

import numpy as np
import pytest

from rig_sim.friction.law import LAWS
from rig_sim.integrate.events import list_events

from ..shared import flow_of

CASES = [
    *({"law": law} for law in LAWS),
    {"law": 6, "d": 2e-7},
    {"law": 5, "gamma": 10.0, "v_belt": -0.5},
    {"law": 5, "u0": 0.2, "omega": 1.1},
    {"law": 4, "u0": 0.2, "omega": 1.1, "d": 2e-7},
    {"law": 5, "u0": 0.1, "omega": 0.7, "droop": 0.02},
]


@pytest.mark.parametrize("case", CASES, ids=str)
def test_compiled_equals_interpreted_bit_for_bit(case):
    flow = flow_of(**case)
    interpreted = list_events(flow, 0.1, 0.0, 60.0, every_cycle=True)
    assert len(interpreted.t) > 10
    machine = list_events(flow, 0.1, 0.0, 60.0, every_cycle=True, compiled=True)
    assert machine.kinds == interpreted.kinds
    assert machine.steps == interpreted.steps
    # transcendental functions come from two libraries: an ulp per event is allowed them
    assert np.max(np.abs(np.subtract(machine.t, interpreted.t))) <= 60.0 * 2.3e-16 * len(machine.t)
