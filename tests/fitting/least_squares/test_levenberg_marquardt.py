"""The minimiser with eliminated per-cycle unknowns finds what the full problem's closed form says."""

import math

import numpy as np
import pytest

from fitting.least_squares import levenberg_marquardt
from fitting.least_squares.normal_equations import Block, Derivatives, LeastSquaresProblem

CYCLES, SAMPLES, SHARED, LOCAL = 7, 11, 3, 2
ROWS = tuple(slice(k * SAMPLES, (k + 1) * SAMPLES) for k in range(CYCLES))


def in_one_block(evaluate):
    def wrapped(u, local, derivatives):
        found = evaluate(u, local, derivatives)
        if found is None:
            return None
        block = Block(slice(0, len(local)), slice(0, found[0].size))
        return found[0], Derivatives((block,), lambda _: found[1])

    return wrapped


def problem(evaluate, rows=ROWS, shared=SHARED, own=LOCAL, **changes):
    """Return a problem without bounds and priors but those given, whose ``evaluate`` returns plain arrays."""
    cycles = len(rows)
    values = {
        "weights": np.ones(cycles),
        "lower": np.full(shared, -np.inf),
        "upper": np.full(shared, np.inf),
        "prior": np.zeros(shared),
        "precision": np.zeros(shared),
        "local_prior": np.zeros((cycles, own)),
        "local_precision": np.full((cycles, own), 1e-12),
    }
    return LeastSquaresProblem(in_one_block(evaluate), rows, evaluate_cycles=None, **values | changes)


def minimise(task, u=0.0, local=0.0, **how):
    """Minimise from these values on."""
    start = np.zeros(task.prior.size) + u, np.zeros(task.local_prior.shape) + local
    return levenberg_marquardt.minimise(task, *start, **{"tolerance": 1e-14} | how)


@pytest.fixture
def linear():
    """Give a linear problem's ``evaluate``, and a function that solves its full matrix beside unknowns that are held.

    The function takes places in (shared, own of each cycle) and their values; it returns all unknowns.
    """
    rng = np.random.default_rng(5)
    n = CYCLES * SAMPLES
    shared, own, data = rng.standard_normal((n, SHARED)), rng.standard_normal((n, LOCAL)), rng.standard_normal(n)

    def evaluate(u, local, derivatives):
        value = shared @ u - data
        for k, part in enumerate(ROWS):
            value[part] += own[part] @ local[k]
        return value, np.hstack([shared, own]) if derivatives else np.empty((0, 0))

    full = np.zeros((n, SHARED + CYCLES * LOCAL))
    full[:, :SHARED] = shared
    for k, part in enumerate(ROWS):
        full[part, SHARED + k * LOCAL : SHARED + (k + 1) * LOCAL] = own[part]

    def solve(held=None):
        held = held or {}
        free = [place for place in range(full.shape[1]) if place not in held]
        found = np.zeros(full.shape[1])
        found[list(held)] = list(held.values())
        found[free] = np.linalg.lstsq(full[:, free], data - full @ found, rcond=None)[0]
        return found

    return evaluate, solve


def test_a_linear_problem_is_solved_as_by_the_full_matrix(linear):
    evaluate, solve = linear
    found, expected = minimise(problem(evaluate)), solve()
    assert found.outcome == "converged"
    assert found.u == pytest.approx(expected[:SHARED], abs=1e-7)
    assert found.local.ravel() == pytest.approx(expected[SHARED:], abs=1e-7)


def test_own_unknowns_that_begin_beyond_their_bounds_are_brought_within(linear):
    """The first step cut them back and raised the cost, was refused however short, and the search stopped there."""
    task = problem(linear[0], local_upper=np.full((CYCLES, LOCAL), 0.1))
    beyond, within = minimise(task, local=5.0), minimise(task)
    assert beyond.outcome == "converged"
    assert beyond.local.max() <= 0.1
    assert beyond.cost == pytest.approx(within.cost, rel=1e-6)


def test_one_last_step_ends_a_linear_search_and_leaves_no_gradient(linear):
    task = problem(linear[0])
    found, ended = levenberg_marquardt.take_last_step(task, minimise(task, max_steps=1)), minimise(task)
    assert found.u == pytest.approx(ended.u, abs=1e-6)
    assert found.cost == pytest.approx(ended.cost, rel=1e-9)
    exact = levenberg_marquardt.linearise(task, found.u, found.local).blocks
    assert found.blocks.cycle_g == pytest.approx(exact.cycle_g, abs=1e-6)
    assert found.blocks.gl == pytest.approx(exact.gl, abs=1e-6)


# A hair above its bound an unknown is free, and its step is cut off there: the others must step beside that.
@pytest.mark.parametrize(("above", "steps"), [(None, 40), (1e-14, 6)])
def test_a_bound_holds_and_the_others_settle_given_it(linear, above, steps):
    evaluate, solve = linear
    bound = solve()[1] + 0.5
    task = problem(evaluate, lower=np.array([-np.inf, bound, -np.inf]))
    found = minimise(task, 0.0 if above is None else [0.0, bound + above, 0.0], max_steps=steps)
    # The second-order part of a step, here rounding alone, may end an ulp or two inside the bound.
    assert found.u[1] >= bound
    assert found.u[1] == pytest.approx(bound, rel=1e-14)
    assert found.u == pytest.approx(solve({1: bound})[:SHARED], abs=1e-6)


def test_a_cycles_own_unknown_on_its_bound_stays_there_and_the_others_settle_beside_it(linear):
    # A step that is merely cut off at the bound no longer fits the others: under noise a search stood still there.
    evaluate, solve = linear
    place = SHARED + 2 * LOCAL  # the first unknown of the third cycle
    upper, start = np.full((CYCLES, LOCAL), np.inf), np.zeros((CYCLES, LOCAL))
    upper[2, 0] = start[2, 0] = bound = solve()[place] - 0.5
    found = minimise(problem(evaluate, local_upper=upper), local=start, max_steps=6)
    assert found.local[2, 0] == pytest.approx(bound, rel=1e-9)
    assert found.u == pytest.approx(solve({place: bound})[:SHARED], abs=1e-6)


@pytest.mark.parametrize("steep", [1e145, 1e160, math.inf])
def test_a_search_stops_where_derivatives_are_too_large_for_a_number(linear, steep):
    """Beside a sharp guide's friction the tangents were 1e229: their squares overflowed, and the step was NaN."""

    def cliff(u, local, derivatives):
        value, jacobian = linear[0](u, local, derivatives)
        if derivatives and np.any(u):
            jacobian = jacobian.copy()
            jacobian[5] *= steep
        return value, jacobian

    task = problem(cliff, weights=np.full(CYCLES, 1e12))
    found = minimise(task)
    assert found.outcome == "no progress"
    assert np.isfinite(found.u).all()
    assert np.isfinite(found.blocks.H).all()
    assert minimise(task, 1.0) is None


def test_a_prior_pulls_with_its_precision():
    task = problem(
        lambda u, local, _: (np.array([u[0] - 1.0 + local[0, 0]]), np.array([[1.0, 1.0]])),
        (slice(0, 1),),
        1,
        1,
        weights=np.array([4.0]),
        prior=np.array([3.0]),
        precision=np.array([4.0]),
        local_precision=np.array([[1e12]]),
    )
    assert minimise(task, 10.0).u[0] == pytest.approx(2.0, abs=1e-6)


def test_a_start_that_cannot_be_followed_gives_none_and_steps_there_are_refused():
    assert minimise(problem(lambda *_: None)) is None

    def evaluate(u, local, derivatives):
        return None if u[0] < 0.5 else (np.array([u[0]]), np.array([[1.0, 0.0]]))

    found = minimise(problem(evaluate, (slice(0, 1),), 1, 1, local_precision=np.ones((1, 1))), 2.0)
    assert 0.5 <= found.u[0] < 0.7
    assert math.isfinite(found.cost)
