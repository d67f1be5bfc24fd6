"""A stick that does not fit, and a landing that overtakes the belt, leave the rest of the record its corners."""

from dataclasses import replace

import numpy as np
import pytest

import rig_sim
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
    landings = time[0] + np.array([stick.start for stick in made.sticks])
    true_landings = np.array([event.t for event in player.events if event.kind.endswith("S")])
    assert np.abs(landings - 3.257).min() < 3e-3
    assert np.abs(landings - true_landings[2]).min() > 0.02  # where it only passes the belt's speed


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
