"""Effects: each is there when the scene names it, alone, the same again from the same seed, and nothing when absent."""

from itertools import pairwise

import numpy as np
import pytest

from daq.wire.frames import TruthFrame
from daq.wire.quadrature import PHASE
from rig_sim.board.board import SimulatedBoard
from rig_sim.board.disturbances import SilentStretches
from rig_sim.motion.play import events
from rig_sim.scenes.scene import scene
from rig_sim.scenes.sections import Gaps

from ..boards import Record, frames_of, record

LOSSES: dict[str, object] = {"slip_loss.rate": 0.8, "slip_loss.counts": 60, "slip_loss.samples": 4}
GAPS: dict[str, object] = {"gaps.rate": 0.5, "gaps.duration": 0.05}


# Counts lost ---------------------------------------------------------------------------------------------------------


def test_lost_counts_are_missing_for_good_and_against_the_motion() -> None:
    whole, losing = (record(SimulatedBoard(scene("rig", **also)), 20_000) for also in ({}, LOSSES))  # type: ignore[arg-type]
    np.testing.assert_array_equal(whole.ticks, losing.ticks)
    missing = whole.net - losing.net
    assert abs(missing[0]) == 0
    plateaus = [value for value, following in pairwise(missing) if abs(following - value) > 5]
    steps = np.diff(missing)
    begun = np.flatnonzero((np.abs(steps) > 5) & (np.abs(np.roll(steps, 1)) <= 5))
    assert 8 <= len(begun) <= 26  # 0.8 a second for 20 s
    assert len(plateaus) >= len(begun)
    motion = whole.net
    for at in begun:
        lost = missing[at + 5] - missing[at]
        assert abs(lost) == pytest.approx(60, abs=2)
        assert np.sign(lost) == np.sign(motion[at + 1] - motion[at - 1])
    # the board sees nothing odd: levels and counters of the slipping cog agree
    np.testing.assert_array_equal(losing.net % 4, PHASE[losing.levels])


def test_the_exact_motion_sent_is_the_mass_not_the_slipping_cog() -> None:
    sent = [
        np.array(
            [
                row
                for frame in frames_of(SimulatedBoard(scene("rig", **also)), 3000)
                if isinstance(frame, TruthFrame)
                for row in frame.rows
            ]
        )
        for also in ({"tell.truth": True}, {"tell.truth": True, **LOSSES})
    ]
    np.testing.assert_array_equal(*sent)


# Gaps ----------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("at_once", [1000, pytest.param(7, marks=pytest.mark.slow)])
def test_samples_in_a_gap_are_missing_and_all_others_unchanged(at_once: int) -> None:
    truthful = {"tell.truth": True}
    whole = frames_of(SimulatedBoard(scene("rig", **truthful)), 20_000)
    gappy = frames_of(SimulatedBoard(scene("rig", **truthful, **GAPS)), 20_000, at_once=at_once)
    everything, some = Record.of(whole), Record.of(gappy)
    sent = some.seq
    np.testing.assert_array_equal(some.up, everything.up[sent])
    np.testing.assert_array_equal(some.ticks, everything.ticks[sent])
    jumps = np.diff(sent)
    lengths = jumps[jumps > 1] - 1
    assert 4 <= len(lengths) <= 20  # 0.5 a second for 20 s
    assert np.all(np.abs(lengths - 50) <= 1)
    rows = [row for frame in gappy if isinstance(frame, TruthFrame) for row in frame.rows]
    every = [row for frame in whole if isinstance(frame, TruthFrame) for row in frame.rows]
    np.testing.assert_allclose(rows, np.array(every)[sent], atol=1e-12)


def test_gaps_come_at_their_rate() -> None:
    silence = SilentStretches(Gaps(rate=2.0, duration=0.1), 3)
    sent = silence.mark_sent(np.arange(0.0, 1000.0, 0.01).tolist())
    begun = sum(before and not after for before, after in pairwise(sent))
    assert begun == pytest.approx(1000 / 0.6, rel=0.1)
    assert 1 - np.mean(sent) == pytest.approx(0.1 / 0.6, rel=0.1)


# All of them ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("effect", [LOSSES, GAPS], ids=["slip_loss", "gaps"])
def test_the_seed_makes_an_effect_again_and_another_seed_another_one(effect: dict[str, object]) -> None:
    steady = {**effect, "scatter.Fs": 0, "jitter.rms": 0}
    first, again, other = (
        frames_of(SimulatedBoard(scene("rig", seed=seed, **steady)), 10_000)
        for seed in (3, 3, 4)  # type: ignore[arg-type]
    )
    assert first == again
    assert first != other


@pytest.mark.parametrize(
    "changes",
    [{"droop.fraction": 0.0}, {"belt.ripple": 0.0, "belt.ripple_hz": 3.0}, {"shaker.a": 0.0, "shaker.phi": 2.0}],
    ids=str,
)
def test_an_effect_of_no_size_is_no_effect(changes: dict[str, object]) -> None:
    assert events(scene("rig", **changes), 20.0) == events(scene("rig"), 20.0)


def test_effects_draw_from_streams_of_their_own() -> None:
    both, losing = (record(SimulatedBoard(scene("rig", **LOSSES, **also)), 10_000) for also in (GAPS, {}))
    np.testing.assert_array_equal(both.up, losing.up[both.seq])
