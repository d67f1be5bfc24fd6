"""The passes of a fit: with much noise assumed, with the noise that the residuals show, with every sample.

first_pass   noise 30 times the resolution, on the thinned record: priors then hold what is far off
settle       again with the noise, weights and scatter that the pass before showed, until these stay
finish       every sample, seen through nodes; levels may fade, outlying cycles hardly count
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from daq.base.compute.arrays import Array
from fitting.driver.fit import TaskFit
from fitting.driver.model import Model
from fitting.driver.nodes import SampleNodes
from fitting.driver.noise import PassNoise
from fitting.driver.task import FitStart, Task
from fitting.estimation.objective import coarse_stride, fitted_windows
from fitting.least_squares import levenberg_marquardt
from fitting.least_squares.problem import LeastSquaresProblem, cost_by_cycle
from fitting.model import parameters, starts
from fitting.model.parameters import PER_RUN, Global
from fitting.sensitivity import flow
from fitting.sensitivity.path import Path


class Limits(NamedTuple):
    """When a minimisation stops: most steps, the gain of one, and by how much of itself one may change the rms."""

    steps: int
    gain: float
    steady: float


# Noise that the first pass assumes, over the resolution.  At half a start that errs by a slip's tenth is held where it
# is; at twice the priors hold a true law too, which then needs one more pass.
FIRST_NOISE = 30.0
# Of each pass on the thinned record.  Half the steps end before a bent valley's floor; twice the steps cost laws that
# are wrong twice the time.  A wrong law's noise is large and its gain small: its rms says whether it still moves.
SEARCH = Limits(12, 1e-3, 1e-3)
WHOLE = Limits(15, 1e-5, np.inf)  # of every sample: at half, a level that fades is not at its end
MOST_PASSES = 4  # after the first; the noise of a true law stays after two
SETTLED = 0.8  # of the noise assumed: a pass that shows no less was the last.  At 0.9 each law takes one pass more
FIRST_DAMPING, LATER_DAMPING = 1e-4, 1e-6  # of the curvatures: far from the end, and near it
NODE_ROUNDS = 2  # how often the nodes read the samples; after the second positions change by less than the rounding
CYCLE_RESTART: dict[str, Any] = {"max_steps": 15, "tolerance": 1e-4}  # of the own unknowns of outlying cycles
CYCLE_GAIN = 0.99  # of a cycle's cost: another start of its own unknowns led to another minimum
# Of forces along an earlier path: how often the path is followed before a pass, the passes in which they settle, the
# most steps of each, and the change of their size at which they have.
FOLLOWED, FORCE_PASSES, FORCE_STEPS, FORCE_SETTLED = 4, 6, 8, 1e-3


def regressed_start(task: Task) -> FitStart:
    """Return the start: shared unknowns of the regression, forces of size 0, windows at the smoothed motion."""
    problem = task.problem
    windows = fitted_windows(problem, thinned=True)
    local = starts.cycle_starts(windows, problem.motions, problem.cycles, problem.start)
    shared = problem.start[list(task.places)]
    return FitStart(np.concatenate([shared, task.curve.start, np.zeros(task.widths[2])]), local)


def restarted_windows(at: TaskFit) -> FitStart:
    """Return where a fit starts again: its shared unknowns, with all windows at the smoothed motion.

    Some cycles may have been held in poor minima by the first shared unknowns, and have held these where they were.
    """
    problem = at.task.problem
    return FitStart(at.q, starts.cycle_starts(at.windows, problem.motions, problem.cycles, at.u))


def first_pass(task: Task, start: FitStart, noise: PassNoise | None = None) -> TaskFit | None:
    """Fit on the thinned record; None where the start cannot be followed.

    A start that was fitted brings its ``noise`` with it; of another nearly any misfit is taken for noise.
    """
    windows = fitted_windows(task.problem, thinned=True)
    if noise is None:
        resolution = np.array([motion.resolution for motion in task.problem.motions])
        noise = PassNoise(FIRST_NOISE * resolution, np.ones(len(windows.rows)))
    at = _one_pass(Model(task, windows, flow.SEARCH_STEP), start, noise, SEARCH, FIRST_DAMPING)
    return None if at is None else _with_noise(at, first=True)


def settle(at: TaskFit) -> TaskFit | None:
    """Fit again with the noise and the weights that the pass before showed, until these no longer change."""
    for _ in range(MOST_PASSES):
        model = Model(at.task, at.windows, flow.SEARCH_STEP, at.model.near)
        found = _one_pass(model, FitStart(at.q, restarted(at)), at.noise, SEARCH, LATER_DAMPING)
        if found is None:
            return None
        before, at = at, _with_noise(found, first=False)
        same = bool(np.all(at.noise.sigma > SETTLED * before.noise.sigma))
        if same and at.solution.outcome == "converged":
            break
    return at


def finish(at: TaskFit) -> TaskFit | None:
    """Fit again with every sample, through nodes; None where the motion cannot be followed in these shorter steps."""
    task = at.task
    fading = Model(task, at.windows, flow.SEARCH_STEP, at.model.near)
    noise = at.noise.with_fade(task, at.windows, at.local)
    # The noise is that of levels that fade: without, a drag that wears shows several times as much.
    faded = _one_pass(fading, FitStart(at.q, restarted(at)), noise, SEARCH, LATER_DAMPING)
    if faded is None:
        return None
    at = _with_noise(faded, first=False)
    start, noise = FitStart(at.q, restarted(at)), at.noise.for_last_pass
    whole = fitted_windows(task.problem, thinned=False)
    nodes = SampleNodes.of(whole, [coarse_stride(motion) for motion in task.problem.motions])
    every = Model(task, whole, flow.LONGEST_STEP)
    found: TaskFit | None = None
    for _ in range(NODE_ROUNDS):
        sparse = Model(task, nodes.windows, flow.LONGEST_STEP)
        for model in (every, sparse):
            model.settle(*start, FOLLOWED)
        residual, there = every.residual(*start), sparse.residual(*start)
        if residual is None or there is None:
            break
        seen = nodes.seen(there + nodes.windows.position, residual)
        seen_by = Model(task, seen, flow.LONGEST_STEP, _over(sparse.near, seen), nodes.count)
        last = _one_pass(seen_by, start, noise, WHOLE, LATER_DAMPING)
        if last is None:
            break
        every.settle(*last.start, FOLLOWED)
        residual = every.residual(*last.start)
        if residual is None:
            break
        found, start = replace(last, model=every, residual=residual, whole=True), last.start
    return found


def restarted(at: TaskFit) -> Array:
    """Return the cycles' own unknowns, those of outlying cycles from the smoothed motion where that costs less.

    A cycle with a velocity step has several minima, and one pass can leave it in a poor one: from there it distorts the
    fit although its weight is low.
    """
    cycles = np.flatnonzero(~at.noise.inliers)
    part = at.problem.of_cycles(at.q, cycles)
    if part is None:
        return at.local
    problem = at.task.problem
    fresh = starts.cycle_starts(at.windows, problem.motions, problem.cycles, at.u)[cycles]
    found = levenberg_marquardt.minimise(part, np.empty(0), fresh, **CYCLE_RESTART)
    held = part.evaluate(part.prior, at.local[cycles], False)
    if found is None or held is None:
        return at.local
    before = cost_by_cycle(part, at.local[cycles], held[0])
    better = cost_by_cycle(part, found.local, found.residual) < CYCLE_GAIN * before
    local = at.local.copy()
    local[cycles[better]] = found.local[better]
    return local


def _over(near: Path | None, windows: object) -> Path | None:
    """Return a path as one of windows with the same times."""
    return None if near is None else replace(near, windows=windows)  # type: ignore[arg-type]


def _with_noise(at: TaskFit, *, first: bool) -> TaskFit:
    return replace(at, noise=at.noise.seen(at.task, at.windows, at.residual, at.local, first=first))


def _one_pass(model: Model, start: FitStart, noise: PassNoise, limits: Limits, damping: float) -> TaskFit | None:
    """Minimise with the noise assumed; forces along the path are evaluated anew until they settle."""
    model.settle(*start, FOLLOWED)
    held: Sequence[Global] = () if noise.fade_sd is not None else (Global.FADE,)
    problem = _least_squares(model, noise, start.q, held)
    settings: dict[str, Any] = {"tolerance": limits.gain, "steady": limits.steady}
    solution = levenberg_marquardt.minimise(problem, *start, max_steps=limits.steps, damping=damping, **settings)
    first = model.task.curve.size + len(model.task.places)
    for _ in range(FORCE_PASSES if model.along else 0):
        if solution is None:
            return None
        before = solution.u[first:]
        model.settle(solution.u, solution.local, 1)
        solution = levenberg_marquardt.minimise(
            problem, solution.u, solution.local, max_steps=FORCE_STEPS, damping=LATER_DAMPING, **settings
        )
        if solution is not None and np.sum((solution.u[first:] - before) ** 2) <= FORCE_SETTLED**2 * np.sum(before**2):
            break
    if solution is None:
        return None
    residual = model.residual(solution.u, solution.local)
    return None if residual is None else TaskFit(model, solution.u, solution.local, residual, noise, problem, solution)


def _least_squares(model: Model, noise: PassNoise, q: Array, held: Sequence[Global]) -> LeastSquaresProblem:
    """Return what a pass minimises: calibrations are priors, shared unknowns of the slots ``held`` stay."""
    task, windows = model.task, model.windows
    problem, (p, _, m) = task.problem, task.widths
    index = list(task.places)
    # a drag takes energy; another force may have either sign
    least = [0.0 if force.drag is not None else -np.inf for force in task.forces for _ in range(force.columns)]
    lower = np.concatenate([problem.lower[index], task.curve.lower, np.array(least)])
    upper = np.concatenate([problem.upper[index], task.curve.upper, np.full(m, np.inf)])
    prior = np.concatenate([problem.prior[index], task.curve.prior, np.zeros(m)])
    precision = np.concatenate([problem.precision[index], task.curve.precision, np.zeros(m)])
    for j, place in enumerate(index):
        run, slot = divmod(place, PER_RUN)
        if slot in held:
            lower[j] = upper[j] = q[j]
        elif slot == Global.FADE and noise.fade_sd is not None:
            precision[j] = noise.fade_sd[run] ** -2.0
    # A slip that starts beyond the belt's speed lets a curve or a drag of its own bend away from the true one.
    bounded = bool(task.curve.size or task.forces) and not task.curve.ramp
    u = problem.start.copy()
    u[index] = q[:p]
    return LeastSquaresProblem(
        evaluate=model.evaluate,
        some=None if model.along else model.some,
        rows=windows.rows,
        weights=noise.weights / noise.sigma[windows.run] ** 2,
        lower=lower,
        upper=upper,
        prior=prior,
        precision=precision,
        local_prior=windows.starting_values(problem.motions),
        local_precision=noise.local_precision(task, windows),
        local_upper=windows.fastest_starts(parameters.copy_shared(u)) if bounded else np.inf,
    )
