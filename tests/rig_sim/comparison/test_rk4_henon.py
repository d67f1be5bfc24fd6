"""The thesis's method: order four in its event times, and the exact kernel's list of events."""

import math
from functools import partial

import pytest

from rig_sim.comparison.rk4_henon import make_rk4_solver
from rig_sim.comparison.stepping import sample_phase
from rig_sim.integrate.events import list_events
from rig_sim.motion.play import play_events
from rig_sim.scenes.scene import scene


def base(law, **changes):
    return scene("base", **{"friction.law": law}, **changes)


def rk4_events(played, until, *, step, max_steps=10_000_000):
    return play_events(played, until, partial(sample_phase, make_rk4_solver(step)), max_steps=max_steps)


def error(played, step, t_max=20.0):
    exact = list_events(played.flow(), 0.0, 0.0, t_max)
    found = rk4_events(played, t_max, step=step)
    assert found.kinds == exact.kinds
    assert len(found.t) >= 4
    return max(abs(a - b) for a, b in zip(found.t, exact.t, strict=True))


@pytest.mark.parametrize("law", [3, 4, 5, 6])
@pytest.mark.parametrize(
    "changes", [{}, {"belt.speed": -0.5, "damper.c": 0.02}, {"drive.u0": 0.1, "drive.omega": 0.7}], ids=str
)
def test_event_times_converge_with_the_fourth_power_of_the_step(law, changes):
    played = base(law, **changes)
    steps = [0.02, 0.01, 0.005]
    errors = [error(played, step) for step in steps]
    order = math.log(errors[0] / errors[2]) / math.log(steps[0] / steps[2])
    assert 3.5 < order < 5.0
    assert errors[2] < 1e-7


def test_first_stick_of_law_1_is_the_closed_form():
    found = rk4_events(base(1), 3.0, step=0.001)
    assert found.t == pytest.approx((math.pi / 6, math.pi / 6 + math.sqrt(3)), abs=1e-12)


def test_force_reversal_and_the_step_limit_are_named_outcomes():
    reversing = base(3, **{"friction.G_slip": 1.0, "start.x": 0.9, "start.v": 0.5})
    assert rk4_events(reversing, 100.0, step=0.01).outcome == "force reversal"
    assert rk4_events(base(5), 100.0, step=0.01, max_steps=50).outcome == "step limit"


@pytest.mark.parametrize("step", [0.0, -0.1, math.nan])
def test_a_step_that_is_not_positive_is_refused(step):
    with pytest.raises(ValueError, match="step is"):
        rk4_events(base(5), 1.0, step=step)
