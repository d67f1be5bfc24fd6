"""Lost counts and steps of the datum are found, each once, and nothing else is taken for one."""

from dataclasses import replace

import numpy as np
import pytest

import processing
from processing.defects import faults
from processing.record import series


def steps_of(data):
    return faults.learn(data, np.zeros(data.time.size, int), steps=True)[1].steps


@pytest.mark.parametrize("size", [6, 10, -12, 40, -300])
def test_a_loss_within_one_sample_is_marked_where_it_happened(motion, recorded, size):
    run = recorded(motion(5, 20.0))
    at = [700, 5000, 9001, 14321]
    count = run.count.copy()
    for k in at:
        count[k:] += size
    found = steps_of(series.from_recording(replace(run, count=count)))
    assert [loss.first for loss in found] == at
    assert [loss.last for loss in found] == at
    assert np.abs([loss.counts - size for loss in found]).max() <= 1


@pytest.mark.parametrize(("jitter", "times"), [(0.0, "recorded"), (100e-6, "recorded"), (30e-6, "nominal")])
def test_no_false_alarm_in_a_clean_minute(motion, recorded, times, jitter):
    assert steps_of(series.from_recording(recorded(motion(5, 60.0, jitter)), times)) == ()


@pytest.mark.parametrize(("noise", "law"), [pytest.param(2e-4, 5, marks=pytest.mark.slow), (1e-3, 3)])
def test_a_datum_that_moves_in_a_camera_track_is_found_and_kept_out_of_the_velocity(motion, imported, noise, law):
    # A camera that was moved went into the velocity and the fit without a word: steps were looked for in counts alone.
    true = motion(law, 20.0)
    rng = np.random.default_rng(law)
    time, clean = true.time[::3], (true.x + rng.normal(0, noise, true.x.size))[::3]
    at, sizes = [1000, 2500, 4100, 5003], np.array([12.0, -30.0, 100.0, -12.0]) * noise
    moved = clean.copy()
    for k, size in zip(at, sizes, strict=True):
        moved[k:] += size
    found, sound = processing.smooth(imported(time, moved)), processing.smooth(imported(time, clean))
    assert sound.losses == ()
    assert [step.first for step in found.losses] == at
    assert [step.size for step in found.losses] == pytest.approx(sizes, abs=3 * noise)
    assert [finding.code for finding in found.findings] == ["position-steps"]
    assert np.abs(found.steady_position - sound.position).max() < 5 * noise
    assert np.sqrt(np.mean((found.velocity - sound.velocity) ** 2)) < np.median(sound.velocity_errors)
    assert np.abs(found.measured - moved).max() == 0
    assert found.lost_counts == 0


@pytest.mark.parametrize("law", [5, 6])
def test_a_step_of_the_datum_does_not_hide_behind_the_readings_it_puts_out_of_line(motion, imported, law):
    """Around a step of eight standard deviations most readings of the smoother's window stand out."""
    true = motion(law, 60.0, jitter=0.0, rate=400.0)
    rng = np.random.default_rng(law)
    at = np.linspace(500, true.time.size - 500, 40).astype(int)
    signs = rng.choice([-1, 1], at.size)
    datum = 2e-4 * 8 * np.cumsum(np.bincount(at, signs, true.time.size))
    seen = true.x + 2e-4 * rng.standard_normal(true.time.size) + datum
    found = np.array([step.first for step in processing.smooth(imported(true.time, seen)).losses])
    assert np.mean([np.abs(found - k).min() <= 5 for k in at]) > 0.94
    assert found.size <= at.size


def test_slips_over_within_a_sample_are_no_steps_of_the_datum(imported):
    time = np.arange(4000) / 200.0
    saw = 0.1 * time % 0.08 + np.random.default_rng(1).normal(0, 1e-4, time.size)
    assert steps_of(series.from_recording(imported(time, saw))) == ()
