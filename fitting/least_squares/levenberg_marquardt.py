"""Levenberg-Marquardt for shared and per-cycle unknowns; the per-cycle ones are eliminated (Schur complement).

Minimises  1/2 sum_c w_c |r_c(u, l_c)|^2 + 1/2 sum ((u - u0)/sd)^2 + 1/2 sum_c sum ((l_c - l0_c)/sd)^2
over the shared unknowns u (p of them, within bounds) and the q unknowns l_c of each cycle c.  Each cycle's
normal equations are q x q, so the cost grows with the number of cycles, not with its cube.

The valley of a friction law is long and bent (its curve's shape, level, damping and datum trade against each other).
So each step has an acceleration: the second derivative of the residuals along the step, from one more evaluation, gives
the acceleration of a geodesic along the floor (Transtrum & Sethna, arXiv:1201.5885).  If a step fails because of a few
cycles, their own unknowns are fitted again with the shared unknowns of the step.  If the valley bends more than the
acceleration predicts, the trial point may be corrected with the derivatives already computed.
"""

import math
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from fitting.least_squares import elimination
from fitting.least_squares.normal_equations import (
    HELD_CURVATURE,
    Derivatives,
    LeastSquaresProblem,
    NormalEquations,
    SchurComplement,
    UnfollowableError,
    cost,
    cost_by_cycle,
    eigen,
    first_rows,
    kernel,
    normal_equations,
    priors,
    sum_gradients,
)
from stickslip.compute.arrays import Array

# Chosen by trial; the minimum does not depend on them.
# Over the curvatures: far from the end, and near it, where with less a correction also moves along the valley.
FIRST_DAMPING, LATER_DAMPING = 1e-4, 1e-6
DAMPING_CUT, DAMPING_RISE = 30.0, 10.0  # factors after success, failure
CAUTIOUS_CUT = 3.0  # factor after a step that was accepted only with more damping
PROBE_STEP = 0.1  # finite-difference step of the second derivative, over the step
CORRECTED_GAIN = 1e-4  # smallest gain over the cost of a corrected step: with less a shorter step may gain more
LARGEST_DAMPING, LEAST_DAMPING = 1e10, 1e-12
LEAST_CHANGE = 1e-12  # change over the cost, below which it is rounding
FAILED_SHARE = 0.1  # share in the rise of the cost of a failed step, above which a cycle is fitted again
# How failed cycles are fitted anew.
CYCLE_REFIT: dict[str, Any] = {"max_steps": 2, "tolerance": 1e-3, "damping": LATER_DAMPING}
ROUNDED = 1e-13  # eigenvalue over the largest, below which a direction is rounding
LARGEST_ACCELERATION = 0.75  # twice the acceleration over the step, above which the step is too long


@dataclass(frozen=True, eq=False)
class Solution:
    u: Array  # (p,)
    local: Array
    cost: float
    residual: Array  # (N,)
    blocks: NormalEquations  # at the solution
    outcome: str  # "converged", "step limit", "no progress", or "no flow": the start could not be followed
    steps: int  # number of evaluations of derivatives


class Step(NamedTuple):
    """A step of the shared unknowns (p,) and of the cycles' own (cycles, q)."""

    u: Array
    local: Array


class Point(NamedTuple):
    """A point of a search: unknowns (p,) and (cycles, q), residuals (N,), their derivatives, and cost."""

    u: Array
    local: Array
    residual: Array
    derivatives: Derivatives
    cost: float
    blocks: NormalEquations


class Trial(NamedTuple):
    u: Array
    local: Array
    cost: float


def minimise(
    problem: LeastSquaresProblem,
    u: Array,
    local: Array,
    *,
    max_steps: int = 40,
    tolerance: float = 1e-5,
    damping: float = FIRST_DAMPING,
    steady: float = math.inf,
    corrections: int = 0,
) -> Solution | None:
    """Minimise from u (p,) and local (cycles, q); None if the motion at the start cannot be followed.

    The search ends if the gain, relative or absolute, of two successive steps is below ``tolerance``, unless the
    weighted rms changes by more than ``steady`` of itself; ``corrections`` is the number of corrections of a failed
    step.
    """
    u, local = np.clip(u, problem.lower, problem.upper), np.minimum(local, problem.local_upper)
    point = linearise(problem, u, local)
    if point is None:
        return None
    small_steps, outcome, steps = 0, "step limit", 1
    while steps < max_steps:
        trial, refused = None, 0
        while damping < LARGEST_DAMPING:
            trial = _try_step(problem, point, damping, corrections)
            if trial is not None and trial.cost - point.cost < LEAST_CHANGE * point.cost:
                break
            refused += 1
            damping *= DAMPING_RISE
        if trial is None or trial.cost >= point.cost:
            outcome = "converged" if damping < LARGEST_DAMPING else "no progress"
            break
        damping = max(damping / (CAUTIOUS_CUT if refused else DAMPING_CUT), LEAST_DAMPING)
        gain = point.cost - trial.cost
        steps += 1
        next_point = linearise(problem, trial.u, trial.local)
        if next_point is None:  # the motion can be followed at the point, but not its derivatives
            point, outcome = point._replace(u=trial.u, local=trial.local, cost=trial.cost), "no progress"
            break
        before, point = point, next_point
        small = gain < tolerance * point.cost or gain < tolerance
        if small and steady < math.inf:
            small = abs(_rms(problem, before) - _rms(problem, point)) < steady * _rms(problem, point)
        small_steps = small_steps + 1 if small else 0
        if small_steps >= 2:
            outcome = "converged"
            break
    return Solution(point.u, point.local, point.cost, point.residual, point.blocks, outcome, steps)


def take_last_step(problem: LeastSquaresProblem, solution: Solution) -> Solution | None:
    """Return the solution after one step from that of a similar problem; None if it cannot be followed."""
    point = linearise(problem, solution.u, solution.local)
    if point is None:
        return None
    trial = _try_step(problem, point, LEAST_DAMPING)
    if trial is None or trial.cost >= point.cost:
        return replace(solution, cost=point.cost, residual=point.residual, blocks=point.blocks)
    evaluation = problem.evaluate(trial.u, trial.local, False)
    blocks = point.blocks.shift(trial.u - point.u, trial.local - point.local)
    residual = point.residual if evaluation is None else evaluation[0]
    return replace(solution, u=trial.u, local=trial.local, cost=trial.cost, residual=residual, blocks=blocks)


def _rms(problem: LeastSquaresProblem, point: Point) -> float:
    return math.sqrt(float(np.sum(problem.weights * np.add.reduceat(point.residual**2, problem.starts))))


def linearise(problem: LeastSquaresProblem, u: Array, local: Array) -> Point | None:
    evaluation = problem.evaluate(u, local, True)
    residual, derivatives = evaluation or (None, None)
    if residual is None or derivatives is None:
        return None
    with np.errstate(over="ignore", invalid="ignore"):  # derivatives that overflow are rejected below
        try:
            blocks = normal_equations(problem.first, problem.weights, residual, derivatives, priors(problem, u, local))
        except UnfollowableError:
            return None
        largest = HELD_CURVATURE * (np.abs(np.diag(blocks.H)).sum() + np.abs(np.einsum("cii->c", blocks.Hl)).sum())
    if not largest < math.inf:
        return None
    return Point(u, local, residual, derivatives, cost(problem, u, local, residual), blocks)


def _try_step(problem: LeastSquaresProblem, point: Point, damping: float, corrections: int = 0) -> Trial | None:
    """Return the point after a step; None if it cannot be followed, or if the second order is not valid."""
    step = _accelerated_step(problem, point, damping)
    if step is None:
        return None
    u = np.clip(point.u + step.u, problem.lower, problem.upper)
    local = np.minimum(point.local + step.local, problem.local_upper)
    evaluation = problem.evaluate(u, local, False)
    if evaluation is None:
        return None
    trial, residual = Trial(u, local, cost(problem, u, local, evaluation[0])), evaluation[0]
    led_back = trial, residual
    for _ in range(corrections if trial.cost >= point.cost else 0):
        corrected = _lead_back(problem, point, *led_back)
        if corrected is None or corrected[0].cost >= led_back[0].cost:
            break
        led_back = corrected
        if led_back[0].cost < (1 - CORRECTED_GAIN) * point.cost:
            trial, residual = led_back
            break
    failed = trial.cost - point.cost >= LEAST_CHANGE * point.cost
    return _refit_failed_cycles(problem, point, trial, residual) if failed else trial


def _lead_back(problem: LeastSquaresProblem, point: Point, trial: Trial, residual: Array) -> tuple[Trial, Array] | None:
    """Return the trial corrected across the valley with the derivatives at the last point, and its residuals."""
    p = point.u.size
    gradient = sum_gradients(problem.first, residual * problem.weight, point.derivatives, p + trial.local.shape[1])
    g = gradient[:, :p].sum(axis=0) + problem.precision * (trial.u - problem.prior)
    gl = gradient[:, p:] + problem.local_precision * (trial.local - problem.local_prior)
    damped = SchurComplement(point.blocks, LATER_DAMPING, (trial.local >= problem.local_upper) & (gl < 0))
    step = _step(problem, trial.u, damped, g, gl)
    u = np.clip(trial.u + step.u, problem.lower, problem.upper)
    local = np.minimum(trial.local + step.local, problem.local_upper)
    evaluation = problem.evaluate(u, local, False)
    return None if evaluation is None else (Trial(u, local, cost(problem, u, local, evaluation[0])), evaluation[0])


def _refit_failed_cycles(problem: LeastSquaresProblem, point: Point, trial: Trial, residual: Array) -> Trial:
    """Return a failed step after fitting again the own unknowns of the few cycles that made it fail."""
    by_cycle = cost_by_cycle(problem, trial.local, residual)
    rise = by_cycle - cost_by_cycle(problem, point.local, point.residual)
    cycles = np.flatnonzero(rise > FAILED_SHARE * np.sum(np.maximum(rise, 0.0)))
    failed_cycles = problem.of_cycles(trial.u, cycles)
    if failed_cycles is None:
        return trial
    begin, unmoved = trial.local[cycles], point.local[cycles]
    unmoved_evaluation = failed_cycles.evaluate(failed_cycles.prior, unmoved, False)
    if unmoved_evaluation is not None:
        cheaper = cost_by_cycle(failed_cycles, unmoved, unmoved_evaluation[0]) < by_cycle[cycles]
        begin = np.where(cheaper[:, None], unmoved, begin)
    refit = minimise(failed_cycles, failed_cycles.prior, begin, **CYCLE_REFIT)
    if refit is None:
        return trial
    local = trial.local.copy()
    local[cycles] = refit.local
    return Trial(trial.u, local, trial.cost - float(by_cycle[cycles].sum()) + refit.cost)


def _accelerated_step(problem: LeastSquaresProblem, point: Point, damping: float) -> Step | None:
    """Return the damped step with its acceleration; None if it is too long for the second order."""
    p = point.u.size
    damped = SchurComplement(point.blocks, damping, (point.local >= problem.local_upper) & (point.blocks.gl < 0))
    step = _step(problem, point.u, damped, point.blocks.g, point.blocks.gl)
    probe_local = np.minimum(point.local + PROBE_STEP * step.local, problem.local_upper)
    probe = problem.evaluate(point.u + PROBE_STEP * step.u, probe_local, False)
    if probe is None:
        return None
    steps = np.hstack([np.tile(step.u, (point.local.shape[0], 1)), step.local])
    gradient = np.zeros_like(steps)
    for block, jacobian in point.derivatives:
        cycles, rows, begin = block.cycles, block.rows, first_rows(problem.first, block)
        linear_change = np.empty(begin[-1])
        kernel(elimination.along)(jacobian, begin, steps[cycles], linear_change)
        bend = ((probe[0][rows] - point.residual[rows]) / PROBE_STEP - linear_change) * (2 / PROBE_STEP)
        force = bend * problem.weights[cycles].repeat(np.diff(begin))
        kernel(elimination.sum_gradients)(jacobian, force, begin, gradient[cycles])
    turn = _step(problem, point.u, damped, gradient[:, :p].sum(axis=0), gradient[:, p:])
    scale, local_scale = np.diag(point.blocks.H), np.einsum("cii->ci", point.blocks.Hl)
    with np.errstate(over="ignore", invalid="ignore"):  # an acceleration that overflows is too large
        length = float(np.sum(scale * step.u**2) + np.sum(local_scale * step.local**2))
        turned = float(np.sum(scale * turn.u**2) + np.sum(local_scale * turn.local**2))
    if not turned <= LARGEST_ACCELERATION**2 * length < math.inf:
        return None
    return Step(step.u + 0.5 * turn.u, step.local + 0.5 * turn.local)


def _step(problem: LeastSquaresProblem, u: Array, damped: SchurComplement, g: Array, gl: Array) -> Step:
    """Return the step down the gradients; unknowns that cross a bound move to it, and the others are solved again."""
    pull = damped.local_step(gl)
    g = damped.reduced_gradient(g, pull)
    step = np.zeros_like(u)
    free = ~((u <= problem.lower) & (g > 0)) & ~((u >= problem.upper) & (g < 0))
    while free.any():
        slope = g + np.einsum("ij,j->i", damped.H[:, ~free], step[~free])
        step[free] = _solve(damped.H[np.ix_(free, free)], -slope[free])
        bounded = np.clip(u + step, problem.lower, problem.upper) - u
        crossing = free & (bounded != (u + step) - u)
        if not crossing.any():
            break
        step[crossing] = bounded[crossing]
        free &= ~crossing
    step = np.clip(u + step, problem.lower, problem.upper) - u
    return Step(step, damped.back_substitute(step, pull))


def _solve(H: Array, target: Array) -> Array:
    """Return x of H x = target, H (n, n) positive semidefinite; directions below rounding are damped."""
    curvature = np.diag(H)
    curved = curvature > 0
    scale = np.where(curved, 1 / np.sqrt(np.where(curved, curvature, 1.0)), 0.0)
    size, axes = eigen(H * scale[:, None] * scale)
    size = np.maximum(size, 0.0)
    rounded = ROUNDED * max(float(size.max()), 1.0)
    along = np.einsum("ij,i->j", axes, scale * target) * size / (size**2 + rounded**2)
    return np.asarray(scale * np.einsum("ij,j->i", axes, along))
