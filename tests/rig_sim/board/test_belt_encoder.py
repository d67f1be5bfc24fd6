"""Belt channel: the board counts how far the belt has run, as it runs: started, backwards, rippling, drooping."""

import math

import numpy as np
import pytest
from scipy.integrate import cumulative_simpson

from daq.runfile.rig import Rig
from daq.wire.frames import Capability, Config, FrameReader, Ident, SampleBlock
from rig_sim.board.belt_encoder import BeltEncoder
from rig_sim.board.board import SimulatedBoard
from rig_sim.motion.play import ScenePlayer
from rig_sim.scenes.model import Scene
from rig_sim.scenes.scene import scene

from ..boards import DELTA, frames_of

CHANNEL: dict[str, object] = {"belt.channel": True}
STEADY: dict[str, object] = {"scatter.Fs": 0, "jitter.rms": 0}


@pytest.mark.parametrize(
    "changes",
    [
        {"droop.fraction": 0.05},
        {"droop.fraction": 0.05, "belt.speed": -0.22, "damper.c": 0.1, "spring.x0": 0.02},
        {"droop.fraction": 0.02, "drive.u0": 0.05, "drive.omega": 4.0},
        {"droop.fraction": 0.02, "drive.u0": 0.05, "drive.omega": 0.0},
        {"droop.fraction": 0.02, "belt.ripple": 0.01, "belt.ripple_hz": 3.0},
        {"droop.fraction": 0.02, "shaker.a": 0.2, "shaker.phi": 2.6},
        {"droop.fraction": 0.02, "friction.law": 6},
    ],
    ids=lambda changes: "+".join(key.split(".")[0] for key in changes),
)
def test_the_travel_is_the_integral_of_the_speed_that_the_load_leaves(changes: dict[str, object]) -> None:
    changed = scene("rig", **CHANNEL, **STEADY, **{"belt.start": 0.0, **changes})
    t = np.arange(0.0, 4.0, 1e-4)
    belt = BeltEncoder(changed)
    belt.delta *= 1e-5  # for the travel to a hundred-thousandth of a count
    path = ScenePlayer(changed).follow(t, forces=True)
    travel = belt.read(path) * belt.delta
    assert changed.belt is not None
    assert changed.droop is not None
    assert changed.friction is not None
    speed = changed.belt.speed - changed.droop.fraction * abs(changed.belt.speed) * path.F / changed.friction.Fs
    if changed.belt.ripple and changed.belt.ripple_hz:
        speed = speed + changed.belt.ripple * np.sin(2 * math.pi * changed.belt.ripple_hz * t)
    expected = cumulative_simpson(speed, x=t, initial=0.0)
    np.testing.assert_allclose(travel, expected, atol=0.05 * DELTA)  # Simpson's rule at landings: F bends there


def test_the_board_sends_sixteen_bits_of_the_belts_count_and_they_roll_over() -> None:
    frames = frames_of(SimulatedBoard(scene("rig", **CHANNEL, **STEADY)), 6000, b"I\nS\n")
    idents = [frame for frame in frames if isinstance(frame, Ident)]
    assert all(Capability.BELT in ident.capabilities for ident in idents)
    sent = np.concatenate([frame.belt for frame in frames if isinstance(frame, SampleBlock)])  # type: ignore[misc]
    true = np.floor(0.22 * np.maximum(np.arange(6000) / 1000 - 0.5, 0.0) / DELTA + 1e-9).astype(np.int64)
    assert true[-1] > 2 * 65536
    np.testing.assert_array_equal(sent, true & 0xFFFF)


def test_everything_else_the_board_says_is_the_same_with_and_without_the_channel() -> None:
    plain, counted = (
        frames_of(SimulatedBoard(scene("rig", **changes)), 3000, b"I\nS\n")
        for changes in ({"belt.channel": False}, CHANNEL)
    )
    for one, other in zip(plain, counted, strict=True):
        if isinstance(one, SampleBlock):
            assert other._replace(belt=None) == one
        elif isinstance(one, Ident):
            assert Capability.BELT not in one.capabilities
        elif isinstance(one, Config):
            assert "belt_metres" not in one.toml
            assert other.toml.startswith(one.toml)
            pitch = Rig.from_toml(other.toml, "CONFIG").belt_metres_per_count
            assert pitch is not None
            assert pitch.sd == pytest.approx(2e-4 * DELTA)
            assert abs(pitch.value - DELTA) < 5 * pitch.sd


def test_another_decoder_starts_the_belts_counter_again_too() -> None:
    board = SimulatedBoard(scene("rig", **CHANNEL))
    FrameReader().feed(board.write(b"S\n") + board.samples(1500) + board.write(b"X\n"))
    again = FrameReader()
    again.feed(board.power_up())
    frames = again.feed(board.write(b"M x1\nS\n") + board.samples(8) + board.write(b"X\n"))
    block = next(frame for frame in frames if isinstance(frame, SampleBlock))
    assert block.belt is not None
    assert 0 <= block.belt[0] <= 60  # one sample of 29 counts after the restart, and its jitter


def played(changed: Scene, t: np.ndarray, cuts: tuple[int, ...] = ()) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return belt travel to a hundred-thousandth of a count, and x, F of the mass, at times ``t``."""
    motion, belt = ScenePlayer(changed), BeltEncoder(changed)
    belt.delta *= 1e-5
    counts, x, F = [], [], []
    for first, last in zip((0, *cuts), (*cuts, len(t)), strict=True):
        path = motion.follow(t[first:last], forces=True)
        counts.append(belt.read(path))
        x.append(path.nodes.x[path.samples])
        F.append(path.F)
    return np.concatenate(counts) * belt.delta, np.concatenate(x), np.concatenate(F)


def test_in_stick_mass_and_drooping_belt_move_together_to_a_thousandth_of_a_count() -> None:
    t = np.arange(0.0, 6.0, 1e-3)
    drooping = scene("rig", **CHANNEL, **{"droop.fraction": 0.05, "scatter.Fs": 0.1, "joint.kick": 0.004})
    found = ScenePlayer(drooping)
    found.events = []
    found.advance(6.0)
    travel, x, _ = played(drooping, t, (800, 801, 4000))
    sticks = [
        (begin.t, end.t)
        for begin, end in zip(found.events, found.events[1:], strict=False)
        if begin.kind == "N>S" and end.kind.startswith("S>")
    ]
    assert len(sticks) >= 3
    for begin, end in sticks:
        own = (t > begin) & (t < end)
        assert own.sum() > 300
        assert np.ptp((travel - x)[own]) < 1e-3 * DELTA
