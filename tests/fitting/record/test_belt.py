"""A counted belt: its compliance is measured apart from any law, and tells a ramp from a belt that slows."""

import numpy as np
import pytest

from fitting import rank
from fitting.record import motion as belt_line

pytestmark = pytest.mark.usefixtures("asked_laws_alone", "unmeasured_curve")
FS_OVER_K = 1.379353536 / 10.5552


@pytest.mark.parametrize(("law", "sign"), [(6, 1), (6, -1), pytest.param(3, -1, marks=pytest.mark.slow)])
def test_the_give_is_read_off_the_sticks_whatever_the_law(simulated, law, sign):
    motion = simulated(
        "belt.channel=true", "droop.fraction=0.02", f"friction.law={law}", f"belt.speed={0.22 * sign}", "scatter.Fs=0"
    )
    line = belt_line.fit_belt_line(motion)
    assert line.slows_under_load
    assert not line.is_unsteady
    assert -line.slope.value == pytest.approx(0.02 * 0.22 / FS_OVER_K, abs=3 * line.slope.sd)
    assert line.slope.sd < 0.02 * abs(line.slope.value)
    free = line.speed_without_load(motion.recording.rig.datum)
    assert free.value == pytest.approx(0.22 * sign, abs=3 * free.sd)


def test_a_stiff_belt_is_not_said_to_give(simulated):
    line = belt_line.fit_belt_line(simulated("belt.channel=true"))
    assert not line.slows_under_load
    assert abs(line.slope.value) < 0.05 * 0.0022 / FS_OVER_K


def test_without_a_channel_there_is_no_line(simulated):
    assert belt_line.fit_belt_line(simulated("droop.fraction=0.01")) is None


@pytest.mark.parametrize("law", [5, pytest.param(1, marks=pytest.mark.slow)])
def test_a_belt_that_slows_cannot_be_told_from_a_ramp_without_its_counts(simulated, law):
    ranking = rank(simulated("droop.fraction=0.01", f"friction.law={law}"), laws=(law, law + 1))
    assert ranking.laws_in_set == (law, law + 1)
    assert "belt tachometer" in ranking.verdict
    assert any("slows under load" in warning for warning in ranking.warnings)


@pytest.mark.parametrize("law", [1, pytest.param(3, marks=pytest.mark.slow)])
def test_with_its_counts_the_jump_law_stands_alone(simulated, law):
    ranking = rank(simulated("belt.channel=true", "droop.fraction=0.01", f"friction.law={law}"), laws=(law, law + 1))
    assert ranking.laws_in_set == (law,)
    droop = ranking.best.parameters["droop"]
    assert droop.value == pytest.approx(0.0022, rel=0.01)
    if law != 1:  # its one drag is one witness: no spread between cycles to make an interval of
        assert droop.lo <= 0.0022 <= droop.hi
    assert ranking.best.rms_m < 1.1 * 7.67e-6 / np.sqrt(12)
    assert not any("slows under load look the same" in warning for warning in ranking.warnings)


@pytest.mark.slow
def test_a_ramp_on_a_belt_that_slows_keeps_its_own_width(simulated):
    ranking = rank(simulated("belt.channel=true", "droop.fraction=0.01", "friction.law=6"), laws=(5, 6))
    assert ranking.laws_in_set == (6,)
    width = ranking.best.parameters["d"]
    assert width.lo <= 0.03 <= width.hi
    assert width.stderr < 1e-4


@pytest.mark.slow
def test_a_stronger_break_away_does_not_pass_for_a_ramp_on_a_counted_belt(simulated):
    ranking = rank(simulated("belt.channel=true", "friction.static=1.3"), laws=(5, 6))
    assert ranking.laws_in_set == (5,)


@pytest.mark.slow
def test_a_stated_speed_goes_before_the_belts_counts(simulated):
    motion = simulated("belt.channel=true", "droop.fraction=0.01", "friction.law=5")
    assert rank(motion, laws=(5, 6), belt_speed="channel").laws_in_set == (5,)
    stated = rank(motion, laws=(5, 6), belt_speed=0.22)
    assert stated.laws_in_set == (5, 6)
    assert any("slows under load look the same" in warning for warning in stated.warnings)


def test_a_belt_that_swings_is_told(simulated):
    ranking = rank(simulated("belt.channel=true", "belt.ripple=0.0044", "belt.ripple_hz=3", duration=12.0), laws=(5, 6))
    assert any("varies by 2 % at 3 Hz" in warning for warning in ranking.warnings)
    assert 5 in ranking.laws_in_set
