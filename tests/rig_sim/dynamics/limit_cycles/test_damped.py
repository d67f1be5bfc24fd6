"""Fixed points, multipliers and special points of one mass, against published numbers and a general solver."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from rig_sim.analyses.limit_cycles.branches import continuation, estimate_interval
from rig_sim.analyses.limit_cycles.fixed_point import fixed_point, quadratic_roots
from rig_sim.analyses.limit_cycles.floquet import floquet
from rig_sim.flow.flow import Flow
from rig_sim.friction.law import LAWS
from rig_sim.integrate.events import list_events

from ...shared import CHAPTERS, flow_of

REFERENCE = CHAPTERS["chapter5"]


def damped(c, **changes):
    return Flow(**{"c": c, "v_belt": 0.6, **changes})


def test_the_fixed_point_and_its_eigenvalues_are_those_of_the_thesis():
    found = fixed_point(damped(0.45))
    assert found.x == pytest.approx(REFERENCE["fixed_point_x"]["value"], abs=REFERENCE["fixed_point_x"]["tol"])
    assert sum(found.eigenvalues) == pytest.approx(3 / 2.8**2 - 0.45, abs=1e-15)
    assert math.prod(found.eigenvalues) == pytest.approx(1.0, abs=1e-15)
    assert found.stable


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("v_belt", [0.6, -0.6, 0.1])
def test_a_mass_on_the_fixed_point_of_any_law_stays(law, v_belt):
    flow = flow_of(law, c=0.1, v_belt=v_belt, droop=0.02 if law != 5 else 0.0)
    x = fixed_point(flow).x
    assert list_events(flow, x, 0.0, 20.0).kinds in ((), ("S>N",), ("S>P",))  # on the edge of slip it may let go once


@pytest.mark.parametrize(("a", "b", "c"), [(1.0, 1e8, 1.0), (2.0, -3.0, 1.0), (1.0, 2.0, 1.0), (1.0, 0.0, 4.0)])
def test_roots_solve_their_equation_without_cancellation(a, b, c):
    for root in quadratic_roots(a, b, c):
        assert abs(a * root * root + b * root + c) <= 1e-15 * (abs(a * root * root) + abs(b * root) + c)


@pytest.mark.parametrize("case", REFERENCE["unstable_orbit"], ids=lambda case: str(case["c"]))
def test_the_unstable_orbit_and_its_multiplier(case):
    orbit = floquet(damped(case["c"]), "unstable")
    assert orbit.x_min == pytest.approx(case["xmin"], abs=case["tol_x"])
    assert orbit.period == pytest.approx(case["T"], abs=case["tol_T"])
    assert orbit.multipliers == pytest.approx((1.0, case["multiplier"]), abs=case["tol_mu"])


@pytest.mark.parametrize("case", REFERENCE["stick_slip_cycle"], ids=lambda case: str(case["c"]))
def test_an_orbit_that_sticks_forgets_where_it_began(case):
    orbit = floquet(damped(case["c"]))
    assert orbit.multipliers == (1.0, 0.0)
    assert (orbit.x_min, orbit.period) == pytest.approx((case["xmin"], case["T"]), abs=case["tol"])


@pytest.mark.parametrize("law", [4, 6])
def test_the_multiplier_of_a_ramp_is_the_slope_of_its_return_map(law):
    """Against finite differences of a general solver on the smooth right-hand side, which knows no phases."""
    d, v, c = 0.2, 0.5, 0.02
    flow = flow_of(law, v_belt=v, d=d, c=c, G_slip=0.05, gamma=0.3)
    orbit = floquet(flow)
    assert "S" in orbit.sequence

    def friction(w):
        if abs(w) <= d:
            return -w / d
        s = abs(w) - d
        return -math.copysign(1 - 0.05 * s if law == 4 else 1 / (1 + 0.3 * s), w)

    def turned(x):
        def rising(t, y):
            return y[1]

        rising.direction, rising.terminal = 1.0, 2  # the start counts as the first
        found = solve_ivp(
            lambda t, y: (y[1], -c * y[1] - y[0] + friction(y[1] - v)),
            (0.0, 30.0),
            (x, 0.0),
            method="DOP853",
            rtol=1e-12,
            atol=1e-13,
            max_step=0.02,
            events=rising,
        )
        return found.y_events[0][-1][0]

    step = 1e-3
    slope = (turned(orbit.x_min + step) - turned(orbit.x_min - step)) / (2 * step)
    assert orbit.multipliers[1] == pytest.approx(slope, rel=2e-3)


@pytest.mark.parametrize(
    ("flow", "which", "outcome", "words"),
    [
        (damped(0.3), "unstable", "no cycle", "not stable"),
        (damped(0.6), "unstable", "no cycle", "no stick-slip orbit"),
        (damped(0.6), "stable", "fixed point", "comes to rest"),
        (damped(3.0), "unstable", "no cycle", "no stick-slip orbit"),
        (damped(0.1, u0=0.1, omega=1.0), "stable", "driven", "driven"),
        (flow_of(1), "stable", "grazing", ""),
        (flow_of(1), "unstable", "no cycle", "not stable"),
        (damped(0.1, v_belt=0.0), "stable", "fixed point", "comes to rest"),
    ],
)
def test_what_is_no_such_orbit_has_a_name(flow, which, outcome, words):
    found = floquet(flow, which)
    assert found.outcome == outcome
    assert words in found.advice


def test_hopf_point_and_discontinuous_fold_of_the_thesis():
    found = continuation(damped, np.linspace(0.3, 0.6, 7))
    hopf, fold = found.points
    assert (hopf.kind, fold.kind) == ("hopf", "fold")
    assert hopf.value == pytest.approx(REFERENCE["hopf_c"]["value"], abs=REFERENCE["hopf_c"]["tol"])
    assert fold.value == pytest.approx(REFERENCE["fold_c"]["value"], abs=REFERENCE["fold_c"]["tol"])
    spans = {
        (branch.kind, branch.stable): tuple(round(branch.rows[end].value, 12) for end in (0, -1))
        for branch in found.branches
    }
    assert spans == {
        ("fixed point", True): (0.4, 0.6),
        ("fixed point", False): (0.3, 0.35),
        ("orbit", True): (0.3, 0.55),
        ("orbit", False): (0.4, 0.55),
    }


def test_under_a_ramp_the_orbits_meet_smoothly():
    def ramp(c):
        return damped(c, ramp=1, d=0.2)

    found = continuation(ramp, np.array([0.7, 0.85]))
    (fold,) = found.points
    gaps = []
    for below in (1e-3, 2.5e-4):
        stable, unstable = (floquet(ramp(fold.value - below), which) for which in ("stable", "unstable"))
        assert 0.0 < stable.multipliers[1] < 1.0 < unstable.multipliers[1]
        gaps.append(unstable.x_min - stable.x_min)
    assert gaps[0] / gaps[1] == pytest.approx(2.0, rel=0.2)  # a square root: four times as near, half as far apart
    assert floquet(ramp(fold.value + 1e-3)).outcome == "fixed point"


def test_a_fixed_point_that_leaves_the_ramp_loses_stability_at_its_edge():
    found = continuation(lambda v: flow_of(6, v_belt=v, d=0.2), np.linspace(0.05, 0.35, 4))
    assert [(point.kind, round(point.value, 12)) for point in found.points if point.kind != "fold"] == [
        ("border-collision", 0.2)
    ]


@pytest.mark.parametrize("draws", [10, 40, 200])
def test_the_interval_of_few_draws_holds_as_much_as_that_of_many(draws):
    """The interval between the quantiles of 40 draws used to hold a further one with 90 %, not 95 %."""
    rng = np.random.default_rng(7)
    held = []
    for row in rng.standard_normal((4000, draws + 1)).tolist():
        found = estimate_interval(row[1:])
        held.append(found.lo <= row[0] <= found.hi)
    expected = 0.95 if draws >= 39 else (draws - 1) / (draws + 1)  # of few draws, from the least to the largest
    assert np.mean(held) == pytest.approx(expected, abs=0.012)
