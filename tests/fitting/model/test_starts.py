"""Starting values that no fit shows: levels that can be followed, and curves of the same friction."""

from dataclasses import replace

import numpy as np
import pytest

from fitting.model import problem
from fitting.model.unknowns import Values
from fitting.record import cycles
from rig_sim.friction.curve import CONSTANT, magnitude
from stickslip.units import Measured


def test_no_start_has_a_level_beyond_the_observed_break_aways(motion_of):
    """With noise in the acceleration and no datum, gamma used to end at the largest value tried, 300 over the speed."""
    motion = motion_of(law=5)
    cut = cycles.segment_cycles(motion)
    rng = np.random.default_rng(1)
    slope = 2.0 * np.exp((motion.velocity - motion.belt_speed) / 0.02)  # steeper near rest than any hyperbola
    noisy = replace(motion, acceleration=motion.acceleration + slope + 0.3 * rng.standard_normal(motion.time.size))
    start, _ = problem.regress_start(noisy, cut, problem.HYPERBOLIC, False, Measured(0.02, 0.2))
    assert start.datum + start.F / start.K < problem.break_away_position(motion, cut) + 0.1 * motion.travel
    assert start.shape < 60.0


@pytest.mark.parametrize(
    ("curve", "shape", "static"),
    [
        (CONSTANT, 0.0, 1.5),
        (problem.LINEAR, 3.0, 1.5),
        (problem.HYPERBOLIC, 3.0, 1.5),
        # the level was found by iteration, and came out negative: `ValueError: math domain error`
        (problem.HYPERBOLIC, 80.0, 0.7),
    ],
)
def test_another_break_away_level_leaves_slip_and_stick_as_they_are(curve, shape, static):
    p = Values(35.0, 4.6, 0.22, shape, 0.03)
    raised = problem.with_static(curve, p, static)
    assert raised.F > 0
    assert raised.static * raised.F / raised.d == pytest.approx(p.F / p.d)
    w = np.array([0.08, 0.2])
    friction = [magnitude(curve, w - q.d, q.F, q.shape * q.F, q.shape) for q in (p, raised)]
    assert friction[0] == pytest.approx(friction[1])
