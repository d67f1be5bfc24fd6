"""Scenes with a friction formula: motion and analyses are those of the curve, and faults name file and key."""

import math
import tomllib
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from rig_sim.analyses.limit_cycles.fixed_point import fixed_point
from rig_sim.analyses.limit_cycles.floquet import floquet
from rig_sim.analyses.limit_cycles.limit_cycle import cycle
from rig_sim.flow.reach import largest_slip_speed
from rig_sim.friction.curve import LINEAR, MEASURED
from rig_sim.motion.play import ScenePlayer, events
from rig_sim.scenes.model import Scene
from rig_sim.scenes.scene import parse_changes, scene

HYPERBOLA = "Fs/(1 + gamma*s)"
STRIBECK = {
    "friction.formula": "Fc + (Fs - Fc)*exp(-(s/v_s)**2) + b*s",
    "friction.Fc": 0.6,
    "friction.v_s": 0.15,
    "friction.b": 0.02,
}
LOGARITHMIC = {"friction.formula": "Fs - fall*log(1 + s/v0)", "friction.fall": 0.08, "friction.v0": 0.01}


def written(folder: Path, friction: str) -> Path:
    path = folder / "mine.toml"
    path.write_text(f"[mass]\nm = 1.0\n[spring]\nk = 1.0\n[belt]\nspeed = 0.5\n[friction]\n{friction}\n")
    return path


@pytest.mark.parametrize(
    ("name", "law", "text", "changes", "until", "allowed"),
    [
        ("base", 3, "Fs - G_slip*s", {}, 200.0, 1e-14),  # the closed form of law 3 itself
        ("base", 5, HYPERBOLA, {}, 200.0, 1e-8),  # measured: 4.7e-9
        ("base", 5, HYPERBOLA, {"friction.static": 1.3, "belt.speed": -0.4}, 200.0, 1e-7),
        ("base", 6, HYPERBOLA, {"friction.d": 0.2}, 200.0, 1e-7),  # measured: 2e-9
        ("forced", 5, HYPERBOLA, {"drive.omega": 0.3}, 100.0, 1e-7),
        ("rig", 5, HYPERBOLA, {}, 20.0, 1e-7),
    ],
)
def test_a_law_written_as_a_formula_has_the_events_of_the_law(
    name: str, law: int, text: str, changes: dict[str, object], until: float, allowed: float
) -> None:
    expected = events(scene(name, **{"friction.law": law, **changes}), until)
    found = events(scene(name, **{"friction.formula": text, **changes}), until)
    assert found.outcome == expected.outcome == "completed"
    assert len(expected.events) >= 10
    assert [event.kind for event in found.events] == [event.kind for event in expected.events]
    assert max(abs(a.t / b.t - 1.0) for a, b in zip(found.events, expected.events, strict=True)) < allowed


def stribeck(s: float) -> float:
    return 0.6 + 0.4 * math.exp(-((s / 0.15) ** 2)) + 0.02 * s


def logarithmic(s: float) -> float:
    return 1.0 - 0.08 * math.log1p(s / 0.01)


@pytest.mark.parametrize(("changes", "friction"), [(STRIBECK, stribeck), (LOGARITHMIC, logarithmic)])
def test_the_cycle_is_that_of_an_independent_integration(changes: dict[str, object], friction: object) -> None:
    """The oracle shares nothing with rig_sim: DOP853 through one slip, and the stick in closed form."""
    belt = 0.5

    def rates(_: float, y: np.ndarray) -> list[float]:
        return [y[1], friction(max(belt - y[1], 0.0)) - y[0]]

    def lands(t: float, y: np.ndarray) -> float:
        return y[1] - belt if t > 0.1 else -1.0

    lands.terminal, lands.direction = True, 1.0
    # slip begins where friction is largest, k x = Fs = 1, at the belt's speed; its acceleration is then 0
    slip = solve_ivp(
        rates, (0.0, 20.0), [1.0, belt], method="DOP853", events=lands, rtol=1e-13, atol=1e-14, dense_output=True
    )
    t_slip, x_landing = float(slip.t_events[0][0]), float(slip.y_events[0][0][0])
    found = cycle(scene("base", **changes).flow())
    assert found.outcome == "cycle"
    assert found.t_slip == pytest.approx(t_slip, rel=1e-7)
    assert found.x_stick == pytest.approx(x_landing, abs=1e-8)
    assert found.period == pytest.approx(t_slip + (1.0 - x_landing) / belt, rel=1e-8)
    x, v = slip.sol(np.linspace(0.0, t_slip, 100_001))
    assert found.v_min == pytest.approx(v.min(), rel=1e-6)
    # a cubic begins at the belt's speed, where the mass turns
    assert (found.x_min, found.x_max) == pytest.approx((x.min(), x.max()), abs=1e-8)


def test_orbit_and_eigenvalues_of_a_formula_are_those_of_the_law() -> None:
    both = [scene("damped", **friction).flow() for friction in ({"friction.law": 5}, {"friction.formula": HYPERBOLA})]
    assert fixed_point(both[1]).x == pytest.approx(fixed_point(both[0]).x, rel=1e-8)
    assert fixed_point(both[1]).eigenvalues == pytest.approx(fixed_point(both[0]).eigenvalues, rel=1e-4)
    known, found = (floquet(flow, "unstable") for flow in both)
    assert found.outcome == known.outcome
    assert found.period == pytest.approx(known.period, rel=1e-6)
    assert found.multipliers[1] == pytest.approx(known.multipliers[1], rel=1e-4)


@pytest.mark.parametrize("changes", [{}, {"start.x": 3.0}, {"start.v": -2.0}, {"belt.speed": 2.0}, {"damper.c": 0.3}])
def test_no_motion_is_faster_than_energy_allows(changes: dict[str, float]) -> None:
    for friction in ({"friction.law": 5}, {"friction.law": 1}, {"friction.law": 3}):
        played = scene("base", **friction, **changes)
        flow = played.flow()
        _, _, v, _ = ScenePlayer(played).columns(np.linspace(0.0, 60.0, 6001))
        start = (flow.m, flow.k, flow.c, flow.v_belt, flow.Fs, played.start.x - flow.x0, played.start.v)
        bound = largest_slip_speed(*start)
        assert np.abs(v - flow.v_belt).max() <= bound
        assert bound < 4.0 * np.abs(v - flow.v_belt).max()  # and it is no wild guess


def test_a_motion_that_leaves_the_formula_ends_with_that_outcome() -> None:
    """At resonance a drive feeds in more energy than spring, belt and friction allow."""
    resonant = {"drive.u0": 6.0, "drive.omega": 1.0, "belt.speed": 0.5}
    played = scene("base", **{"friction.formula": "Fs*exp(-s)", **resonant})
    flow = played.flow()
    end = flow.table[5 * flow.pieces + 1]
    found = events(played, 2000.0)
    assert found.outcome == "end of the curve"
    assert "friction.formula" in found.advice
    player = ScenePlayer(played)
    player.advance(2000.0)
    assert abs(player.v - flow.v_belt) == pytest.approx(end, rel=1e-12)
    assert fixed_point(flow._replace(u0=0.0, v_belt=1.1 * end)).outcome == "end of the curve"


def test_scatter_belt_start_and_a_ramp_stand_beside_a_formula() -> None:
    lively = scene("rig", **{**STRIBECK, "friction.Fc": 0.8, "friction.Fs": 1.4, "friction.v_s": 0.05})
    assert lively.friction is not None
    assert lively.friction.level() == pytest.approx(1.4, rel=1e-15)
    assert not lively.flow().ramp  # the rig's d is that of its laws with a ramp
    found = events(lively, 20.0)
    assert found.outcome == "completed"
    breaks = [event.x for event in found.events if event.kind == "S>N"][1:]
    assert np.std(breaks) == pytest.approx(0.03 * 1.4 / lively.spring.k, rel=0.5)
    ramp = scene("base", **STRIBECK, **{"friction.d": 0.1}).flow()
    assert (ramp.ramp, ramp.d, ramp.curve) == (1, 0.1, MEASURED)
    assert scene("base", **STRIBECK, **{"friction.G_stick": -5.0, "friction.static": 1.5}).flow().d == pytest.approx(
        0.3
    )
    assert not scene("base", **STRIBECK, **{"friction.d": 0.1, "friction.contact": "jump"}).flow().ramp


def test_a_file_states_formula_and_parameters(tmp_path: Path) -> None:
    text = 'formula = "Fc + (top - Fc)*exp(-s/v_s)"\nFc = 0.5\ntop = 1\nv_s = 0.1\nd = 0.02'
    found = scene(written(tmp_path, text))
    assert found.friction is not None
    assert found.friction.formula_values() == {"Fc": 0.5, "top": 1.0, "v_s": 0.1}
    assert found.flow().ramp
    assert scene(Scene.model_validate(found.model_dump(exclude_unset=True))).flow() == found.flow()
    assert scene(found, **{"friction.v_s": 0.2}).friction.formula_values()["v_s"] == 0.2
    assert tomllib.loads(text)["formula"] == found.friction.formula


def test_a_change_of_law_and_formula_replaces_the_other() -> None:
    formula = scene("base", **STRIBECK)
    back = scene(formula, **{"friction.law": 3})
    assert back.flow() == scene("base", **{"friction.law": 3}).flow()._replace(d=back.flow().d)
    assert back.flow().curve == LINEAR
    # the order of changes does not matter: what friction is comes first
    assert scene("base", **dict(reversed(STRIBECK.items()))).flow() == formula.flow()
    assert scene("base", friction={"Fc": 0.5, "formula": "Fc"}).flow().Fs == 0.5


def test_settings_of_a_command_line_carry_a_formula() -> None:
    plain = parse_changes(["friction.formula=Fc + (Fs - Fc)*exp(-s/v_s)", "friction.Fc=0.5", "friction.v_s=0.1"])
    quoted = parse_changes(['friction.formula="Fc + (Fs - Fc)*exp(-s/v_s)"', "friction.Fc=0.5", "friction.v_s=0.1"])
    assert plain == quoted
    assert scene("base", **plain).flow().curve == MEASURED
