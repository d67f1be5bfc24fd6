"""Starting values come within a few per cent, and corners do not pull gamma down."""

from dataclasses import replace

import numpy as np
import pytest

from fitting.model import problem
from fitting.model.unknowns import PerCycle, Values, to_array
from fitting.model.windows import ShootingWindows
from fitting.record import cycles
from rig_sim.friction.curve import magnitude
from stickslip.units import Measured

KNOWN = Measured(0.0, 5e-4)


@pytest.mark.parametrize(("law", "curve", "shape"), [(3, problem.LINEAR, 0.435), (5, problem.HYPERBOLIC, 9.618)])
def test_jump_laws_start_near_the_truth(motion_of, law, curve, shape):
    motion = motion_of(law=law)
    start, _ = problem.regress_start(motion, cycles.segment_cycles(motion), curve, False, KNOWN)
    assert start.K == pytest.approx(35.184, rel=0.01)
    assert start.v_dr == pytest.approx(0.22, rel=0.01)
    assert start.shape == pytest.approx(shape, rel=0.15)
    assert start.d == 0


def test_a_guide_that_is_not_there_is_none_in_the_regression(motion_of):
    motion = motion_of(law=5)
    cut = cycles.segment_cycles(motion)
    alone, none = problem.regress_start(motion, cut, problem.HYPERBOLIC, False, KNOWN)
    beside, size = problem.regress_start(motion, cut, problem.HYPERBOLIC, False, KNOWN, lambda v: -np.tanh(v / 0.003))
    assert none == 0
    assert abs(size) < 0.02 * alone.F
    assert beside.shape == pytest.approx(alone.shape, rel=0.1)


@pytest.mark.parametrize(("law", "curve"), [(4, problem.LINEAR), (6, problem.HYPERBOLIC)])
def test_a_ramp_is_read_off_the_slope_of_the_plateau(motion_of, law, curve):
    motion = motion_of(law=law)
    start, _ = problem.regress_start(motion, cycles.segment_cycles(motion), curve, True, KNOWN)
    assert start.d == pytest.approx(0.03, rel=0.1)
    assert start.v_dr == pytest.approx(0.22, rel=0.02)


def test_a_mass_that_overtakes_the_belt_starts_at_a_level_below_its_load(motion_of):
    """The level used to be the regression's in every pass: beside a larger Fs the mass could then overtake no more."""
    motion = motion_of(law=5)
    cut = cycles.segment_cycles(motion)
    overtaking = tuple(replace(cycle, overtakes=True) for cycle in cut.used)
    windows = ShootingWindows.from_cycles(motion, overtaking)
    for F in (3.5, 4.5):
        u = to_array(Values(35.184, F, 0.22, 9.618))
        level = F * np.exp(problem.cycle_starts(windows, [motion], overtaking, u)[:, PerCycle.NEXT_LEVEL])
        load = [-35.184 * np.interp(cycle.landing, motion.time, motion.position) for cycle in overtaking]
        assert level == pytest.approx(np.maximum(0.9 * np.array(load), 0.2 * F))


def test_no_slip_sample_lies_near_a_corner(motion_of):
    motion = motion_of(law=5)
    cut = cycles.segment_cycles(motion)
    assert problem.slip_samples(motion, cut).x.size < sum(
        cycle.landing - motion.time[cycle.slip[0]] for cycle in cut.used
    ) / 1e-3 - 2 * len(cut.used) * (motion.half_window / 1e-3 - 2)


def test_without_a_datum_the_rest_position_is_found_along(motion_of):
    motion = motion_of(law=5)
    loose = Measured(0.02, 0.2)
    start, _ = problem.regress_start(motion, cycles.segment_cycles(motion), problem.HYPERBOLIC, False, loose)
    assert start.datum == pytest.approx(0.0, abs=0.005)
    assert start.shape == pytest.approx(9.618, rel=0.2)


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


@pytest.mark.parametrize("other", [problem.LINEAR, problem.HYPERBOLIC])
@pytest.mark.parametrize("curve", [problem.LINEAR, problem.HYPERBOLIC])
def test_a_matched_curve_has_the_same_friction_at_two_speeds(curve, other):
    F, shape = problem.matched_curve(curve, other, 4.6, 1.1, 0.6)
    s = np.array([0.15, 0.45])
    assert magnitude(curve, s, F, shape * F, shape) == pytest.approx(magnitude(other, s, 4.6, 1.1 * 4.6, 1.1))


def test_the_scatter_of_the_levels_betrays_the_rest_position_under_a_linear_law(motion_of):
    motion = motion_of(law=3)
    loose = Measured(0.08, 0.08)
    start, _ = problem.regress_start(motion, cycles.segment_cycles(motion), problem.LINEAR, False, loose)
    assert start.datum == pytest.approx(0.0, abs=0.02)


@pytest.mark.parametrize(
    ("curve", "shape", "static"),
    [
        (problem.CONSTANT, 0.0, 1.5),
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
