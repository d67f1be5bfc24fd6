"""Laws, a free curve and forces fitted by the driver to records of the tests' own rig."""

from dataclasses import replace

import numpy as np
import pytest

from fitting.judge.law_fits import cut_run
from fitting.judge.library import DEPARTURES
from fitting.laws import SIX
from fitting.model.flow import LONGEST_STEP
from fitting.model.forces import Force
from fitting.model.predict import Model, curve_knots, free_curve_task, law_task, regressed_curve
from fitting.model.problem import EstimationProblem, cycle_starts
from fitting.model.unknowns import PER_CYCLE, Global
from fitting.record import motion as frame
from fitting.search import exchange
from fitting.search.exchange import best_end, exchange_starts, fit_all, fit_from, fit_laws, start_beside
from fitting.search.passes import finish, first_pass, regressed_start, restarted_windows, settle
from processing.smoothing import smooth

LIBRARY = {departure.name: departure for departure in DEPARTURES}
NEAR = 4.0  # standard errors
TRUE = {Global.K: 35.184, Global.V_DR: 0.22}


def deviation(found, slot, true):
    return (found.u[slot] - true) / found.deviation(slot)


def curve_task(runs, forces=()):
    """Return the task of a free curve with a jump, which starts from the regression."""
    problem, knots = EstimationProblem.build(SIX[5], runs), curve_knots(runs, 0.0)
    start = problem.start.copy()
    start[Global.K], coefficients = regressed_curve(runs, start, knots, 0.0)
    return replace(free_curve_task(problem, knots, start, coefficients), forces=tuple(forces))


@pytest.mark.parametrize("law", [2, 4, 5])
def test_a_true_law_leaves_the_noise_and_covers_what_made_the_record(runs_of, law):
    runs = runs_of(law=law, seed=3, duration=10.0)
    (found,) = fit_laws([SIX[law]], runs)
    assert found.whole
    assert found.geometric_mean_rms < 1.15 * runs[0].motion.resolution
    for slot, true in TRUE.items():
        assert abs(deviation(found, slot, true)) < NEAR


def test_what_a_law_leaves_does_not_depend_on_which_laws_are_asked_for(runs_of):
    """Law 1 left 1.13 mm beside all six laws and 6.42 mm beside law 5 alone."""
    runs = runs_of(law=5, seed=1, duration=10.0)
    every = {found.law.number: found for found in fit_laws(SIX.values(), runs)}
    assert sorted(every) == [1, 2, 3, 4, 5, 6]
    for asked in ([SIX[1], SIX[5]], [SIX[6]]):
        for found in fit_laws(asked, runs):
            there = every[found.law.number]
            assert found.geometric_mean_rms == pytest.approx(there.geometric_mean_rms, rel=1e-6)
            assert found.q == pytest.approx(there.q, rel=1e-6)


def test_noise_is_that_of_levels_that_fade(runs_of):
    """Within one long drag a tenth of the level wears away, and a fit to its noise without that had k/m 4 sd off."""
    (found,) = fit_laws([SIX[2]], runs_of(law=2, seed=1, wear=0.15, duration=20.0))
    assert found.geometric_mean_rms < 1.15 * found.task.problem.motions[0].resolution
    assert float(found.noise.sigma[0]) < 3 * found.geometric_mean_rms
    assert abs(deviation(found, Global.K, TRUE[Global.K])) < NEAR


def test_a_ramp_of_constant_friction_errs_no_more_than_a_jump(runs_of):
    jump, ramp = fit_laws([SIX[1], SIX[2]], runs_of(law=1, seed=1, duration=10.0))
    assert ramp.geometric_mean_rms <= 1.001 * jump.geometric_mean_rms


@pytest.mark.parametrize("law", [3, 5])
def test_a_free_curve_is_the_friction_that_made_the_record(runs_of, law):
    runs = runs_of(law=law, seed=1, duration=10.0)
    (by_law,) = fit_laws([SIX[law]], runs)
    task = curve_task(runs)
    starts = [(start_beside(task, by_law), by_law.noise.without_fade), (regressed_start(task), None)]
    found = finish(best_end(task, starts))
    assert found.geometric_mean_rms < 1.01 * by_law.geometric_mean_rms
    assert abs(deviation(found, Global.K, TRUE[Global.K])) < NEAR
    s = np.linspace(0.05, 0.9, 50) * found.task.curve.spline.knots[-1]
    F = 35.184 * 0.13068
    true = F - 0.6 / 0.3 * s if law == 3 else F / (1 + 9.618 * s)
    assert found.task.friction(found.q, s) == pytest.approx(true, abs=0.01 * F)


def test_a_ramps_break_away_level_is_found_when_it_is_free(runs_of):
    runs = runs_of(law=6, seed=3, static=1.3, duration=10.0)
    task = law_task(SIX[6], runs)
    held = finish(settle(first_pass(task, regressed_start(task))))
    (free,) = fit_all([task])
    assert held.geometric_mean_rms > 1.3 * runs[0].motion.resolution > free.geometric_mean_rms
    assert abs(deviation(free, Global.STATIC, 1.3)) < NEAR


def test_a_break_away_level_that_is_hardly_known_apart_from_the_ramp_stays(simulated):
    # It is 1.2 +- 0.18, so it was taken for 1: the record was "none of the six", although 1 fits it far worse.
    changes = (
        "friction.law=6",
        "friction.static=1.3",
        "encoder.lines_per_rev=628",
        "scatter.Fs=0.036",
        "damper.c=0.016",
    )
    kinematics = simulated(*changes, "wear.rate=0.0045", "jitter.rms=8.9e-5", "seed=2206", duration=15.0)
    runs = [cut_run(frame.from_kinematics(kinematics, kinematics.recording.rig, None), frozenset())]
    (found,) = fit_laws([SIX[6]], runs)
    assert Global.STATIC in found.task.places
    assert found.u[Global.STATIC] - 1 < NEAR * found.deviation(Global.STATIC)
    for slot, true in (TRUE | {Global.SHAPE: 9.618, Global.D: 0.03, Global.STATIC: 1.3}).items():
        assert abs(deviation(found, slot, true)) < NEAR


def test_a_break_away_level_is_found_from_between_the_fit_without_one_and_the_regression(simulated):
    # From the curves of either the search crept along a valley: the record was "none of the six".
    changes = ("friction.law=6", "friction.static=1.3", "scatter.Fs=0.060875", "damper.c=0.033676")
    more = ("wear.rate=0.00245104", "joint.kick=-0.00222089", "jitter.rms=5.17894e-5", "seed=4306")
    kinematics = simulated(*changes, *more, duration=20.0)
    runs = [cut_run(frame.from_kinematics(kinematics, kinematics.recording.rig, None), frozenset())]
    (found,) = fit_laws([SIX[6]], runs)
    assert found.geometric_mean_rms < 1.5 * runs[0].motion.resolution
    for slot, true in {Global.SHAPE: 9.618, Global.D: 0.03, Global.STATIC: 1.3}.items():
        assert abs(deviation(found, slot, true)) < NEAR


def test_a_fit_goes_on_from_where_it_ended(runs_of):
    runs = runs_of(law=5, seed=1, duration=10.0)
    (first,) = fit_all([law_task(SIX[5], runs)])
    again = fit_from(first.task, first.start, first.noise)
    assert again.geometric_mean_rms == pytest.approx(first.geometric_mean_rms, rel=1e-3)
    assert again.q[:3] == pytest.approx(first.q[:3], rel=1e-5)


@pytest.mark.parametrize("free", [False, True])
@pytest.mark.parametrize("force", [None, LIBRARY["spring-nonlinear"], LIBRARY["guide-friction"]])
def test_derivatives_are_differences_of_the_residuals(runs_of, free, force):
    runs, forces = runs_of(law=5, seed=1, duration=10.0), () if force is None else (Force(force),)
    task = curve_task(runs, forces) if free else law_task(SIX[5], runs, forces)
    windows = task.problem.windows(thinned=True).some(np.arange(3))
    model = Model(task, windows, LONGEST_STEP)
    q, local = regressed_start(task)
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


def test_a_force_whose_scale_was_not_scanned_is_refused():
    with pytest.raises(ValueError, match="scan it"):
        Force(LIBRARY["eccentricity"])


def test_a_lost_law_starts_again_with_its_windows_at_the_smoothed_motion(runs_of):
    runs = runs_of(law=4, seed=1, duration=10.0)
    task = law_task(SIX[5], runs)
    first = first_pass(task, regressed_start(task))
    again = restarted_windows(first)
    problem = task.problem
    assert np.array_equal(again.q, first.q)
    assert not np.array_equal(again.local, first.local)
    assert np.array_equal(again.local, cycle_starts(first.windows, problem.motions, problem.cycles, first.u))


def test_a_law_whose_first_pass_is_far_off_starts_from_one_that_it_contains(belt_rig, tmp_path):
    """Of slips of 25 samples under Stribeck friction law 5 was given up at 4000 times the noise, law 1 ended at 29."""
    time, position = belt_rig.recorded(belt_rig.Contact(curve="stribeck", duration=20.0), rate=50.0, count=0.0)
    position += 5e-6 * np.random.default_rng(5).standard_normal(time.size)
    smoothed = smooth(belt_rig.imported(tmp_path / "track.csv", time, position, decimals=7))
    motion = frame.from_kinematics(smoothed, smoothed.recording.rig, None)
    fits = fit_laws([SIX[1], SIX[3], SIX[5]], [cut_run(motion, frozenset())])
    found = {fit.law.number: fit.geometric_mean_rms for fit in fits}
    assert found[3] <= 1.001 * found[1]
    assert found[5] < 10 * motion.resolution


def astray(at, times):
    """Bend the curve of a fit more until it errs so many times as much."""
    q = at.q.copy()
    found = at
    while found.geometric_mean_rms < times * at.geometric_mean_rms:
        q[at.task.places.index(Global.SHAPE)] *= 1.0001
        found = replace(at, q=q, residual=at.model.residual(q, at.local))
    return found


@pytest.fixture(scope="module")
def settled(runs_of):
    """Give law 5 settled on a record that it made."""
    task = law_task(SIX[5], runs_of(law=5, seed=1, duration=10.0))
    return settle(first_pass(task, regressed_start(task)))


@pytest.mark.parametrize("times", [1.1, 4.0])
def test_a_law_that_errs_more_than_a_neighbour_starts_again_where_that_one_ended(settled, times):
    """Law 4 of a record whose levels do not scatter stopped 0.4 % above what it could reach, law 6 did not."""
    tasks = [settled.task, settled.task]
    moved, kept = exchange_starts(tasks, [astray(settled, times), settled], map)
    assert moved.geometric_mean_rms == pytest.approx(settled.geometric_mean_rms, rel=1e-4)
    assert kept is settled


def test_a_fit_of_every_sample_is_not_replaced_by_one_of_the_thinned_record(settled):
    """A camera's record leaves less when it is thinned: 956 um of a first pass replaced a finished fit of 988 um."""
    finished = astray(finish(settled), 1.1)
    assert exchange_starts([settled.task] * 2, [finished, settled], map) == [finished, settled]


def test_a_law_of_few_samples_a_slip_ends_where_its_own_regression_leads(belt_rig, tmp_path):
    """Of slips of 10 samples law 5 went on from law 3's end, and left 10 times the noise that its regression led to."""
    time, position = belt_rig.recorded(belt_rig.Contact(curve="hyperbolic", duration=20.0), rate=20.0, count=0.0)
    position += 5e-6 * np.random.default_rng(5).standard_normal(time.size)
    smoothed = smooth(belt_rig.imported(tmp_path / "track.csv", time, position, decimals=7))
    run = cut_run(frame.from_kinematics(smoothed, smoothed.recording.rig, None), frozenset())
    alone = finish(settle(first_pass(law_task(SIX[5], [run]), regressed_start(law_task(SIX[5], [run])))))
    (found,) = fit_laws([SIX[5]], [run])
    assert found.geometric_mean_rms <= 1.0005 * alone.geometric_mean_rms


def test_a_settled_fit_that_errs_more_than_its_first_pass_is_not_kept(settled, monkeypatch):
    """Law 4 at 136 um settled at 361 um, and law 6, which started from there, missed its break-away level."""
    monkeypatch.setattr(exchange, "settle", lambda fit: astray(fit, 1.1))
    assert exchange.settle_lower(settled) is settled
