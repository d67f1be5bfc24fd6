"""Fits of laws with memory to records of rig_sim: the true parameters, as well as the study of design 17 knew them."""

from contextlib import nullcontext
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from matplotlib.figure import Figure

import fitting
import rig_sim
from daq.runfile.rig import Rig
from fitting.drawing import draw
from fitting.judge.parameters import friction_band
from fitting.laws import MEMORY, SIX
from fitting.least_squares.normal_equations import SchurComplement
from fitting.model import memory
from fitting.model.unknowns import Global
from fitting.search.exchange import fit_laws
from fitting.search.memory import fit_memory, starting_values
from processing.smoothing import smooth
from rig_sim.scenes.scene import validate_content
from stickslip.units import Measured

from ... import rig as own_rig
from ...conftest import no_other_law
from ..frames import cut

MASS, STIFFNESS, DAMPING, NOISE, RATE = 0.3, 10.5, 0.015, 1e-5, 250.0
STATE = {"F0": 1.2, "a": 0.03, "b": 0.105, "v0": 0.1}
CONTACTS = {  # newtons
    "lugre": {"s0": 1.5e4, "s1": 67.2, "Fc": 0.6, "Fs": 1.35, "v_s": 0.1},
    "ageing": STATE | {"D": 2e-3},
    "slip": STATE | {"D": 5e-3},
}
# Standard errors at this noise in the study: of k/m, 1/s^2, and relative ones of the parameters.
STUDY = {
    "lugre": {"k/m": 0.006, "s0": 0.003, "s1": 0.006, "v_s": 0.0007},
    "ageing": {"k/m": 0.008, "D": 0.00129, "a": 0.0045},
    "slip": {"k/m": 0.007, "D": 0.0012},
}


@cache
def record_of(law, seed=3, speed=0.22):
    content = {
        "name": "contact",
        "seed": seed,
        "mass": {"m": MASS},
        "spring": {"k": STIFFNESS},
        "damper": {"c": DAMPING},
        "belt": {"speed": speed},
        "friction": {"law": law, **CONTACTS[law]},
        "start": {"x": 0.05, "v": 0.0},
        "scatter": {"Fs": 0.02},
    }
    motion = rig_sim.run(validate_content(content, "contact"), until=30.0, rate=RATE)
    position = motion.x[:-1] + NOISE * np.random.default_rng(seed).standard_normal(motion.x.size - 1)
    rig = Rig(
        name="rig",
        mass=Measured(MASS, 1e-3 * MASS),
        datum=Measured(0.0, 1e-4),
        damping=Measured(DAMPING, 0.1 * DAMPING),
    )
    return own_rig.as_recording(np.arange(position.size) / RATE, position, RATE, rig, law)


@cache
def run_of(law, seed=3, speed=0.22):
    return cut(smooth(record_of(law, seed, speed)))


@cache
def nearest(law, seed=3, speed=0.22):
    return fit_laws([SIX[5]], [run_of(law, seed, speed)])[0]


def first_start(law, contact):
    problem = memory.MemoryProblem.of_law(law, [run_of(contact)])
    values, u = next(starting_values(law, problem, nearest(contact)))
    task = memory.memory_task(law, problem, values)
    return task, memory.warm_start(task, u)


OWN = fitting.Law("own", "F0 + a*log(s/v0) + b*log(z*v0/D)", rate="1 - s*z/D")
LAG = fitting.Law("lag", "Fc + (Fs - Fc)*exp(-z/v_s)", rate="(s - z)/tau")


def truth(law):
    """Return the parameters per unit mass, and F0 at the speed that the fit holds, 1 m/s."""
    values = {name: value if name in ("v_s", "D", "v0") else value / MASS for name, value in CONTACTS[law].items()}
    if "F0" in values:
        values["F0"] += (values["b"] - values["a"]) * np.log(values["v0"])
    return values


@pytest.mark.parametrize("law", CONTACTS)
def test_a_law_with_memory_gives_its_parameters_from_positions(law):
    fit = fit_memory(MEMORY[law], [run_of(law)], nearest(law))
    assert fit.finished
    assert fit.outcome == "converged"
    assert fit.geometric_mean_rms == pytest.approx(NOISE, rel=0.03)
    sd = np.sqrt(np.diag(SchurComplement(fit.solution.blocks).covariance))
    assert abs(fit.q[0] - STIFFNESS / MASS) < 3 * sd[0]
    assert sd[0] == pytest.approx(STUDY[law]["k/m"], rel=0.25)
    p, true = len(fit.places), truth(law)
    for name, theta, own in zip(fit.task.curve.free, fit.theta, sd[p:], strict=True):
        assert abs(theta - np.log(true[name])) < 3 * own, name
        if name in STUDY[law]:
            assert own == pytest.approx(STUDY[law][name], rel=0.25), name


@pytest.mark.parametrize("law", CONTACTS)
def test_derivatives_are_those_of_the_motion(law):
    task, start = first_start(MEMORY[law], law)
    p, true = len(task.places), truth(law)
    model = task.predict(task.problem.windows(thinned=True), 1.0)
    q = np.concatenate([start.q[:p], np.log([true[name] for name in task.curve.free])])
    q[0] = STIFFNESS / MASS
    found = model.all_derivatives(q, start.local).columns()
    for j in range(q.size):
        step = (1e-5 if j < p else 1e-3) * max(1.0, q[j])
        beside = [model.residual(q + sign * step * (np.arange(q.size) == j), start.local) for sign in (1.0, -1.0)]
        expected = (beside[0] - beside[1]) / (2 * step)
        assert np.sqrt(np.mean((found[:, j] - expected) ** 2)) < 5e-3 * np.sqrt(np.mean(expected**2)), j


def test_two_formulas_move_as_the_published_law_that_they_are():
    """Theirs is the logarithm that an asinh is beside slip this fast, and its state the age, not its logarithm."""
    values, moved = truth("ageing"), []
    for law in (MEMORY["ageing"], OWN.given(fix={"v0": 1.0})):
        problem = memory.MemoryProblem.of_law(law, [run_of("ageing")])
        task = memory.memory_task(law, problem, values)
        start = memory.warm_start(task, problem.start)
        model = task.predict(problem.windows(thinned=True), 1.0)
        moved.append((model.residual(start.q, start.local), model.all_derivatives(start.q, start.local).columns()))
    (position, by_unknowns), (own, own_by_unknowns) = moved
    assert np.max(np.abs(own - position)) < 1e-7
    size = np.sqrt(np.mean(by_unknowns**2, axis=0))
    assert np.all(np.sqrt(np.mean((own_by_unknowns - by_unknowns) ** 2, axis=0)) <= 1e-3 * size)


def test_derivatives_of_two_formulas_are_those_of_the_motion():
    """Of friction that lags behind slip: its state is a speed."""
    problem = memory.MemoryProblem.of_law(LAG, [run_of("lugre")])
    task = memory.memory_task(LAG, problem, {"Fc": 2.0, "Fs": 4.5, "v_s": 0.1, "tau": 0.01})
    start = memory.warm_start(task, problem.start)
    model = task.predict(problem.windows(thinned=True), 1.0)
    found = model.all_derivatives(start.q, start.local).columns()
    for j in range(start.q.size):
        step = 1e-5 * max(1.0, abs(start.q[j])) * (np.arange(start.q.size) == j)
        beside = [model.residual(start.q + sign * step, start.local) for sign in (1.0, -1.0)]
        expected = (beside[0] - beside[1]) / (2 * step[j])
        assert np.sqrt(np.mean((found[:, j] - expected) ** 2)) < 5e-3 * np.sqrt(np.mean(expected**2)), j


def test_a_law_of_two_formulas_gives_its_parameters_from_positions():
    """Blind, with v0 held by the fit, as F0 and v0 enter only together."""
    fit = fit_memory(OWN, [run_of("ageing")], nearest("ageing"))
    published = fit_memory(MEMORY["ageing"], [run_of("ageing")], nearest("ageing"))
    assert fit.outcome == "converged"
    assert [group.names for group in fit.task.curve.together] == [("F0", "v0")]
    assert fit.geometric_mean_rms == pytest.approx(published.geometric_mean_rms, rel=1e-4)
    sd = np.sqrt(np.diag(SchurComplement(published.solution.blocks).covariance))[len(published.places) :]
    for name, own in zip(published.task.curve.free, sd, strict=True):
        if name != "F0":
            assert fit.law_values[name] == pytest.approx(published.law_values[name], rel=0.1 * own)
    s = np.array([0.01, 0.1, 0.5])
    assert fit.task.friction(fit.q, s) == pytest.approx(published.task.friction(published.q, s), rel=1e-4)


@pytest.mark.parametrize(
    ("law", "units"),
    [
        (OWN, {"F0": "N", "a": "N", "v0": "m/s", "b": "N", "D": "m", "z": "s"}),
        (LAG, {"Fc": "N", "Fs": "N", "v_s": "m/s", "tau": "s", "z": "m/s"}),
        (
            fitting.Law("brush", "s0*z", rate="s*(1 - s0*z/(Fs - G*s))"),
            {"s0": "N/m", "Fs": "N", "G": "N s/m", "z": "m"},
        ),
    ],
)
def test_units_of_two_formulas_follow_from_both(law, units):
    assert {name: law.unit(name, newtons=True) for name in units} == units


def test_bristles_without_falling_friction_give_their_parameters():
    """Dahl's law does not stick and slip, but its windows, started as those of a record, determine it."""
    run, law = run_of("lugre"), MEMORY["dahl"].given(start={"s0": 2100.0, "s1": 55.0, "Fc": 2.4})
    task, start = first_start(law, "lugre")
    true = np.log([3000.0, 40.0, 2.6])
    q = np.concatenate([start.q[: len(task.places)], true])
    windows, chance = task.problem.windows(thinned=False), np.random.default_rng(1)
    position = task.predict(windows, 1.0).motion_in(windows, q, start.local, None)[0]
    measured = run.motion.measured.copy()
    measured[windows.source] = position + NOISE * chance.standard_normal(position.size)
    fit = fit_memory(law, [replace(run, motion=replace(run.motion, measured=measured))], nearest("lugre"))
    assert fit.geometric_mean_rms == pytest.approx(NOISE, rel=0.03)
    sd = np.sqrt(np.diag(SchurComplement(fit.solution.blocks).covariance))[len(task.places) :]
    assert np.all(np.abs(fit.theta - true) < 3 * sd)
    assert np.all(sd < [0.001, 0.004, 0.03])


@pytest.mark.parametrize("values", [{"F0": 4.0, "a": 0.1, "b": 0.35}, {"F0": 0.4, "a": 0.35, "b": 0.1}])
def test_steady_friction_is_positive_at_any_speed(values):
    """The formula is negative at small speeds where a > b: its logarithm ended the fit with an error."""
    curve, u = (
        memory.MemoryCurve(MEMORY["ageing"], values | {"D": 1e-3}, memory.Sizes(4.0, 1.0, 0.1)),
        np.zeros(len(Global)),
    )
    u[Global.V_DR] = 0.2
    speed = np.array([0.0, 1e-6, 1e-3, 0.1, 1.0])
    found = curve.friction(u, curve.start, np.zeros(0), speed)
    assert np.all(found > 0)
    formula = MEMORY["ageing"].curve.value(np.maximum(speed, 2e-7), curve.values(curve.start, u))
    large = formula > 5 * values["a"]
    assert found[large] == pytest.approx(formula[large], rel=1e-3)


def test_two_belt_speeds_tell_a_from_b():
    runs = [run_of("ageing", seed, speed) for seed, speed in ((3, 0.22), (4, 0.12))]
    alone, both = (fit_memory(MEMORY["ageing"], own, fit_laws([SIX[5]], own)[0]) for own in (runs[:1], runs))
    errors, true = [], truth("ageing")
    for fit in (alone, both):
        p, covariance = len(fit.places), SchurComplement(fit.solution.blocks).covariance
        for name, theta, variance in zip(fit.task.curve.free, fit.theta, np.diag(covariance)[p:], strict=True):
            assert abs(theta - np.log(true[name])) < 3 * np.sqrt(variance), name
        errors.append(np.sqrt(np.diag(covariance)[p + fit.task.curve.free.index("a")]))
    assert errors[1] < 0.8 * errors[0]


def test_a_loop_of_one_cycle_surrounds_the_friction_of_steady_slip():
    """Where slip is fast, friction is within a hundredth of the steady one; where it reverses, friction does."""
    fit = fit_memory(MEMORY["lugre"], [run_of("lugre")], nearest("lugre"))
    speed, force = fit.loop
    steady = fit.task.friction(fit.q, np.abs(speed))
    fast = speed > 0.3
    assert fast.sum() > 500
    assert force[fast] == pytest.approx(steady[fast], rel=0.01)
    falling = (speed > 0.05) & (speed < 0.1)
    assert np.min((force - steady)[falling]) < -0.1 < 0.1 < np.max((force - steady)[falling])
    assert force.max() == pytest.approx(truth("lugre")["Fs"], rel=0.02)
    assert np.min(force[speed < 0]) < 0
    drawn = Figure().subplots()
    draw(drawn, [(fit, "LuGre", {})], run_of("lugre").motion, None)
    assert drawn.lines[-1].get_label() == "LuGre, one cycle"
    assert drawn.get_xlim()[0] < speed.min() < 0


def test_the_steady_friction_is_within_its_errors():
    fit, speed = fit_memory(MEMORY["lugre"], [run_of("lugre")], nearest("lugre")), np.geomspace(0.01, 0.6, 20)
    band = friction_band(fit, run_of("lugre").motion, speed, 0.01)
    true = MASS * MEMORY["lugre"].curve.value(speed, truth("lugre"))
    assert np.all(np.abs(MASS * fit.task.friction(fit.q, speed) - true) < band)
    assert np.all(band < 0.1 * true)


def test_a_belt_that_slows_under_load_is_not_modelled_with_memory():
    run = run_of("lugre")
    slowing = replace(run, motion=replace(run.motion, compliance=Measured(0.1, 0.01)))
    assert "slows" in fit_memory(MEMORY["lugre"], [slowing], nearest("lugre"))


def test_bristles_too_stiff_to_show_stand_beside_their_limit(monkeypatch):
    """With a presliding of 1 nm LuGre's law is a Gaussian Stribeck curve; it ended at six times the noise."""
    monkeypatch.setitem(CONTACTS, "lugre", CONTACTS["lugre"] | {"s0": 1e9, "s1": 1e4})
    with no_other_law():
        ranking = fitting.rank(record_of.__wrapped__("lugre"), laws=[5, "stribeck-gaussian", "lugre"])
    assert ranking.members == ("stribeck-gaussian", "lugre")
    limit, bristles = (ranking.row(law).rms_m for law in ranking.members)
    assert bristles == pytest.approx(limit, rel=0.01)


@pytest.mark.parametrize(
    ("law", "others"),
    [*((law, [3, 5]) for law in ("lugre", "slip")), pytest.param("slip", None, marks=pytest.mark.slow)],
)
def test_a_requested_law_with_memory_wins_and_its_scene_is_played(law, others, tmp_path):
    with no_other_law() if others else nullcontext():
        ranking = fitting.rank(record_of(law), laws=[*(others or ["1-6"]), law])
    assert ranking.members == (law,)
    row = ranking.best
    assert row.as_json()["rate"] == MEMORY[law].rate
    for name, value in CONTACTS[law].items():
        if name not in ("F0", "v0"):
            assert abs(row.parameters[name].value - value) < 4 * row.parameters[name].stderr, name
    ranking.save_scene(tmp_path / "fitted.toml")
    played = rig_sim.run(tmp_path / "fitted.toml", until=20.0, rate=RATE)
    assert np.ptp(played.x[-2500:]) == pytest.approx(np.ptp(ranking.motion.measured), rel=0.1)
