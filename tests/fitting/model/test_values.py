"""Positions alone: those of a path in every mode of the contact, and those of an integrator that shares nothing."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from fitting.model.flow import SEARCH_STEP, Drag
from fitting.model.path import Curve, follow, positions
from fitting.model.unknowns import PER_RUN, Global, PerCycle

K, F, V, SHAPE, DAMPING = 35.184, 4.598, 0.22, 9.6, 0.03
CONSTANT, LINEAR, HYPERBOLIC = 0, 1, 2
SLIP = np.array([[0.128, 0.1, 0.05, -0.4, 0.0, 0.0]])
STUCK = np.array([[0.0, 0.0, 0.05, 0.0, -0.1, 0.215]])
RIPPLE = {"cosine": 3e-3, "sine": -2e-3, "omega": 14.0}
CASES = {
    "constant": (CONSTANT, False, {}, {}),
    "linear": (LINEAR, False, {"shape": 0.8}, {}),
    "hyperbolic": (HYPERBOLIC, False, {}, {}),
    "stick": (HYPERBOLIC, False, {}, {"stick": 1}),
    "overtakes the belt": (LINEAR, False, {"shape": 0.4}, {"overtakes": 1}),
    "ramp": (HYPERBOLIC, True, {"d": 0.03}, {}),
    "stick on a ramp": (HYPERBOLIC, True, {"d": 0.03}, {"stick": 1}),
    "overtakes on a ramp": (LINEAR, True, {"shape": 0.4, "d": 0.01}, {"overtakes": 1}),
    "ramp of 1 mm/s": (HYPERBOLIC, True, {"d": 1e-3}, {}),
    "steep ramp": (HYPERBOLIC, True, {"d": 1e-5}, {"stick": 1}),
    "break-away of a ramp": (HYPERBOLIC, True, {"d": 0.06, "static": 1.2}, {}),
    "compliant belt": (HYPERBOLIC, False, {"compliance": 0.05}, {}),
    "ramp on a compliant belt": (LINEAR, True, {"shape": 0.8, "d": 0.02, "compliance": 0.05}, {}),
    "ripple": (HYPERBOLIC, False, RIPPLE, {}),
    "stick on a ripple": (HYPERBOLIC, False, RIPPLE, {"stick": 1}),
}


def unknowns(**changes):
    u = np.zeros(PER_RUN)
    u[: Global.D] = K, np.log(F), V, SHAPE
    u[[Global.DAMPING, Global.STATIC]] = DAMPING, 1.0
    for name, value in changes.items():
        u[Global[name.upper()]] = value
    return u


@pytest.mark.parametrize("rate", [1000.0, 100.0])
@pytest.mark.parametrize("case", CASES)
def test_positions_are_those_of_the_path(one_window, case, rate):
    curve, ramp, changes, shape = CASES[case]
    windows, u, local = one_window(rate=rate, **shape), unknowns(**changes), STUCK if "stick" in shape else SLIP
    found = positions(windows, Curve(curve, ramp), u, local)
    path = follow(windows, Curve(curve, ramp), u, local)
    assert found[0] == path.model[0]
    assert found == pytest.approx(path.model, abs=5e-8)


def test_a_search_errs_by_less_than_a_micron(one_window):
    windows = one_window()
    found = positions(windows, Curve(HYPERBOLIC, False), unknowns(), SLIP, longest_step=SEARCH_STEP)
    exact = follow(windows, Curve(HYPERBOLIC, False), unknowns(), SLIP).model
    assert found == pytest.approx(exact, abs=1e-6)


@pytest.mark.parametrize("d", [0.0, 0.03])
def test_a_slip_and_its_landing_are_those_of_an_outside_integrator(one_window, d):
    """Slip, landing at the belt's speed, then stick, or a ramp of the next level: by DOP853 from event to event."""
    windows = one_window(seconds=1.0)
    level, after = math.exp(SLIP[0, PerCycle.LEVEL]), math.exp(SLIP[0, PerCycle.NEXT_LEVEL])

    def slip(_, state):
        s = V - state[1] - d
        return state[1], level * F / (1 + SHAPE * s) - K * state[0] - DAMPING * state[1]

    def held(_, state):
        rise = after * F / d if d else 0.0
        return (state[1], rise * (V - state[1]) - K * state[0] - DAMPING * state[1]) if d else (V, 0.0)

    def lands(_, state):
        return V - d - state[1]

    lands.terminal, lands.direction = True, -1
    tight = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-13, "dense_output": True}
    time = windows.time
    first = solve_ivp(slip, (time[0], time[-1]), SLIP[0, :2], events=lands, **tight)
    landing = first.t_events[0][0]
    assert time[0] + 0.3 < landing < time[-1] - 0.1
    state = first.y_events[0][0]
    second = solve_ivp(held, (landing, time[-1]), state, **tight)
    exact = np.where(time <= landing, first.sol(time)[0], second.sol(np.maximum(time, landing))[0])
    found = positions(windows, Curve(HYPERBOLIC, d > 0), unknowns(d=d), SLIP)
    assert found == pytest.approx(exact, abs=5e-8)


def test_forces_besides_are_followed(one_window):
    u, windows, curve = unknowns(), one_window(), Curve(HYPERBOLIC, False)
    path = follow(windows, curve, u, SLIP)
    v = np.linspace(-2, 2, 2001)
    besides = {
        "along": path,
        "acceleration": 0.1 * np.cos(9 * path.time),
        "belt_speed": 0.05 * (path.time - 2.0),
        "drag": Drag(v, -0.3 * np.tanh(v / 0.1), 0.01),
    }
    moved = follow(windows, curve, u, SLIP, **besides).model
    assert np.abs(moved - path.model).max() > 1e-4
    assert positions(windows, curve, u, SLIP, **besides) == pytest.approx(moved, abs=5e-8)


@pytest.mark.parametrize("start", [np.inf, 1e105])
def test_a_motion_that_is_none_has_no_positions(one_window, start):
    away = SLIP.copy()
    away[0, PerCycle.X_SLIP] = start
    assert positions(one_window(), Curve(HYPERBOLIC, False), unknowns(), away) is None


def test_a_motion_of_far_too_many_steps_has_no_positions(one_window):
    assert positions(one_window(), Curve(LINEAR, False), unknowns(shape=-1e5), SLIP) is None
