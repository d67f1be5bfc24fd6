"""Levenberg-Marquardt for shared and per-cycle unknowns; the per-cycle ones are eliminated (Schur complement).

Minimises  1/2 sum_c w_c |r_c(u, l_c)|^2 + 1/2 sum ((u - u0)/sd)^2 + 1/2 sum_c sum ((l_c - l0_c)/sd)^2
over the shared unknowns u (p of them, within bounds) and the q unknowns l_c of each cycle c.  Each cycle's
normal equations are q x q, so the cost grows with the number of cycles, not with its cube.

The valley of a friction law is long and bent (its curve's shape, level, damping and datum trade against each other).
So each step is bent: the second derivative of the residuals along it, one evaluation more, gives the acceleration with
which a geodesic would follow the floor (Transtrum & Sethna, arXiv:1201.5885).  Where a step fails because of a few
cycles, their own unknowns are fitted anew beside the shared ones that the step leads to.  Where the valley bends more
than the acceleration says, a step may be led back across it by the derivatives at hand.
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

# Chosen by trial; the objective does not depend on them.
FIRST_DAMPING, DAMPING_CUT, DAMPING_RISE = 1e-4, 30.0, 10.0  # of the curvatures; factors after a step taken, refused
CAUTIOUS_CUT = 3.0  # factor after a step that was first refused
PROBE_STEP = 0.1  # share of the step: where the second derivative along it is measured
CORRECTION_DAMPING = 1e-6  # of a step back onto the floor of a valley: with less it moves along the valley too
CORRECTED_GAIN = 1e-4  # gain over the cost, of a step that was led back: with less a shorter one may gain more
LARGEST_DAMPING, LEAST_DAMPING = 1e10, 1e-12
LEAST_CHANGE = 1e-12  # change over the cost: less is rounding
FAILED_SHARE = 0.1  # share of the rise of the cost where a step fails: a cycle with more is fitted anew
ANEW: dict[str, Any] = {"max_steps": 2, "tolerance": 1e-3, "damping": 1e-6}  # how failed cycles are fitted anew
ROUNDED = 1e-13  # eigenvalue over the largest: weaker directions are rounding
LARGEST_ACCELERATION = 0.75  # twice the acceleration over the step: with more the step is too long


@dataclass(frozen=True, eq=False)
class Solution:
    u: Array  # (p,)
    local: Array
    cost: float
    residual: Array  # (N,)
    blocks: NormalEquations  # at the solution
    outcome: str  # "converged", "step limit", "no progress", or "no flow": the start could not be followed
    steps: int  # derivatives taken


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
    """Minimise from u (p,) and local (cycles, q); None where the start cannot be followed.

    ``tolerance`` is the gain of a step, relative or absolute, that ends the search when met twice in a row, unless the
    weighted rms changes by more than ``steady`` of itself; ``corrections`` limits how often a step is led back.
    """
    u, local = np.clip(u, problem.lower, problem.upper), np.minimum(local, problem.local_upper)
    at = linearise(problem, u, local)
    if at is None:
        return None
    calm, outcome, steps = 0, "step limit", 1
    while steps < max_steps:
        trial, refused = None, 0
        while damping < LARGEST_DAMPING:
            trial = _trial(problem, at, damping, corrections)
            if trial is not None and trial.cost - at.cost < LEAST_CHANGE * at.cost:
                break
            refused += 1
            damping *= DAMPING_RISE
        if trial is None or trial.cost >= at.cost:
            outcome = "converged" if damping < LARGEST_DAMPING else "no progress"
            break
        damping = max(damping / (CAUTIOUS_CUT if refused else DAMPING_CUT), LEAST_DAMPING)
        gain = at.cost - trial.cost
        steps += 1
        there = linearise(problem, trial.u, trial.local)
        if there is None:  # the point itself can be followed, one of its neighbours cannot
            at, outcome = at._replace(u=trial.u, local=trial.local, cost=trial.cost), "no progress"
            break
        before, at = at, there
        small = gain < tolerance * at.cost or gain < tolerance
        if small and steady < math.inf:
            small = abs(_rms(problem, before) - _rms(problem, at)) < steady * _rms(problem, at)
        calm = calm + 1 if small else 0
        if calm >= 2:
            outcome = "converged"
            break
    return Solution(at.u, at.local, at.cost, at.residual, at.blocks, outcome, steps)


def last_step(problem: LeastSquaresProblem, near: Solution) -> Solution | None:
    """Return the end of one step from a similar problem's solution; None where it cannot be followed."""
    at = linearise(problem, near.u, near.local)
    if at is None:
        return None
    trial = _trial(problem, at, LEAST_DAMPING)
    if trial is None or trial.cost >= at.cost:
        return replace(near, cost=at.cost, residual=at.residual, blocks=at.blocks)
    found = problem.evaluate(trial.u, trial.local, False)
    blocks = at.blocks.moved(trial.u - at.u, trial.local - at.local)
    residual = at.residual if found is None else found[0]
    return replace(near, u=trial.u, local=trial.local, cost=trial.cost, residual=residual, blocks=blocks)


def _rms(problem: LeastSquaresProblem, at: Point) -> float:
    return math.sqrt(float(np.sum(problem.weights * np.add.reduceat(at.residual**2, problem.starts))))


def linearise(problem: LeastSquaresProblem, u: Array, local: Array) -> Point | None:
    found = problem.evaluate(u, local, True)
    residual, derivatives = found or (None, None)
    if residual is None or derivatives is None:
        return None
    with np.errstate(over="ignore", invalid="ignore"):  # derivatives too large for a number are none
        try:
            blocks = normal_equations(problem.first, problem.weights, residual, derivatives, priors(problem, u, local))
        except UnfollowableError:
            return None
        largest = HELD_CURVATURE * (np.abs(np.diag(blocks.H)).sum() + np.abs(np.einsum("cii->c", blocks.Hl)).sum())
    if not largest < math.inf:
        return None
    return Point(u, local, residual, derivatives, cost(problem, u, local, residual), blocks)


def _trial(problem: LeastSquaresProblem, at: Point, damping: float, corrections: int = 0) -> Trial | None:
    """Return the end of a step; None where it cannot be followed, or the second order no longer holds."""
    step = _accelerated_step(problem, at, damping)
    if step is None:
        return None
    u = np.clip(at.u + step.u, problem.lower, problem.upper)
    local = np.minimum(at.local + step.local, problem.local_upper)
    found = problem.evaluate(u, local, False)
    if found is None:
        return None
    trial, residual = Trial(u, local, cost(problem, u, local, found[0])), found[0]
    led_back = trial, residual
    for _ in range(corrections if trial.cost >= at.cost else 0):
        corrected = _corrected(problem, at, *led_back)
        if corrected is None or corrected[0].cost >= led_back[0].cost:
            break
        led_back = corrected
        if led_back[0].cost < (1 - CORRECTED_GAIN) * at.cost:
            trial, residual = led_back
            break
    failed = trial.cost - at.cost >= LEAST_CHANGE * at.cost
    return _with_failed_cycles_anew(problem, at, trial, residual) if failed else trial


def _corrected(problem: LeastSquaresProblem, at: Point, trial: Trial, residual: Array) -> tuple[Trial, Array] | None:
    """Return the trial led back across the valley by the derivatives at hand, and its residuals."""
    p = at.u.size
    gradient = sum_gradients(problem.first, residual * problem.weight, at.derivatives, p + trial.local.shape[1])
    g = gradient[:, :p].sum(axis=0) + problem.precision * (trial.u - problem.prior)
    gl = gradient[:, p:] + problem.local_precision * (trial.local - problem.local_prior)
    damped = SchurComplement(at.blocks, CORRECTION_DAMPING, (trial.local >= problem.local_upper) & (gl < 0))
    step = _step(problem, trial.u, damped, g, gl)
    u = np.clip(trial.u + step.u, problem.lower, problem.upper)
    local = np.minimum(trial.local + step.local, problem.local_upper)
    found = problem.evaluate(u, local, False)
    return None if found is None else (Trial(u, local, cost(problem, u, local, found[0])), found[0])


def _with_failed_cycles_anew(problem: LeastSquaresProblem, at: Point, trial: Trial, residual: Array) -> Trial:
    """Return a failed step with the own unknowns of the few cycles that made it fail fitted again."""
    by_cycle = cost_by_cycle(problem, trial.local, residual)
    rise = by_cycle - cost_by_cycle(problem, at.local, at.residual)
    cycles = np.flatnonzero(rise > FAILED_SHARE * np.sum(np.maximum(rise, 0.0)))
    part = problem.of_cycles(trial.u, cycles)
    if part is None:
        return trial
    begin, held = trial.local[cycles], at.local[cycles]
    stayed = part.evaluate(part.prior, held, False)
    if stayed is not None:
        cheaper = cost_by_cycle(part, held, stayed[0]) < by_cycle[cycles]
        begin = np.where(cheaper[:, None], held, begin)
    found = minimise(part, part.prior, begin, **ANEW)
    if found is None:
        return trial
    local = trial.local.copy()
    local[cycles] = found.local
    return Trial(trial.u, local, trial.cost - float(by_cycle[cycles].sum()) + found.cost)


def _accelerated_step(problem: LeastSquaresProblem, at: Point, damping: float) -> Step | None:
    """Return the damped step with its acceleration; None where it exceeds the reach of the second order."""
    p = at.u.size
    damped = SchurComplement(at.blocks, damping, (at.local >= problem.local_upper) & (at.blocks.gl < 0))
    step = _step(problem, at.u, damped, at.blocks.g, at.blocks.gl)
    beside = np.minimum(at.local + PROBE_STEP * step.local, problem.local_upper)
    near = problem.evaluate(at.u + PROBE_STEP * step.u, beside, False)
    if near is None:
        return None
    both = np.hstack([np.tile(step.u, (at.local.shape[0], 1)), step.local])
    gradient = np.zeros_like(both)
    for block, part in at.derivatives:
        own, rows, begin = block.cycles, block.rows, first_rows(problem.first, block)
        straight = np.empty(begin[-1])
        kernel(elimination.along)(part, begin, both[own], straight)
        bend = ((near[0][rows] - at.residual[rows]) / PROBE_STEP - straight) * (2 / PROBE_STEP)
        push = bend * problem.weights[own].repeat(np.diff(begin))
        kernel(elimination.sum_gradients)(part, push, begin, gradient[own])
    turn = _step(problem, at.u, damped, gradient[:, :p].sum(axis=0), gradient[:, p:])
    scale, local_scale = np.diag(at.blocks.H), np.einsum("cii->ci", at.blocks.Hl)
    with np.errstate(over="ignore", invalid="ignore"):  # a turn too long for a number is too long
        length = float(np.sum(scale * step.u**2) + np.sum(local_scale * step.local**2))
        turned = float(np.sum(scale * turn.u**2) + np.sum(local_scale * turn.local**2))
    if not turned <= LARGEST_ACCELERATION**2 * length < math.inf:
        return None
    return Step(step.u + 0.5 * turn.u, step.local + 0.5 * turn.local)


def _step(problem: LeastSquaresProblem, u: Array, damped: SchurComplement, g: Array, gl: Array) -> Step:
    """Return the step down the gradients; unknowns that would cross a bound move onto it, and the others step anew."""
    pull = damped.local_step(gl)
    g = damped.reduced_gradient(g, pull)
    step = np.zeros_like(u)
    free = ~((u <= problem.lower) & (g > 0)) & ~((u >= problem.upper) & (g < 0))
    while free.any():
        slope = g + np.einsum("ij,j->i", damped.H[:, ~free], step[~free])
        step[free] = _solve(damped.H[np.ix_(free, free)], -slope[free])
        kept = np.clip(u + step, problem.lower, problem.upper) - u
        crossing = free & (kept != (u + step) - u)
        if not crossing.any():
            break
        step[crossing] = kept[crossing]
        free &= ~crossing
    step = np.clip(u + step, problem.lower, problem.upper) - u
    return Step(step, damped.back_substitute(step, pull))


def _solve(H: Array, target: Array) -> Array:
    """Return x of H x = target, H (n, n) positive semidefinite; directions below rounding fade out."""
    curvature = np.diag(H)
    held = curvature > 0
    scale = np.where(held, 1 / np.sqrt(np.where(held, curvature, 1.0)), 0.0)
    size, axes = eigen(H * scale[:, None] * scale)
    size = np.maximum(size, 0.0)
    rounded = ROUNDED * max(float(size.max()), 1.0)
    along = np.einsum("ij,i->j", axes, scale * target) * size / (size**2 + rounded**2)
    return np.asarray(scale * np.einsum("ij,j->i", axes, along))
