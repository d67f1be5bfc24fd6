"""The measured curve in the metric of the record: what a formula is compared with.

Minimised is (c(formula) - c)' I (c(formula) - c), c the coefficients of the measured curve and I the information on
them with everything else fitted again.  What the record does not show does not count.
"""

from typing import NamedTuple

import numpy as np

from fitting.curve.result import MeasuredCurve
from fitting.driver.fit import Fit
from fitting.driver.start_search import Target
from fitting.driver.task import KNOT_POWER, free_curve
from fitting.least_squares.normal_equations import eigen
from fitting.model.parameters import Global
from stickslip.compute.arrays import Array

GRID_SPEEDS = 300  # speeds at which a formula is projected on the spline, as dense as the knots
LOW_COEFFICIENTS = 2  # coefficients, which act below a twentieth of the largest slip speed
LEAST_INFORMATION = 1e-12  # information over the largest: less is rounding


class MeasuredTarget(NamedTuple):
    """Target of a formula, in the directions of the curve's coefficients that the record constrains, without a prior.

    The distances have unit variance; ``level_sd`` (m/s^2) is that of a constant by which the whole curve may be off.
    """

    alone: Target
    level_sd: float

    @property
    def near(self) -> Target:
        """The target with the uncertainty of the level."""
        return self.alone.off_by_a_constant(self.level_sd)


def friction_target(fit: Fit) -> MeasuredTarget:
    """Return the measured curve as a target with equal weight on `GRID_SPEEDS`, for curves far from it."""
    speeds = _speeds(fit)
    friction = fit.spline(speeds)
    return MeasuredTarget(Target.of(speeds, friction, float(np.median(friction))), _level_sd(fit))


def measured_target(curve: MeasuredCurve) -> MeasuredTarget:
    """Return the measured curve as a target, in the metric of the record.

    Where the residuals exceed the noise, the metric uses them. The lowest coefficients are fitted again with each
    formula, since their effect is not linear.
    """
    fit, linear = curve.spline_fit, curve.linear
    basis, total = free_curve(fit.task).basis, linear.reduced.H
    places, n = len(fit.places), basis.precision.size
    turn = np.eye(places + n)
    turn[places:] = basis.inverse_slopes  # from coordinates to coefficients
    prior = np.zeros((places + n, places + n))
    prior[places:, places:] = np.diag(basis.precision)
    total, prior, data = (np.einsum("ki,kl,lj->ij", turn, one, turn) for one in (total, prior, total - prior))
    gradient = linear.gradients.sum(axis=0)
    gradient[:places] += linear.priors.gradient[:places]
    gradient = np.einsum("ki,k->i", turn, gradient)
    if fit.held_rest is not None:  # taken as known here: how far it may be off is `MeasuredTarget.level_sd`
        known = fit.places.index(Global.DATUM)
        data[known], data[:, known], prior[known, known], gradient[known] = 0.0, 0.0, 1.0, 0.0
    first = places + LOW_COEFFICIENTS
    others = data[:first, :first] + prior[:first, :first]
    cross = data[first:, :first]
    follow = followed(others, cross)
    own = data[first:, first:] - np.einsum("ik,kj->ij", cross, follow)
    size, axes = eigen(0.5 * (own + own.T))
    # shown is what the record knows better than the prior
    held = np.einsum("ik,ij,jk->k", axes, prior[first:, first:], axes)
    shown = size > np.maximum(held, LEAST_INFORMATION * size.max())
    deviation = np.sqrt(size[shown])
    root = np.zeros((deviation.size, n))
    root[:, LOW_COEFFICIENTS:] = deviation[:, None] * axes[:, shown].T
    # where the record alone would have the curve: not pulled by its prior, and at the very minimum
    pull = gradient[first:] - np.einsum("ki,k->i", follow, gradient[:first])
    aim = np.einsum("ki,i->k", root, fit.spline.coefficients)
    aim -= np.einsum("ik,i->k", axes[:, shown], pull) / deviation
    excess = max(curve.chi, 1.0)
    speeds = _speeds(fit)
    root = np.einsum("mn,nk->mk", root, fit.spline.projection(speeds))
    friction = float(np.median(fit.spline.coefficients))
    return MeasuredTarget(Target(speeds, root / excess, aim / excess, friction), _level_sd(fit))


def _speeds(fit: Fit) -> Array:
    return np.asarray(float(fit.spline.knots[-1]) * np.linspace(0.0, 1.0, GRID_SPEEDS) ** KNOT_POWER)


def _level_sd(fit: Fit) -> float:
    return 0.0 if fit.held_rest is None else fit.values.K * fit.held_rest.sd


def followed(curvature: Array, cross: Array) -> Array:
    """Return by how much some unknowns (p,) follow others (n,): inv(curvature) cross', shape (p, n).

    By a solution: an inverse left the weakest direction, 1e-8 of the strongest, to rounding, and forms that differed
    from the curve along it cost nothing. An unknown without curvature does not move.
    """
    found = np.zeros(cross.T.shape)
    seen = np.diag(curvature) > 0
    scale = 1 / np.sqrt(np.diag(curvature)[seen])
    scaled = curvature[np.ix_(seen, seen)] * scale[:, None] * scale
    found[seen] = scale[:, None] * np.linalg.solve(scaled, scale[:, None] * cross.T[seen])
    return found
