"""Motion: a scene played exactly, stretch after stretch, with what changes the flow between events."""

import itertools
from pathlib import Path as FilePath

import numpy as np
import pytest

from rig_sim.motion.play import LEAST_FACTOR, Event, ScenePlayer, events
from rig_sim.scenes.scene import parse_changes, scene
from stickslip.errors import InputError


def test_without_friction_and_belt_the_mass_is_a_harmonic_oscillator(tmp_path: FilePath) -> None:
    path = tmp_path / "free.toml"
    path.write_text("[mass]\nm = 2.0\n[spring]\nk = 8.0\nx0 = 0.25\n[start]\nx = 1.25\n")
    t = np.linspace(0, 30, 301)
    motion = ScenePlayer(scene(path))
    followed = motion.follow(t, forces=True)
    at = followed.samples
    np.testing.assert_allclose(followed.nodes.x[at], 0.25 + np.cos(2 * t), atol=1e-12)
    np.testing.assert_allclose(followed.nodes.v[at], -2 * np.sin(2 * t), atol=1e-12)
    np.testing.assert_array_equal(followed.F, 0.0)


def test_a_mass_at_rest_within_the_cone_stays_put_until_the_belt_starts() -> None:
    parked = scene("rig", start={"x": 0.1}, belt={"start": 3.0}, scatter={"Fs": 0.0})
    found = events(parked, 5.0)
    assert found.events[0] == Event(3.0, 0.1, "S>N")
    motion = ScenePlayer(parked)
    followed = motion.follow(np.array([0.0, 1.0, 2.9]), forces=True)
    np.testing.assert_array_equal(followed.nodes.x[followed.samples], 0.1)
    np.testing.assert_allclose(followed.F, parked.spring.k * 0.1, rtol=1e-14)


def test_stretches_of_any_length_give_the_same_motion() -> None:
    rig = scene("rig", seed=5)
    t = np.arange(8001) / 1000
    whole = ScenePlayer(rig).follow(t)
    motion, xs = ScenePlayer(rig), []
    cuts = [0, 1, 2, 700, 701, 3333, 3334, 8001]
    for first, last in itertools.pairwise(cuts):
        piece = motion.follow(t[first:last])
        xs.append(piece.nodes.x[piece.samples])
    np.testing.assert_allclose(np.concatenate(xs), whole.nodes.x[whole.samples], atol=1e-13)
    np.testing.assert_array_equal(whole.nodes.t[whole.samples], t)
    assert np.all(np.diff(whole.nodes.t) >= 0)


def test_nodes_lie_close_enough_for_the_encoder_between_rare_samples() -> None:
    rig = scene("rig")
    rare = ScenePlayer(rig).follow(np.array([0.7, 4.0]))
    assert len(rare.samples) == 2
    assert np.diff(rare.nodes.t).max() <= 2e-3
    np.testing.assert_array_equal(rare.nodes.t[rare.samples], [0.7, 4.0])


def test_each_landing_draws_its_own_friction_level() -> None:
    rig = scene("rig", seed=1)
    found = events(rig, 60.0).events
    levels = np.array([event.x for event in found if event.kind == "S>N"][1:]) / 0.13068
    assert len(levels) > 20
    assert levels.mean() == pytest.approx(1.0, abs=0.03)
    assert 0.015 < levels.std() < 0.06
    assert len(set(levels)) == len(levels)


def test_wear_lowers_the_level_at_each_landing_and_never_below_the_bound() -> None:
    worn = scene("rig", scatter={"Fs": 0.0}, wear={"rate": 0.02})
    found = events(worn, 20.0).events
    landings = [event.t for event in found if event.kind.endswith(">S")]
    slips = [event.x for event in found if event.kind == "S>N" and event.t > landings[0]]
    for landing, x in zip(landings, slips, strict=False):
        assert x == pytest.approx(0.13068 * (1 - 0.02 * landing), rel=1e-12)
    late = ScenePlayer(scene("rig", scatter={"Fs": 0.0}, wear={"rate": 1.0}))
    late.advance(30.0)
    assert late.flow.factor == LEAST_FACTOR


def test_a_zero_length_stick_draws_too() -> None:
    # The belt runs so fast that law 1 grazes: every landing at the slip point is a stick of zero length.
    grazing = scene("base", start={"x": 1.0, "v": 0.5}, **{"friction.law": 1, "wear.rate": 1e-3})
    motion = ScenePlayer(grazing)
    motion.events = []
    motion.advance(30.0)
    assert motion.flow.factor < 1.0


def test_the_joint_kicks_once_per_turn_of_the_belt() -> None:
    kicked = scene("rig", scatter={"Fs": 0.0}, joint={"kick": -0.05}, belt={"length": 0.66})
    found = events(kicked, 12.0).events
    kicks = [event.t for event in found if event.kind == "kick"]
    np.testing.assert_allclose(kicks, [0.5 + 3 * (turn + 1) for turn in range(3)])
    motion = ScenePlayer(kicked)
    path = motion.follow(np.array([3.4, 3.6]))
    twice = np.flatnonzero(np.diff(path.nodes.t) == 0)
    assert len(twice) == 1
    assert path.nodes.v[twice[0] + 1] - path.nodes.v[twice[0]] == pytest.approx(-0.05)
    assert path.nodes.x[twice[0] + 1] == path.nodes.x[twice[0]]


def test_a_kick_ends_the_stick_it_falls_into() -> None:
    still = scene("rig", belt={"length": 0.44}, scatter={"Fs": 0.0}, joint={"kick": 0.02})
    found = events(still, 3.5).events
    at = [i for i, event in enumerate(found) if event.kind == "kick"]
    assert at
    assert any(found[i + 1].kind == "S>P" and found[i + 1].t == found[i].t for i in at)


@pytest.mark.parametrize("d", [0.0044, 0.0066, 0.03])
def test_a_ramp_of_any_width_is_left_once(d: float) -> None:
    # Taking w from v again after each event put it an ulp inside the edge: d = 0.0044 went to and fro until the
    # event-rate limit.
    for speed in np.linspace(0.1, 0.4, 7).tolist():
        found = events(scene("rig", **{"friction.law": 6, "friction.d": d, "belt.speed": speed, "scatter.Fs": 0}), 6.0)
        assert found.outcome == "completed"
        assert len(found.events) < 30


def test_the_step_limit_is_a_named_outcome() -> None:
    found = events(scene("forced"), 1000.0, max_steps=50)
    assert (found.outcome, found.steps) == ("step limit", 50)
    assert found.advice
    motion = ScenePlayer(scene("rig"), max_steps=20)
    path = motion.follow(np.arange(20_000) / 1000)
    assert motion.outcome.name == "step limit"
    assert 0 < len(path.samples) < 20_000
    assert path.nodes.t[path.samples[-1]] == (len(path.samples) - 1) / 1000
    assert len(motion.follow(np.array([30.0])).samples) == 0


@pytest.mark.parametrize("change", ["mass.m=1e-9", "friction.Fs=1e9", "friction.gamma=1e9"])
def test_a_motion_too_fast_to_be_followed_is_refused(change: str) -> None:
    # It ended in a MemoryError: half a terabyte for the nodes of one millisecond.
    player = ScenePlayer(scene("rig", **parse_changes([change])))
    with pytest.raises(InputError, match="too fast for steps"):
        player.follow(np.arange(1, 9) / 1000)
