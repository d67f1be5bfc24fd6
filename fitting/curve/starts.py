"""Where the search for a curve starts: the law's own curve, and what the weak form gives."""

from dataclasses import dataclass

import numpy as np

from daq.base.compute.arrays import Array
from fitting.curve.weak_form import LOWEST_LEVEL, weak_form
from fitting.estimation.covariance import scaled_inverse
from fitting.estimation.fit import Fit
from fitting.model.parameters import PER_RUN, Global, PerCycle
from fitting.model.starts import break_away_position
from fitting.sensitivity.path import Curve
from fitting.sensitivity.spline import FrictionSpline
from rig_sim.friction.curve import magnitude
from rig_sim.friction.law import LAWS

LOW_SPEED = 0.06  # of the last knot: the weak form sees little below, where one start takes the load at the break-away
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
    """Return starts by the weak form; none on a ramp, or where it fails.

    The first replaces the weak form's curve at low speed, where it sees little, by one that begins with the load at the
    break-away.  A start with more friction at rest than that load sticks in every window, one with far less slips too
    early: both ended in poor minima.  The damping is the calibrated one: a wrong law's, up to 30 standard errors off,
    led a search without a datum far along the valley of datum and damping.
    """
    spline = curve.spline
    u = fit.u.copy()
    u[Global.DAMPING :: PER_RUN] = fit.problem.start[Global.DAMPING :: PER_RUN]
    seen = None if spline is None or curve.ramp else weak_form(fit.problem, u, spline)
    if spline is None or seen is None:
        return []
    K, coefficients, level = seen
    if not (K > 0 and np.median(coefficients) > 0):
        return []
    u[Global.K :: PER_RUN] = K
    level = np.log(np.maximum(level, LOWEST_LEVEL))
    own = fit.windows.starting_values(fit.problem.motions)
    own[:, PerCycle.LEVEL], own[:, PerCycle.NEXT_LEVEL] = level, np.append(level[1:], 0.0)
    anchored = coefficients.copy()
    low = max(3, int(np.sum(spline.knots < LOW_SPEED * spline.knots[-1])) + 1)
    anchored[:low] = np.linspace(_friction_at_rest(fit, u), anchored[low], low, endpoint=False)
    return [CurveStart(u, anchored, own), CurveStart(u, coefficients, own)]


def _friction_at_rest(fit: Fit, u: Array) -> float:
    """Return the load at the break-aways, m/s^2; friction at rest is less where a contact breaks away above it."""
    loads = [
        own[Global.K] * (break_away_position(run.motion, run.cut) - own[Global.DATUM])
        + own[Global.DAMPING] * own[Global.V_DR]
        for run, own in zip(fit.problem.runs, u.reshape(-1, PER_RUN), strict=True)
    ]
    return float(np.median(loads))


def project(spline: FrictionSpline, s: Array) -> Array:
    """Return the matrix (coefficients, k) from values at speeds s (k,) to the coefficients of the nearest spline."""
    basis = spline.basis(s)
    square = np.einsum("ki,kj->ij", basis, basis)
    scale, inverse = scaled_inverse(square, np.diag(square))
    return np.asarray(np.einsum("ij,kj->ik", inverse * scale[:, None] * scale, basis))
