"""The stepped path: positions of the exact flow and in closed form, forces besides, and a spline that is a law."""

import tracemalloc

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from fitting.model import path
from fitting.model.flow import CREEP, Drag
from fitting.model.path import Curve, FrictionSpline, follow, positions, spline_curve
from fitting.model.tangents import local_tangents, shared_tangents, tangents
from fitting.model.unknowns import Global, PerCycle

from .exact_flow import CONSTANT, HYPERBOLIC, LINEAR, F, K, V, exact_positions, unknowns

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
    "steep ramp": (HYPERBOLIC, True, {"d": 1e-5}, {}),
    "stick on a steep ramp": (HYPERBOLIC, True, {"d": 1e-5}, {"stick": 1}),
    "ramp of 1 mm/s": (HYPERBOLIC, True, {"d": 1e-3}, {}),
    "stick on a ramp of 1 mm/s": (HYPERBOLIC, True, {"d": 1e-3}, {"stick": 1}),
    "ripple on a ramp": (LINEAR, True, {"shape": 0.4, "d": 2e-3, **RIPPLE}, {}),
    "break-away of a ramp": (HYPERBOLIC, True, {"d": 0.06, "static": 1.2, "datum": -0.05}, {}),
    "compliant belt": (HYPERBOLIC, False, {"compliance": 0.05}, {}),
    "ramp on a compliant belt": (LINEAR, True, {"shape": 0.8, "d": 0.02, "compliance": 0.05}, {}),
    "ripple": (HYPERBOLIC, False, RIPPLE, {}),
    "stick on a ripple": (HYPERBOLIC, False, RIPPLE, {"stick": 1}),
    "camera": (HYPERBOLIC, False, {}, {"rate": 100.0}),
}


def followed(one_window, curve=HYPERBOLIC, ramp=False, changes=None, shape=None):
    """Return what `follow` takes: windows, curve, unknowns of the run and of the cycle."""
    shape = shape or {}
    local = (STUCK if shape.get("stick") else SLIP).copy()
    return one_window(**shape), Curve(curve, ramp), unknowns(**(changes or {})), local


@pytest.mark.parametrize("case", CASES)
def test_positions_and_tangents_are_those_of_the_exact_flow(one_window, case):
    curve, ramp, changes, _ = CASES[case]
    windows, law, u, local = followed(one_window, *CASES[case])
    if case == "break-away of a ramp":
        local[0, PerCycle.V_SLIP] = V - 0.05
    path = follow(windows, law, u, local)
    exact = exact_positions(curve, ramp, windows, u, local)
    assert path.model == pytest.approx(exact, abs=3e-8 if case == "camera" else 5e-9)
    shared = [Global.K, Global.LOG_F, Global.V_DR, Global.SHAPE, Global.DATUM, Global.DAMPING]
    shared += [Global[name.upper()] for name in changes if name not in ("shape", "datum")]
    found = np.hstack([shared_tangents(path, shared), local_tangents(path)])
    columns = [(0, slot) for slot in shared] + [(1, (0, column)) for column in PerCycle]
    for j, (vector, place) in enumerate(columns):
        moved = u.copy(), local.copy()
        moved[vector][place] += 1e-6
        expected = (exact_positions(curve, ramp, windows, *moved) - exact) / 1e-6  # errs by the curvature
        assert np.abs(found[:, j] - expected).max() <= 2e-4 * max(np.abs(expected).max(), 1e-3), columns[j]


@pytest.mark.parametrize("rate", [1000.0, 100.0])
@pytest.mark.parametrize("case", CASES)
def test_positions_alone_are_those_of_the_path(one_window, case, rate):
    curve, ramp, changes, shape = CASES[case]
    arguments = followed(one_window, curve, ramp, changes, shape | {"rate": rate})
    found, path = positions(*arguments), follow(*arguments)
    assert found[0] == path.model[0]
    assert found == pytest.approx(path.model, abs=5e-8)


@pytest.mark.parametrize("stick", [0, 1])
def test_a_steep_ramp_takes_few_steps(one_window, stick):
    """A ramp of 1 mm/s took 47 steps a sample, and a record whose law had one 80 s."""
    arguments = followed(one_window, ramp=True, changes={"d": 1e-3}, shape={"stick": stick})
    assert follow(*arguments).steps.shape[0] < 2 * arguments[0].time.size


def start(x, v, stick=False, level=1.0, following=1.0):
    """Return a cycle's own unknowns: place and speed at its start, levels before and after the landing."""
    state = (0.0, 0.0, x, v) if stick else (x, v, 0.0, 0.0)
    return np.array([[*state[:2], np.log(level), np.log(following), *state[2:]]])


def undamped(windows, local, curve=CONSTANT, ramp=False, **changes):
    return positions(windows, Curve(curve, ramp), unknowns(**{"damping": 0.0} | changes), local)


def test_a_ramps_stick_creeps_as_far_as_the_load_goes(one_window):
    """Beyond the level of slip a window of stick used to slip away, and the law fitted worse than its jump law."""
    d, windows = 0.02, one_window(stick=1, seconds=1.2, rate=30.0)
    rate = -K * d / F  # v - V = -d K x/F, once the start has died away
    x = undamped(windows, start(0.0, V, stick=True), ramp=True, d=d)
    assert K * x[-1] > 1.5 * F
    assert np.diff(x)[20:] * 30.0 == pytest.approx(V + rate * (x[21:] + x[20:-1]) / 2, rel=1e-3)


@pytest.mark.parametrize(
    ("stick", "overtakes", "static"), [(0, 0, 1.0), (0, 1, 1.0), (1, 0, 1.0), (0, 0, 1.4), (1, 0, 1.4)]
)
def test_a_ramp_law_contains_its_jump_law(one_window, stick, overtakes, static):
    first = start(-0.02, 0.2, stick=True) if stick else start(0.128, 0.1, level=1.05, following=0.6)
    windows = one_window(stick=stick, overtakes=overtakes, rate=100.0)
    jump, ramp = (undamped(windows, first, HYPERBOLIC, ramp, d=1e-6 * V, static=static, shape=12.0) for ramp in (0, 1))
    assert ramp == pytest.approx(jump, abs=5e-7)


def test_touching_the_belt_at_the_start_changes_the_motion_continuously(one_window):
    windows = one_window(seconds=0.5, rate=100.0, earliest_landing=2.4)
    place = F / K - 1e-4  # just short of the slip point: friction still wins, the belt is touched first
    ends = [undamped(windows, start(place, V - gap))[-1] for gap in (1e-9, 1e-6, 1e-5)]
    assert ends == pytest.approx([ends[0]] * 3, abs=1e-5)


def test_fading_lowers_the_level_as_a_smaller_level_would(one_window):
    """The level is a line that begins with the record: late cycles lose a larger fraction of theirs."""
    windows = one_window(begin=6.0, seconds=0.41, rate=100.0, earliest_landing=9.0, level_epoch=6.0)
    worn = undamped(windows, start(0.12, 0.1), fade=0.02)
    fine = np.linspace(0.0, 0.4, 40_001)
    h, fade = fine[1], 0.02 / (1 - 0.02 * 6.0)
    x, v, motion = 0.12, 0.1, [0.12]
    for t in fine[:-1]:  # leap-frog with a level that falls at every step
        v += 0.5 * h * (F * (1 - fade * t) - K * x)
        x += h * v
        v += 0.5 * h * (F * (1 - fade * (t + h)) - K * x)
        motion.append(x)
    assert worn == pytest.approx(np.array(motion)[::1000], abs=6e-6)  # at four times the nominal wear


def spline_of(function, fastest=0.9, pieces=13):
    s = np.linspace(0, fastest, 400)
    return FrictionSpline.over(fastest * np.linspace(0, 1, pieces + 1) ** 1.6).nearest(s, function(s))


def test_the_spline_nearest_to_values_is_that_of_numpy():
    s = np.linspace(0, 0.9, 400)
    found = spline_of(lambda s: s**0.3)
    wanted = np.linalg.lstsq(found.basis(s), s**0.3, rcond=None)[0]
    assert found.coefficients == pytest.approx(wanted, abs=1e-12)


@pytest.mark.parametrize("compliance", [0.0, 0.05])
@pytest.mark.parametrize("ramp", [False, True])
def test_a_spline_that_is_a_line_moves_as_the_linear_law(one_window, ramp, compliance):
    u, windows = unknowns(shape=0.8, d=0.02, fade=0.01, compliance=compliance), one_window()
    law = follow(windows, Curve(LINEAR, ramp), u, SLIP)
    spline = spline_of(lambda s: F * (1 - 0.8 * s))
    assert follow(windows, spline_curve(spline, ramp), u, SLIP).model == pytest.approx(law.model, abs=1e-9)


def slope(model, h=1e-5):
    """Return the central difference of ``model(h)`` at 0."""
    return (model(h) - model(-h)) / (2 * h)


def test_a_force_and_a_change_of_the_belt_besides_are_followed_and_have_their_tangents(one_window):
    arguments = followed(one_window)
    path = follow(*arguments)
    force, drift = np.cos(9 * path.time), 0.05 * (path.time - 2.0)

    def rates(t, state):
        s = V + 0.05 * (t - 2.0) - state[1]
        friction = F * np.exp(0.05) / (1 + 9.6 * s)
        return state[1], friction - K * state[0] - 0.03 * state[1] + 0.1 * np.cos(9 * t)

    besides = {"along": path, "acceleration": 0.1 * force, "belt_speed": drift}
    exact = solve_ivp(rates, (2.0, 2.3), SLIP[0, :2], t_eval=path.windows.time[:300], rtol=1e-11, atol=1e-13).y[0]
    moved = follow(*arguments, **besides).model
    assert moved[:300] == pytest.approx(exact, abs=1e-7)
    assert positions(*arguments, **besides) == pytest.approx(moved, abs=5e-8)
    column = tangents(path, np.column_stack([force, 0 * force]), belt_speed=np.column_stack([0 * force, drift]))
    for j, (name, change) in enumerate({"acceleration": force, "belt_speed": drift}.items()):
        expected = slope(lambda h, name=name, change=change: follow(*arguments, along=path, **{name: h * change}).model)
        assert column[:, j] == pytest.approx(expected, abs=1e-6)


def sharp_guide(size, turn=1e-6):
    """Return a force of ``size`` against the velocity, which jumps within ``turn`` of rest."""
    return Drag(np.array([-3.0, -turn, turn, 3.0]), size * np.array([1.0, 1.0, -1.0, -1.0]), turn)


@pytest.mark.parametrize("rate", [1000.0, 125.0])
def test_a_guide_is_followed_through_the_turn_of_the_mass(one_window, rate):
    """Steps passed over the jump of the force: at 125 Hz positions were 0.2 mm off."""
    size, windows = 0.8, one_window(rate=rate, seconds=0.48)
    found = follow(windows, Curve(HYPERBOLIC, False), unknowns(), SLIP, drag=sharp_guide(size))

    def turned(way):
        def rates(_, state):
            friction = F * np.exp(0.05) / (1 + 9.6 * (V - state[1]))
            return state[1], friction - K * state[0] - 0.03 * state[1] - way * size

        return rates

    def rest(_, state):
        return state[1]

    rest.terminal = True
    exact, state, t = [], SLIP[0, :2], 2.0
    for way in (1.0, -1.0):
        rest.direction = -way
        own = windows.time[windows.time >= t]
        part = solve_ivp(turned(way), (t, 2.5), state, t_eval=own, events=rest, rtol=1e-11, atol=1e-13)
        exact.append(part.y[0])
        state, t = part.y_events[0][0] if way > 0 else None, part.t_events[0][0] if way > 0 else None
    exact = np.concatenate(exact)
    assert exact.size > 0.4 * rate
    assert found.model[: exact.size] == pytest.approx(exact[: windows.time.size], abs=2e-7 if rate > 500 else 2e-6)


def test_points_are_stored_within_their_memory(one_window, monkeypatch):
    """A mass that settled on a ramp at the last of the points took one more: the fit ended in an error of shapes.

    Interpreted, the kernel raises where it stores beyond an array; compiled, it does not.
    """
    arguments = followed(one_window, *CASES["ramp of 1 mm/s"])
    whole = follow(*arguments)
    settles = int(np.argmax(whole.mode[whole.steps[:, 0]] == CREEP))
    monkeypatch.setattr(path, "compiled", lambda kernel, *_, **__: kernel)
    for size in range(settles, settles + 5):
        monkeypatch.setattr(path, "STEPS_A_SAMPLE", (0.0, (size - 19.5) / arguments[0].time.size))
        found = follow(*arguments)
        assert found.landed.size == found.window.size == whole.time.size


@pytest.mark.parametrize("function", [follow, positions])
@pytest.mark.parametrize(
    ("x", "curve", "shape"),
    [
        (np.inf, HYPERBOLIC, 9.6),
        (1e105, HYPERBOLIC, 9.6),  # its cube, the force of a hard spring, overflowed: a warning on the terminal
        (0.128, LINEAR, -1e5),  # a search that tried such a curve filled 21 GB of memory with its steps
    ],
)
def test_a_motion_without_a_number_beyond_any_rig_or_of_far_too_many_steps_is_none(
    one_window, function, x, curve, shape
):
    away = SLIP.copy()
    away[0, PerCycle.X_SLIP] = x
    tracemalloc.start()
    assert function(one_window(), Curve(curve, False), unknowns(shape=shape), away) is None
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 1e9


def test_tangents_of_the_fade_are_differences(one_window):
    windows, curve = one_window(), Curve(HYPERBOLIC, False)
    found = shared_tangents(follow(windows, curve, unknowns(fade=0.02), SLIP), [Global.FADE])[:, 0]
    expected = slope(lambda h: follow(windows, curve, unknowns(fade=0.02 + h), SLIP).model)
    assert np.abs(found).max() > 1e-3  # m per 1/s
    assert found == pytest.approx(expected, abs=1e-3 * np.abs(found).max())
