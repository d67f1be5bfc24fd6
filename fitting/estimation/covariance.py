"""Intervals: a sandwich over cycles, calibrations as priors, t quantile.

Residuals of a slightly wrong model are correlated within a cycle and independent between cycles, so the spread of the
cycles' gradients shows how far the estimate would move with other cycles.  With few cycles the sandwich can be too
small; the curvature at the noise level rms x sqrt(correlation time) is the floor.  In it a cycle informs by no more
than its residuals allow: under constant friction only the drag of a start-up constrains the belt's speed, so that no
other cycle shows how far a belt's ripple moves it.

The errors of the levels must not inform the parameters (`without_level_errors`).

Without a datum the prior of the friction levels is wider than their scatter (`EstimationProblem.level_prior`).  The
floor is then the covariance of the estimate under the true scatter.
"""

import math
from dataclasses import replace

import numpy as np

from fitting.driver.fit import Fit
from fitting.least_squares.levenberg_marquardt import linearise
from fitting.least_squares.normal_equations import ROUNDING, SchurComplement, eigen, scaled_inverse
from fitting.model.parameters import PerCycle
from stickslip.compute.arrays import Array, autocorrelation_time

# Variance of a cycle's residuals over what the fit assumes, at the most, since a correlation time from one
# window is uncertain.  With 4 the error of the belt's speed from a drag on a rippling belt would be too small by 2.
LARGEST_VARIANCE = 2.0
# Scatter of the levels beyond their errors, in standard errors of a mean square, from which they inform.  With 20
# cycles that is a scatter as large as the errors, which noise alone shows once in 150 contacts; with half of it once in
# 13, with twice of it the scatter must be 1.4 times the errors.
SCATTER_ERRORS = 3.0


def without_level_errors(fit: Fit) -> Fit:
    """Return a fit whose curvatures are those at the levels without their errors.

    Without a datum a ramp law constrains only Fs/d, v_dr - d and x0 + Fs/k, unless the friction level changes between
    cycles. Levels that differ only by their errors would count as such a change, and v_dr would get an interval a
    hundred times too narrow.
    """
    if fit.problem.level_prior <= 1 or not fit.inlier_cycles.any():
        return fit
    local = fit.local.copy()
    for column in (PerCycle.LEVEL, PerCycle.NEXT_LEVEL):
        true, error = _true_square(fit, column)
        local[:, column] *= true / (true + error)
    there, here = linearise(fit.least_squares, fit.solution.u, local), fit.solution.blocks
    if there is None:
        return fit
    blocks = replace(there.blocks, g=here.g, gl=here.gl, cycle_g=here.cycle_g)
    return replace(fit, solution=replace(fit.solution, blocks=blocks))


def levels_differ(fit: Fit) -> bool:
    return _true_square(fit, PerCycle.LEVEL)[0] > 0


def _true_square(fit: Fit, column: PerCycle) -> tuple[float, Array]:
    """Return the mean square of a cycle's unknown beyond its expected errors, and the squares (cycles,)."""
    own = fit.inlier_cycles
    error = np.asarray(np.linalg.inv(fit.solution.blocks.Hl)[:, column, column])
    likely = float(np.mean(error[own])) * (1 + SCATTER_ERRORS * math.sqrt(2 / own.sum()))
    return max(float(np.mean(fit.local[own, column] ** 2)) - likely, 0.0), error


def covariance(fit: Fit) -> Array:
    """Return a covariance (p, p) of the unknowns not smaller than either of `covariances`.

    A variance in it may exceed both: for one quantity take the larger of both variances.
    """
    return upper_bound(*covariances(fit))


def covariances(fit: Fit) -> tuple[Array, Array]:
    """Return the covariances (p, p) of the unknowns, the curve's last, by the sandwich and by the curvature.

    The priors are so many more independent sources.
    """
    blocks = fit.solution.blocks
    reduced = SchurComplement(blocks)
    H = reduced.H
    own = reduced.reduced_gradients(blocks.cycle_g, reduced.local_step(blocks.gl))
    cycles = own.shape[0]
    scale, bread = scaled_inverse(H, np.diag(blocks.H))
    own = own * scale
    priors = np.diag(fit.least_squares.precision * scale**2)
    meat = np.einsum("ci,cj->ij", own, own) * (cycles / max(cycles - 1, 1)) + priors
    sandwich = np.einsum("ik,kl->il", np.einsum("ik,kl->il", bread, meat), bread)
    share = _founded(fit)
    informed = np.einsum("c,cpr->pr", share - 1, reduced.by_cycle(blocks.cycle_curvature))
    own_scale, limited = scaled_inverse(H + informed, np.diag(blocks.H))
    if fit.problem.level_prior > 1:
        narrower = np.einsum("c,cpr->pr", share, reduced.by_prior(_excess(fit))) * own_scale[:, None] * own_scale
        limited = limited - np.einsum("ij,jk,kl->il", limited, narrower, limited)
    return sandwich * scale[:, None] * scale, limited * own_scale[:, None] * own_scale


def upper_bound(first: Array, second: Array) -> Array:
    """Return a covariance (p, p) that is in no direction smaller than either of two.

    In the basis in which the second is 1 and the first diagonal it is the larger of both. Raising the variances with
    fixed correlations would not do: where Fs and gamma are strongly correlated, it would give the friction's slope at
    the belt's speed an error that neither covariance allows.
    """
    unit = np.sqrt(np.diag(second))
    size, axes = eigen(second / unit[:, None] / unit)
    root = np.sqrt(np.maximum(size, ROUNDING))
    back, there = axes / root / unit[:, None], axes * root * unit[:, None]
    ratio, turn = eigen(np.einsum("ki,kl,lj->ij", back, first, back))
    half = np.einsum("ik,kj->ij", there, turn) * np.sqrt(np.maximum(ratio, 1.0))
    return np.asarray(np.einsum("ik,jk->ij", half, half))


def _founded(fit: Fit) -> Array:
    """Return the share (cycles,) of a cycle's information that its residuals allow."""
    assumed = 1 / fit.least_squares.weights
    own = np.full(assumed.size, 1e-300)
    for cycle, _, first, size, *_ in fit.windows.table:  # a drag is a window of the first cycle
        part = fit.residual[first : first + size]
        own[cycle] = max(own[cycle], float(np.mean(part**2)) * autocorrelation_time([part]))
    return np.asarray(np.minimum(LARGEST_VARIANCE * assumed / own, 1.0))


def _excess(fit: Fit) -> Array:
    """Return the excess precision (cycles, q) of the levels by which the prior is wider than their scatter."""
    sd = fit.noise.level_sd(fit.windows, fit.problem.level_prior)
    excess = (1 - (fit.noise.scatter / sd) ** 2) / sd**2
    found = np.zeros_like(fit.solution.blocks.gl)
    found[:, PerCycle.LEVEL : PerCycle.NEXT_LEVEL + 1] = np.where(fit.inlier_cycles[:, None], excess, 0.0)
    return found
