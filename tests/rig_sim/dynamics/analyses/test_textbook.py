"""Textbook systems through attractors, exponents and sweeps: answers that are known without a belt."""

import itertools
import math

import numpy as np
import pytest

from rig_sim.analyses.exponent import exponent, rotation_number
from rig_sim.analyses.settling import find_attractors, settle
from rig_sim.analyses.sweep import sweep

from ..textbook import BouncingBall, Circle, Logistic, OnInterval


def moved(f, start=None):
    return f.motion(f.start if start is None else np.array(start))


# Beginnings of periods 1, 2, 4, 8 and 16 of the logistic map and their limit; values between them.
DOUBLINGS = (1.0, 3.0, 3.449489743, 3.544090360, 3.564407266, 3.568759420)


def test_the_sweep_of_the_logistic_map_doubles_its_period_where_feigenbaum_says():
    for period, (first, last) in zip((1, 2, 4, 8, 16), itertools.pairwise(DOUBLINGS), strict=True):
        values = [first + 0.1 * (last - first), last - 0.1 * (last - first)]
        rows = sweep(lambda r: find_attractors(Logistic(r), [np.array([0.3])], r), values)
        assert [(row.drive_periods, len(row.points)) for row in rows] == [(period, period)] * 2
    assert settle(moved(Logistic(3.9))).period is None


def test_starts_on_one_attractor_share_it_and_two_attractors_stay_apart():
    chaos = find_attractors(Logistic(3.9), [np.array([start]) for start in (0.1, 0.2, 0.33)], 3.9)
    assert [(row.share, row.drive_periods) for row in chaos] == [(1.0, None)]
    wells = OnInterval(lambda x: 1.5 * x - 0.5 * x**3, -1.2, 1.2)
    rows = find_attractors(wells, [np.array([side]) for side in (1.0, -1.0, 1.1)], 0.0)
    assert [(row.share, row.drive_periods) for row in rows] == [(pytest.approx(2 / 3), 1), (pytest.approx(1 / 3), 1)]


def test_an_orbit_approached_from_both_sides_has_period_one():
    """Beside a period doubling every second point used to come back before every point did."""
    assert settle(moved(Logistic(2.985))).period == 1


def test_rotation_numbers_of_the_circle_map():
    golden = 0.5 * (math.sqrt(5.0) - 1.0)
    free = moved(Circle(golden, 0.0))
    assert rotation_number(free.follow(200)) == pytest.approx(golden, abs=1e-14)
    assert exponent(moved(Circle(golden, 0.0)), 100).exponent == 0.0
    locked = moved(Circle(0.5, 0.9))  # in the tongue of 1/2
    assert settle(locked).period == 2
    assert rotation_number(locked.follow(500)) == pytest.approx(0.5, abs=1e-12)
    # K = 1, turn = 0.60666: the golden mean (Shenker 1982), where the exponent is 0
    assert rotation_number(moved(Circle(0.6066610635, 1.0)).follow(20_000)) == pytest.approx(golden, abs=1e-6)


def test_the_bouncing_ball_locks_and_becomes_chaotic():
    # the fixed point: speed 2 pi, with (1 - e) 2 pi = A cos(phase); stable for 0 < A sin(phase) < 2 (1 + e)
    e = 0.5
    for A, period in ((3.3, 1), (4.5, 2)):
        phase = math.acos((1.0 - e) * 2.0 * math.pi / A)
        assert (A * math.sin(phase) < 2.0 * (1.0 + e)) is (period == 1)
        assert settle(moved(BouncingBall(e, A), (phase + 0.01, 2.0 * math.pi))).period == period
    found = exponent(moved(BouncingBall(e, 12.0), (0.3, 6.0)), 2000)
    assert found.exponent > 10.0 * found.stderr > 0.0
