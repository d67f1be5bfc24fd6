"""Droop: a belt that slows under load; laws 1 and 3 become 2 and 4 exactly, law 5 an independent solution's motion."""

import math
from dataclasses import asdict

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from rig_sim.analyses.limit_cycles.limit_cycle import cycle
from rig_sim.flow.contact_state import initial_mode
from rig_sim.flow.modes import NEGATIVE, RAMP
from rig_sim.integrate.events import list_events
from rig_sim.integrate.phases import State, next_event
from rig_sim.integrate.work import new_work
from rig_sim.motion.play import events
from rig_sim.scenes.scene import scene

from ..shared import flow_of


def load(w: float, droop: float, gamma: float = 3.0) -> float:
    """Return friction of law 5 at x' - v_belt = w from its definition: w is the true relative speed less droop F."""

    def slipping(s: float) -> float:
        return 1 / (1 + gamma * s)

    if abs(w) <= droop:
        return -w / droop
    s = brentq(lambda s: s + droop * slipping(s) - abs(w), 0.0, abs(w), xtol=1e-16, rtol=1e-15)
    return -math.copysign(slipping(s), w)


@pytest.mark.parametrize(("law", "G"), [(1, 0.0), (3, 0.05)])
@pytest.mark.parametrize("belt", [0.5, -0.5])
def test_laws_1_and_3_on_a_drooping_belt_are_laws_2_and_4(law: int, G: float, belt: float) -> None:
    drooping = flow_of(law, droop=0.2, v_belt=belt, u0=0.1, omega=0.7)
    ramp = flow_of(law + 1, d=0.2, G_slip=G / (1 - 0.2 * G), v_belt=belt, u0=0.1, omega=0.7)
    found, expected = list_events(drooping, 0.0, 0.0, 100.0), list_events(ramp, 0.0, 0.0, 100.0)
    assert found.kinds == expected.kinds
    np.testing.assert_allclose(found.t, expected.t, rtol=1e-11)
    assert len(found.t) > 5


def test_ramp_and_droop_add_up() -> None:
    found = list_events(flow_of(2, d=0.15, droop=0.05, c=0.01), 0.0, 0.0, 60.0)
    expected = list_events(flow_of(2, d=0.2, c=0.01), 0.0, 0.0, 60.0)
    assert found.kinds == expected.kinds
    np.testing.assert_allclose(found.t, expected.t, rtol=1e-12)


@pytest.mark.parametrize("drive", [0.0, 0.1])
def test_one_slip_of_law_5_is_that_of_an_independent_solver(drive: float) -> None:
    droop = 0.05
    flow = flow_of(5, droop=droop, c=0.02, u0=drive, omega=0.7)
    work = new_work()
    x, v = 1.05, 0.5 - droop * 1.001

    def motion(t: float, y: np.ndarray) -> tuple[float, float]:
        return y[1], load(y[1] - 0.5, droop) - 0.02 * y[1] - y[0] + drive * math.cos(0.7 * t)

    def lands(t: float, y: np.ndarray) -> float:
        return float(y[1] - 0.5 + droop)

    lands.terminal, lands.direction = True, 1.0  # type: ignore[attr-defined]
    # short steps, as the solver finds events on an interpolant of lower order than its steps
    expected = solve_ivp(motion, (0.0, 20.0), (x, v), "DOP853", events=lands, rtol=2.3e-14, atol=1e-15, max_step=0.001)
    start = State(initial_mode(flow, x, v, 0.0), x, v - 0.5, 0.0)
    kind, (mode, x_end, w_end, t_end, _) = next_event(flow, start, 20.0, work)
    assert (kind, mode) == (4 * NEGATIVE + RAMP, RAMP)
    assert w_end == -droop
    assert t_end == pytest.approx(expected.t_events[0][0], abs=1e-12)
    assert x_end == pytest.approx(expected.y_events[0][0][0], abs=1e-12)


def test_the_orbit_on_a_drooping_belt_is_exact() -> None:
    drooping, ramp = cycle(flow_of(3, droop=0.01)), cycle(flow_of(4, d=0.01, G_slip=0.05 / (1 - 0.01 * 0.05)))
    assert (drooping.outcome, drooping.sequence) == (ramp.outcome, ramp.sequence) == ("cycle", "NS")
    for key, value in asdict(ramp).items():
        if isinstance(value, float):
            assert getattr(drooping, key) == pytest.approx(value, rel=1e-11), key
    hyperbolic = cycle(scene("rig", **{"droop.fraction": 0.01}))
    assert hyperbolic.outcome == "cycle"
    settled = events(scene("rig", **{"droop.fraction": 0.01, "scatter.Fs": 0, "belt.start": 0}), 60.0).events
    assert settled[-1].t - settled[-3].t == pytest.approx(hyperbolic.period, rel=1e-10)


def test_a_resting_belt_does_not_droop_and_scatter_leaves_the_width_alone() -> None:
    rig = scene("rig", **{"droop.fraction": 0.01})
    assert rig.flow(belt_running=False).droop == 0
    assert rig.flow(factor=0.9).droop == rig.flow().droop == 0.01 * 0.22
    found = events(rig, 30.0)
    assert found.outcome == "completed"
    assert len(found.events) > 20
