"""Dither: the threshold by formula and by simulation, and the motion that is left."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from rig_sim.analyses.control.dither import quench, sample_positions, threshold
from rig_sim.cli import app as cli
from rig_sim.flow.flow import Flow
from rig_sim.friction.curve import CONSTANT
from stickslip.console import application

from ...shared import CHAPTERS, answer, settings

REFERENCE = CHAPTERS["chapter6"]["dither"]


def test_the_threshold_is_that_of_the_swing_of_a_mass_and_a_spring():
    """By a general solver: the speed of spring, mass and damper alone under a drive at the threshold."""
    flow = Flow(m=1.4, k=2.3, c=0.3, v_belt=0.21, omega=7.0)
    u0 = threshold(flow)

    def field(t, y):
        return [y[1], (u0 * math.cos(flow.omega * t) - flow.c * y[1] - flow.k * y[0]) / flow.m]

    last = solve_ivp(field, (0.0, 200.0), [0.0, 0.0], method="DOP853", rtol=1e-10, t_eval=np.linspace(195, 200, 5000))
    assert last.y[1].max() == pytest.approx(flow.v_belt, rel=1e-5)
    assert threshold(Flow(v_belt=0.085, omega=10.0)) == pytest.approx(0.085 * 99.0 / 10.0, rel=1e-14)


def test_a_drive_too_slow_to_follow_leaves_the_swings_out(capsys):
    """They were printed as nan."""
    assert application.run(cli.app, "quench forced --set drive.omega=1e-4".split()) == 0
    shown = capsys.readouterr().out
    assert shown.startswith("step limit:")
    assert "peak to peak of x -; without the drive -\n" in shown


@pytest.mark.parametrize(
    "case",
    [REFERENCE["checked"][0], *(pytest.param(case, marks=pytest.mark.slow) for case in REFERENCE["checked"][1:])],
    ids=str,
)
def test_the_cases_of_the_reference(case):
    changes = f"belt.speed={case['v_dr']}", f"drive.omega={case['w']}"
    if "below" in case:
        below = answer("quench forced", *settings(*changes, f"drive.u0={case['below']}"))
        assert (below["outcome"], below["quenched"]) == ("not quenched", False)
    above = answer("quench forced", *settings(*changes, f"drive.u0={case.get('above', case.get('quenched'))}"))
    assert (above["outcome"], above["quenched"]) == ("quenched", True)
    assert above["threshold"] == pytest.approx(case["v_dr"] * (case["w"] ** 2 - 1) / case["w"], rel=1e-12)
    assert above["swing"] == pytest.approx(2.0 * above["threshold"] * above["ratio"] / case["w"] ** 2, rel=0.03)


@pytest.mark.parametrize(
    ("flow", "tolerance"),
    [
        pytest.param(Flow(v_belt=0.085, omega=20.0), 0.01, marks=pytest.mark.slow),
        (Flow(v_belt=0.085, omega=10.0), 0.022),  # the falling friction makes the swing smaller
        pytest.param(Flow(v_belt=-0.5, omega=20.0, c=0.05), 0.005, marks=pytest.mark.slow),
        pytest.param(Flow(m=0.3, k=10.6, Fs=1.38, gamma=9.6, v_belt=0.22, omega=150.0), 0.005, marks=pytest.mark.slow),
    ],
)
def test_the_simulated_threshold_is_that_of_the_formula(flow, tolerance):
    found = quench(flow._replace(u0=threshold(flow)), 0.0, 0.0)
    assert found.simulated_threshold == pytest.approx(found.threshold, rel=tolerance)
    assert found.simulated_threshold == pytest.approx(found.threshold_with_slope, rel=0.004)


@pytest.mark.parametrize(
    ("flow", "outcome"),
    [
        (Flow(v_belt=0.5, omega=20.0, u0=1.0, c=0.7), "nothing to quench"),  # the damper is enough
        (Flow(v_belt=0.5, omega=20.0, u0=1.0, curve=CONSTANT), "nothing to quench"),  # no stick-slip
        (Flow(v_belt=0.0, omega=20.0, u0=1.0), "nothing to quench"),
        (Flow(v_belt=0.085, omega=5.0, u0=0.0), "no drive"),
        (Flow(v_belt=0.085, omega=1.0, u0=0.2), "not quenched"),  # at resonance
        (Flow(v_belt=0.085, omega=0.3, u0=0.2), "not quenched"),  # repeats with the drive, but sticks
        (Flow(v_belt=0.085, omega=1.0, u0=2.0), "growing"),
    ],
)
def test_every_drive_has_a_named_outcome(flow, outcome):
    found = quench(flow, 0.0, 0.0)
    assert (found.outcome, found.quenched) == (outcome, False)


def test_positions_are_those_of_the_linear_motion_where_the_mass_slides():
    flow = Flow(v_belt=2.0, curve=CONSTANT, omega=3.0, u0=0.4)
    times = np.linspace(0.0, 5.0, 11)
    swing = 0.4 / (1.0 - 9.0)
    expected = 1.0 + (0.2 - 1.0 - swing) * np.cos(times) + swing * np.cos(3.0 * times)
    assert sample_positions(flow, 0.2, 0.0, times) == pytest.approx(expected, abs=1e-12)
