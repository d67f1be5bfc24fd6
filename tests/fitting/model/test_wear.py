"""Wear: the trend of the levels, with an interval that holds the truth; and what is known only in combination."""

from dataclasses import replace

import numpy as np
import pytest

from fitting import rank
from fitting.model import windows

pytestmark = pytest.mark.usefixtures("asked_laws_alone", "unmeasured_curve")


def test_the_error_of_a_trend_is_that_of_the_scatter():
    rng = np.random.default_rng(8)
    time = np.arange(20.0)
    z = []
    for _ in range(400):
        found = windows.level_trend(time, (1 - 0.004 * time) * (1 + 0.05 * rng.standard_normal(20)))
        z.append((found.rate.value - 0.004) / found.rate.sd)
    assert np.mean(np.abs(z) < 2.101) == pytest.approx(0.95, abs=0.035)  # t of 18 degrees of freedom


def test_three_levels_are_no_trend():
    assert windows.level_trend(np.arange(3.0), np.ones(3)) is None


@pytest.mark.parametrize("law", [3, pytest.param(6, marks=pytest.mark.slow)])
def test_wear_of_a_run_lies_in_its_interval(simulated, law):
    parameters = rank(simulated(f"friction.law={law}", "wear.rate=0.006"), laws=(law,)).best.parameters
    found, first = parameters["wear"], parameters["Fs0/m"]
    assert found.lo <= 0.006 <= found.hi
    assert found.hi - found.lo < 0.02
    assert first.lo <= 35.184 * 0.13068 <= first.hi
    assert first.value > parameters["Fs/m"].value


def test_friction_that_never_sticks_again_shows_no_wear(simulated):
    assert "wear" not in rank(simulated("friction.law=1", duration=12.0), laws=(1,)).best.parameters


@pytest.mark.parametrize("scatter", [0.0, pytest.param(0.03, marks=pytest.mark.slow)])
def test_what_is_known_only_in_combination_is_given_as_such(simulated, scatter):
    kinematics = simulated("friction.law=1", f"scatter.Fs={scatter}", duration=12.0)
    rig = kinematics.recording.rig
    known = rank(kinematics, laws=(1,)).best.parameters
    parameters = rank(kinematics, replace(rig, datum=None), laws=(1,)).best.parameters
    assert not {"Fs/m", "Fs/k", "x0", "Fs"} & set(parameters)
    both = parameters["x0 + Fs/k"]
    assert both.value == pytest.approx(known["x0"].value + known["Fs/k"].value, abs=4 * both.stderr + 1e-9)
    # where the datum is known, its error is in that of the level; a level a third as high had a third of the error
    assert both.stderr**2 == pytest.approx(known["Fs/k"].stderr ** 2 - known["x0"].stderr ** 2, rel=0.1)
    assert parameters["k/m"].value == pytest.approx(35.184, rel=1e-4)


def test_without_a_damping_calibration_the_linear_law_knows_its_slope_less_the_damping(simulated):
    kinematics = simulated("friction.law=3", "scatter.Fs=0", duration=12.0)
    rig = replace(kinematics.recording.rig, damping=None)
    parameters = rank(kinematics, rig, laws=(3,)).best.parameters
    assert not {"G_slip/m", "G_slip", "c/m", "c"} & set(parameters)
    slope = parameters["(G_slip - c)/m"]
    assert slope.value == pytest.approx(2.0, abs=4 * slope.stderr)
    assert slope.stderr < 0.05


@pytest.mark.parametrize("seed", [5, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (11, 16))])
def test_the_ramp_of_constant_friction_is_known_no_better_than_the_datum(simulated, seed):
    motion = simulated("friction.law=2", f"seed={seed}", "scatter.Fs=0", duration=12.0)
    parameters = rank(motion, laws=(2,)).best.parameters
    for name, truth in {"d": 0.03, "v_dr": 0.22, "Fs/k": 0.13068}.items():
        assert parameters[name].lo <= truth <= parameters[name].hi, name
    assert parameters["x0"].stderr == pytest.approx(5e-4, rel=0.01)
