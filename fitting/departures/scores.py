"""Score tests: how much of a fit's residual one more parameter would explain, and how significantly.

The columns of a departure are projected off everything that the fit adjusts (`fitting.estimation.linearised`), so one
linear step gives its parameters.  Their error is a jackknife over the cycles: residuals are correlated within a cycle,
and cycles are independent.

Source: D. R. Cox, D. V. Hinkley, Theoretical Statistics, 1974, 9.3 (score tests); B. Efron, C. Stein, Ann. Statist. 9
(1981) 586 (the jackknife).
"""

import math
from dataclasses import dataclass

import numpy as np

from fitting.distributions import fisher_log_tail, normal_quantile
from fitting.estimation.linearised import LinearisedFit
from stickslip.compute.arrays import Array

# Share of a column's curvature left after the projection: with no more, the fit already adjusts it.  Derivatives
# err by 3e-6 of their size, so 1e-11 is rounding.  Quadratic drag, the least distinguishable beside a damping and a
# law's shape, keeps 2e-7; at 1e-6 it was never found.
LEAST_KEPT = 1e-9
# What is added to a curvature, over it: two columns that do the same stay solvable, and no estimate changes by more.
RIDGE = 1e-12


@dataclass(frozen=True, eq=False)
class Score:
    coefficients: Array  # (k,)
    covariance: Array  # (k, k) the jackknife's over the cycles, and at least that of the noise
    gain: float  # by how much the cost falls
    log_p: float  # log of the probability of as large a step by chance, from the jackknife alone


def score(base: LinearisedFit, columns: Array) -> Score | None:
    """Test a departure with the derivatives ``columns`` (N, 1 or 2).

    None where the fit already adjusts its parameters, fewer than four cycles remain, or a single cycle shows it.
    """
    scores = base.scores(columns)
    information, total = scores.information, scores.score
    k, n = total.shape[1], int(np.sum(np.any(total != 0, axis=1)))
    whole, gradient = scores.total_information, scores.total
    kept = float(np.min(np.diag(whole) / np.maximum(scores.raw, 1e-300)))
    if not kept > LEAST_KEPT or n < k + 3:
        return None
    coefficients = -solve(whole, gradient)
    others = whole - information
    if np.any(np.einsum("nii->ni", others) <= RIDGE * np.diag(whole)):
        return None  # one cycle alone shows it: there is no other to compare with
    steps = -solve(others, gradient - total)
    beside = steps - steps.mean(axis=0)
    jackknife = (n - 1) / n * np.einsum("ck,cl->kl", beside, beside)
    noise = np.diag(solve(whole, np.eye(k)))
    floor = np.sqrt(np.maximum(noise / np.maximum(np.diag(jackknife), 1e-300), 1.0))
    return Score(
        coefficients=coefficients,
        covariance=jackknife * floor[:, np.newaxis] * floor,
        gain=-0.5 * float(np.sum(gradient * coefficients)),
        log_p=log_probability(coefficients, jackknife, n),
    )


def log_probability(coefficients: Array, covariance: Array, cycles: int) -> float:
    """Return the log p-value of coefficients (k,) by Hotelling's T^2 of the cycles."""
    k, n = coefficients.size, cycles
    statistic = float(np.sum(coefficients * solve(covariance, coefficients)))
    return fisher_log_tail(statistic * (n - k) / (k * (n - 1)), k, n - k)


def sigmas(log_p: float, trials: float = 1.0) -> float:
    """Return the standard deviations of a normal variable with two-sided tail exp(log_p), after so many trials."""
    log_tail = min(log_p + math.log(max(trials, 1.0)), 0.0) - math.log(2)
    if log_tail > -700:
        return max(-normal_quantile(math.exp(log_tail)), 0.0)
    return math.sqrt(-2 * log_tail - math.log(-2 * log_tail * 2 * math.pi))


def solve(matrix: Array, right: Array) -> Array:
    """Solve for one or two unknowns each, (..., k), in units of the diagonal of the matrices (..., k, k)."""
    scale = 1 / np.sqrt(np.maximum(np.einsum("...kk->...k", matrix), 1e-300))
    scaled = matrix * scale[..., :, np.newaxis] * scale[..., np.newaxis, :] + RIDGE * np.eye(scale.shape[-1])
    return np.asarray(scale * np.linalg.solve(scaled, (scale * right)[..., np.newaxis])[..., 0])
