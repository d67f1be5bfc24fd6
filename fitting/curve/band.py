"""The covariance of the measured curve and its simultaneous band.

A band that holds the whole curve is wider than the interval of one point: its factor is the quantile of the largest
deviation over all speeds, in standard deviations, found from normal draws.  As for the laws' parameters, both the
noise alone and the scatter of the cycles' gradients (sandwich) give a covariance, and the larger deviation counts at
each speed: with few cycles the sandwich comes out too small, with residuals that are not white the other.
"""

import numpy as np

from fitting.driver.fit import Fit
from fitting.driver.task import free_curve
from fitting.estimation.linearised import LinearisedFit
from fitting.least_squares.normal_equations import eigen
from fitting.model.parameters import Global
from stickslip.compute.arrays import Array

SPEEDS = 200  # speeds of the curve: the band is smooth between them
SEEN_FROM, SEEN_TO = 0.03, 0.985  # of the fastest slip: below, few samples; beyond, few cycles
DRAWS = 400  # the quantile of 95 % is then known to 2 %
SEED = 20_240  # the draws are the same for every record


def covariances(linear: LinearisedFit) -> tuple[Array, Array]:
    """Return the covariance (p, p) of the shared unknowns by the noise, and by the scatter between cycles."""
    noise = linear.covariance
    own = linear.gradients
    cycles = own.shape[0]
    meat = np.einsum("ci,cj->ij", own, own) * (cycles / max(cycles - 1, 1)) + linear.priors.precision
    return noise, np.einsum("ik,kl,lj->ij", noise, meat, noise, optimize=False)


def seen_speeds(fit: Fit) -> Array:
    """Return the slip speeds beyond the ramp (k,), m/s, of the band."""
    fastest = fit.spline.knots[-1]
    return np.linspace(SEEN_FROM * fastest, SEEN_TO * fastest, SPEEDS)


def curve_columns(fit: Fit, s: Array) -> Array:
    """Return derivatives (k, p) of friction at s beyond the ramp by the shared unknowns and the ramp's half-width."""
    found = np.asarray(np.einsum("ki,ij->kj", fit.spline.basis(s), free_curve(fit.task).basis.slopes))
    if Global.D in fit.places and fit.problem.ramp:
        h = 1e-4 * fit.spline.knots[-1]
        found[:, fit.places.index(Global.D)] = -(fit.spline(s + h) - fit.spline(s - h)) / (2 * h)
    return found


def half_widths(columns: Array, both: tuple[Array, Array], confidence: float, widening: float) -> Array:
    """Return the half-width of the band (k,), m/s^2.

    ``columns`` (k, p) are the curve's derivatives by the unknowns; ``confidence`` is that of the whole curve, and
    ``widening`` a factor for few cycles.
    """
    rng = np.random.default_rng(SEED)
    deviation, quantile = np.zeros(columns.shape[0]), 0.0
    for covariance in both:
        scale = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
        size, axes = eigen(covariance / scale[:, None] / scale)
        root = scale[:, None] * axes * np.sqrt(np.maximum(size, 0.0))
        along = np.einsum("kp,pq->kq", columns, root)
        own = np.sqrt(np.sum(along**2, axis=1))
        draws = rng.standard_normal((size.size, DRAWS))
        most = np.max(np.abs(np.einsum("kq,qn->kn", along, draws)) / np.maximum(own, 1e-300)[:, None], axis=0)
        quantile = max(quantile, float(np.quantile(most, confidence)))
        deviation = np.maximum(deviation, own)
    return np.asarray(widening * quantile * deviation)
