"""The passes of a fit: with much noise assumed, with the noise that the residuals show, with every sample.

first_pass   noise 30 times the resolution, on the thinned record: priors then hold what is far off
settle       again with the noise, weights and scatter that the pass before showed, until these stay
finish       every sample, seen through nodes, and a last step of all; levels may fade, outlying cycles hardly count

Cycles in which the mass overtakes the belt unseen are found between `settle` and `finish`.
"""

import math
import time as clock
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from fitting import noise_levels
from fitting.least_squares import levenberg_marquardt
from fitting.least_squares.normal_equations import LeastSquaresProblem, cost_by_cycle
from fitting.model import flow, unknowns
from fitting.model.curves import LawCurve
from fitting.model.path import Path
from fitting.model.predict import FitStart, Model, Task
from fitting.model.problem import cycle_starts, with_static
from fitting.model.unknowns import PER_RUN, RIPPLE, Global
from fitting.model.windows import SampleNodes
from fitting.search.fit import Fit, PassNoise
from stickslip.compute.arrays import Array, Mask


class Limits(NamedTuple):
    """Most steps of a minimisation, and the gain and relative change of the rms below which it ends."""

    steps: int
    gain: float
    steady: float
    corrections: int = 0


FIRST_NOISE = 30.0  # noise assumed in the first pass, over the resolution: a start may err by a tenth of a slip
SEARCH = Limits(12, 1e-3, 1e-3)  # on the thinned record; the gain of a wrong law is small, so its rms decides
WHOLE = Limits(30, 1e-5, np.inf, corrections=3)  # with every sample
MOST_PASSES = 4  # passes after the first; the noise of a true law stays after two
NOISE_SETTLED = 0.8  # noise shown over the noise assumed, above which a pass is the last
NOISE_CUT = 4.0  # factor by which the noise assumed falls from pass to pass, where it is known
FIRST_DAMPING, LATER_DAMPING = 1e-4, 1e-6  # of the curvatures: far from the end, and near it
CYCLE_RESTART: dict[str, Any] = {"max_steps": 15, "tolerance": 1e-4}  # of the own unknowns of outlying cycles
GIVEN_UP_BEYOND_BEST = 30.0  # error over the best after the first pass; true laws reach 20 in harsh records
STATIC_GAIN = 5.0  # least gain in log likelihood by a separate break-away level of a ramp
STATIC_STARTS = (1.1, 1.5)  # starts of the break-away level over that of slip: either alone misses true levels
TOWARDS_REGRESSION = (1.0, 0.75)  # starts on the way from the curve of a fit without a level to the regression
CYCLE_GAIN = 0.99  # cost over that of a cycle before: another start of its own unknowns led to another minimum
# Forces along a path: times that it is followed before a pass; most passes, steps of each, and change when settled.
FOLLOWED, FORCE_PASSES, FORCE_STEPS, FORCE_SETTLED = 4, 6, 8, 1e-3


def regressed_start(task: Task) -> FitStart:
    problem = task.problem
    windows = problem.windows(thinned=True)
    local = cycle_starts(windows, problem.motions, problem.cycles, problem.start)
    shared = problem.start[list(task.places)]
    return FitStart(np.concatenate([shared, task.curve.start, np.zeros(task.widths[2])]), local)


def restarted_windows(at: Fit) -> FitStart:
    """Restart all windows at the smoothed motion: the first shared unknowns may have led them to poor minima."""
    problem = at.task.problem
    return FitStart(at.q, cycle_starts(at.windows, problem.motions, problem.cycles, at.u))


def assumed_noise(task: Task, times: float = FIRST_NOISE) -> PassNoise:
    """Return noise of so many resolutions."""
    resolution = np.array([motion.resolution for motion in task.problem.motions])
    return PassNoise(times * resolution, np.ones(len(task.problem.cycles)))


def first_pass(task: Task, start: FitStart, noise: PassNoise | None = None) -> Fit | None:
    """Fit the thinned record; without the noise of a fitted start nearly any misfit is taken for noise."""
    begun = clock.process_time()
    windows = task.problem.windows(thinned=True)
    noise = assumed_noise(task) if noise is None else noise
    at = _one_pass(task.predict(windows, flow.SEARCH_STEP), start, noise, SEARCH, FIRST_DAMPING)
    if at is None:
        return None
    return replace(_with_noise(at, first=True), cpu_s=clock.process_time() - begun)


def regressed_pass(task: Task, noise: PassNoise | None = None) -> Fit | None:
    """Fit from the regression; under large noise any ripple fits, so its frequency is freed at the end."""
    steady = task.without(*RIPPLE)
    if steady.places == task.places:
        return first_pass(task, regressed_start(task), noise)
    held = first_pass(steady, regressed_start(steady), noise)
    if held is None:
        return None
    return first_pass(task, FitStart(_beside(task, held.u, held), held.local), held.noise)


def settle(at: Fit, noise_m: Array | None = None) -> Fit | None:
    """Repeat the pass with the noise shown until that stays; a known noise (runs,), m, is approached in steps."""
    begun, spent = clock.process_time(), at.cpu_s
    for _ in range(MOST_PASSES):
        found = _searched(at)
        if found is None:
            return None
        before, at = at, _with_noise(found, first=False)
        if noise_m is not None:
            nearer = np.maximum(np.minimum(at.noise.sigma, before.noise.sigma / NOISE_CUT), noise_m)
            at = replace(at, noise=replace(at.noise, sigma=nearer))
        same = bool(np.all(at.noise.sigma > NOISE_SETTLED * before.noise.sigma))
        if same and at.solution.outcome == "converged":
            break
    return replace(at, cpu_s=spent + clock.process_time() - begun)


def _searched(at: Fit) -> Fit | None:
    model = at.task.predict(at.windows, flow.SEARCH_STEP, at.model.near)
    return _one_pass(model, FitStart(at.q, restarted(at)), at.noise, SEARCH, LATER_DAMPING)


def with_own_static(at: Fit) -> Fit:
    """Give a ramp a break-away level if the thinned record gains; free from the first pass it ends in poor minima."""
    begun, task = clock.process_time(), at.task.with_static
    reached = noise_levels.DESCRIBES * task.resolution
    best = at
    for u in [] if task is at.task else _static_starts(task, at):
        first = first_pass(task, FitStart(_beside(task, u, at), at.local), at.noise)
        found = settle(first) if first is not None and first.geometric_mean_rms < at.geometric_mean_rms else None
        if found is not None and found.geometric_mean_rms < best.geometric_mean_rms:
            best = found
            if best.geometric_mean_rms < reached:
                break
    gain = at.residual.size * math.log(at.geometric_mean_rms / best.geometric_mean_rms)
    return replace(best if gain >= STATIC_GAIN else at, cpu_s=at.cpu_s + clock.process_time() - begun)


def _static_starts(task: Task, at: Fit) -> list[Array]:
    """Return unknowns (13 runs,) with a break-away level, from the end of a fit without one.

    Without a level the curve rises towards rest, and the regression of the smoothed slips is too flat. The first starts
    lie between the two, with the fit's friction at rest as the level; the others keep its friction in slip.
    """
    between = [at.u.copy() for _ in TOWARDS_REGRESSION]
    for u, share in zip(between, TOWARDS_REGRESSION, strict=True):
        for own, seen in zip(u.reshape(-1, PER_RUN), task.problem.start.reshape(-1, PER_RUN), strict=True):
            rest = own[Global.LOG_F]
            for slot in (Global.LOG_F, Global.SHAPE):
                own[slot] += share * (seen[slot] - own[slot])
            own[Global.STATIC] = max(math.exp(rest - own[Global.LOG_F]), STATIC_STARTS[0])
    others = [at.u.copy() for _ in STATIC_STARTS]
    for u, level in zip(others, STATIC_STARTS, strict=True):
        _set_static(task, u, level)
    return [*between, *others]


def _beside(task: Task, u: Array, at: Fit) -> Array:
    u = np.clip(u, task.problem.lower, task.problem.upper)
    return np.concatenate([u[list(task.places)], at.q[len(at.task.places) :]])


def _set_static(task: Task, u: Array, level: float) -> None:
    """Change the break-away level in u, with the same friction in slip and slope in stick."""
    if isinstance(task.curve, LawCurve):
        for own in u.reshape(-1, PER_RUN):
            own[:] = unknowns.to_array(with_static(task.curve.code, unknowns.values(own), level))


def _static_gain(at: Fit) -> float:
    """Return the approximate gain in log likelihood; inf without a level."""
    if Global.STATIC not in at.task.places:
        return math.inf
    excess, sd = float(at.u[Global.STATIC]) - 1.0, at.deviation(Global.STATIC)
    return 0.5 * (excess / sd) ** 2 if sd > 0 else 0.0


def finish(at: Fit, noise_m: Array | None = None) -> Fit | None:
    """Fit every sample, through nodes, with a known noise (runs,), m, if any; None if that cannot be followed."""
    begun, spent = clock.process_time(), at.cpu_s
    noise = at.noise.with_fade(at.task, at.windows, at.local)
    # The noise is that of levels that fade: without, a drag that wears shows several times as much.
    faded = _searched(replace(at, noise=noise))
    if faded is None:
        return None
    at = _with_noise(faded, first=False)
    if noise_m is not None:
        at = replace(at, noise=replace(at.noise, sigma=noise_m))
    found = finish_from(at.task, FitStart(at.q, restarted(at)), at.noise, at.model.near)
    return None if found is None else replace(found, cpu_s=spent + clock.process_time() - begun)


def finish_from(task: Task, start: FitStart, noise: PassNoise, near: Path | None = None) -> Fit | None:
    """Fit every sample from near the end; a break-away level without gain is removed."""
    begun = clock.process_time()
    found = _whole(task, start, noise, near)
    if found is None:
        return None
    if _static_gain(found) < STATIC_GAIN:
        level, u = found.task.without(Global.STATIC), found.u.copy()
        _set_static(level, u, 1.0)
        without = _whole(level, FitStart(_beside(level, u, found), found.local), noise, near)
        # Its error does not decide: along a bent valley a level may be open, and yet none of them be 1.
        if without is not None and without.solution.cost - found.solution.cost < STATIC_GAIN:
            found = without
    found = _started_below_belt(found, noise)
    return replace(found, cpu_s=clock.process_time() - begun)


def _whole(
    task: Task, start: FitStart, settled: PassNoise, near: Path | None, *, below_belt: bool = False
) -> Fit | None:
    noise = settled.for_last_pass
    whole = task.problem.windows(thinned=False)
    nodes = SampleNodes.of(whole, task.problem.thinning)
    every, sparse = task.predict(whole, flow.LONGEST_STEP), task.predict(nodes.windows, flow.LONGEST_STEP)
    for model in (every, sparse):
        model.settle(*start, FOLLOWED)
    residual, there = every.residual(*start), sparse.residual(*start)
    if residual is None or there is None:
        return None
    seen = nodes.seen(there + nodes.windows.position, residual)
    path = None if sparse.near is None else replace(sparse.near, windows=seen)
    seen_by = task.predict(seen, flow.LONGEST_STEP, path, nodes.count)
    last = _one_pass(seen_by, start, noise, WHOLE, LATER_DAMPING, below_belt=below_belt)
    if last is None:
        return None
    every.settle(*last.start, FOLLOWED)
    problem = least_squares_problem(every, noise, last.q, below_belt=below_belt)
    solution = levenberg_marquardt.last_step(problem, last.solution)
    if solution is None:
        return None
    return Fit(every, solution.u, solution.local, solution.residual, settled, problem, solution, whole=True)


def _started_below_belt(at: Fit, noise: PassNoise) -> Fit:
    """Refit slips that start faster than the belt from a slower start, and keep the better fit.

    Friction there points the other way until the mass sticks: a local minimum under noise, Fs up to 15 % too small.
    Bounds from the first pass on lead other fits into poor minima.
    """
    problem, curve = at.task.problem, at.task.curve
    fastest = at.windows.fastest_starts(at.u)
    beyond = (at.local > fastest).any(axis=1) & noise.inliers
    if curve.ramp or curve.law is None or curve.law.kind.curve == "constant" or not beyond.any():
        return at
    fresh = cycle_starts(at.windows, problem.motions, problem.cycles, at.u)
    below = np.minimum(np.where(beyond[:, None], fresh, at.local), fastest)
    found = _whole(at.task, FitStart(at.q, below), noise, None, below_belt=True)
    return found if found is not None and found.solution.cost < at.solution.cost else at


def fit_cycles(task: Task, start: FitStart, noise: PassNoise) -> FitStart:
    """Fit the cycles' own unknowns beside the shared ones of a start."""
    model = task.predict(task.problem.windows(thinned=True), flow.SEARCH_STEP)
    cycles = np.arange(len(task.problem.cycles))
    part = least_squares_problem(model, noise, start.q).of_cycles(start.q, cycles)
    end = None if part is None else levenberg_marquardt.minimise(part, np.empty(0), start.local, **CYCLE_RESTART)
    return start if end is None else start._replace(local=end.local)


def restarted(at: Fit) -> Array:
    """Restart outlying cycles from the smoothed motion where that costs less: a velocity step makes several minima."""
    cycles = np.flatnonzero(~at.noise.inliers)
    part = at.least_squares.of_cycles(at.q, cycles)
    if part is None:
        return at.local
    problem = at.task.problem
    fresh = cycle_starts(at.windows, problem.motions, problem.cycles, at.u)[cycles]
    found = levenberg_marquardt.minimise(part, np.empty(0), fresh, **CYCLE_RESTART)
    held = part.evaluate(part.prior, at.local[cycles], False)
    if found is None or held is None:
        return at.local
    before = cost_by_cycle(part, at.local[cycles], held[0])
    better = cost_by_cycle(part, found.local, found.residual) < CYCLE_GAIN * before
    local = at.local.copy()
    local[cycles[better]] = found.local[better]
    return local


def _with_noise(at: Fit, *, first: bool) -> Fit:
    return replace(at, noise=at.noise.seen(at.task, at.windows, at.residual, at.local, first=first))


def _one_pass(
    model: Model, start: FitStart, noise: PassNoise, limits: Limits, damping: float, *, below_belt: bool = False
) -> Fit | None:
    """Minimise under assumed noise; forces along the path are evaluated anew until they settle."""
    model.settle(*start, FOLLOWED)
    problem = least_squares_problem(model, noise, start.q, below_belt=below_belt)
    settings: dict[str, Any] = {"tolerance": limits.gain, "steady": limits.steady, "corrections": limits.corrections}
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
    return None if residual is None else Fit(model, solution.u, solution.local, residual, noise, problem, solution)


def least_squares_problem(model: Model, noise: PassNoise, q: Array, *, below_belt: bool = False) -> LeastSquaresProblem:
    """Return the problem of a pass; ``below_belt`` bounds slips to start slower than the belt."""
    task, windows = model.task, model.windows
    problem, (p, _, m) = task.problem, task.widths
    index = list(task.places)
    lower = np.concatenate([problem.lower[index], task.curve.lower, *(force.lower for force in task.forces)])
    upper = np.concatenate([problem.upper[index], task.curve.upper, *(force.upper for force in task.forces)])
    prior = np.concatenate([problem.prior[index], task.curve.prior, np.zeros(m)])
    precision = np.concatenate([problem.precision[index], task.curve.precision, np.zeros(m)])
    for j, place in enumerate(index):
        run, slot = divmod(place, PER_RUN)
        if slot == Global.FADE:
            if noise.fade_sd is None:
                lower[j] = upper[j] = q[j]
            else:
                precision[j] = noise.fade_sd[run] ** -2.0
    # A slip that starts beyond the belt's speed lets a curve or a drag of its own bend away from the true one.
    bounded = not task.curve.ramp and bool(below_belt or task.curve.size or task.forces)
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
        local_upper=windows.fastest_starts(unknowns.copy_shared(u)) if bounded else np.inf,
    )


LEFT_BY_OVERTAKING = 0.5  # share of a spoilt cycle's excess mean square: less is left where the mass overtakes


def find_overtaking(at: Fit) -> Mask:
    asked: Mask = at.windows.spoilt(at.residual) & ~at.windows.overtaking
    overtaking = np.zeros(asked.size, np.bool_)
    cycles = np.flatnonzero(asked)
    problem = at.task.problem.with_overtaking(asked)
    task, windows = replace(at.task, problem=problem), problem.windows(thinned=True)
    part = least_squares_problem(task.predict(windows, at.model.longest_step), at.noise, at.q).of_cycles(at.q, cycles)
    if part is None:
        return overtaking
    fresh = cycle_starts(windows, problem.motions, problem.cycles, at.u)[cycles]
    found = levenberg_marquardt.minimise(part, np.empty(0), fresh, **CYCLE_RESTART)
    if found is not None:
        run = at.windows.run
        usual = np.array([np.median(at.cycle_rms[run == own]) for own in run[cycles]]) ** 2
        left = windows.some(cycles).rms(found.residual) ** 2 - usual
        overtaking[cycles] = left < LEFT_BY_OVERTAKING * (at.cycle_rms[cycles] ** 2 - usual)
    return overtaking


def with_overtaking(at: Fit, overtaking: Mask) -> Fit | None:
    problem = at.task.problem.with_overtaking(overtaking)
    fresh = cycle_starts(problem.windows(thinned=True), problem.motions, problem.cycles, at.u)
    local = np.where(overtaking[:, None], fresh, at.local)
    return first_pass(replace(at.task, problem=problem), FitStart(at.q, local), at.noise)
