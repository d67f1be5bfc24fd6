"""Events and cycles against multi-precision arithmetic, 25 digits in tests/reference/events.json; and compiled."""

import math

import numpy as np
import pytest

from rig_sim.analyses.limit_cycles.limit_cycle import cycle
from rig_sim.comparison.error_vs_time import difference
from rig_sim.friction.law import LAWS
from rig_sim.integrate.events import list_events

from ..shared import flow_of

SLIP_POINT = (1.0, 0.5)
FOLD = 0.556168088639876  # the damper at which stick-slip ends
TWO_ULP = 2.3e-13  # of a time near 1000
SETS = [
    (3, {}),
    (5, {}),
    (3, {"m": 0.23, "k": 1.7, "v_belt": 1.31, "Fs": 2.9, "c": 0.013, "G_slip": 0.11}),
    (5, {"m": 2.3, "k": 0.7, "v_belt": 0.31, "gamma": 7.7, "Fs": 1.9, "c": 0.013}),
    (5, {"static": 1.37, "x0": -0.4, "gamma": 1.1}),
    (5, {"v_belt": -0.2, "gamma": 0.6, "k": 3.0, "c": 0.04}),
    (1, {"static": 1.3}),
    (6, {"m": 2.3, "k": 0.7, "v_belt": 0.31, "gamma": 7.7, "Fs": 1.9, "c": 0.013, "d": 0.011}),
    (4, {"m": 0.9, "v_belt": -0.7, "G_slip": 0.06, "d": 0.05}),
]
CASES = [  # laws, changes of the flow, start (x, v), until, tolerance, least number of events
    (LAWS, {}, (0.0, 0.0), 25.0, 2e-14, 7),
    ([5], {"v_belt": -0.5, "c": 0.02, "x0": 0.1, "static": 1.1}, (0.0, 0.0), 25.0, 2e-14, 7),
    ([3, 4, 5], {"u0": 0.2, "omega": 0.7}, (0.0, 0.0), 25.0, 2e-14, 7),
    ([6], {"d": 2e-9}, (0.0, 0.0), 25.0, 2e-14, 7),
    *(([law], changes, (0.0, 0.0), 1000.0, TWO_ULP, 60) for law, changes in SETS),
    # driven
    ([5], {"u0": 0.2, "omega": 0.3}, (0.0, 0.0), 100.0, 1e-12, 10),
    ([5], {"v_belt": 0.085, "u0": 0.2, "omega": 0.41}, (0.0, 0.0), 100.0, 1e-12, 10),
    ([3], {"u0": 0.1, "omega": 0.7, "c": 0.01, "phase": 0.4}, (0.0, 0.0), 100.0, 1e-12, 10),
    ([6], {"u0": 0.15, "omega": 0.37, "d": 0.1, "k": 1.3}, (0.0, 0.0), 100.0, 1e-12, 10),
    ([4], {"v_belt": -0.5, "u0": 0.1, "omega": 1.9, "m": 1.4}, (0.0, 0.0), 100.0, 1e-12, 10),
    ([3], {"c": 0.05, "u0": 0.3, "omega": 1.0}, (0.0, 0.0), 30.0, 1e-14, 8),  # at resonance, the fall damped away
    # driven hard: the stick ends at its lower edge, and slip turns over without stick
    ([3, 5], {"v_belt": 0.1, "u0": 2.5, "omega": 0.3}, (0.0, 0.0), 40.0, 1e-12, 8),
    # slips shorter than the longest step, 4/(1 + 87.3)
    ([1, 3, 5], {"v_belt": 0.085, "u0": 0.02, "omega": 87.3}, (0.0, 0.0), 11.9, 2e-13, 4),
    # belts at rest, with the mass outside the cone, and backwards
    (LAWS, {"v_belt": 0.0}, (3.3, 0.0), 40.0, 1e-14, 2),
    (LAWS, {"v_belt": -0.6, "c": 0.02, "x0": 0.1}, (0.2, 0.1), 40.0, 2e-14, 2),
    # wide ramps: G_stick -1 has complex roots, -2 a double root
    *(([4, 6], {"d": d, "v_belt": 1.5}, (0.0, 0.0), 40.0, 2e-14, 8) for d in (1.0, 0.5)),
    # starts on edges, far away, and just below the fold, where w comes back at 9e-5 per unit of time
    ([3, 4, 5, 6], {}, SLIP_POINT, 30.0, 2e-14, 5),
    *(
        ([2, 4, 6], {"d": 0.5, "c": 0.1}, (x, v), 12.0, 1e-14, 0)
        for x in (-2.5, 0.0, 0.5, 1.0, 2.5)
        for v in (0.0, 1.0)
    ),
    ([1, 5, 6], {}, (1e6, 0.0), 30.0, 1e-14, 9),
    ([5], {"v_belt": 0.6, "c": FOLD - 1e-9}, (1.0 - FOLD * 0.6, 0.6), 60.0, 3e-11, 18),
    ([5], {"gamma": 1e-8}, SLIP_POINT, 40.0, 1e-11, 10),  # gamma -> 0 is law 1, which grazes
    *(([5, 6], {"gamma": gamma}, SLIP_POINT, 40.0, 2e-14, 10) for gamma in (1.0, 1e2, 1e4, 1e8)),
]


@pytest.mark.parametrize(
    ("law", "changes", "start", "until", "within", "least"),
    [(law, *case) for laws, *case in CASES for law in laws],
    ids=str,
)
def test_events_meet_the_reference(reference_events, law, changes, start, until, within, least):
    flow = flow_of(law, **changes)
    expected = reference_events(flow, *start, until)
    for every_cycle in (True, False):
        found = list_events(flow, *start, until, every_cycle=every_cycle)
        error, note = difference(found, [(t, kind) for t, kind, _ in expected], until)
        assert note == ""
        assert error <= within
        assert len(found.t) >= least
        for x, (_, _, place) in zip(found.x, expected, strict=False):
            assert abs(x - place) <= within * max(1.0, abs(start[0]))


@pytest.mark.parametrize(("law", "changes"), SETS, ids=str)
def test_period_stick_time_and_sticking_point_are_right_to_1e_14(law, changes, reference_events):
    flow = flow_of(law, **changes)
    orbit = cycle(flow)
    assert orbit.outcome == "cycle"
    expected = reference_events(flow, 0.0, 0.0, 1000.0)
    slips = [i for i, (_, kind, _) in enumerate(expected) if kind[0] == "S"]
    begin, end = slips[-2], slips[-1]
    before = end - 1  # the landing that stays
    measured = {
        "period": expected[end][0] - expected[begin][0],
        "t_stick": expected[end][0] - expected[before][0],
        "x_stick": expected[before][2],
    }
    for name, value in measured.items():
        assert abs(getattr(orbit, name) - value) <= 1e-14 * max(1.0, abs(value)), name


def test_law_1_driven_may_touch_the_belt_within_less_than_an_ulp(reference_events):
    # omega = 3/10 exactly brings the mass back to the belt's speed at t = 78.026; the nearest float falls short
    # by 7e-18, less than rounding of w, and the next float passes: a stick of zero length, none, or one of 1e-8
    flow = flow_of(1, u0=0.2, omega=0.3)
    expected = reference_events(flow, 0.0, 0.0, 100.0)
    beyond = reference_events(flow._replace(omega=math.nextafter(0.3, 1.0)), 0.0, 0.0, 100.0)
    assert (len(expected), len(beyond)) == (6, 8)
    assert float(beyond[-1][0] - beyond[-2][0]) == pytest.approx(1.1e-8, rel=0.05)
    found = list_events(flow, 0.0, 0.0, 100.0)
    assert found.t[:6] == pytest.approx([float(t) for t, _, _ in expected], abs=1e-13)
    assert len(found.t) in (6, 8)
    assert found.t[6:] == pytest.approx([78.0260309] * (len(found.t) - 6), abs=2e-7)


COMPILED = [
    *({"law": law} for law in LAWS),
    {"law": 6, "d": 2e-7},
    {"law": 5, "gamma": 10.0, "v_belt": -0.5},
    {"law": 5, "u0": 0.2, "omega": 1.1},
    {"law": 4, "u0": 0.2, "omega": 1.1, "d": 2e-7},
    {"law": 5, "u0": 0.1, "omega": 0.7, "droop": 0.02},
]


@pytest.mark.parametrize("case", COMPILED, ids=str)
def test_compiled_equals_interpreted_bit_for_bit(case):
    flow = flow_of(**case)
    interpreted = list_events(flow, 0.1, 0.0, 60.0, every_cycle=True)
    assert len(interpreted.t) > 10
    machine = list_events(flow, 0.1, 0.0, 60.0, every_cycle=True, compiled=True)
    assert machine.kinds == interpreted.kinds
    assert machine.steps == interpreted.steps
    # transcendental functions come from two libraries: an ulp per event is allowed them
    assert np.max(np.abs(np.subtract(machine.t, interpreted.t))) <= 60.0 * 2.3e-16 * len(machine.t)
