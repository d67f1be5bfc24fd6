"""The compiled kernels are the interpreted ones: same source, same bits; and the cache follows the source."""

import os
import subprocess
import sys

import numpy as np
import pytest

from rig_sim.friction.law import LAWS
from rig_sim.integrate.events import list_events
from stickslip.compute.compile import ANNOUNCEMENT

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


@pytest.mark.slow
def test_first_use_says_that_it_compiles_and_the_second_does_not(tmp_path):
    code = (
        "from rig_sim.integrate.compiled import compiled; from rig_sim.flow.flow import Flow;"
        "from rig_sim.flow.contact_state import force, initial_mode;"
        "print(compiled(initial_mode)(Flow(), 0.0, 0.0, 0.0)); compiled(force)"
    )
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    first, second = (
        subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=environment)
        for _ in range(2)
    )
    assert first.stdout.strip() == second.stdout.strip() == "1"
    assert first.stderr == ANNOUNCEMENT + "\n"
    assert second.stderr == ""
    assert len(list((tmp_path / "stickslip").glob("kernels-*"))) == 1
