"""A free spline as the friction curve, fitted to the measured positions of every window by the driver.

Unknown are the law's shared parameters but its own level and shape, the coordinates of the curve's coefficients, and
each cycle's own six.  The search starts where a law ended and at the regression of the smoothed slips.
"""

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from fitting.curve.level import assumed_rest, law_scatters, levels_scatter, moved_to, rest_prior, unseen
from fitting.driver.coordinates import CurveCoordinates
from fitting.driver.curves import FreeCurve
from fitting.driver.driver import best_end
from fitting.driver.fit import Fit
from fitting.driver.passes import finish, regressed_start
from fitting.driver.task import FitStart, Task, curve_knots, free_curve_task, regressed_curve
from fitting.estimation.linearised import LinearisedFit
from fitting.least_squares.levenberg_marquardt import Solution
from fitting.least_squares.problem import LeastSquaresProblem
from fitting.model.parameters import PER_RUN, Global, PerCycle
from fitting.model.problem import EstimationProblem
from fitting.sensitivity.path import Path
from fitting.sensitivity.spline import FrictionSpline
from stickslip.compute.arrays import Array, Mask
from stickslip.units import Measured


@dataclass(frozen=True, eq=False)
class SplineFit:
    fit: Fit  # the law's, whose windows, calibrations and contact it has
    at: Fit  # where the driver ended
    path: Path  # along every sample, with the curve
    noise: Array  # (runs,) standard deviation of one position, m
    rest: Measured | None  # of the first run's spring, where no datum was fitted (`fitting.curve.level`)

    @property
    def places(self) -> tuple[int, ...]:
        """The shared unknowns, without the curve's (`fitting.model.parameters`)."""
        return self.at.task.places

    @property
    def basis(self) -> CurveCoordinates:
        """The coordinates of the curve's coefficients."""
        curve = self.at.task.curve
        if not isinstance(curve, FreeCurve):
            raise TypeError("a spline fit has a free curve")
        return curve.basis

    @property
    def task(self) -> LeastSquaresProblem:
        """The problem of the last pass: unknowns are ``places``, then the curve's coordinates."""
        return self.at.least_squares

    @property
    def solution(self) -> Solution:
        return self.at.solution

    @property
    def spline(self) -> FrictionSpline:
        spline = self.path.curve.spline
        if spline is None:
            raise RuntimeError("a spline fit follows a spline")
        return spline

    @property
    def u(self) -> Array:
        return self.path.u

    @cached_property
    def chi(self) -> float:
        """Weighted rms residual over the noise."""
        task = self.task
        w = np.repeat(task.weights, [rows.stop - rows.start for rows in task.rows])
        own = self.noise[self.at.windows.run][task.owner]
        return math.sqrt(float(np.sum(w * self.at.residual**2) / np.sum(w * own**2)))

    @property
    def inlier(self) -> Mask:
        """Inlier cycles (cycles,)."""
        return self.at.noise.inliers

    def scatters(self, noise: Array) -> bool:
        """Return `fitting.curve.level.levels_scatter` by the friction at the belt's speed; ``noise`` is (runs,)."""
        friction = float(self.spline(self.u[[Global.V_DR]])[0])
        return levels_scatter(self.solution, self.inlier, friction / float(self.u[Global.K]), noise)

    def linearised(self) -> LinearisedFit:
        """Return the problem made linear at the solution; the curve's coordinates are the last unknowns.

        An assumed rest position stays as uncertain as assumed.
        """
        linear = LinearisedFit.at(self.at)
        if linear is None:
            raise RuntimeError("a spline fit has a path")
        if self.rest is None:
            return linear
        place, beside = self.places.index(Global.DATUM), unseen(self.places, self.path)
        shared, precision = linear.shared.copy(), linear.prior_precision.copy()
        shared[:, place] = -np.einsum("ij,j->i", shared[:, : beside.size], beside)
        precision[place, place] = 1 / self.rest.sd**2
        return replace(linear, shared=shared, prior_precision=precision)


def fit_spline(fit: Fit, noise: Array) -> SplineFit | None:
    """Fit a spline on the contact (jump or ramp) of its best law; None where its motion cannot be followed."""
    rest = assumed_rest(fit)
    if rest is None:
        return _fit_spline(fit, noise, None)
    # the residuals of a wrong law can make its levels scatter: the curve decides
    scatter = law_scatters(fit, noise)
    found = _fit_spline(fit, noise, None if scatter else rest)
    if found is None or found.scatters(noise) == scatter:
        return found
    return _fit_spline(fit, noise, rest if scatter else None)


def _fit_spline(fit: Fit, noise: Array, rest: Measured | None) -> SplineFit | None:
    """Fit a spline with an assumed rest position, or with a free one."""
    beside = _beside_law(fit, rest)
    if beside is None:
        return None
    task, law_end = beside
    starts = [(law_end, fit.noise.without_fade), *((start, None) for start in _regressed(task))]
    settled = best_end(task, starts, noise)
    found = None if settled is None else finish(settled, noise) or settled
    if found is None or found.path is None:
        return None
    return SplineFit(fit, found, found.path, noise, rest)


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
    problem, curve = task.problem, task.curve
    if not isinstance(curve, FreeCurve):
        raise TypeError("not the task of a free curve")
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
