"""Close returns, Newton's method and OGY on maps whose orbits are known in closed form."""

import math

import numpy as np
import pytest

from rig_sim.analyses.control.locking import Locking, find_and_lock, lock
from rig_sim.analyses.control.search_and_lock import search_and_lock
from rig_sim.analyses.unstable_orbits import UnstableOrbit, find_orbits_in_motion, orbit_multipliers
from rig_sim.systems.formula import FormulaMap
from rig_sim.systems.interface import derivatives, difference, orbit

from ..textbook import BouncingBall, Henon, Logistic


def locked_on(f: FormulaMap, start: list[float], period: int, budget: float) -> Locking:
    found = find_and_lock(f, np.array(start), period, budget, 50_000)
    assert found.outcome == "locked"
    assert found.lock is not None
    assert found.lock.events_to_lock is not None
    assert np.max(np.abs(found.lock.changes)) <= budget * f.strength
    assert abs(found.lock.changes[-1]) < 1e-11 * f.strength
    end = found.lock.states[-period:]
    turned = min(np.max(np.abs(difference(f, np.roll(end, k, axis=0), found.orbits[0].points))) for k in range(period))
    assert turned < 1e-10
    # left alone just before the control took hold, the motion goes elsewhere
    at = found.lock.events_to_lock
    alone = orbit(f, found.lock.states[at], 40)
    assert np.max(np.min(np.linalg.norm(difference(f, alone[:, None], found.orbits[0].points), axis=2), axis=1)) > 0.05
    return found


@pytest.mark.parametrize("start", [0.2, 0.5, 0.77])
def test_logistic_map(start: float) -> None:
    r = 3.9
    fixed = locked_on(Logistic(3.9), [start], 1, 0.01).orbits
    assert [orbit.points[0, 0] for orbit in fixed] == [pytest.approx(1 - 1 / r, abs=1e-12)]
    assert fixed[0].multipliers[0] == pytest.approx(2 - r, abs=1e-9)
    [pair] = locked_on(Logistic(3.9), [start], 2, 0.01).orbits
    root = math.sqrt((r + 1) * (r - 3))
    assert pair.points[:, 0] == pytest.approx(((r + 1 - root) / (2 * r), (r + 1 + root) / (2 * r)), abs=1e-12)
    assert pair.multipliers[0] == pytest.approx(4 + 2 * r - r * r, abs=1e-9)
    triples = locked_on(Logistic(3.9), [start], 3, 0.003).orbits
    assert len(triples) == 2  # a cubic has both
    assert abs(triples[0].multipliers[0]) < abs(triples[1].multipliers[0])


def test_a_phase_is_compared_the_short_way_round() -> None:
    found = locked_on(BouncingBall(0.4, -8.0), [1.0, 2.0], 1, 0.05).orbits[0]
    phase, v = found.points[0]
    turns = v / (2 * math.pi)
    assert turns == pytest.approx(round(turns), abs=1e-11)
    assert v == pytest.approx(0.4 * v - 8.0 * math.cos(phase), abs=1e-10)
    trace, area = 1.4 + 8.0 * math.sin(phase), 0.4
    assert np.sum(found.multipliers) == pytest.approx(trace, rel=1e-9)
    assert np.prod(found.multipliers) == pytest.approx(area, rel=1e-8)


def test_derivatives_and_multipliers_of_long_orbits() -> None:
    slope, response = derivatives(Henon(), np.array([0.3, -0.4]))
    assert slope == pytest.approx(np.array([[-0.6, 0.3], [1.0, 0.0]]), abs=1e-10)
    assert response == pytest.approx((0.7, 0.0), abs=1e-10)
    # the product of many slopes keeps nothing of the small multiplier: it used to come out above 1
    generator = np.random.default_rng(1)
    slopes = generator.normal(size=(60, 2, 2))
    slopes[:, 1] *= 0.05
    multipliers = orbit_multipliers(slopes)
    assert np.log(np.abs(multipliers)).sum() == pytest.approx(np.log(np.abs(np.linalg.det(slopes))).sum(), abs=0.2)


@pytest.mark.parametrize(
    ("r", "period", "budget", "outcome"),
    [
        (3.9, 1, 0.0, "no budget"),
        (2.8, 1, 0.01, "stable orbit"),
        (2.8, 2, 0.01, "regular motion"),
        (3.5, 1, 1e-4, "regular motion"),
        (3.9, 5000, 0.01, "no orbit"),
        (3.9, 1, 1e-9, "not locked"),
        (4.5, 1, 0.01, "no orbit"),  # the map ends
    ],
)
def test_every_attempt_ends_in_a_named_outcome(r: float, period: int, budget: float, outcome: str) -> None:
    found = find_and_lock(Logistic(r), np.array([0.31]), period, budget, 3000)
    assert found.outcome == outcome
    assert (found.advice == "") == (outcome == "stable orbit")
    assert (found.lock is not None and found.lock.locked) == (outcome == "stable orbit")


def test_orbits_that_one_parameter_cannot_hold_end_in_a_named_outcome() -> None:
    points, multipliers = np.zeros((1, 2)), np.array([3.0 + 0j, -2.0])
    free = UnstableOrbit(points, multipliers, np.diag([3.0, -2.0])[None], np.ones((1, 2)))
    assert lock(Henon(), free, np.zeros(2), 0.1, 100).outcome == "several unstable directions"
    deaf = UnstableOrbit(points, np.array([3.0 + 0j, 0.5]), np.diag([3.0, 0.5])[None], np.array([[0.0, 1.0]]))
    assert lock(Henon(), deaf, np.zeros(2), 0.1, 100).outcome == "no response"


def test_the_search_of_the_thesis_finds_the_window_and_leaves_the_orbit_again() -> None:
    # The logistic map's window of period 3 opens at 1 + sqrt(8).
    found = search_and_lock(Logistic(3.82), np.array([0.31]), 3, 0.01, steps=200)
    assert found.change is not None
    step = 0.01 * 3.82 / 200
    assert 0.0 <= 3.82 + found.change - (1 + math.sqrt(8)) < 3 * step
    assert found.kept is not None
    assert found.kept < 60
    assert not found.stays
    assert search_and_lock(Logistic(3.7), np.array([0.31]), 3, 0.01).change is None
    at_once = search_and_lock(Logistic(3.2), np.array([0.31]), 2, 0.01)
    assert (at_once.change, at_once.steps, at_once.stays) == (0.0, 0, True)


def test_orbits_need_a_motion_longer_than_their_period() -> None:
    assert find_orbits_in_motion(Logistic(3.9), np.full((4, 1), 0.3), 4) == []
