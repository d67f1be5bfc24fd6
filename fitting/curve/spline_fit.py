"""A free spline as the friction curve, fitted to the measured positions of every window by the driver.

Unknown are the law's shared parameters but its own level and shape, the coordinates of the curve's coefficients, and
each cycle's own six.  The search starts where a law ended and at the regression of the smoothed slips.
"""

import math
from dataclasses import replace

import numpy as np

from fitting.curve.level import assumed_rest, law_scatters, moved_to, rest_prior, unseen
from fitting.driver.driver import best_end
from fitting.driver.fit import Fit
from fitting.driver.passes import finish, regressed_start
from fitting.driver.task import FitStart, Task, curve_knots, free_curve, free_curve_task, regressed_curve
from fitting.estimation.linearised import LinearisedFit
from fitting.model.parameters import PER_RUN, Global, PerCycle
from fitting.model.problem import EstimationProblem
from fitting.sensitivity.spline import FrictionSpline
from stickslip.compute.arrays import Array
from stickslip.units import Measured


def linearised(fit: Fit) -> LinearisedFit:
    """Return the problem made linear at the solution; the curve's coordinates are the last unknowns.

    An assumed rest position stays as uncertain as assumed.
    """
    linear, curve, rest = LinearisedFit.at(fit), fit.curve_on_path, fit.held_rest
    if linear is None or curve is None:
        raise RuntimeError("a fitted curve has a path")
    if rest is None:
        return linear
    place, beside = fit.places.index(Global.DATUM), unseen(fit.places, curve, fit.u)
    precision = linear.priors.precision.copy()
    precision[place, place] = 1 / rest.sd**2

    def move(part: Array) -> Array:
        part = part.copy()
        part[:, place] = -np.einsum("ij,j->i", part[:, : beside.size], beside)
        return part

    return linear.changed(move, linear.priors._replace(precision=precision))


def chi(fit: Fit, noise: Array) -> float:
    """Return the weighted rms residual over the noise (runs,), m."""
    task = fit.least_squares
    w = task.weight
    own = noise[fit.windows.run].repeat(np.diff(task.first))
    return math.sqrt(float(np.sum(w * fit.residual**2) / np.sum(w * own**2)))


def fit_spline(fit: Fit, noise: Array) -> Fit | None:
    """Fit a spline on the contact (jump or ramp) of its best law; None where its motion cannot be followed."""
    rest = assumed_rest(fit)
    if rest is None:
        return _fit_spline(fit, noise, None)
    # the residuals of a wrong law can make its levels scatter: the curve decides
    scatter = law_scatters(fit, noise)
    found = _fit_spline(fit, noise, None if scatter else rest)
    if found is None or law_scatters(found, noise) == scatter:
        return found
    return _fit_spline(fit, noise, rest if scatter else None)


def _fit_spline(fit: Fit, noise: Array, rest: Measured | None) -> Fit | None:
    """Fit a spline with an assumed rest position, or with a free one."""
    beside = _beside_law(fit, rest)
    if beside is None:
        return None
    task, law_end = beside
    starts = [(law_end, fit.noise.without_fade), *((start, None) for start in _regressed(task))]
    settled = best_end(task, starts, noise)
    found = None if settled is None else finish(settled, noise) or settled
    return found if found is not None and found.can_be_followed else None


def _beside_law(fit: Fit, rest: Measured | None) -> tuple[Task, FitStart] | None:
    """Return the task of the free curve on a law's contact, and the law's fit as a start.

    None where the law's ramp is as wide as the slips are fast.
    """
    ramp = fit.law.ramp
    problem, local = _problem(fit, rest), fit.local.copy()
    knots = curve_knots(problem.runs, float(fit.u[Global.D]) if ramp else 0.0)
    if knots[-1] <= 0:
        return None
    spline = FrictionSpline.over(knots)
    s = np.linspace(0.0, knots[-1], 20 * knots.size)
    friction = fit.task.friction(fit.q, s)
    u, coefficients = fit.u, np.einsum("ik,k->i", spline.projection(s), friction)
    if rest is not None:
        u, coefficients = moved_to(u, coefficients, rest, ramp=ramp)
        local[:, PerCycle.LEVEL : PerCycle.NEXT_LEVEL + 1] = 0.0
    task = free_curve_task(problem, knots, u, coefficients)
    index = list(task.places)
    return task, FitStart(np.concatenate([u[index], task.curve.start]), _started_below(fit, local))


def _regressed(task: Task) -> list[FitStart]:
    """Return the start from the smoothed slips; none where their regression is absurd."""
    problem, curve = task.problem, free_curve(task)
    d = float(problem.start[Global.D]) if curve.ramp else 0.0
    found = regressed_curve(problem.runs, problem.start, curve.spline.knots, d)
    if found is None:
        return []
    own, start = regressed_start(task), problem.start.copy()
    start[Global.K :: PER_RUN] = found[0]
    beside = start[list(task.places)]
    return [own._replace(q=curve.basis.unknowns(beside, found[1]))]


def _started_below(fit: Fit, local: Array) -> Array:
    """Return the cycles' own unknowns; a start beyond the belt's speed is replaced by the smoothed motion's."""
    if fit.law.ramp:
        return local
    smoothed = fit.windows.starting_values(fit.problem.motions)
    beyond = local[:, PerCycle.V_SLIP] > fit.windows.fastest_starts(fit.u)[:, PerCycle.V_SLIP]
    local[beyond, : PerCycle.LEVEL] = smoothed[beyond, : PerCycle.LEVEL]
    return local


def _problem(fit: Fit, rest: Measured | None) -> EstimationProblem:
    """Return the law's problem with the prior of the rest positions."""
    problem = fit.problem
    prior, precision = problem.prior.copy(), problem.precision.copy()
    lower, upper, start = problem.lower.copy(), problem.upper.copy(), problem.start.copy()
    for number, run in enumerate(problem.runs):
        place, known = PER_RUN * number + Global.DATUM, rest_prior(run)
        prior[place], precision[place] = known.value, 1 / known.sd**2 if known.sd > 0 else precision[place]
        if number == 0 and rest is not None:
            lower[place] = upper[place] = start[place] = rest.value
    return replace(problem, prior=prior, precision=precision, lower=lower, upper=upper, start=start)
