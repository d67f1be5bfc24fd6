"""Shaker: small oscillations have the phasor's frequency and growth, the fixed point stays, and the thesis agrees."""

import cmath
import math

import numpy as np
import pytest

from rig_sim.analyses.control.shaker import phasor
from rig_sim.analyses.limit_cycles.fixed_point import friction_at_rest
from rig_sim.analyses.limit_cycles.limit_cycle import cycle
from rig_sim.effects.shaker import add_shaker
from rig_sim.flow.flow import Flow
from rig_sim.motion.play import ScenePlayer, events
from rig_sim.scenes.model import Scene
from rig_sim.scenes.scene import scene
from rig_sim.scenes.sections import Start

V, GAMMA = 0.5, 3.0
REST = 1 / (1 + GAMMA * V)
SLOPE = GAMMA / (1 + GAMMA * V) ** 2


def shaken(a: float, phi: float, base: str = "base", **changes: object) -> Scene:
    return scene(base, **{"shaker.a": a, "shaker.phi": phi, **changes})


def thesis_formula(m: float, k: float, S: float, a: float, phi: float) -> complex:
    """Return Omega of (6.13), written out."""
    E = a * cmath.exp(-1j * phi)
    return cmath.sqrt(k / m - (S + E) ** 2 / (4 * m**2)) + 1j * (S + E) / (2 * m)


def measured_omega(shaker: Scene, x_rest: float, span: float, size: float) -> complex:
    """Return Omega of small motions about ``x_rest``: eigenvalues of what ``span`` seconds do to them, size -> 0."""

    def turned(reach: float) -> np.ndarray:
        columns = []
        for dx, dv in ((reach, 0.0), (0.0, reach)):
            ends = []
            for sign in (1, -1):
                start = Start(x=x_rest + sign * dx, v=sign * dv)
                motion = ScenePlayer(shaker.model_copy(update={"start": start}))
                assert motion.advance(span)
                ends.append(np.array([motion.x, motion.v]))
            columns.append((ends[0] - ends[1]) / (2 * reach))
        return np.array(columns).T

    matrix = (4 * turned(size) - turned(2 * size)) / 3  # even orders of the size cancel, the cubic one goes here
    grown = np.linalg.eigvals(matrix)
    z = np.log(grown[np.argmax(grown.imag)].astype(complex)) / span  # z = i omega + delta, |omega span| < pi
    return complex(z.imag, z.real)


@pytest.mark.parametrize(
    ("a", "phi"),
    [
        (0.3, 3.14159),
        (0.6, math.pi),
        (0.6, 2.2),
        (0.5, 0.969 * math.pi),
        (0.5, 4.4),
        (0.3, 1.2),
        (0.4, 0.0),
        (1.5, 2.6),
    ],
)
@pytest.mark.parametrize("damping", [0.0, 0.18])
def test_a_small_oscillation_has_the_phasors_frequency_and_growth(a: float, phi: float, damping: float) -> None:
    expected = thesis_formula(1.0, 1.0, SLOPE - damping, a, phi)
    found = measured_omega(shaken(a, phi, **{"damper.c": damping}), REST, 1.0, 1e-4)
    assert found == pytest.approx(expected, abs=1e-9)
    assert phasor(1.0, 1.0, SLOPE - damping, a, phi) == pytest.approx(expected, abs=1e-15)


@pytest.mark.parametrize("law", range(1, 7))
def test_on_the_rig_it_is_the_phasors_too_under_every_law_either_way(law: int) -> None:
    speed, m, k, Fs = 0.22, 0.3, 10.5552, 1.379353536
    s = speed - (0.03 if law in (2, 4, 6) else 0.0)
    level, slope = {
        1: (Fs, 0.0),
        3: (Fs - 0.6 * s, 0.6),
        5: (Fs / (1 + 9.618 * s), Fs * 9.618 / (1 + 9.618 * s) ** 2),
    }[law - (law + 1) % 2]
    for sign in (1, -1):
        changes: dict[str, object] = {"friction.law": law, "belt.speed": sign * speed, "belt.start": 0}
        rig = shaken(0.8, 2.4, "rig", **changes, **{"damper.c": 0.1, "spring.x0": 0.01})
        expected = thesis_formula(m, k, slope - 0.1, 0.8, 2.4)
        found = measured_omega(rig, 0.01 + sign * level / k, 0.2, 1e-5)
        assert found == pytest.approx(expected, abs=3e-9 * abs(expected))


def test_inside_a_ramp_the_slope_is_the_ramps() -> None:
    ramp = shaken(0.5, 2.2, **{"friction.law": 6, "friction.G_stick": -1.5, "belt.speed": 0.1})
    found = measured_omega(ramp, 0.15, 0.2, 1e-4)  # F = 1.5 x 0.1
    assert found == pytest.approx(thesis_formula(1.0, 1.0, -1.5, 0.5, 2.2), abs=1e-9)


@pytest.mark.parametrize(("law", "fraction"), [(1, 0.1), (3, 0.1), (5, 0.05), (6, 0.02)])
def test_a_drooping_belt_makes_the_slope_steeper_and_the_shaker_knows(law: int, fraction: float) -> None:
    drooping = shaken(0.5, 2.2, **{"friction.law": law, "droop.fraction": fraction})
    bare = drooping.model_copy(update={"shaker": None}).flow()
    F, slope = friction_at_rest(bare)
    found = measured_omega(drooping, F, 1.0, 1e-4)
    assert found == pytest.approx(thesis_formula(1.0, 1.0, slope, 0.5, 2.2), abs=1e-9)
    resting = measured_omega(drooping.model_copy(update={"shaker": None}), F, 1.0, 1e-4)
    assert resting == pytest.approx(thesis_formula(1.0, 1.0, slope, 0.0, 0.0), abs=1e-9)


@pytest.mark.parametrize("phi", [2.2, 3.14159, math.pi, 4.0])
def test_the_fixed_point_does_not_move(phi: float) -> None:
    still = shaken(0.9, phi, **{"start.x": REST + 1e-3})
    motion = ScenePlayer(still)
    motion.advance(3000.0)
    assert motion.x == pytest.approx(REST, abs=3e-14)
    assert motion.v == pytest.approx(0.0, abs=3e-14)
    assert cycle(shaken(4.0, math.pi)).x_rest == pytest.approx(REST, abs=1e-14)


def test_the_slip_point_is_where_spring_damper_and_shaker_together_reach_fs() -> None:
    flow = shaken(0.5, 2.5).flow()
    found = cycle(shaken(0.5, 2.5))
    assert found.outcome == "cycle"
    assert found.x_slip is not None
    assert flow.k * (found.x_slip - flow.x0) == pytest.approx(1.0 - flow.c * V, abs=1e-14)
    assert flow.k > 1 > flow.c > 0
    onsets = [event.x for event in events(shaken(0.5, 2.5), 60.0).events if event.kind == "S>N"]
    assert len(onsets) > 5
    np.testing.assert_allclose(onsets, found.x_slip, atol=1e-14)


def test_the_shaker_waits_for_the_belt_and_follows_the_factor_on_friction() -> None:
    late = shaken(0.8, 2.4, "rig", **{"scatter.Fs": 0.2})
    assert late.flow(belt_running=False) == late.model_copy(update={"shaker": None}).flow(belt_running=False)
    motion = ScenePlayer(late)
    motion.advance(0.4)
    assert motion.flow.k == 10.5552
    motion.advance(5.0)
    assert motion.flow.factor != 1.0
    assert motion.flow == late.flow(factor=motion.flow.factor)
    F, slope = friction_at_rest(late.model_copy(update={"shaker": None}).flow(factor=motion.flow.factor))
    assert motion.flow.x0 + F / motion.flow.k == pytest.approx(F / 10.5552, rel=1e-13)
    Omega = thesis_formula(0.3, 10.5552, slope, 0.8, 2.4)
    assert motion.flow.k == pytest.approx(0.3 * abs(Omega) ** 2, rel=1e-13)


def test_a_mass_without_friction_is_shaken_all_the_same() -> None:
    bare = Flow(Fs=0.0, c=0.1)
    assert friction_at_rest(bare) == (0.0, 0.0)
    Omega = thesis_formula(1.0, 1.0, -0.1, 0.2, 1.0)
    flow = add_shaker(bare, 0.2, 1.0)
    assert (flow.c, flow.k, flow.x0) == pytest.approx((-2 * Omega.imag, abs(Omega) ** 2, 0.0), abs=1e-14)


@pytest.mark.parametrize(
    ("changes", "last"),
    [
        (
            {"wear.rate": -0.02},
            200.0,
        ),  # it runs in until its slope alone is steeper than the oscillation can be
        ({"wear.rate": -0.1, "belt.start": 30.0, "start.x": 3.0}, 30.0),  # by landings before the shaker is switched on
    ],
)
def test_friction_that_leaves_nothing_to_tune_to_ends_the_run_by_name(changes: dict[str, object], last: float) -> None:
    found = events(shaken(0.1, 3.0, **{"belt.speed": 0.1, **changes}), 200.0)
    assert found.outcome == "shaker out of tune"
    assert "creep" in found.advice
    assert len(found.events) > 2
    assert found.events[-1].t < last


@pytest.mark.parametrize("phi", [math.pi, 3.14159, 3.141593, 0.0])
def test_a_phase_of_pi_as_people_write_it_is_a_damper_even_where_the_mass_would_creep(phi: float) -> None:
    flow = shaken(5.0, phi).flow()
    assert flow.c == pytest.approx(5.0 * -math.cos(phi), abs=1e-9)
    assert (flow.k, flow.x0) == (1.0, 0.0)


@pytest.mark.parametrize(("law", "a", "phi"), [(1, 3.0, 0.0), (5, 3.0, 0.0), (5, 20.0, 0.0), (6, 20.0, 0.0)])
def test_a_motion_that_grows_without_end_ends_by_name(law: int, a: float, phi: float) -> None:
    # It used to be a division by zero in the hyperbola's Taylor step.
    runaway = shaken(a, phi, **{"friction.law": law})
    assert events(runaway, 1000.0).outcome == "not finite"
    found = cycle(runaway)
    assert found.outcome == "no cycle"
    assert "grows" in found.advice
