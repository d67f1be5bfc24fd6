"""What a pass of a law's fit minimises: on which samples, over which unknowns, with which priors."""

import numpy as np

from daq.base.compute.arrays import Array, Integers
from fitting.data.frame import MeasuredMotion
from fitting.estimation.fit import Fit, PassState
from fitting.least_squares.problem import Evaluate, LeastSquaresProblem
from fitting.model import parameters
from fitting.model.parameters import PER_RUN, RIPPLE, Global, PerCycle
from fitting.model.problem import EstimationProblem
from fitting.model.shooting import evaluator
from fitting.model.windows import ShootingWindows

COARSE = 62.5  # samples a slip: residuals are correlated over many samples, and the search runs on a thinned record
STICK_SPEED_SD = 0.05  # of the belt's speed: how well smoothing knows the speed in the middle of a stick


def fitted_windows(problem: EstimationProblem, *, thinned: bool) -> ShootingWindows:
    """Return the windows of all runs, of every sample or thinned to `COARSE` a slip."""
    return ShootingWindows.join(
        [
            ShootingWindows.from_cycles(run.motion, run.cut.used, coarse_stride(run.motion) if thinned else 1)
            for run in problem.runs
        ]
    )


def coarse_stride(motion: MeasuredMotion) -> int:
    """Return every how many samples one is left of a record thinned to `COARSE` a slip."""
    return max(1, round(motion.time.size / motion.span * motion.slip_s / COARSE))


def priors(problem: EstimationProblem, state: PassState) -> tuple[Array, Array]:
    """Return means and precisions of the shared unknowns' priors."""
    prior, precision = problem.prior.copy(), problem.precision.copy()
    if state.fade_sd is not None:
        precision[Global.FADE :: PER_RUN] = [1 / sd**2 for sd in state.fade_sd]
    return prior, precision


def fit_objective(fit: Fit) -> LeastSquaresProblem:
    """Return what the last pass of a fit minimised."""
    return pass_objective(fit.problem, fit.windows, fit.state, list(fit.active))


def pass_objective(
    problem: EstimationProblem, windows: ShootingWindows, state: PassState, index: list[int]
) -> LeastSquaresProblem:
    """Return what a pass minimises when it moves the shared unknowns at ``index``."""
    prior, precision = priors(problem, state)
    wide = [(0.1 * motion.travel, motion.belt_speed) for motion in problem.motions]
    local_sd = np.array([[x, v, 0.0, 0.0, x, STICK_SPEED_SD * v] for x, v in wide])[windows.run]
    local_sd[:, PerCycle.LEVEL : PerCycle.NEXT_LEVEL + 1] = state.level_sd(windows, problem.level_prior)

    def some(u: Array, cycles: Integers) -> Evaluate:
        full = state.u.copy()
        full[index] = u
        full = parameters.copy_shared(full)
        return evaluator(
            problem.curve, problem.ramp, windows.some(cycles), full, [], problem.scale, problem.local_scale
        )

    return LeastSquaresProblem(
        evaluate=evaluator(problem.curve, problem.ramp, windows, state.u, index, problem.scale, problem.local_scale),
        some=some,
        rows=windows.rows,
        weights=state.weights / state.sigma[windows.run] ** 2,
        lower=problem.lower[index],
        upper=problem.upper[index],
        prior=prior[index],
        precision=precision[index],
        local_prior=windows.starting_values(problem.motions),
        local_precision=1 / local_sd**2,
    )


def active_unknowns(problem: EstimationProblem, state: PassState) -> tuple[int, ...]:
    """Return the unknowns that a pass moves.

    A ramp's break-away level is moved only where it gains something (`trajectory`).

    Fading comes last: the levels must be known first, whose trend says about how much of it there may be.  So does a
    ripple, which the sticks have shown well enough: far from the end its phase would be turned to please the slips.
    """
    late = () if state.fade_sd is not None else (Global.FADE, *RIPPLE)
    late = late if state.static else (*late, Global.STATIC)
    return tuple(place for place in problem.active if place % PER_RUN not in late)
