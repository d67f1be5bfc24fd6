"""Ripple: a belt whose speed swings, held against closed forms and an independent solver."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from rig_sim.analyses.limit_cycles.limit_cycle import cycle
from rig_sim.motion.play import ScenePlayer, events
from rig_sim.scenes.scene import scene

HZ = 0.31
OMEGA = 2 * math.pi * HZ
RIPPLE: dict[str, object] = {"belt.ripple": 0.05, "belt.ripple_hz": HZ}


def test_in_stick_the_mass_goes_with_the_swinging_belt() -> None:
    start = 0.4
    rippling = scene("rig", **{"belt.start": start, "belt.ripple": 0.01, "belt.ripple_hz": 5.0, "scatter.Fs": 0})
    t = np.arange(0.45, 0.85, 0.01)
    path = ScenePlayer(rippling).follow(np.concatenate(([0.0], t)), forces=True)
    x, v = path.nodes.x[path.samples][1:], path.nodes.v[path.samples][1:]
    theta = 10 * math.pi * (t - start)
    stuck = np.abs(v - 0.22 - 0.01 * np.sin(theta)) < 1e-13
    assert stuck.sum() > 20
    travelled = np.diff(x[stuck] - (0.22 * t[stuck] - 0.01 / (10 * math.pi) * np.cos(theta[stuck])))
    np.testing.assert_allclose(travelled, 0.0, atol=1e-14)
    inertia = 0.3 * 0.01 * 10 * math.pi * np.cos(theta[stuck])
    np.testing.assert_allclose(path.F[1:][stuck], inertia + 10.5552 * x[stuck], rtol=1e-12)


@pytest.mark.parametrize("law", [2, 4, 6])
@pytest.mark.parametrize("belt", [0.5, -0.5])
def test_ramp_laws_on_a_rippling_belt_are_an_independent_solvers(law: int, belt: float) -> None:
    from rig_sim.friction.contact import force
    from rig_sim.friction.law import LAWS

    rippling = scene("base", **{"friction.law": law, "belt.speed": belt, "damper.c": 0.02, **RIPPLE})
    assert rippling.friction is not None
    parameters = rippling.friction.parameters()

    def motion(t: float, y: np.ndarray) -> tuple[float, float]:
        w = y[1] - belt - 0.05 * math.sin(OMEGA * t)
        return y[1], force(LAWS[law], w, **parameters) - 0.02 * y[1] - y[0]

    t = 0.1 * np.arange(401)
    expected = solve_ivp(motion, (0.0, 40.0), (0.0, 0.0), "LSODA", t_eval=t, rtol=1e-10, atol=1e-12, max_step=0.02)
    path = ScenePlayer(rippling).follow(t)
    np.testing.assert_allclose(path.nodes.x[path.samples], expected.y[0], atol=1e-6)
    np.testing.assert_allclose(path.nodes.v[path.samples], expected.y[1], atol=1e-5)


def test_the_slip_of_law_5_is_an_independent_solvers() -> None:
    rippling = scene("base", **{"start.x": 1.5, "start.v": 0.1, **RIPPLE})
    first = events(rippling, 20.0).events[0]

    def motion(t: float, y: np.ndarray) -> tuple[float, float]:
        w = y[1] - 0.5 - 0.05 * math.sin(OMEGA * t)
        return y[1], 1 / (1 - 3 * w) - y[0]

    def lands(t: float, y: np.ndarray) -> float:
        return float(y[1] - 0.5 - 0.05 * math.sin(OMEGA * t))

    lands.terminal = True  # type: ignore[attr-defined]
    expected = solve_ivp(motion, (0.0, 20.0), (1.5, 0.1), "DOP853", events=lands, rtol=2.3e-14, atol=1e-15)
    assert first.kind == "N>S"
    assert first.t == pytest.approx(expected.t_events[0][0], abs=1e-12)
    assert first.x == pytest.approx(expected.y_events[0][0][0], abs=1e-12)


def test_a_rippling_belt_drives_the_mass_and_has_no_orbit() -> None:
    assert cycle(scene("base", **RIPPLE)).outcome == "driven"
