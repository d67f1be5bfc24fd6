"""A measured friction curve (law 0): its spline, its motion against multi-precision, and every analysis on it."""

import math

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from rig_sim.analyses.limit_cycles.branches import continuation
from rig_sim.analyses.limit_cycles.limit_cycle import cycle
from rig_sim.analyses.settling import find_attractors
from rig_sim.comparison import reference
from rig_sim.flow.flow import Flow
from rig_sim.friction.spline import about, find_problem, piece_of, spline_table
from rig_sim.integrate.events import list_events
from rig_sim.scenes.scene import scene
from rig_sim.systems.driven import driven_map_with_starts
from rig_sim.systems.landing import LandingMap

SPEEDS = (0.0, 0.02, 0.05, 0.1, 0.17, 0.25, 0.35, 0.5, 0.7, 0.9, 1.2, 1.5, 1.8, 2.1)
HYPERBOLA = [[s, 1.0 / (1.0 + 3.0 * s)] for s in SPEEDS]
STRIBECK = [[s, 0.7 + 0.3 * math.exp(-((s / 0.2) ** 2)) + 0.05 * s] for s in SPEEDS]
CONCAVE = [[s, 0.75 + 0.25 * math.cos(min(s, 1.5) * math.pi / 1.5)] for s in np.linspace(0.0, 2.0, 16).tolist()]


def flow(curve: list[list[float]], **changes: float) -> Flow:
    """Return the base scene's flow with a measured curve; changes by section__key."""
    keys = {key.replace("__", "."): value for key, value in changes.items()}
    return scene("base", **{"friction.law": 0, "friction.curve": curve, **keys}).flow()


def test_the_spline_is_the_not_a_knot_cubic_and_goes_on_with_constant_slope() -> None:
    curve = [*STRIBECK[:4], *STRIBECK[-3:]]
    points = tuple((s, F) for s, F in curve)
    pieces, table = spline_table(points)

    def value(s: float) -> tuple[float, float]:
        return about(table, pieces, piece_of(table, pieces, s), s)[:2]

    rest = curve[0][1]
    places = (0.0, 0.01, 0.05, 0.3, 1.9, 2.0999)
    expected = CubicSpline(*np.transpose(curve), bc_type="not-a-knot")(places)
    for s, F in zip(places, expected.tolist(), strict=True):
        assert abs(rest * value(s)[0] - F) < 4e-15
    assert value(3.0)[1] == value(2.1)[1]
    assert value(3.0)[0] == pytest.approx(value(2.1)[0] + 0.9 * value(2.1)[1], rel=1e-15)
    # a spline with breaks of its own is such a curve when one more point stands in its first and its last piece
    assert pieces == len(points) - 2  # its intervals, less one at either end, and the line beyond


@pytest.mark.parametrize(
    ("curve", "changes", "until"),
    [
        (HYPERBOLA, {}, 100.0),
        (STRIBECK, {"friction__static": 1.4, "belt__speed": -0.3, "damper__c": 0.02}, 100.0),
        ([[0.0, 1.0], [0.5, 0.7], [1.5, 0.6]], {}, 100.0),
        (CONCAVE, {"drive__u0": 0.2, "drive__omega": 1.3}, 15.0),
        (STRIBECK, {"friction__contact": "ramp", "friction__d": 0.05}, 15.0),
    ],
)
def test_events_are_those_of_40_digits(curve: list[list[float]], changes: dict[str, float], until: float) -> None:
    moving = flow(curve, **changes)
    found = list_events(moving, 0.0, 0.0, until, every_cycle=True)
    expected = reference.events(moving, 0.0, 0.0, until)
    assert found.outcome == "completed"
    assert len(expected) > 3
    assert list(found.kinds) == [kind for _, kind, _ in expected]
    assert max(abs(float(t - at)) for t, (at, _, _) in zip(found.t, expected, strict=True)) < 1e-12
    assert max(abs(float(x - at)) for x, (_, _, at) in zip(found.x, expected, strict=True)) < 1e-12


def test_two_points_and_equal_points_are_laws_3_and_1() -> None:
    for curve, law, outcome in (
        ([[0.0, 1.0], [2.0, 0.9]], 3, "cycle"),
        ([[0.0, 1.0], [1.0, 1.0], [3.0, 1.0]], 1, "grazing"),
    ):
        found, known = cycle(flow(curve)), cycle(scene("base", **{"friction.law": law}).flow())
        assert found.outcome == known.outcome == outcome
        assert found.period == pytest.approx(known.period, rel=1e-14)


def test_stick_slip_that_ends_in_swings_without_stick_is_found_and_named() -> None:
    """Twenty thousand steps, two seconds, were spent on each such motion, and no end of stick-slip was reported."""
    curve = flow(CONCAVE, belt__speed=0.8, damper__c=0.45)
    assert cycle(curve).outcome == "pure slip"
    found = continuation(lambda c: curve._replace(c=c), np.linspace(0.2, 0.6, 5))
    assert [point.kind for point in found.points] == ["grazing", "hopf"]
    end = found.points[0].value
    assert cycle(curve._replace(c=end - 1e-9)).outcome == "cycle"
    assert cycle(curve._replace(c=end + 1e-9)).outcome == "pure slip"


def test_a_curve_that_falls_to_nothing_ends_in_force_reversal() -> None:
    found = list_events(flow([[0.0, 1.0], [0.1, 0.5], [0.3, 0.1], [0.4, 0.01]]), 3.0, 0.0, 30.0)
    assert found.outcome == "force reversal"
    assert find_problem([(0.0, 1.0), (1.0, 0.5)]) == ""


POINTS = [[s, 1.0 / (1.0 + 3.0 * s)] for s in np.linspace(0.0, 3.0, 250).tolist()]


@pytest.mark.slow  # a kernel is compiled
def test_a_driven_curve_of_many_points_has_the_attractors_of_the_law() -> None:
    """A driven curve of 200 points and more ended in a bug, exit code 1.

    Compiled code was handed its table as a tuple, and was made anew for each number of points.
    """
    friction: dict[str, object] = {"friction.law": 0, "friction.curve": POINTS}
    known, found = (
        find_attractors(*driven_map_with_starts(driven.flow(), 0.0, 0.0, "poincare"), 0.3)
        for driven in (scene("forced", **{"drive.omega": 0.3}), scene("forced", **{"drive.omega": 0.3, **friction}))
    )
    assert [row.period for row in found] == [row.period for row in known] == [1]
    assert found[0].points == pytest.approx(known[0].points, rel=1e-4)
    assert LandingMap(scene("forced", **friction).flow()).first_landing(0.0, 0.0).outcome == "completed"
