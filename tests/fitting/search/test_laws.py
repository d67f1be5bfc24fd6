"""The search of all laws: each finds what made the record, and none errs more than one that it contains."""

from dataclasses import replace

import numpy as np
import pytest

import rig_sim
from daq.runfile.rig import Rig
from fitting import rank
from fitting.judge.library import DEPARTURES
from fitting.laws import SIX
from fitting.model.flow import LONGEST_STEP
from fitting.model.forces import Force
from fitting.model.predict import Model, curve_knots, free_curve_task, law_task, regress_curve
from fitting.model.problem import EstimationProblem
from fitting.model.unknowns import PER_CYCLE, Global, PerCycle
from fitting.search.exchange import fit_laws
from fitting.search.passes import start_from_regression
from processing.smoothing import smooth
from rig_sim.motion.play import ScenePlayer

from ..frames import cut

LIBRARY = {departure.name: departure for departure in DEPARTURES}
TRUE = {Global.K: 35.184, Global.V_DR: 0.22}
CONTAINED = ((1, 2), (3, 4), (5, 6), (1, 3), (1, 5))
KICKED = (
    "friction.law=5", "seed=70405", "scatter.Fs=0.0597", "wear.rate=0.00336", "joint.kick=-0.00834",
    "jitter.rms=2.05e-06", "damper.c=0.02712",
)  # fmt: skip
OVERTAKEN = {"friction.law": 5, "seed": 11, "scatter.Fs": 0.05, "jitter.rms": 5e-5, "damper.c": 0.01}


def check_parameters(fit, true):
    """Hold that unknowns lie within 4 standard errors of what made the record."""
    for slot, value in true.items():
        assert abs(fit.u[slot] - value) < 4.0 * fit.deviation(slot), slot


def errors_of(laws, runs):
    return {fit.law.number: fit.geometric_mean_rms for fit in fit_laws([SIX[law] for law in laws], runs)}


def check_nested(errors):
    for inner, outer in CONTAINED:
        assert errors[outer] <= 1.001 * errors[inner]


def test_a_law_never_errs_more_than_one_it_contains_whichever_are_asked_for(runs_of):
    """Laws 2 and 4 ended at 12 and 1.5 mm beside laws 1 and 3 with 0.9 and 0.2 mm.

    Law 1 left 1.13 mm beside all six laws and 6.42 mm beside law 5 alone.
    """
    runs = runs_of(law=5, seed=1, duration=10.0)
    every = errors_of(SIX, runs)
    check_nested(every)
    assert every[5] < 5e-6
    for asked in ([1, 5], [6]):
        assert errors_of(asked, runs) == {law: pytest.approx(every[law], rel=1e-6) for law in asked}


def test_a_ramp_of_constant_friction_errs_no_more_than_a_jump(runs_of):
    errors = errors_of((1, 2), runs_of(law=1, seed=1, duration=10.0))
    assert errors[2] <= 1.001 * errors[1]


@pytest.mark.slow
@pytest.mark.parametrize(("law", "noise"), [(2, 2e-4), (3, 2e-4), (5, 1e-3)])
def test_a_law_never_errs_more_than_one_it_contains_on_a_camera_track(belt_rig, law, noise):
    recording = belt_rig.recording(law=law, rate=400.0, duration=30.0, jitter=0.0, delta=1e-5, seed=4)
    rng = np.random.default_rng(law)
    recording.position[:] += np.round(noise * rng.standard_normal(recording.position.size), 5)
    bare = replace(recording, rig=Rig(name="", metres_per_count=None))
    check_nested(errors_of(SIX, [cut(replace(smooth(recording), recording=bare))]))


def test_noise_is_that_of_levels_that_fade(runs_of):
    """Within one long drag a tenth of the level wears away, and a fit to its noise without that had k/m 4 sd off."""
    (found,) = fit_laws([SIX[2]], runs_of(law=2, seed=1, wear=0.15, duration=20.0))
    assert found.geometric_mean_rms < 1.15 * found.task.problem.motions[0].resolution
    assert float(found.noise.sigma[0]) < 3 * found.geometric_mean_rms
    check_parameters(found, {Global.K: TRUE[Global.K]})


@pytest.mark.parametrize(
    ("changes", "duration", "times", "true"),
    [
        # It is 1.2 +- 0.18, so it was taken for 1: the record was "none of the six", although 1 fits it far worse.
        (
            ("encoder.lines_per_rev=628", "scatter.Fs=0.036", "damper.c=0.016", "wear.rate=0.0045", "jitter.rms=8.9e-5",
             "seed=2206"),
            15.0, np.inf, TRUE,
        ),
        # From the curves without one and of the regression the search crept along a valley: "none of the six".
        (
            ("scatter.Fs=0.060875", "damper.c=0.033676", "wear.rate=0.00245104", "joint.kick=-0.00222089",
             "jitter.rms=5.17894e-5", "seed=4306"),
            20.0, 1.5, {},
        ),
    ],
    ids=["hardly known apart from the ramp", "along a valley"],
)  # fmt: skip
def test_a_break_away_level_of_a_ramp_is_found(simulated, changes, duration, times, true):
    kinematics = simulated("friction.law=6", "friction.static=1.3", *changes, duration=duration)
    (found,) = fit_laws([SIX[6]], [cut(kinematics)])
    assert Global.STATIC in found.task.places
    assert found.geometric_mean_rms < times * found.task.problem.motions[0].resolution
    check_parameters(found, true | {Global.SHAPE: 9.618, Global.D: 0.03, Global.STATIC: 1.3})


@pytest.mark.usefixtures("asked_law_alone")
def test_cycles_with_a_velocity_step_do_not_pull_at_the_parameters(simulated):
    """Three of 17 cycles meet the belt's joint: gamma was 11 and k/m 4 standard errors off."""
    (row,) = rank(simulated(*KICKED, duration=30.0), laws=(5,)).rows
    assert (~row.fit.inlier_cycles).sum() >= 2
    for name, true in {"k/m": 35.184, "gamma": 9.618, "c/m": 0.02712 / 0.3, "v_dr": 0.22}.items():
        found = row.parameters[name]
        assert abs(found.value - true) < 2.5 * found.stderr, name


@pytest.mark.parametrize("free", [False, True])
@pytest.mark.parametrize("force", [None, LIBRARY["spring-nonlinear"], LIBRARY["guide-friction"]])
def test_derivatives_are_differences_of_the_residuals(runs_of, free, force):
    runs, forces = runs_of(law=5, seed=1, duration=10.0), () if force is None else (Force(force),)
    if free:
        problem, knots = EstimationProblem.build(SIX[5], runs), curve_knots(runs, 0.0)
        start = problem.start.copy()
        start[Global.K], coefficients = regress_curve(runs, start, knots, 0.0)
        task = replace(free_curve_task(problem, knots, start, coefficients), forces=forces)
    else:
        task = law_task(SIX[5], runs, forces)
    windows = task.problem.windows(thinned=True).of_cycles(np.arange(3))
    model = Model(task, windows, LONGEST_STEP)
    q, local = start_from_regression(task)
    local = local[:3]
    if force is not None:
        q[-1] = 0.05
    model.settle(q, local, 1)
    found = model.all_derivatives(q, local).columns()
    assert found.shape == (windows.time.size, q.size + PER_CYCLE)
    for j in range(q.size):
        step = np.zeros(q.size)
        step[j] = 1e-5 * max(abs(q[j]), 0.1)
        ends = [model.residual(q + side * step, local) for side in (1, -1)]
        size = np.abs(found[:, j]).max()
        assert found[:, j] == pytest.approx((ends[0] - ends[1]) / (2 * step[j]), abs=3e-3 * size + 1e-5)


@pytest.fixture(scope="module")
def overtaken(simulated):
    """Give a record in which the mass once overtakes the belt, and its fits by laws 5 and 6."""
    run = cut(simulated(*(f"{key}={value}" for key, value in OVERTAKEN.items()), duration=30.0))
    return run, {fit.law.number: fit for fit in fit_laws((SIX[5], SIX[6]), [run])}


@pytest.mark.parametrize("law", [5, 6])
def test_an_overtaking_too_small_to_be_seen_is_found_by_what_it_leaves(overtaken, law):
    """The cycle left 2.4 times as much as the others; a few such cycles of a long record made law 5 start again."""
    run, found = overtaken[0], overtaken[1][law]
    assert not any(cycle.overtakes for cycle in run.cut.used)
    assert found.cycle_rms.max() < 1.1 * np.median(found.cycle_rms)
    (overtaking,) = [cycle for cycle in found.task.problem.cycles if cycle.overtakes]
    _, _, velocity, _ = ScenePlayer(rig_sim.scene("rig", **OVERTAKEN)).columns(run.motion.time)
    faster = (velocity > 0.22 + 1e-6) & (run.motion.time > 1.0)
    assert np.abs(run.motion.time[faster] - overtaking.landing).max() < 0.1


def test_the_level_under_which_the_mass_overtakes_the_belt_has_no_weight_in_the_mean(overtaken):
    """Only a low level lets it overtake: with such levels in the mean, Fs/m was 1 % below that of the slips."""
    found = overtaken[1][5]
    levels = found.local[:, [PerCycle.LEVEL, PerCycle.NEXT_LEVEL]]
    overtaking = np.array([cycle.overtakes for cycle in found.task.problem.cycles])
    assert levels[overtaking, 1].max() < -0.05
    assert abs(levels[:, 0].mean()) < 1e-3
