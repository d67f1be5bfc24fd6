"""The statistics of stick-slip, on a force record that was made with known levels, drops and spikes."""

import math
from dataclasses import replace

import numpy as np
import pytest

import processing
from daq.runfile.recording import Recording
from daq.runfile.rig import Rig
from processing import statistics


def force_record(slips=24, belt=1e-3, seed=3, rate=500.0):
    """Return times and stretch of a pulled spring: sticks that rise at the belt's speed, quick drops, and both known.

    Break-away levels scatter by 10 % around 4 mm and fall by 1 % a second; the noise has spikes, ten a second.
    """
    rng = np.random.default_rng(seed)
    t, x, now, level = [0.0], [2e-3], 0.0, 2e-3
    tops, drops = [], []
    for _ in range(slips):
        top = 4e-3 * (1 - 0.01 * now) * (1 + 0.1 * rng.standard_normal())
        stick = max(top - level, 2e-4) / belt
        bottom = top - 1.2e-3 * (1 + 0.2 * rng.random())
        for span, end in ((stick, level + belt * stick), (0.04, bottom)):
            now += span
            t.append(now)
            x.append(end)
        tops.append(x[-2])
        drops.append(x[-2] - bottom)
        level = bottom
    t.append(now + 1.0)
    x.append(level + belt)
    time = np.arange(0.0, t[-1], 1 / rate)
    position = np.interp(time, t, x) + 4e-6 * rng.standard_normal(time.size)
    wild = rng.random(time.size) < 10 / rate
    position[wild] += rng.choice([-1, 1], wild.sum()) * rng.uniform(1e-4, 5e-4, wild.sum())
    return time, position, np.array(tops), np.array(drops), int(wild.sum())


def recorded(time, position):
    at = "2024-05-01T12:00:00+02:00"
    return Recording("", at, at, 500.0, Rig(), time, position)


@pytest.fixture(scope="module")
def motion():
    time, position, *known = force_record()
    return processing.smooth(recorded(time, position)), known


def test_the_statistics_of_a_force_record_are_those_it_was_made_with(motion):
    smoothed, (tops, drops, wild) = motion
    found = statistics.from_kinematics(smoothed).as_json()
    assert found["slips"] == pytest.approx(len(tops), abs=1)
    assert found["break_away_m"]["mean"] == pytest.approx(tops.mean(), rel=0.02)
    assert found["break_away_m"]["sd"] == pytest.approx(tops.std(ddof=1), rel=0.1)
    assert found["drop_m"]["mean"] == pytest.approx(drops.mean(), rel=0.05)
    assert found["break_away_m"]["trend_per_s"] == pytest.approx(-4e-5, rel=1.0)
    assert found["spikes"] == pytest.approx(wild, rel=0.1)
    assert smoothed.belt_speed == pytest.approx(1e-3, rel=0.02)


def test_the_trend_is_the_least_squares_slope_and_few_slips_have_no_statistics(motion):
    counted = statistics.from_kinematics(motion[0])
    line = tuple(replace(event, break_away_m=3.0 - 0.5 * event.t) for event in counted.events)
    exact = replace(counted, events=line).summary("break_away_m")
    assert exact["trend_per_s"] == pytest.approx(-0.5, rel=1e-9)
    few = replace(counted, slips=2, events=line[:2])
    assert few.as_json()["break_away_m"] is None
    assert "too few" in few.sentences("m")[0]
    both = statistics.pooled([counted, counted])
    assert both.slips == 2 * counted.slips
    assert both.summary("drop_m")["trend_per_s"] is None


def test_what_an_end_of_the_record_cuts_off_has_no_duration(motion):
    events = statistics.from_kinematics(motion[0]).as_json()["break_aways"]
    assert events[0]["stick_s"] is None
    assert all(event["stick_s"] > 0 for event in events[1:])
    assert all(math.isfinite(event["break_away_m"]) for event in events)


def test_a_stick_during_which_the_belt_rests_has_no_duration():
    """A pause of 10 s used to be a stick of 11 s."""
    time, position, *_ = force_record(seed=5)
    middle = int(np.searchsorted(time, 0.4 * time[-1]))
    while position[middle + 50] <= position[middle]:  # not in a slip
        middle += 50
    pause = 10 * round(1 / (time[1] - time[0]))
    noise = 4e-6 * np.random.default_rng(1).standard_normal(pause)
    paused = np.concatenate((position[:middle], position[middle] + noise, position[middle:]))
    times = (time[1] - time[0]) * np.arange(paused.size)
    found, whole = (
        statistics.from_kinematics(processing.smooth(recorded(*one))) for one in ((times, paused), (time, position))
    )
    assert np.nanmax(found.column("stick_s")) == pytest.approx(np.nanmax(whole.column("stick_s")), rel=0.1)
