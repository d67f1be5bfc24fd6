"""Scenes with friction laws with memory: their motion, the counts of the board, and errors for what is not modelled."""

import numpy as np
import pytest

import rig_sim
from rig_sim.board.board import SimulatedBoard
from rig_sim.motion import play
from rig_sim.motion.play import ScenePlayer
from rig_sim.scenes.model import Scene
from rig_sim.scenes.scene import parse_changes, scene

LUGRE = ["friction.law=lugre", "friction.s0=15 N/mm", "friction.s1=60", "friction.Fc=600 mN", "friction.v_s=10 cm/s"]
STATE = ["friction.F0=1.2 N", "friction.a=0.03", "friction.b=0.105", "friction.D=2 mm", "friction.v0=0.1"]
LAWS = {
    "lugre": LUGRE,
    "dahl": [*LUGRE, "friction.law=dahl"],
    "ageing": ["friction.law=ageing", *STATE],
    "slip": ["friction.law=slip", *STATE],
}


def rig(law: str, *more: str) -> Scene:
    return scene("rig", **parse_changes([*LAWS[law], *more]))


def test_parameters_have_units():
    friction = rig("lugre").friction
    assert friction.memory_parameters() == {
        "s0": 15e3,
        "s1": 60.0,
        "s2": 0.0,
        "Fc": 0.6,
        "Fs": pytest.approx(1.379, abs=1e-3),
        "v_s": 0.1,
    }
    assert rig("ageing").friction.memory_parameters()["D"] == 2e-3


def test_another_law_drops_the_parameters_of_a_memory():
    changed = scene(rig("lugre"), **{"friction.law": 5})
    assert changed.friction.model_extra == {}
    formula = scene(rig("lugre"), **{"friction.formula": "Fs - b*s", "friction.b": 0.1})
    assert formula.friction.model_extra == {"b": 0.1}


@pytest.mark.parametrize(("law", "speed"), [*((law, 0.22) for law in LAWS), ("ageing", -0.22)])
def test_the_cycle_is_the_one_that_a_long_motion_settles_on(law, speed):
    changed = scene(rig(law, "belt.start=0"), scatter=None, **{"belt.speed": speed})
    orbit = rig_sim.cycle(changed)
    player = ScenePlayer(changed)
    player.events = []
    t, x, _, _ = player.columns(np.arange(12_501) / 500)
    slips = [event for event in player.events if event.t > 15.0 and event.kind[0] == "S"]
    assert orbit.outcome == "cycle"
    assert orbit.sequence == ("NS" if speed > 0 else "PS")
    assert orbit.period == pytest.approx(slips[-1].t - slips[-2].t, rel=1e-4)
    assert orbit.t_stick + orbit.t_slip == pytest.approx(orbit.period)
    assert orbit.x_slip == pytest.approx(slips[-1].x, abs=1e-5)
    last = x[t > 25.0 - orbit.period]
    assert (orbit.x_min, orbit.x_max) == pytest.approx((last.min(), last.max()), abs=2e-5)


@pytest.mark.parametrize("law", ["ageing", "slip"])
@pytest.mark.parametrize(("m", "speed"), [(0.3, 0.22), (1e-6, 1e-3), (2.0, 0.01)])
def test_steady_sliding_loses_its_stability_at_the_critical_stiffness(law, m, speed):
    """k_c = (b - a)/D (1 + m v^2/(a D)): J. Rice, A. Ruina, J. Appl. Mech. 50 (1983) 343, eq. 23."""
    critical = (0.105 - 0.03) / 2e-3 * (1.0 + m * speed**2 / (0.03 * 2e-3))
    for share, stable in ((0.999, False), (1.001, True)):
        changes = {"mass.m": m, "belt.speed": speed, "spring.k": share * critical}
        assert rig_sim.fixed_point(scene(rig(law), **changes)).stable is stable


@pytest.mark.parametrize(("share", "outcome"), [(0.8, "cycle"), (1.25, "fixed point")])
def test_a_spring_stiffer_than_the_critical_one_ends_stick_slip(share, outcome):
    changes = {"mass.m": 0.001, "belt.speed": 1e-3, "spring.k": share * 37.5, "friction.F0": 12.0}
    assert rig_sim.cycle(scene(rig("slip"), **changes)).outcome == outcome


def test_the_board_counts_the_motion_and_sends_the_truth():
    changed = rig("ageing", "belt.channel=true", "output.truth=true", "scatter.Fs=0.05")
    board = SimulatedBoard(changed)
    board.write(b"R 1000\nS\n")
    assert len(board.samples(3000)) > 30_000
    player = ScenePlayer(changed)
    path = player.follow(np.arange(3000) / 1000.0, forces=True)
    nodes, samples = path.nodes, path.samples
    assert len(samples) == 3000
    assert len({flow.factor for _, flow in path.flows}) > 2
    accelerations = np.gradient(nodes.v[samples], nodes.t[samples])
    balance = changed.mass.m * accelerations + changed.spring.k * nodes.x[samples]
    assert np.median(np.abs(path.F - balance)) < 1e-4


@pytest.mark.parametrize("law", ["lugre", "ageing"])
def test_a_long_motion_goes_on_in_compiled_code(monkeypatch, law):
    expected = rig_sim.run(rig(law), 4.0, 200)
    monkeypatch.setattr(play, "INTERPRETED_STEPS", 300)
    found = rig_sim.run(rig(law), 4.0, 200)
    assert found.x == pytest.approx(expected.x, abs=1e-9)
    assert found.F == pytest.approx(expected.F, abs=1e-6)
    assert len(rig_sim.events(rig(law), 4.0).events) >= 4


@pytest.mark.parametrize("law", LAWS)
def test_a_motion_of_one_sample_ends(law):
    """It was played for ever: a phase of no time stored no sample."""
    assert rig_sim.run(rig(law), 0.001, 100).samples == 1
