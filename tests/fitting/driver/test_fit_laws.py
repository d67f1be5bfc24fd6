"""The search of all laws: a law that contains another never errs more than it, whatever the record."""

import numpy as np
import pytest

import rig_sim
from daq.runfile.rig import Rig
from fitting import noise_levels, rank
from fitting.judge import law_fits
from fitting.laws import SIX
from fitting.model.predict import law_task
from fitting.model.problem import Run
from fitting.model.unknowns import Global, PerCycle
from fitting.record import cycles
from fitting.record import motion as frame
from fitting.search.exchange import fit_laws
from fitting.search.fit import without_outliers
from fitting.search.passes import first_pass, regressed_start
from processing.smoothing import smooth
from rig_sim.motion.play import ScenePlayer

HARSH = (
    "friction.law=5", "seed=3", "scatter.Fs=0.12", "wear.rate=0.00833", "joint.kick=0.0164", "jitter.rms=2e-4",
    "damper.c=0.0102", "belt.ripple=0.02", "belt.ripple_hz=2.613",
)  # fmt: skip
KICKED = (
    "friction.law=5", "seed=70405", "scatter.Fs=0.0597", "wear.rate=0.00336", "joint.kick=-0.00834",
    "jitter.rms=2.05e-06", "damper.c=0.02712",
)  # fmt: skip
OVERTAKEN = {"friction.law": 5, "seed": 11, "scatter.Fs": 0.05, "jitter.rms": 5e-5, "damper.c": 0.01}
CONTAINED = ((1, 2), (3, 4), (5, 6), (1, 3), (1, 5))


def usual_errors(recording, rig=None):
    motion = frame.from_kinematics(smooth(recording), recording.rig if rig is None else rig, None)
    fits = fit_laws(tuple(SIX.values()), [Run(motion, cycles.segment_cycles(motion))])
    return {fit.law.number: fit.geometric_mean_rms for fit in fits}


def test_a_law_never_errs_more_than_one_it_contains(belt_rig):
    """Laws 2 and 4 used to end at 12 and 1.5 mm beside laws 1 and 3 with 0.9 and 0.2 mm."""
    errors = usual_errors(belt_rig.recording(law=5, duration=8.0))
    for inner, outer in CONTAINED:
        assert errors[outer] <= 1.001 * errors[inner]
    assert errors[5] < 5e-6


@pytest.mark.slow
@pytest.mark.parametrize(("law", "noise"), [(2, 2e-4), (3, 2e-4), (5, 1e-3)])
def test_nor_on_a_camera_track_without_calibration(belt_rig, law, noise):
    recording = belt_rig.recording(law=law, rate=400.0, duration=30.0, jitter=0.0, delta=1e-5, seed=4)
    rng = np.random.default_rng(law)
    recording.position[:] += np.round(noise * rng.standard_normal(recording.position.size), 5)
    errors = usual_errors(recording, Rig(name="", metres_per_count=None))
    assert set(errors) == {1, 2, 3, 4, 5, 6}
    for inner, outer in CONTAINED:
        assert errors[outer] <= 1.001 * errors[inner]


@pytest.mark.slow
def test_a_search_that_is_lost_starts_again(simulated):
    """Law 5 ended 0.3 to 0.6 mm off by itself: cycles in poor minima of their own held k/m 2 to 3 % off."""
    smoothed = simulated(*HARSH, duration=30.0)
    run = law_fits.cut_run(frame.from_kinematics(smoothed, smoothed.recording.rig, None), frozenset())
    task = law_task(SIX[5], [run])
    lost = first_pass(task, regressed_start(task))
    assert lost.geometric_mean_rms > noise_levels.LOST * run.motion.resolution
    (found,) = fit_laws((SIX[5],), [run])
    assert found.geometric_mean_rms < 2 * run.motion.resolution
    assert found.u[Global.K] == pytest.approx(35.184, rel=1e-4)


@pytest.mark.usefixtures("asked_law_alone")
def test_cycles_with_a_velocity_step_do_not_pull_at_the_parameters(simulated):
    """Three of 17 cycles meet the belt's joint: gamma was 11 and k/m 4 standard errors off."""
    smoothed = simulated(*KICKED, duration=30.0)
    (row,) = rank(smoothed, laws=(5,)).rows
    assert (~row.fit.inlier_cycles).sum() >= 2
    for name, true in {"k/m": 35.184, "gamma": 9.618, "c/m": 0.02712 / 0.3, "v_dr": 0.22}.items():
        found = row.parameters[name]
        assert abs(found.value - true) < 2.5 * found.stderr, name


def test_weights_without_outliers_are_those_of_the_inliers():
    weights = np.array([1.0, 0.6, 0.2, 0.1, 0.005, 1e-5])
    found = without_outliers(weights)
    assert np.array_equal(found[:3], weights[:3])
    assert found[3:] == pytest.approx([0.1 / 8, 0.005 * 0.02, 1e-5 * 0.02])


@pytest.fixture(scope="module")
def overtaken(simulated):
    """Give a record in which the mass once overtakes the belt, and its fits by laws 5 and 6."""
    smoothed = simulated(*(f"{key}={value}" for key, value in OVERTAKEN.items()), duration=30.0)
    run = law_fits.cut_run(frame.from_kinematics(smoothed, smoothed.recording.rig, None), frozenset())
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
