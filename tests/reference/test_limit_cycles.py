"""Limit cycles and driven event lists against the multi-precision reference (50 digits, limit_cycles.json)."""

import json
from fractions import Fraction
from pathlib import Path

import pytest

from rig_sim.analyses.limit_cycles.limit_cycle import cycle
from rig_sim.flow.flow import Flow
from rig_sim.friction.law import LAWS

REFERENCE = json.loads(Path(__file__).with_name("limit_cycles.json").read_text())
MEASURED = ("period", "t_stick", "t_slip", "x_slip", "x_stick", "x_min", "x_max", "v_min", "v_max")
PERIODIC = [case for case in REFERENCE["cases"] if "period" in case]
RESTING = [case for case in REFERENCE["cases"] if "result" in case]


def flow_of(params: dict[str, str | int]) -> Flow:
    law = LAWS[int(params["law"])]
    changes = {
        field: float(params[key])
        for key, field in {
            "vdr": "v_belt",
            "gamma": "gamma",
            "Gs": "G_slip",
            "c": "c",
            "u0": "u0",
            "om": "omega",
        }.items()
        if key in params
    }
    if "Gst" in params:
        changes["d"] = 1.0 / abs(float(params["Gst"]))
    return Flow(curve=law.curve_code, ramp=law.ramp, **changes)


@pytest.mark.parametrize("case", PERIODIC, ids=lambda case: case["name"])
def test_cycle_meets_the_reference(case):
    orbit = cycle(flow_of(case["params"]))
    assert orbit.outcome == "cycle"
    compared = [key for key in MEASURED if key in case]
    assert {"period", "t_stick", "x_stick", "v_min"} <= set(compared)
    for key in compared:
        error = abs(Fraction(getattr(orbit, key)) - Fraction(case[key]))
        assert error <= 1e-14 * max(1.0, abs(float(case[key]))), key
    if "slip_sequence" in case:
        assert orbit.sequence == case["slip_sequence"]


@pytest.mark.parametrize("case", RESTING, ids=lambda case: case["name"])
def test_case_without_a_cycle_ends_at_its_fixed_point(case):
    orbit = cycle(flow_of(case["params"]))
    assert orbit.outcome == "fixed point"
    assert orbit.period is None
    expected = 0.5 if case["params"]["law"] == 6 else 1.0 / (1.0 + 3.0 * 0.6)
    assert orbit.x_rest == pytest.approx(expected, abs=1e-15)
