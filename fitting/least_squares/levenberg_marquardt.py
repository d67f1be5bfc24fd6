"""Levenberg-Marquardt for shared and per-cycle unknowns; the per-cycle ones are eliminated (Schur complement).

Minimises  1/2 sum_c w_c |r_c(u, l_c)|^2 + 1/2 sum ((u - u0)/sd)^2 + 1/2 sum_c sum ((l_c - l0_c)/sd)^2
over the shared unknowns u (p of them, within bounds) and the q unknowns l_c of each cycle c.  Each cycle's
normal equations are q x q, so the cost grows with the number of cycles, not with its cube.

The valley of a friction law is long and bent (its curve's shape, level, damping and datum trade against each other),
and a straight step along it soon leaves its floor.  So each step is bent: the second derivative of the residuals
along it, one evaluation more, gives the acceleration with which a geodesic would follow the floor (Transtrum & Sethna,
arXiv:1201.5885).  A cycle that would not follow (a kick, a corner on the wrong side) is held back by itself.
"""

import math
from dataclasses import dataclass

import numpy as np

from daq.compute.arrays import Array
from fitting.least_squares import elimination
from fitting.least_squares.normal_equations import NormalEquations, SchurComplement, eigen, kernel, normal_equations
from fitting.least_squares.problem import LeastSquaresProblem, cost, cost_by_cycle

# Chosen by trial on the runs of docs/identification.md, not swept.  The objective does not depend on them.
FIRST_DAMPING, DAMPING_CUT, DAMPING_RISE = 1e-4, 30.0, 10.0  # of the curvatures; factors after a step taken, refused
CAUTIOUS_CUT = 3.0  # factor after a step that was first refused
PROBE_STEP = 0.1  # of the step: where the second derivative along it is measured
OUTLIER_SHARE = 0.1  # of the cost increase of all cycles: a cycle with more is an outlier and is damped by itself
FEW = 0.35  # of the cycles: where more are outliers, the shared parameters are damped instead
LARGEST_CYCLE_DAMPING = 1e12  # times the shared damping: from there on a cycle's own unknowns stand still
ROUNDED = 1e-13  # of the largest eigenvalue: weaker directions are rounding; not swept
LARGEST_ACCELERATION = 0.75  # of the step: twice the acceleration may be as long, else the step is too long for it


@dataclass(frozen=True, eq=False)
class Solution:
    """Where the minimiser stopped.

    Attributes
    ----------
    u, local : (p,), (cycles, q) f8
    cost : float
    residual : (N,) f8
    blocks : NormalEquations
        At the solution.
    outcome : str
        "converged", "step limit", "no progress", or "no flow": the start could not be followed.
    steps : int
        Derivatives taken.
    """

    u: Array
    local: Array
    cost: float
    residual: Array
    blocks: NormalEquations
    outcome: str
    steps: int


@dataclass(frozen=True, eq=False)
class Step:
    """A step of the shared unknowns (p,) and of the cycles' own (cycles, q)."""

    u: Array
    local: Array


def minimise(
    problem: LeastSquaresProblem,
    u: Array,
    local: Array,
    *,
    max_steps: int = 40,
    tolerance: float = 1e-5,
    damping: float = FIRST_DAMPING,
) -> Solution | None:
    """Minimise from (u, local); None when not even the start can be followed.

    Parameters
    ----------
    problem : LeastSquaresProblem
    u : (p,) f8
    local : (cycles, q) f8
    max_steps : int
        Derivatives to take at most.
    tolerance : float
        Stop when a step lowers the cost by less than this fraction (twice in a row), or by less than this at all.
    damping : float
        Of the first step, times the curvatures: less where the start is known to be near.
    """
    u = np.clip(u, problem.lower, problem.upper)
    first = problem.evaluate(u, local, True)
    if first is None:
        return None
    residual, jacobian = first
    value = cost(problem, u, local, residual)
    cycle_damping = np.ones(local.shape[0])
    calm, outcome, steps = 0, "step limit", 1
    blocks = normal_equations(problem, u, local, residual, jacobian)
    while steps < max_steps:
        moved, refused = False, 0
        while damping < 1e10:
            step = _accelerated_step(problem, u, local, blocks, damping * cycle_damping, residual, jacobian)
            if isinstance(step, Step):
                trial, local_trial = np.clip(u + step.u, problem.lower, problem.upper), local + step.local
                local_trial = np.minimum(local_trial, problem.local_upper)
                found = problem.evaluate(trial, local_trial, False)
                trial_value = math.inf if found is None else cost(problem, trial, local_trial, found[0])
                if trial_value < value:
                    moved = True
                    break
                if found is not None and trial_value - value < 1e-12 * value:
                    break
                cost_increase = np.zeros(cycle_damping.size)
                if found is not None:
                    cost_increase = cost_by_cycle(problem, local_trial, found[0]) - cost_by_cycle(
                        problem, local, residual
                    )
            else:
                cost_increase = step
            refused += 1
            # One outlying cycle (a velocity step, a wrong switching time) must not slow down all the others.
            outlier_cycles = cost_increase > OUTLIER_SHARE * np.sum(np.maximum(cost_increase, 0.0))
            if (
                0 < outlier_cycles.sum() <= FEW * outlier_cycles.size
                and cycle_damping[outlier_cycles].max() < LARGEST_CYCLE_DAMPING
            ):
                cycle_damping[outlier_cycles] *= DAMPING_RISE**2
            else:
                damping *= DAMPING_RISE
        if not moved:
            outcome = "converged" if damping < 1e10 else "no progress"
            break
        gain, value = value - trial_value, trial_value
        u, local = trial, local_trial
        ease = CAUTIOUS_CUT if refused else DAMPING_CUT
        damping, cycle_damping = max(damping / ease, 1e-12), np.maximum(cycle_damping / ease, 1.0)
        again = problem.evaluate(u, local, True)
        steps += 1
        if again is None:  # the point itself can be followed, one of its neighbours cannot
            outcome = "no progress"
            break
        residual, jacobian = again
        blocks = normal_equations(problem, u, local, residual, jacobian)
        calm = calm + 1 if gain < tolerance * value or gain < tolerance else 0
        if calm >= 2:
            outcome = "converged"
            break
    return Solution(u, local, value, residual, blocks, outcome, steps)


def _accelerated_step(
    problem: LeastSquaresProblem,
    u: Array,
    local: Array,
    blocks: NormalEquations,
    damping: Array,
    residual: Array,
    jacobian: Array,
) -> Step | Array:
    """Return the damped step with its acceleration, or whose fault it is that it leads too far.

    Too far is where the second order no longer holds; a cycle's fault (cycles,) is its share of the second derivative,
    and nobody's (0) where the flow cannot be followed at all.

    ``damping`` is the cycles' own (cycles,); the least of them is that of the shared unknowns.
    """
    p = u.size
    damped = SchurComplement(blocks, damping)
    step = _step(problem, u, damped, blocks.g, blocks.gl)
    beside = np.minimum(local + PROBE_STEP * step.local, problem.local_upper)
    near = problem.evaluate(u + PROBE_STEP * step.u, beside, False)
    if near is None:
        return np.zeros(damping.size)
    both = np.hstack([np.tile(step.u, (damping.size, 1)), step.local])
    straight = np.empty(residual.size)
    kernel(elimination.along)(jacobian, problem.first, both, straight)
    bend = ((near[0] - residual) / PROBE_STEP - straight) * (2 / PROBE_STEP)
    push = bend * problem.weights[problem.owner]
    gradient = np.zeros_like(both)
    kernel(elimination.sum_gradients)(jacobian, push, problem.first, gradient)
    turn = _step(problem, u, damped, gradient[:, :p].sum(axis=0), gradient[:, p:])
    scale, local_scale = np.diag(blocks.H), np.einsum("cii->ci", blocks.Hl)
    with np.errstate(over="ignore", invalid="ignore"):  # a turn too long for a number is too long
        length = float(np.sum(scale * step.u**2) + np.sum(local_scale * step.local**2))
        turned = float(np.sum(scale * turn.u**2) + np.sum(local_scale * turn.local**2))
        strain = np.add.reduceat(bend * push, problem.starts)
    if not turned <= LARGEST_ACCELERATION**2 * length < math.inf:
        return np.asarray(strain) if np.isfinite(strain).all() else np.zeros(damping.size)
    return Step(step.u + 0.5 * turn.u, step.local + 0.5 * turn.local)


def _step(problem: LeastSquaresProblem, u: Array, damped: SchurComplement, g: Array, gl: Array) -> Step:
    """Return the step down the gradients g and gl, within the bounds.

    An unknown on its bound that is pushed outward stays.  One whose step would cross its bound goes onto it, and the
    others step anew beside that: merely cut off, it would leave them a step made for another place, and a search next
    to a bound would stop where no step helps.
    """
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
    """Return x of H x = target, H (n, n) positive semidefinite, with nothing along directions that only rounding holds.

    Where these begin must be no cliff: they fade out.
    """
    scale = 1 / np.sqrt(np.maximum(np.diag(H), 1e-300))
    size, axes = eigen(H * scale[:, None] * scale)
    size = np.maximum(size, 0.0)
    along = np.einsum("ij,i->j", axes, scale * target) * size / (size**2 + (ROUNDED * size.max()) ** 2)
    return np.asarray(scale * np.einsum("ij,j->i", axes, along))
