"""Where the search for a curve starts: the law's own curve, and what the weak form gives."""

from dataclasses import dataclass

import numpy as np

from daq.compute.arrays import Array
from fitting.curve.weak_form import LOWEST_LEVEL, weak_form
from fitting.estimation.covariance import scaled_inverse
from fitting.estimation.fit import Fit
from fitting.model.parameters import PER_RUN, Global, PerCycle
from fitting.sensitivity.path import Curve
from fitting.sensitivity.spline import FrictionSpline
from rig_sim.friction.curve import magnitude
from rig_sim.friction.law import LAWS

LOW_SPEED = 0.06  # of the last knot: the weak form sees little below, and one start goes on straight from there
STEEPEST_START = 0.3  # of the friction there, from one coefficient to the next
PER_PIECE = 20  # speeds at which a law's curve is projected on the spline


@dataclass(frozen=True, eq=False)
class CurveStart:
    """Shared unknowns (13 runs,), coefficients of the curve (n,), m/s^2, and the cycles' own unknowns (cycles, 6)."""

    u: Array
    coefficients: Array
    local: Array


def own_start(fit: Fit, curve: Curve) -> CurveStart:
    """Return the law's own curve and motion as a start."""
    spline = curve.spline
    if spline is None:
        raise RuntimeError("no spline to start")
    law, p = LAWS[fit.law], fit.values
    s = np.linspace(0.0, spline.knots[-1], PER_PIECE * (spline.knots.size - 1))
    target = magnitude(law.curve_code, s, p.F, p.shape * p.F, p.shape)
    smoothed = fit.windows.starting_values(fit.problem.motions)
    local = fit.local.copy()
    if not law.ramp:  # a start that the law put beyond the belt's speed begins at the smoothed motion again
        beyond = local[:, PerCycle.V_SLIP] > fit.windows.fastest_starts(fit.u)[:, PerCycle.V_SLIP]
        local[beyond, : PerCycle.LEVEL] = smoothed[beyond, : PerCycle.LEVEL]
    return CurveStart(fit.u, np.einsum("ik,k->i", project(spline, s), np.asarray(target)), local)


def weak_starts(fit: Fit, curve: Curve) -> list[CurveStart]:
    """Return starts by the weak form, at first made straight at low speed; none on a ramp, or where it fails."""
    spline = curve.spline
    seen = None if spline is None or curve.ramp else weak_form(fit.problem, fit.u, spline)
    if spline is None or seen is None:
        return []
    K, coefficients, level = seen
    if not (K > 0 and np.median(coefficients) > 0):
        return []
    u = fit.u.copy()
    u[Global.K :: PER_RUN] = K
    level = np.log(np.maximum(level, LOWEST_LEVEL))
    own = fit.windows.starting_values(fit.problem.motions)
    own[:, PerCycle.LEVEL], own[:, PerCycle.NEXT_LEVEL] = level, np.append(level[1:], 0.0)
    straight = coefficients.copy()
    low = max(3, int(np.sum(spline.knots < LOW_SPEED * spline.knots[-1])) + 1)
    fall = np.clip(straight[low] - straight[low + 1], 0.0, STEEPEST_START * abs(straight[low]))
    straight[:low] = straight[low] + np.arange(low, 0, -1) * fall
    return [CurveStart(u, straight, own), CurveStart(u, coefficients, own)]


def project(spline: FrictionSpline, s: Array) -> Array:
    """Return the matrix (coefficients, k) from values at speeds s (k,) to the coefficients of the nearest spline."""
    basis = spline.basis(s)
    square = np.einsum("ki,kj->ij", basis, basis)
    scale, inverse = scaled_inverse(square, np.diag(square))
    return np.asarray(np.einsum("ij,kj->ik", inverse * scale[:, None] * scale, basis))
