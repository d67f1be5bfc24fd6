"""Sticks that do not fit, overtaking landings, and sticks or slips cut short leave the rest of a record its corners."""

from dataclasses import replace

import numpy as np
import pytest

import rig_sim
from processing.kalman.stick_slip import LAND, LEAVE, OVERTAKE, SLIP
from processing.record.series import Series
from processing.segmentation.model_selection import find_odd_spans
from processing.segmentation.switching_times import SwitchingTimes, group_by_stick
from processing.smoothing import smooth
from rig_sim.motion.play import ScenePlayer


def rms(values):
    return 1e3 * float(np.sqrt(np.mean(values**2)))


def test_a_landing_that_overtakes_the_belt_gets_corners_of_its_own(recorded, motion):
    """The mass runs ahead of the belt for 62 ms at 3.2 s; the whole record used to be smoothed without corners."""
    time = (
        np.round((np.arange(1, 12_001) * 1e-3 + 30e-6 * np.random.default_rng(3).standard_normal(12_000)) * 1e6) / 1e6
    )
    player = ScenePlayer(rig_sim.scene("rig", seed=9205, belt={"start": 0.0}))
    player.events = []
    path = player.follow(time)
    x, v = path.nodes.x[path.samples], path.nodes.v[path.samples]
    true = replace(motion(5, 1.0), time=time, x=x, v=v)
    made = smooth(recorded(true))
    assert made.method == "segment"
    assert rms(made.velocity - v) < 0.045
    assert rms((made.velocity - v)[(time > 3.1) & (time < 3.4)]) < 0.2
    passing = [corner for corner in made.corners if corner.what == "overtake"]
    landings = time[0] + np.array([stick.start for stick in made.sticks])
    true_landings = np.array([event.t for event in player.events if event.kind.endswith("S")])
    assert time[0] + passing[0].time == pytest.approx(true_landings[2], abs=4 * passing[0].sd)
    assert len(passing) == 1
    assert np.abs(landings - 3.257).min() < 3e-3
    assert np.abs(landings - true_landings[2]).min() > 0.02  # where it only passes the belt's speed


def test_an_odd_stick_that_begins_behind_the_end_of_a_record_has_a_span():
    """A mass ahead of the belt at the end of a record landed behind it: `process smooth` ended in an IndexError."""
    series = Series(np.arange(100.0), np.zeros(100), 0.0, 0.0, 1.0, (slice(0, 100),))
    at, kind = (
        np.array([10.0, 20.0, 40.0, 50.0, 95.0, 102.0]),
        np.array([LAND, LEAVE, LAND, LEAVE, OVERTAKE, LAND], np.uint8),
    )
    times = SwitchingTimes(at, np.ones(6), kind, (SLIP,), 20.0)
    odd = np.array([False, False, True])
    assert find_odd_spans(series, times, group_by_stick(times), odd, few=0.5) == [(45.0, 103.0)]


@pytest.mark.parametrize("pitch", [7.67e-6, 5e-5])
def test_a_disturbed_stick_is_smoothed_by_itself(recorded, motion, pitch):
    """A tap of 3 mm within one stick of seventeen; the others keep their corners."""
    true = motion(5, 30.0)
    begin, end = true.sticks[len(true.sticks) // 2]
    middle = 0.6 * begin + 0.4 * end
    tap = 3e-3 * np.exp(-(((true.time - middle) / 0.02) ** 2))
    tapped = replace(true, x=true.x + tap, v=true.v - 2 * (true.time - middle) / 0.02**2 * tap)
    clean, made = (smooth(recorded(own, pitch)) for own in (true, tapped))
    assert made.method == clean.method == "segment"
    away = np.abs(true.time - middle) > 4.0  # beyond the middles of the sticks beside it
    plain = smooth(recorded(tapped, pitch), "rts")
    assert rms((made.velocity - tapped.v)[away]) < 1.2 * rms((clean.velocity - true.v)[away])
    assert rms((made.velocity - tapped.v)[away]) < 0.5 * rms((plain.velocity - tapped.v)[away])
    inside = np.abs(made.velocity - tapped.v) <= 2 * made.velocity_errors
    assert inside[~away].mean() > 0.85


def part(true, begin, end):
    """Return the motion from one time to another, s, without the sticks."""
    own = slice(*np.searchsorted(true.time, (begin, end)))
    return replace(true, time=true.time[own], x=true.x[own] - true.x[own.start], v=true.v[own], sticks=())


@pytest.mark.parametrize(("late", "least"), [(4, 0.9), (30, 0.3)])
@pytest.mark.parametrize("length", [3.0, 12.0])
def test_a_landing_just_before_the_end_of_a_record_is_one(recorded, motion, length, late, least):
    """From 15 to 35 ms of stick were smoothed as slip: 1.3 to 3.6 mm/s in the last 100 ms.

    After 30 ms that stick also took all others their corners, in a short record.
    """
    true = motion(5, 20.0)
    landing = true.sticks[7][0]
    cut = part(true, landing + late * 1e-3 - length, landing + late * 1e-3)
    made = smooth(recorded(cut))
    assert made.method == "segment"
    error = made.velocity - cut.v
    assert rms(error[-100:]) < least
    assert rms(error[100:-100]) < 0.06
    assert cut.time[0] + made.sticks[-1].start == pytest.approx(landing, abs=1.5e-3)
    assert made.sticks[-1].end == made.time[-1]


@pytest.mark.parametrize("late", [20, 30])
def test_a_break_away_just_before_the_end_of_a_record_is_one(recorded, motion, late):
    """The first 30 ms of a slip were smoothed as stick: 1.3 mm/s in the last 100 ms, all outside their errors."""
    true = motion(5, 20.0)
    onset = true.sticks[7][1]
    cut = part(true, onset + late * 1e-3 - 12.0, onset + late * 1e-3)
    made = smooth(recorded(cut))
    assert made.phases[-1].kind == "slip"
    assert cut.time[0] + made.phases[-1].start == pytest.approx(onset, abs=0.012)
    error = made.velocity - cut.v
    assert rms(error[-100:]) < 0.3
    assert np.mean(np.abs(error[-100:]) <= 2 * made.velocity_errors[-100:]) > 0.7


def test_a_landing_just_after_the_beginning_of_a_record_is_one(recorded, motion):
    """A slip of 4 ms before a stick was smoothed as stick: 2 to 6 mm/s in the first 100 ms."""
    true = motion(5, 20.0)
    landing = true.sticks[3][0]
    cut = part(true, landing - 4e-3, landing + 9.0)
    made = smooth(recorded(cut))
    assert made.phases[0].kind == "slip"
    assert cut.time[0] + made.sticks[0].start == pytest.approx(landing, abs=1.5e-3)
    assert rms((made.velocity - cut.v)[:100]) < 1.0


@pytest.mark.parametrize("law", [4, 6])
def test_a_stick_in_which_the_mass_creeps_does_not_break_away_where_the_record_ends(recorded, motion, law):
    true = motion(law, 20.0)
    sticks = [stick for stick in true.sticks if np.ptp(stick) > 0.25][-3:]
    for begin, end in sticks:
        cut = part(true, max(end - 10.0, 0.0), 0.4 * begin + 0.6 * end)
        made = smooth(recorded(cut))
        assert made.phases[-1].kind == "stick"
        assert cut.time[0] + made.sticks[-1].start == pytest.approx(begin, abs=0.03)


@pytest.mark.parametrize("counts_per_second", [3.0, 300.0])
def test_a_parked_counter_that_drifts_is_reported(recorded, motion, counts_per_second):
    """It used to be "1 stick, stuck for 100 %" without a word."""
    time = np.arange(10_000) * 1e-3
    dither = 0.8 * np.random.default_rng(1).random(time.size)
    moved = (counts_per_second * time + dither) * 7.67e-6
    made = smooth(recorded(replace(motion(5, 1.0), time=time, x=moved, v=moved)))
    assert [finding.code for finding in made.findings] == ["drift"]
    assert made.findings[0].value == pytest.approx(counts_per_second * 7.67e-6, rel=0.02)
    assert made.findings[0].sigmas > 100
    assert smooth(recorded(motion(5, 6.0))).findings == ()
