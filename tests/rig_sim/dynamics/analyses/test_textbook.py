"""Textbook systems through the analyses of driven systems: answers that are known without a belt."""

import itertools
import math

import numpy as np
import pytest

from rig_sim.dynamics.analyses.exponent import exponent, rotation_number
from rig_sim.dynamics.analyses.settling import Settled, attractors, is_same, settled
from rig_sim.dynamics.analyses.sweep import sweep
from rig_sim.dynamics.system.system import Passages
from rig_sim.flow.modes import COMPLETED, OUTCOMES


class Textbook:
    """A system given by one passage: state -> next state, its Jacobian and the time that has passed."""

    unit = 1

    def __init__(self, start, scale):
        self.state, self.scale, self.time = np.atleast_1d(np.array(start, dtype=float)), np.atleast_1d(scale), 0.0
        self.direction = np.ones(len(self.state)) / math.sqrt(len(self.state))

    def follow(self, number, *, tangent=False):
        states, growth, times = [], [], []
        for _ in range(number):
            self.state, jacobian, duration = self.passage(self.state, tangent)
            self.direction = np.atleast_2d(jacobian) @ self.direction
            size = np.linalg.norm(self.direction)
            self.direction /= size
            self.time += duration
            states.append(self.state)
            growth.append(math.log(size))
            times.append(self.time)
        return Passages(np.array(times), np.array(states), np.array(growth), OUTCOMES[COMPLETED])

    def drawn(self, number):
        return self.follow(number).states[:, 0]


class Logistic(Textbook):
    def __init__(self, r, start=0.3):
        super().__init__(start, 1.0)
        self.r = r

    def passage(self, x, _):
        return self.r * x * (1.0 - x), self.r * (1.0 - 2.0 * x), 1.0


class Circle(Textbook):
    """theta -> theta + turn - (K/2 pi) sin(2 pi theta); its time is the angle."""

    def __init__(self, turn, K):
        super().__init__(0.1, 1.0)
        self.turn, self.K = turn, K

    def passage(self, theta, _):
        step = self.turn - self.K / (2.0 * math.pi) * np.sin(2.0 * math.pi * theta)
        return (theta + step) % 1.0, 1.0 - self.K * np.cos(2.0 * math.pi * theta), float(step[0])


class BouncingBall(Textbook):
    """A ball on a table that moves far less than it flies: phase, speed -> phase + speed, e speed + A cos(phase)."""

    def __init__(self, e, A, start):
        super().__init__(start, [2.0 * math.pi, 10.0])
        self.e, self.A = e, A

    def passage(self, state, _):
        phase = (state[0] + state[1]) % (2.0 * math.pi)
        kick = -self.A * math.sin(phase)
        jacobian = [[1.0, 1.0], [kick, self.e + kick]]
        return np.array([phase, self.e * state[1] + self.A * math.cos(phase)]), np.array(jacobian), 1.0


class Duffing(Textbook):
    """x'' + delta x' - x + x^3 = f cos(omega t), with its variational equation, by Runge and Kutta's formula."""

    steps = 50

    def __init__(self, f, start=(1.0, 0.0), delta=0.3, omega=1.2):
        super().__init__(start, [1.0, 1.0])
        self.f, self.delta, self.omega = f, delta, omega

    def slopes(self, t, y):
        x, v, *rest = y
        pull = 1.0 - 3.0 * x * x
        base = [v, self.f * math.cos(self.omega * t) - self.delta * v + x - x**3]
        for dx, dv in zip(rest[::2], rest[1::2], strict=True):
            base += [dv, pull * dx - self.delta * dv]
        return base

    def passage(self, state, tangent):
        y = [*state.tolist(), *([1.0, 0.0, 0.0, 1.0] if tangent else [])]
        h = 2.0 * math.pi / self.omega / self.steps
        for i in range(self.steps):
            k1 = self.slopes(i * h, y)
            k2 = self.slopes((i + 0.5) * h, [a + 0.5 * h * b for a, b in zip(y, k1, strict=True)])
            k3 = self.slopes((i + 0.5) * h, [a + 0.5 * h * b for a, b in zip(y, k2, strict=True)])
            k4 = self.slopes((i + 1.0) * h, [a + h * b for a, b in zip(y, k3, strict=True)])
            y = [a + h / 6.0 * (b + 2.0 * c + 2.0 * d + e) for a, b, c, d, e in zip(y, k1, k2, k3, k4, strict=True)]
        return np.array(y[:2]), np.array(y[2:]).reshape(2, 2).T if tangent else np.eye(2), 1.0


# Beginnings of periods 1, 2, 4, 8 and 16 of the logistic map and their limit; values between them.
DOUBLINGS = (1.0, 3.0, 3.449489743, 3.544090360, 3.564407266, 3.568759420)


def test_the_sweep_of_the_logistic_map_doubles_its_period_where_feigenbaum_says():
    for period, (first, last) in zip((1, 2, 4, 8, 16), itertools.pairwise(DOUBLINGS), strict=True):
        values = [first + 0.1 * (last - first), last - 0.1 * (last - first)]
        rows = sweep(lambda r: attractors([Logistic(r)], r), values)
        assert [(row.drive_periods, len(row.points)) for row in rows] == [(period, period)] * 2
    assert settled(Logistic(3.9)).period is None


def test_starts_on_one_attractor_share_it_and_two_attractors_stay_apart():
    chaos = attractors([Logistic(3.9, start) for start in (0.1, 0.2, 0.33)], 3.9)
    assert [(row.share, row.drive_periods) for row in chaos] == [(1.0, None)]
    rows = attractors([Duffing(0.2, (side, 0.0)) for side in (1.0, -1.0, 1.1)], 0.2)
    assert [(row.share, row.drive_periods) for row in rows] == [(pytest.approx(2 / 3), 1), (pytest.approx(1 / 3), 1)]


def test_a_start_that_has_not_quite_settled_is_on_the_orbit_all_the_same():
    """Beside a bifurcation one orbit used to count as two attractors, of periods 4 and 8 or of none."""
    orbit = np.array([[0.1], [0.4], [0.7], [0.9]])
    late = Settled(np.concatenate([orbit, orbit + 2e-4]), 8, OUTCOMES[COMPLETED])
    early = Settled(orbit, 4, OUTCOMES[COMPLETED])
    assert is_same(early, late, np.ones(1))
    assert is_same(late, early, np.ones(1))
    assert not is_same(Settled(orbit[:2], 2, OUTCOMES[COMPLETED]), early, np.ones(1))


def test_an_orbit_approached_from_both_sides_has_period_one():
    """Beside a period doubling every second point used to come back before every point did."""
    assert settled(Logistic(2.985)).period == 1


def test_exponent_of_the_logistic_map_is_log_two():
    found = exponent(Logistic(4.0), 20_000)
    assert found.exponent == pytest.approx(math.log(2.0), abs=4.0 * found.stderr)
    assert found.stderr < 0.01
    regular = exponent(Logistic(3.2), 100)
    assert (regular.exponent, regular.period) == (pytest.approx(0.5 * math.log(0.16), abs=1e-12), 2)


def test_rotation_numbers_of_the_circle_map():
    golden = 0.5 * (math.sqrt(5.0) - 1.0)
    free = Circle(golden, 0.0)
    assert rotation_number(free.follow(200)) == pytest.approx(golden, abs=1e-14)
    assert exponent(Circle(golden, 0.0), 100).exponent == 0.0
    locked = Circle(0.5, 0.9)  # in the tongue of 1/2
    assert settled(locked).period == 2
    assert rotation_number(locked.follow(500)) == pytest.approx(0.5, abs=1e-12)
    # K = 1, turn = 0.60666: the golden mean (Shenker 1982), where the exponent is 0
    assert rotation_number(Circle(0.6066610635, 1.0).follow(20_000)) == pytest.approx(golden, abs=1e-6)


def test_the_bouncing_ball_locks_and_becomes_chaotic():
    # the fixed point: speed 2 pi, with (1 - e) 2 pi = A cos(phase); stable for 0 < A sin(phase) < 2 (1 + e)
    e = 0.5
    for A, period in ((3.3, 1), (4.5, 2)):
        phase = math.acos((1.0 - e) * 2.0 * math.pi / A)
        assert (A * math.sin(phase) < 2.0 * (1.0 + e)) is (period == 1)
        assert settled(BouncingBall(e, A, (phase + 0.01, 2.0 * math.pi))).period == period
    found = exponent(BouncingBall(e, 12.0, (0.3, 6.0)), 2000)
    assert found.exponent > 10.0 * found.stderr > 0.0


@pytest.mark.slow
@pytest.mark.parametrize(("f", "period"), [(0.2, 1), (0.28, 2), (0.29, 4), (0.37, 5), (0.5, None), (0.65, 2)])
def test_periods_of_duffing(f, period):
    assert settled(Duffing(f)).period == period


@pytest.mark.slow
def test_exponent_of_duffing_in_a_well():
    """Of complex multipliers each has half the logarithm of the volume; one period's growth used to be taken."""
    found = exponent(Duffing(0.2), 200)
    assert found.period == 1
    assert found.exponent == pytest.approx(-0.5 * 0.3 * 2.0 * math.pi / 1.2, abs=1e-4)
