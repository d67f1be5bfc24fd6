"""The minimiser with eliminated per-cycle unknowns finds what the full problem's closed form says."""

import math
from dataclasses import replace

import numpy as np
import pytest

from fitting.least_squares import levenberg_marquardt
from fitting.least_squares.normal_equations import Block, Derivatives, LeastSquaresProblem, SchurComplement

CYCLES, SAMPLES, SHARED, LOCAL = 7, 11, 3, 2
ALL = np.arange(CYCLES)


@pytest.fixture
def linear():
    """Give a linear least-squares problem with its full matrix (N, p + c q) and data."""
    rng = np.random.default_rng(5)
    n = CYCLES * SAMPLES
    shared = rng.standard_normal((n, SHARED))
    own = rng.standard_normal((n, LOCAL))
    data = rng.standard_normal(n)
    rows = tuple(slice(k * SAMPLES, (k + 1) * SAMPLES) for k in range(CYCLES))

    def evaluate(u, local, derivatives):
        value = shared @ u - data
        for k, part in enumerate(rows):
            value[part] += own[part] @ local[k]
        return value, np.hstack([shared, own]) if derivatives else np.empty((0, 0))

    full = np.zeros((n, SHARED + CYCLES * LOCAL))
    full[:, :SHARED] = shared
    for k, part in enumerate(rows):
        full[part, SHARED + k * LOCAL : SHARED + (k + 1) * LOCAL] = own[part]
    return evaluate, rows, full, data


def in_one_block(evaluate):
    def wrapped(u, local, derivatives):
        found = evaluate(u, local, derivatives)
        if found is None:
            return None
        block = Block(slice(0, len(local)), slice(0, found[0].size))
        return found[0], Derivatives((block,), lambda _: found[1])

    return wrapped


def least_squares(evaluate, rows, *rest, some=None, **named):
    """Return a problem whose ``evaluate`` returns plain arrays."""
    some = None if some is None else (lambda u, cycles, some=some: in_one_block(some(u, cycles)))
    return LeastSquaresProblem(in_one_block(evaluate), rows, *rest, some=some, **named)


def problem(evaluate, rows, **changes):
    values = {
        "evaluate": evaluate,
        "rows": rows,
        "weights": np.ones(CYCLES),
        "lower": np.full(SHARED, -np.inf),
        "upper": np.full(SHARED, np.inf),
        "prior": np.zeros(SHARED),
        "precision": np.zeros(SHARED),
        "local_prior": np.zeros((CYCLES, LOCAL)),
        "local_precision": np.full((CYCLES, LOCAL), 1e-12),
    }
    return least_squares(**(values | changes))


def test_a_linear_problem_is_solved_as_by_the_full_matrix(linear):
    evaluate, rows, full, data = linear
    found = levenberg_marquardt.minimise(
        problem(evaluate, rows), np.zeros(SHARED), np.zeros((CYCLES, LOCAL)), tolerance=1e-14
    )
    expected = np.linalg.lstsq(full, data, rcond=None)[0]
    assert found.outcome == "converged"
    assert found.u == pytest.approx(expected[:SHARED], abs=1e-7)
    assert found.local.ravel() == pytest.approx(expected[SHARED:], abs=1e-7)


def test_own_unknowns_that_begin_beyond_their_bounds_are_brought_within(linear):
    """The first step cut them back and raised the cost, was refused however short, and the search stopped there."""
    evaluate, rows, _, _ = linear
    task = problem(evaluate, rows, local_upper=np.full((CYCLES, LOCAL), 0.1))
    begin = np.zeros(SHARED)
    beyond = levenberg_marquardt.minimise(task, begin, np.full((CYCLES, LOCAL), 5.0), tolerance=1e-14)
    within = levenberg_marquardt.minimise(task, begin, np.zeros((CYCLES, LOCAL)), tolerance=1e-14)
    assert beyond.outcome == "converged"
    assert beyond.local.max() <= 0.1
    assert beyond.cost == pytest.approx(within.cost, rel=1e-6)


def test_one_last_step_ends_a_linear_search_and_leaves_no_gradient(linear):
    evaluate, rows, _, _ = linear
    task = problem(evaluate, rows)
    start = levenberg_marquardt.minimise(task, np.zeros(SHARED), np.zeros((CYCLES, LOCAL)), max_steps=1)
    ended = levenberg_marquardt.minimise(task, np.zeros(SHARED), np.zeros((CYCLES, LOCAL)), tolerance=1e-14)
    found = levenberg_marquardt.last_step(task, start)
    assert found.u == pytest.approx(ended.u, abs=1e-6)
    assert found.cost == pytest.approx(ended.cost, rel=1e-9)
    exact = levenberg_marquardt.linearise(task, found.u, found.local).blocks
    assert found.blocks.cycle_g == pytest.approx(exact.cycle_g, abs=1e-6)
    assert found.blocks.gl == pytest.approx(exact.gl, abs=1e-6)


def test_the_reduced_hessian_is_the_inverse_of_the_marginal_covariance(linear):
    evaluate, rows, full, _ = linear
    u, local = np.zeros(SHARED), np.zeros((CYCLES, LOCAL))
    task = problem(evaluate, rows)
    blocks = levenberg_marquardt.linearise(task, u, local).blocks
    H = SchurComplement(blocks).H
    covariance = np.linalg.inv(full.T @ full + 1e-12 * np.eye(full.shape[1]))[:SHARED, :SHARED]
    assert np.linalg.inv(H) == pytest.approx(covariance, rel=1e-6)


def test_a_bound_holds_and_the_others_settle_given_it(linear):
    evaluate, rows, full, data = linear
    free = np.linalg.lstsq(full, data, rcond=None)[0]
    lower = np.full(SHARED, -np.inf)
    lower[1] = free[1] + 0.5
    task = problem(evaluate, rows, lower=lower)
    found = levenberg_marquardt.minimise(task, np.zeros(SHARED), np.zeros((CYCLES, LOCAL)), tolerance=1e-14)
    kept = np.delete(np.arange(full.shape[1]), 1)
    rest = np.linalg.lstsq(full[:, kept], data - full[:, 1] * lower[1], rcond=None)[0]
    # The second-order part of a step, here rounding alone, may end an ulp or two inside the bound.
    assert found.u[1] >= lower[1]
    assert found.u[1] == pytest.approx(lower[1], rel=1e-14)
    assert found.u[[0, 2]] == pytest.approx(rest[:2], abs=1e-6)


def test_a_prior_pulls_with_its_precision():
    def evaluate(u, local, derivatives):
        return np.array([u[0] - 1.0 + local[0, 0]]), np.array([[1.0, 1.0]])

    task = least_squares(
        evaluate,
        (slice(0, 1),),
        np.array([4.0]),
        np.array([-np.inf]),
        np.array([np.inf]),
        np.array([3.0]),
        np.array([4.0]),
        np.zeros((1, 1)),
        np.array([[1e12]]),
    )
    found = levenberg_marquardt.minimise(task, np.array([10.0]), np.zeros((1, 1)), tolerance=1e-14)
    assert found.u[0] == pytest.approx(2.0, abs=1e-6)


def test_a_start_that_cannot_be_followed_gives_none():
    task = problem(lambda *_: None, (slice(0, 1),) * CYCLES)
    assert levenberg_marquardt.minimise(task, np.zeros(SHARED), np.zeros((CYCLES, LOCAL))) is None


def test_steps_into_what_cannot_be_followed_are_refused():
    def evaluate(u, local, derivatives):
        if u[0] < 0.5:
            return None
        return np.array([u[0]]), np.array([[1.0, 0.0]])

    task = least_squares(
        evaluate,
        (slice(0, 1),),
        np.ones(1),
        np.array([-np.inf]),
        np.array([np.inf]),
        np.zeros(1),
        np.zeros(1),
        np.zeros((1, 1)),
        np.ones((1, 1)),
    )
    found = levenberg_marquardt.minimise(task, np.array([2.0]), np.zeros((1, 1)))
    assert 0.5 <= found.u[0] < 0.7
    assert math.isfinite(found.cost)


def test_a_bent_valley_is_followed_in_few_steps():
    # u1 must follow exp(2 u0) along a floor far flatter than its walls
    def evaluate(u, local, derivatives):
        wall = 1e2 * (u[1] - math.exp(2 * u[0]))
        residual = np.array([wall, u[0] - 2.0])
        slope = np.array([[-2e2 * math.exp(2 * u[0]), 1e2, 0.0], [1.0, 0.0, 0.0]])
        return residual, slope

    task = least_squares(
        evaluate,
        (slice(0, 2),),
        np.ones(1),
        np.full(2, -np.inf),
        np.full(2, np.inf),
        np.zeros(2),
        np.zeros(2),
        np.zeros((1, 1)),
        np.ones((1, 1)),
    )
    found = levenberg_marquardt.minimise(task, np.array([0.0, 1.0]), np.zeros((1, 1)), max_steps=70, tolerance=1e-12)
    assert found.u == pytest.approx([2.0, math.exp(4.0)], rel=1e-6)


def of_one_unknown_each(residual, slopes):
    """Return a problem of one shared unknown and one of each cycle's own; functions of (u, l), also of some cycles."""

    def evaluate(u, local, derivatives, cycles=ALL):
        slope = np.c_[slopes(u[0], local[:, 0], cycles)] if derivatives else np.empty((0, 0))
        return residual(u[0], local[:, 0], cycles), slope

    def some(u, cycles):
        def evaluate_cycles(_, local, derivatives):
            found, slope = evaluate(u, local, derivatives, cycles)
            return found, slope[:, 1:]

        return evaluate_cycles

    return least_squares(
        evaluate,
        tuple(slice(k, k + 1) for k in range(CYCLES)),
        np.ones(CYCLES),
        np.full(1, -np.inf),
        np.full(1, np.inf),
        np.zeros(1),
        np.zeros(1),
        np.zeros((CYCLES, 1)),
        np.ones((CYCLES, 1)),
        some=some,
    )


def test_one_cycle_gone_astray_does_not_hold_up_the_others():
    # a cliff lies between where the last cycle's own unknown starts and where its residual would be 0
    def residual(u, local, cycles):
        last = cycles == CYCLES - 1
        return (u - 3.0) * (cycles + 1.0) + local - 5.0 * last + 1e6 * (last & (local > 0.5))

    def slopes(u, local, cycles):
        return cycles + 1.0, np.ones(cycles.size)

    task = replace(of_one_unknown_each(residual, slopes), weights=np.r_[np.ones(CYCLES - 1), 0.01])
    task = replace(task, local_precision=np.full((CYCLES, 1), 1e-4))
    start = np.full(1, 2.9), np.zeros((CYCLES, 1))
    found = levenberg_marquardt.minimise(task, *start, max_steps=8, tolerance=1e-10)
    held_up = levenberg_marquardt.minimise(replace(task, some=None), *start, max_steps=8, tolerance=1e-10)
    assert found.local[-1, 0] <= 0.5
    assert found.u[0] == pytest.approx(3.0, abs=0.1)
    assert found.cost < 0.2 * held_up.cost


def test_a_cycle_in_a_bent_valley_of_its_own_costs_few_steps():
    # the first cycle's own unknown follows exp(u) along steep walls; the others pull u from 0 to 2
    def residual(u, local, cycles):
        return np.where(cycles == 0, 1e4 * (local - math.expm1(u)), u - 2.0)

    def slopes(u, local, cycles):
        first = cycles == 0
        return np.where(first, -1e4 * math.exp(u), 1.0), np.where(first, 1e4, 0.0)

    task = replace(of_one_unknown_each(residual, slopes), local_precision=np.full((CYCLES, 1), 1e-6))
    start = np.zeros(1), np.zeros((CYCLES, 1))
    found = levenberg_marquardt.minimise(task, *start, tolerance=1e-10)
    alone = levenberg_marquardt.minimise(replace(task, some=None), *start, tolerance=1e-10)
    assert found.u[0] == pytest.approx(2.0, abs=1e-4)
    assert found.local[0, 0] == pytest.approx(math.expm1(found.u[0]), rel=1e-6)
    assert found.steps <= alone.steps / 2


def test_an_unknown_without_curvature_does_not_move():
    # Rounding may leave a curvature below 0 after the elimination.
    H = np.array([[4.0, 0.0], [0.0, -1e-17]])
    assert levenberg_marquardt._solve(H, np.array([2.0, 1.0])) == pytest.approx([0.5, 0.0])
    assert levenberg_marquardt._solve(np.zeros((1, 1)), np.ones(1)) == pytest.approx([0.0])


def test_a_search_next_to_a_bound_goes_on_along_it(linear):
    # A hair above its bound an unknown is free, and its step is cut off there: the others must step beside that.
    evaluate, rows, full, data = linear
    free = np.linalg.lstsq(full, data, rcond=None)[0]
    lower = np.full(SHARED, -np.inf)
    lower[1] = free[1] + 0.5
    start = np.array([0.0, lower[1] + 1e-14, 0.0])
    task = problem(evaluate, rows, lower=lower)
    found = levenberg_marquardt.minimise(task, start, np.zeros((CYCLES, LOCAL)), max_steps=6, tolerance=1e-14)
    kept = np.delete(np.arange(full.shape[1]), 1)
    rest = np.linalg.lstsq(full[:, kept], data - full[:, 1] * lower[1], rcond=None)[0]
    # The second-order part of a step, here rounding alone, may end an ulp or two inside the bound.
    assert found.u[1] >= lower[1]
    assert found.u[1] == pytest.approx(lower[1], rel=1e-14)
    assert found.u[[0, 2]] == pytest.approx(rest[:2], abs=1e-6)


def test_a_cycles_own_unknown_on_its_bound_stays_there_and_the_others_settle_beside_it(linear):
    # A step that is merely cut off at the bound no longer fits the others: under noise a search stood still there.
    evaluate, rows, full, data = linear
    place = SHARED + 2 * LOCAL  # the first unknown of the third cycle
    bound = np.linalg.lstsq(full, data, rcond=None)[0][place] - 0.5
    upper = np.full((CYCLES, LOCAL), np.inf)
    upper[2, 0] = bound
    start = np.zeros((CYCLES, LOCAL))
    start[2, 0] = bound
    task = problem(evaluate, rows, local_upper=upper)
    found = levenberg_marquardt.minimise(task, np.zeros(SHARED), start, max_steps=6, tolerance=1e-14)
    kept = np.delete(np.arange(full.shape[1]), place)
    rest = np.linalg.lstsq(full[:, kept], data - full[:, place] * bound, rcond=None)[0]
    assert found.local[2, 0] == pytest.approx(bound, rel=1e-9)
    assert found.u == pytest.approx(rest[:SHARED], abs=1e-6)


@pytest.mark.parametrize("steep", [1e145, 1e160, math.inf])
def test_a_search_stops_where_derivatives_are_too_large_for_a_number(linear, steep):
    """Beside a sharp guide's friction the tangents were 1e229: their squares overflowed, and the step was NaN."""
    evaluate, rows, _, _ = linear
    begin = np.zeros(SHARED), np.zeros((CYCLES, LOCAL))

    def cliff(u, local, derivatives):
        value, jacobian = evaluate(u, local, derivatives)
        if derivatives and np.any(u):
            jacobian = jacobian.copy()
            jacobian[5] *= steep
        return value, jacobian

    task = problem(cliff, rows, weights=np.full(CYCLES, 1e12))
    found = levenberg_marquardt.minimise(task, *begin)
    assert found.outcome == "no progress"
    assert np.isfinite(found.u).all()
    assert np.isfinite(found.blocks.H).all()
    assert levenberg_marquardt.minimise(task, begin[0] + 1.0, begin[1]) is None


def test_a_step_off_the_floor_of_a_bent_valley_is_led_back():
    # A free curve behind a ramp took 22 steps, half of them refused, and stopped 0.01 in cost above the minimum.
    rows = tuple(slice(k * SAMPLES, (k + 1) * SAMPLES) for k in range(CYCLES))
    first = np.arange(CYCLES) * SAMPLES

    def evaluate(u, local, derivatives):
        x, y, z = u
        value, slopes = np.zeros(CYCLES * SAMPLES), np.zeros((CYCLES * SAMPLES, SHARED + LOCAL))
        value[first], slopes[first, :2] = 1e4 * (y - math.exp(x)), (-1e4 * math.exp(x), 1e4)
        value[first + 1], slopes[first + 1, 0] = x - 1.5, 1.0
        value[first + 2], slopes[first + 2, 2] = z, 1.0
        return value, slopes if derivatives else np.empty((0, 0))

    bent = problem(evaluate, rows, local_precision=np.ones((CYCLES, LOCAL)))
    start = np.array([0.5, math.exp(0.5), 1.0]), np.zeros((CYCLES, LOCAL))
    plain, led_back = (levenberg_marquardt.minimise(bent, *start, max_steps=200, corrections=n) for n in (0, 3))
    assert led_back.outcome == "converged"
    assert led_back.u == pytest.approx([1.5, math.exp(1.5), 0.0], abs=1e-4)
    assert led_back.steps < 0.6 * plain.steps
