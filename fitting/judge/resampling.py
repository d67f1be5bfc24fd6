"""Errors of a fitted law without a covariance: bootstrap over cycles, and profile likelihood.

Bootstrap.  Residuals are correlated within a cycle, and the friction level is new in each.  So cycles are resampled,
with the exponential weights of the Bayesian bootstrap (D. Rubin, Ann. Statist. 9 (1981) 130), which omit none.
Calibrations are drawn from their errors.  Each draw is fitted with a warm start.

Profile.  One parameter is fixed at several values and all others are fitted again.  The deviance is twice the rise of
the objective: in a linear problem it is the square of the distance in standard errors.  It excludes the errors of the
metres per count and of the mass, which only scale the result.
"""

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from fitting.judge.parameters import Parameter, covariances, independent_parameters, unknown_of
from fitting.least_squares import levenberg_marquardt
from fitting.least_squares.levenberg_marquardt import Solution
from fitting.least_squares.normal_equations import LeastSquaresProblem
from fitting.record.motion import MeasuredMotion
from fitting.search.fit import Fit
from stickslip.compute.arrays import Array
from stickslip.errors import DataError, InputError, nearest

FIRST_DAMPING = 1e-6  # damping over the curvatures; each fit starts near its minimum, which does not depend on it
FEWEST_FITTED = 0.9  # share of draws that must be fitted: the outermost tenth is 44 % of a normal variance
# Reach in standard errors on either side, and fits on each.
PROFILE_REACH, PROFILE_STEPS = 3.0, 6


def bootstrap(fit: Fit, motion: MeasuredMotion, n: int, seed: int | None) -> dict[str, Array]:
    """Return parameters of n draws: by name arrays (draws,), per unit mass, of the first run."""
    if not (isinstance(n, int) and n >= 2):
        raise InputError(
            f"n must be a whole number, 2 or more, not {n!r}",
            "bootstrap",
            "use 200 draws to obtain a standard error to within 5 %",
        )
    rng, problem = np.random.default_rng(seed), fit.least_squares
    independent = independent_parameters(fit, motion)
    spread = np.where(problem.precision > 0, 1 / np.sqrt(np.where(problem.precision > 0, problem.precision, 1.0)), 0.0)
    draws = []
    for _ in range(n):
        weight = rng.exponential(size=problem.weights.size)
        prior = problem.prior + spread * rng.standard_normal(spread.size)
        scale, unconstrained = (1 + motion.length_error * float(rng.standard_normal()), float(rng.standard_normal()))
        draw = replace(
            problem,
            weights=problem.weights * weight,
            local_precision=problem.local_precision * weight[:, np.newaxis],
            prior=np.clip(prior, problem.lower, problem.upper),
        )
        solution = _refit(draw, fit.q, fit.local)
        if solution is not None:
            draws.append(independent.at(solution.u, unconstrained) * scale**independent.lengths)
    if len(draws) < FEWEST_FITTED * n:
        message = f"{n - len(draws)} of {n} bootstrap samples could not be fitted"
        raise DataError(message, "bootstrap", "use the standard errors of the covariance, or record more cycles")
    return dict(zip(independent.names, np.array(draws).T, strict=True))


def profile(fit: Fit, motion: MeasuredMotion, parameters: Mapping[str, Parameter], name: str) -> dict[str, Array]:
    """Return ``value`` (k,) of a parameter, and with it fixed there ``deviance`` (k,) and ``rms_m`` (k,).

    Unknown, fixed or dependent parameters raise InputError, a motion that cannot be followed DataError.
    """
    if name not in parameters:
        raise InputError(f"law {fit.law.name} has no parameter {name!r}", "profile", nearest(name, list(parameters)))
    parameter, unknown = parameters[name], unknown_of(fit, motion, name)
    if unknown is None:
        profiled = [other for other in parameters if unknown_of(fit, motion, other) and not parameters[other].fixed]
        raise InputError(f"{name} is computed from other parameters", "profile", f"choose one of {', '.join(profiled)}")
    (index, value), problem = unknown, fit.least_squares
    if parameter.fixed or problem.lower[index] == problem.upper[index]:
        raise InputError(f"{name} is fixed", "profile", "choose a fitted parameter, or remove it from fix")
    minimum = _refit(problem, fit.q, fit.local) or fit.solution
    middle = float(minimum.u[index])
    sd = math.sqrt(max(float(covariance[index, index]) for covariance in covariances(fit)))
    points = [(value(middle), minimum)]
    for side in (-1.0, 1.0):
        neighbour = minimum
        for step in range(1, PROFILE_STEPS + 1):
            u = middle + side * PROFILE_REACH * step / PROFILE_STEPS * sd
            if not problem.lower[index] <= u <= problem.upper[index]:
                break
            solution = _refit(_hold_unknown(problem, index, u), neighbour.u, neighbour.local)
            if solution is None:
                break
            neighbour = solution
            points.append((value(u), solution))
    if len(points) == 1:
        raise DataError(f"the motion cannot be computed for other values of {name}", "profile", "use its interval")
    points.sort(key=lambda point: point[0])
    return {
        "value": np.array([x for x, _ in points]),
        "deviance": np.array([2 * (solution.cost - minimum.cost) for _, solution in points]),
        "rms_m": np.array([float(np.sqrt(np.mean(solution.residual**2))) for _, solution in points]),
    }


def _hold_unknown(problem: LeastSquaresProblem, index: int, value: float) -> LeastSquaresProblem:
    lower, upper = problem.lower.copy(), problem.upper.copy()
    lower[index] = upper[index] = value
    return replace(problem, lower=lower, upper=upper)


def _refit(problem: LeastSquaresProblem, u: Array, local: Array) -> Solution | None:
    return levenberg_marquardt.minimise(problem, u, local, damping=FIRST_DAMPING)
