"""The linearised fit agrees with a dense least-squares solution of the same problem, and with the fit itself."""

from dataclasses import replace

import numpy as np
import pytest

from fitting.judge.linearised import LinearisedFit
from fitting.least_squares.normal_equations import Block, Derivatives, Priors
from fitting.model.unknowns import Global

CYCLES, SAMPLES, SHARED, LOCAL, MORE = 4, 12, 3, 2, 2


@pytest.fixture
def problem():
    """Give a random problem, and the stacked matrix of all unknowns: shared, each cycle's, further ones."""
    rng = np.random.default_rng(3)
    n = CYCLES * SAMPLES
    rows = tuple(slice(SAMPLES * k, SAMPLES * (k + 1)) for k in range(CYCLES))
    root = rng.standard_normal((SHARED, SHARED))
    jacobian = rng.standard_normal((n, SHARED + LOCAL))
    residual, weights = rng.standard_normal(n), rng.uniform(0.5, 2.0, CYCLES)
    priors = Priors(
        root @ root.T,
        rng.standard_normal(SHARED),
        rng.uniform(0.1, 3.0, (CYCLES, LOCAL)),
        rng.standard_normal((CYCLES, LOCAL)),
    )
    halves = [Block(slice(k, k + 2), slice(SAMPLES * k, SAMPLES * (k + 2))) for k in (0, 2)]
    derivatives = Derivatives(halves, lambda block: jacobian[block.rows])
    found = LinearisedFit.of(derivatives, residual, rows, weights, priors)
    further = rng.standard_normal((n, MORE))
    dense = np.zeros((n, SHARED + CYCLES * LOCAL + MORE))
    dense[:, :SHARED], dense[:, -MORE:] = jacobian[:, :SHARED], further
    for k, own in enumerate(rows):
        dense[own, SHARED + LOCAL * k : SHARED + LOCAL * (k + 1)] = jacobian[own, SHARED:]
    return found, further, dense


def curvature(found, dense):
    """Return Gauss-Newton curvature and gradient of all unknowns of the dense problem, priors included."""
    weight = np.repeat(found.weights, SAMPLES)
    H, g = dense.T @ (weight[:, None] * dense), dense.T @ (weight * found.residual)
    H[:SHARED, :SHARED] += found.priors.precision
    g[:SHARED] += found.priors.gradient
    own = slice(SHARED, SHARED + CYCLES * LOCAL)
    H[own, own] += np.diag(found.priors.local_precision.ravel())
    g[own] += found.priors.local_gradient.ravel()
    return H, g


def test_information_is_the_schur_complement(problem):
    found, _, dense = problem
    H, _ = curvature(found, dense[:, :-MORE])
    total = found.reduced.H
    assert total == pytest.approx(np.linalg.inv(np.linalg.inv(H)[:SHARED, :SHARED]))
    assert found.reduced.covariance == pytest.approx(np.linalg.inv(total))


def test_a_refit_leaves_what_dense_least_squares_leave(problem):
    found, further, dense = problem
    H, _ = curvature(found, dense[:, :-MORE])
    weight = np.repeat(found.weights, SAMPLES)
    step = -np.linalg.solve(H, dense[:, :-MORE].T @ (weight[:, None] * further))
    assert found.refit_columns(further) == pytest.approx(further + dense[:, :-MORE] @ step)


@pytest.mark.parametrize("apart", [1e-7, 1e-9, 1e-11, 0.0])
def test_unknowns_that_rounding_hides_do_not_spoil_a_refit(problem, apart):
    """A level that a rest position hides took steps of 1e5 at an eigenvalue of -5e-12, and any residual was noise."""
    found, further, dense = problem
    columns = np.concatenate([part for _, part in found.derivatives])
    columns[:, 2] = columns[:, 0] + columns[:, 1] + apart * columns[:, 2]
    flat = found.priors._replace(precision=np.zeros((SHARED, SHARED)), gradient=np.zeros(SHARED))
    blocks = Derivatives(found.derivatives.blocks, lambda block: columns[block.rows])
    alike = LinearisedFit.of(blocks, found.residual, found.rows, found.weights, flat)
    two = [column for column in range(SHARED + CYCLES * LOCAL) if column != 2]
    H, _ = curvature(replace(found, priors=flat), dense[:, :-MORE])
    weighted = np.repeat(found.weights, SAMPLES)[:, None] * further
    step = -np.linalg.solve(H[np.ix_(two, two)], dense[:, two].T @ weighted)
    assert alike.refit_columns(further) == pytest.approx(further + dense[:, two] @ step, abs=1e-5)


def test_without_a_cycle_the_others_are_fitted_by_themselves(problem):
    found, _, dense = problem
    spoilt = np.array([False, True, False, False])
    left = found.without(spoilt)
    counted = np.repeat(~spoilt, SAMPLES)
    H, g = curvature(found, dense[:, :-MORE] * counted[:, None])
    expected = found.residual - dense[:, :-MORE] @ np.linalg.solve(H, g)
    assert left.residual[counted] == pytest.approx(expected[counted], abs=1e-3)


def test_scores_are_those_of_the_dense_problem(problem):
    found, further, dense = problem
    H, g = curvature(found, dense)
    known, more = H[:-MORE, :-MORE], H[-MORE:, :-MORE]
    scores = found.scores(further)
    information = H[-MORE:, -MORE:] - more @ np.linalg.solve(known, more.T)
    assert scores.information == pytest.approx(information)
    assert scores.gradient == pytest.approx(g[-MORE:] - more @ np.linalg.solve(known, g[:-MORE]))
    assert scores.raw == pytest.approx(np.diag(H)[-MORE:])


def test_a_fit_is_linearised_at_its_minimum(ranked_alone):
    """Gradients of all cycles and the priors cancel there, or point out of a bound; a refit moves next to nothing.

    The damping of this record ends at its bound 0, with a gradient of 0.35 standard errors.
    """
    fit = ranked_alone(5, law=5).best.fit
    found = LinearisedFit.at(fit)
    assert found.residual == pytest.approx(fit.residual, abs=1e-12)
    gradient = found.gradients.sum(axis=0) + found.priors.gradient
    gradient *= np.sqrt(np.diag(found.reduced.covariance))
    at_lower, at_upper = fit.q <= fit.least_squares.lower, fit.q >= fit.least_squares.upper
    names = np.array([Global(place).name for place in fit.places])
    assert set(names[at_lower | at_upper]) <= {"DAMPING"}
    assert np.abs(gradient[~(at_lower | at_upper)]).max() < 0.01
    assert gradient[at_lower].min(initial=0) >= 0
    assert gradient[at_upper].max(initial=0) <= 0
    noise = np.random.default_rng(1).standard_normal((fit.residual.size, 3))
    left = found.refit_columns(noise)
    unknowns = found.priors.gradient.size + 6 * len(found.rows)
    assert 0 < np.sum(noise**2) - np.sum(left**2) < 3 * unknowns
