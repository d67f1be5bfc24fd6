"""Steps of the velocity are marked with their size, and landings are not taken for them."""

import numpy as np
import pytest

import daq
import processing
import rig_sim
from processing import stage
from processing.defects import faults
from processing.record import series
from rig_sim.motion.play import ScenePlayer


@pytest.fixture(scope="module")
def kicked():
    """Return 60 s of the rig with a belt joint that kicks by 0.05 m/s, its times, and when it does."""
    return with_kicks(0.05, 2)


def kicks_of(data):
    return faults.learn(data, np.zeros(data.time.size, int), steps=True)[1].kicks


def with_kicks(size, seed):
    scene = rig_sim.scene("rig", seed=seed, joint={"kick": size}, belt={"start": 0.0})
    time = np.arange(1, 60_001) * 1e-3 + 30e-6 * np.random.default_rng(1002).standard_normal(60_000)
    motion = ScenePlayer(scene)
    motion.events = []
    path = motion.follow(time)
    return time, path.nodes.x[path.samples], np.array([event.t for event in motion.events if event.kind == "kick"])


@pytest.mark.parametrize(("size", "share"), [(0.02, 0.85), (0.05, 1.0), (0.1, 1.0)])
def test_kicks_are_marked_with_their_size_and_nothing_else_is(recorded, motion, size, share):
    time, x, at = with_kicks(size, 2)
    plain = motion(5, 1.0)
    found = kicks_of(series.from_recording(recorded(type(plain)(time, x, x, ()))))
    when = time[[kick.sample for kick in found]]
    apart = np.abs(when[:, None] - at)
    assert np.mean(apart.min(axis=0) < 4e-3) >= share
    assert apart.min(axis=1).max() < 4e-3
    assert np.median([kick.step for kick in found]) == pytest.approx(size, rel=0.15)


@pytest.mark.parametrize(("law", "pitch"), [(1, 7.67e-6), (3, 1e-6), (5, 7.67e-6), (5, 50e-6), (6, 50e-6)])
def test_landings_are_no_kicks(motion, recorded, law, pitch):
    assert kicks_of(series.from_recording(recorded(motion(law, 30.0), pitch))) == ()


def test_a_track_without_counts_shows_none(imported):
    time = np.arange(100) * 1e-3
    assert kicks_of(series.from_recording(imported(time, np.abs(time - 0.05)))) == ()


def test_kicks_are_kept_in_the_run_file(tmp_path, kicked, motion, run_data):
    from daq.runfile import store

    time, x, _ = kicked
    target = tmp_path / "run.h5"
    store.write(target, run_data(type(motion(5, 1.0))(time[:20_000], x[:20_000], x[:20_000], ())))
    made = processing.smooth(daq.load(target))
    stage.save(made, target)
    assert made.kicks
    assert stage.load(target).kicks == made.kicks
