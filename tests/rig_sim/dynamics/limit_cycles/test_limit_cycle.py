"""Periodic orbits: properties across the laws, and a named outcome where there is none."""

import math

import pytest

from rig_sim.analyses.limit_cycles.limit_cycle import cycle
from rig_sim.friction.law import LAWS

from ...shared import flow_of


def test_law_1_grazes_on_its_circle():
    orbit = cycle(flow_of(1))
    assert orbit.outcome == "grazing"
    assert orbit.period == 2.0 * math.pi
    assert orbit.t_stick == 0.0
    assert (orbit.x_stick, orbit.x_min, orbit.x_max, orbit.v_min, orbit.v_max) == (1.0, 0.5, 1.5, -0.5, 0.5)


def test_law_2_grazes_on_the_ramps_edge():
    orbit = cycle(flow_of(2))
    assert orbit.outcome == "grazing"
    assert orbit.t_stick == 0.0
    assert (orbit.x_stick, orbit.x_min, orbit.x_max, orbit.v_min) == pytest.approx((1.0, 0.7, 1.3, -0.3), abs=1e-15)


def test_static_friction_alone_makes_law_1_stick():
    # slip from k x = 1.3 on a circle about x = 1 of radius hypot(0.3, 0.5)
    orbit = cycle(flow_of(1, static=1.3))
    assert orbit.outcome == "cycle"
    assert orbit.x_stick == pytest.approx(0.7, abs=1e-15)
    assert orbit.t_stick == pytest.approx(1.2, abs=1e-14)
    assert orbit.t_slip == pytest.approx(2.0 * math.pi - 2.0 * math.atan2(0.3, 0.5), abs=1e-14)
    assert orbit.v_min == pytest.approx(-math.hypot(0.3, 0.5), abs=1e-15)


@pytest.mark.parametrize(
    ("flow", "outcome"),
    [
        (flow_of(1, c=0.1), "fixed point"),
        (flow_of(1, v_belt=0.0), "fixed point"),
        (flow_of(2, v_belt=0.1), "fixed point"),
        (flow_of(3, c=0.2), "fixed point"),
        (flow_of(5, c=3.0), "fixed point"),
        (flow_of(6, d=1.0), "fixed point"),
        (flow_of(3, G_slip=1.0), "force reversal"),
        (flow_of(4, G_slip=2.0), "force reversal"),
        (flow_of(5, u0=0.2, omega=1.6), "driven"),
        (flow_of(5, v_belt=7.0, Fs=0.2, gamma=3.0), "no cycle"),
        (flow_of(5, Fs=0.0), "grazing"),
        (flow_of(5, gamma=0.0), "grazing"),
    ],
)
def test_scene_without_stick_slip_has_a_named_outcome(flow, outcome):
    orbit = cycle(flow)
    assert orbit.outcome == outcome
    assert (orbit.x_rest is None) == (outcome != "fixed point")
    if outcome != "grazing":
        assert orbit.advice
        assert orbit.period is None


@pytest.mark.parametrize("gamma", [1e-300, 1e-8, 1e4, 1e8, 1e12])
@pytest.mark.parametrize("law", [5, 6])
def test_any_gamma_ends_the_search(law, gamma):
    assert cycle(flow_of(law, gamma=gamma)).outcome in ("cycle", "grazing", "no cycle")


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("c", [3.2, 10.0, 1e3, 1e9])
def test_heavy_damping_ends_at_the_fixed_point(law, c):
    # It used to end as "no cycle": the slip lasts for c/k, in steps of m/c.
    orbit = cycle(flow_of(law, c=c, G_slip=0.05, gamma=3.0, d=1e-3))
    s = 0.5 - (1e-3 if LAWS[law].ramp else 0.0)
    friction = {"constant": 1.0, "linear": 1.0 - 0.05 * s, "hyperbolic": 1.0 / (1.0 + 3.0 * s)}[LAWS[law].curve]
    assert orbit.outcome == "fixed point"
    assert orbit.x_rest == pytest.approx(friction, rel=1e-6)
