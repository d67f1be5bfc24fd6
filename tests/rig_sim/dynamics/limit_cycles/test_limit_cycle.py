"""Periodic orbits: properties across the laws, and a named outcome where there is none."""

import math
import subprocess
import sys
from dataclasses import astuple

import pytest

from rig_sim.analyses.limit_cycles.limit_cycle import cycle
from rig_sim.flow.flow import Flow
from rig_sim.flow.frame import frame
from rig_sim.friction.law import LAWS
from rig_sim.systems.turn import creeps


def flow_of(law, **changes):
    return Flow(curve=LAWS[law].curve_code, ramp=LAWS[law].ramp, **changes)


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


@pytest.mark.parametrize("v_belt", [1e-12, 1e-3, 0.2, 3.0])
def test_period_of_law_3_does_not_depend_on_belt_speed(v_belt):
    orbit = cycle(flow_of(3, v_belt=v_belt))
    reference = cycle(flow_of(3))
    assert orbit.period == pytest.approx(reference.period, abs=4e-15)
    assert orbit.t_stick == pytest.approx(reference.t_stick, abs=4e-15)


@pytest.mark.parametrize("law", LAWS)
def test_backward_belt_mirrors_the_orbit(law):
    one = cycle(flow_of(law, x0=0.0))
    other = cycle(flow_of(law, v_belt=-0.5))
    assert other.period == one.period
    assert (other.x_min, other.x_max) == (-one.x_max, -one.x_min)
    assert (other.v_min, other.v_max) == (-one.v_max, -one.v_min)
    assert other.sequence == one.sequence.replace("N", "P")


@pytest.mark.parametrize("law", LAWS)
def test_orbit_scales_with_its_units(law):
    # m 0.3 kg, k 10.5 N/m, Fs 1.4 N: time in sqrt(m/k), length in Fs/k
    m, k, Fs = 0.3, 10.5, 1.4
    time, length = math.sqrt(m / k), Fs / k
    speed = length / time
    base = cycle(flow_of(law))
    scaled = cycle(
        flow_of(
            law,
            m=m,
            k=k,
            Fs=Fs,
            v_belt=0.5 * speed,
            G_slip=0.05 * Fs / speed,
            gamma=3.0 / speed,
            d=0.2 * speed,
            x0=0.7,
        )
    )
    assert scaled.sequence == base.sequence
    assert scaled.period / time == pytest.approx(base.period, rel=1e-13)
    assert (scaled.x_stick - 0.7) / length == pytest.approx(base.x_stick, abs=1e-13)
    assert scaled.v_min / speed == pytest.approx(base.v_min, rel=1e-13)


def test_mass_may_outrun_the_belt():
    orbit = cycle(flow_of(5, gamma=10.0))
    assert orbit.sequence == "NPS"
    assert orbit.v_max > 0.5


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


@pytest.mark.parametrize("G_stick", [1e8, 1e12, 1e16])
def test_steepest_ramps_give_the_jump_orbit(G_stick):
    steep, jump = cycle(flow_of(6, d=1.0 / G_stick)), cycle(flow_of(5))
    assert steep.period == pytest.approx(jump.period, abs=10.0 / G_stick + 1e-13)
    assert steep.t_stick == pytest.approx(jump.t_stick, abs=10.0 / G_stick + 1e-13)


def test_a_scene_is_anything_with_a_flow():
    class Scene:
        def flow(self):
            return Flow(gamma=2.0)

    assert astuple(cycle(Scene())) == astuple(cycle(Flow(gamma=2.0)))


def test_an_orbit_costs_no_heavy_imports():
    code = (
        "import sys; from rig_sim.analyses.limit_cycles.limit_cycle import cycle;"
        "from rig_sim.flow.flow import Flow; cycle(Flow());"
        "print(*sorted({'numpy', 'scipy', 'numba', 'matplotlib'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == ""


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("c", [3.2, 10.0, 1e3, 1e9])
def test_heavy_damping_ends_at_the_fixed_point(law, c):
    # It used to end as "no cycle": the slip lasts for c/k, in steps of m/c.
    orbit = cycle(flow_of(law, c=c, G_slip=0.05, gamma=3.0, d=1e-3))
    s = 0.5 - (1e-3 if LAWS[law].ramp else 0.0)
    friction = {"constant": 1.0, "linear": 1.0 - 0.05 * s, "hyperbolic": 1.0 / (1.0 + 3.0 * s)}[LAWS[law].curve]
    assert orbit.outcome == "fixed point"
    assert orbit.x_rest == pytest.approx(friction, rel=1e-6)


def test_damping_that_is_not_heavy_enough_is_followed_to_its_end():
    """Creep is claimed only where no phase could stick again: else the motion is played."""
    for c in (0.1, 0.5, 1.0, 1.5, 1.9, 2.5):
        fr = frame(flow_of(5, c=c, gamma=3.0))
        assert not creeps(fr, 0.5, -0.1, c - 3.0)
    assert creeps(frame(flow_of(1, c=2.1)), 0.5, -0.1, 2.1)
    assert not creeps(frame(flow_of(1, c=2.1)), 0.5, -0.9, 2.1)  # slows down faster than the larger root
    assert not creeps(frame(flow_of(1, c=2.1)), 0.5, 0.1, 2.1)
