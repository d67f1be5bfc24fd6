"""The passes of a fit: with a large assumed noise, with the noise estimated from the residuals, with every sample.

first_pass   the thinned record, with noise 30 times the resolution: the priors then dominate a poor start
settle       again, with noise, weights and scatter estimated from the pass before, until these no longer change
finish       every sample, averaged at nodes, then one step on the samples; levels may fade, outliers hardly count

Overtaking of the belt that segmentation missed is found between `settle` and `finish`.
"""

import math
import time as clock
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from fitting import noise_levels
from fitting.least_squares import levenberg_marquardt
from fitting.least_squares.levenberg_marquardt import FIRST_DAMPING, LATER_DAMPING
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


FIRST_NOISE = 30.0  # noise assumed in the first pass, over the resolution: a start may be a tenth of a slip off
SEARCH = Limits(12, 1e-3, 1e-3)  # on the thinned record; the gain of a wrong law is small, so its rms decides
WHOLE = Limits(30, 1e-5, np.inf, corrections=3)  # with every sample
MOST_PASSES = 4  # passes after the first; the noise of a true law stays after two
NOISE_SETTLED = 0.8  # estimated over assumed noise, above which a pass is the last
NOISE_CUT = 4.0  # largest factor by which the assumed noise falls from pass to pass, where ``noise_m`` is given
CYCLE_RESTART: dict[str, Any] = {"max_steps": 15, "tolerance": 1e-4}  # of the own unknowns of outlying cycles
GIVEN_UP_BEYOND_BEST = 30.0  # error over the best after the first pass; true laws reach 20 in harsh records
STATIC_GAIN = 5.0  # least gain in log likelihood by a separate break-away level of a ramp
STATIC_STARTS = (1.1, 1.5)  # starts of the break-away level over that of slip: either alone misses true levels
TOWARDS_REGRESSION = (1.0, 0.75)  # starts between a fit without a break-away level (0) and the regression (1)
CYCLE_GAIN = 0.99  # cost of a restarted cycle over its cost before: with less it is in a better minimum
# Forces along a path: how often the path is followed before a pass; most passes, steps of each, and final change.
FOLLOWED, FORCE_PASSES, FORCE_STEPS, FORCE_SETTLED = 4, 6, 8, 1e-3


def start_from_regression(task: Task) -> FitStart:
    problem = task.problem
    windows = problem.windows(thinned=True)
    local = cycle_starts(windows, problem.motions, problem.cycles, problem.start)
    shared = problem.start[list(task.places)]
    return FitStart(np.concatenate([shared, task.curve.start, np.zeros(task.widths[2])]), local)


def restart_windows(fit: Fit) -> FitStart:
    """Restart all windows at the smoothed motion: the first shared unknowns may have led them to local minima."""
    problem = fit.task.problem
    return FitStart(fit.q, cycle_starts(fit.windows, problem.motions, problem.cycles, fit.u))


def assume_noise(task: Task, times: float = FIRST_NOISE) -> PassNoise:
    """Return a noise of ``times`` the resolution, with equal weights."""
    resolution = np.array([motion.resolution for motion in task.problem.motions])
    return PassNoise(times * resolution, np.ones(len(task.problem.cycles)))


def first_pass(task: Task, start: FitStart, noise: PassNoise | None = None) -> Fit | None:
    """Fit the thinned record; without a warm start's noise a large one is assumed."""
    begun = clock.process_time()
    windows = task.problem.windows(thinned=True)
    noise = assume_noise(task) if noise is None else noise
    fit = _run_pass(task.predict(windows, flow.SEARCH_STEP), start, noise, SEARCH, FIRST_DAMPING)
    if fit is None:
        return None
    return replace(_update_noise(fit, first=True), cpu_s=clock.process_time() - begun)


def first_pass_from_regression(task: Task, noise: PassNoise | None = None) -> Fit | None:
    """Fit from the regression, first without the ripple: under large noise any ripple frequency fits."""
    steady_task = task.without(*RIPPLE)
    if steady_task.places == task.places:
        return first_pass(task, start_from_regression(task), noise)
    fit = first_pass(steady_task, start_from_regression(steady_task), noise)
    if fit is None:
        return None
    return first_pass(task, FitStart(_join_unknowns(task, fit.u, fit), fit.local), fit.noise)


def settle(fit: Fit, noise_m: Array | None = None) -> Fit | None:
    """Repeat the pass with the estimated noise until that is constant; ``noise_m`` (runs,), m, is its lower bound."""
    begun, spent = clock.process_time(), fit.cpu_s
    for _ in range(MOST_PASSES):
        repeated = _repeat_pass(fit)
        if repeated is None:
            return None
        before, fit = fit, _update_noise(repeated, first=False)
        if noise_m is not None:
            sigma = np.maximum(np.minimum(fit.noise.sigma, before.noise.sigma / NOISE_CUT), noise_m)
            fit = replace(fit, noise=replace(fit.noise, sigma=sigma))
        noise_stays = bool(np.all(fit.noise.sigma > NOISE_SETTLED * before.noise.sigma))
        if noise_stays and fit.solution.outcome != "step limit":  # otherwise the same pass again
            break
    return replace(fit, cpu_s=spent + clock.process_time() - begun)


def _repeat_pass(fit: Fit) -> Fit | None:
    model = fit.task.predict(fit.windows, flow.SEARCH_STEP, fit.model.earlier_path)
    return _run_pass(model, FitStart(fit.q, restart_outliers(fit)), fit.noise, SEARCH, LATER_DAMPING)


def fit_break_away_level(fit: Fit) -> Fit:
    """Add a break-away level to a ramp if that improves the fit; free from the first pass it ends in local minima."""
    begun, task = clock.process_time(), fit.task.with_static
    noise_limit = noise_levels.DESCRIBES * task.resolution
    best = fit
    for u in [] if task is fit.task else _static_starts(task, fit):
        first = first_pass(task, FitStart(_join_unknowns(task, u, fit), fit.local), fit.noise)
        settled = settle(first) if first is not None and first.geometric_mean_rms < fit.geometric_mean_rms else None
        if settled is not None and settled.geometric_mean_rms < best.geometric_mean_rms:
            best = settled
            if best.geometric_mean_rms < noise_limit:
                break
    gain = fit.residual.size * math.log(fit.geometric_mean_rms / best.geometric_mean_rms)
    return replace(best if gain >= STATIC_GAIN else fit, cpu_s=fit.cpu_s + clock.process_time() - begun)


def _static_starts(task: Task, fit: Fit) -> list[Array]:
    """Return unknowns (13 runs,) with a break-away level, from a fit without one.

    Without a level the fitted curve is too steep near rest, and the regression of the smoothed slips is too flat. The
    first starts lie between the two, with the fit's friction at rest as level. The others keep its friction in slip.
    """
    between = [fit.u.copy() for _ in TOWARDS_REGRESSION]
    for u, share in zip(between, TOWARDS_REGRESSION, strict=True):
        for u_of_run, regressed in zip(u.reshape(-1, PER_RUN), task.problem.start.reshape(-1, PER_RUN), strict=True):
            rest = u_of_run[Global.LOG_F]
            for slot in (Global.LOG_F, Global.SHAPE):
                u_of_run[slot] += share * (regressed[slot] - u_of_run[slot])
            u_of_run[Global.STATIC] = max(math.exp(rest - u_of_run[Global.LOG_F]), STATIC_STARTS[0])
    same_in_slip = [fit.u.copy() for _ in STATIC_STARTS]
    for u, level in zip(same_in_slip, STATIC_STARTS, strict=True):
        _set_static(task, u, level)
    return [*between, *same_in_slip]


def _join_unknowns(task: Task, u: Array, fit: Fit) -> Array:
    u = np.clip(u, task.problem.lower, task.problem.upper)
    return np.concatenate([u[list(task.places)], fit.q[len(fit.task.places) :]])


def _set_static(task: Task, u: Array, level: float) -> None:
    """Change the break-away level in u; friction in slip and the slope in stick stay the same."""
    if isinstance(task.curve, LawCurve):
        for u_of_run in u.reshape(-1, PER_RUN):
            u_of_run[:] = unknowns.to_array(with_static(task.curve.code, unknowns.values(u_of_run), level))


def _static_gain(fit: Fit) -> float:
    """Return the approximate gain in log likelihood by a break-away level; inf without one."""
    if Global.STATIC not in fit.task.places:
        return math.inf
    excess, sd = float(fit.u[Global.STATIC]) - 1.0, fit.deviation(Global.STATIC)
    return 0.5 * (excess / sd) ** 2 if sd > 0 else 0.0


def finish(fit: Fit, noise_m: Array | None = None) -> Fit | None:
    """Fit every sample, with the noise ``noise_m`` (runs,), m, if given; None if the motion cannot be followed."""
    begun, spent = clock.process_time(), fit.cpu_s
    noise = fit.noise.with_fade(fit.task, fit.windows, fit.local)
    # The noise is estimated with levels that fade: without, that of a drag with wear is several times too large.
    faded = _repeat_pass(replace(fit, noise=noise))
    if faded is None:
        return None
    fit = _update_noise(faded, first=False)
    if noise_m is not None:
        fit = replace(fit, noise=replace(fit.noise, sigma=noise_m))
    finished = finish_from(fit.task, FitStart(fit.q, restart_outliers(fit)), fit.noise, fit.model.earlier_path)
    return None if finished is None else replace(finished, cpu_s=spent + clock.process_time() - begun)


def finish_from(task: Task, start: FitStart, noise: PassNoise, earlier_path: Path | None = None) -> Fit | None:
    """Fit every sample from a settled start; a break-away level that does not improve the fit is removed."""
    begun = clock.process_time()
    fit = _fit_every_sample(task, start, noise, earlier_path)
    if fit is None:
        return None
    if _static_gain(fit) < STATIC_GAIN:
        level, u = fit.task.without(Global.STATIC), fit.u.copy()
        _set_static(level, u, 1.0)
        fit_without = _fit_every_sample(level, FitStart(_join_unknowns(level, u, fit), fit.local), noise, earlier_path)
        # The error of the level alone does not decide: along a bent valley a poorly constrained level may exclude 1.
        if fit_without is not None and fit_without.solution.cost - fit.solution.cost < STATIC_GAIN:
            fit = fit_without
    fit = _restart_slips_below_belt(fit, noise)
    return replace(fit, cpu_s=clock.process_time() - begun)


def _fit_every_sample(
    task: Task, start: FitStart, pass_noise: PassNoise, earlier_path: Path | None, *, below_belt: bool = False
) -> Fit | None:
    noise = pass_noise.for_last_pass
    windows = task.problem.windows(thinned=False)
    nodes = SampleNodes.of(windows, task.problem.thinning)
    model, model_of_nodes = task.predict(windows, flow.LONGEST_STEP), task.predict(nodes.windows, flow.LONGEST_STEP)
    for prediction in (model, model_of_nodes):
        prediction.settle(*start, FOLLOWED)
    residual_of_samples, residual_of_nodes = model.residual(*start), model_of_nodes.residual(*start)
    if residual_of_samples is None or residual_of_nodes is None:
        return None
    measured_nodes = nodes.with_mean_residuals(residual_of_nodes + nodes.windows.position, residual_of_samples)
    path = None if model_of_nodes.earlier_path is None else replace(model_of_nodes.earlier_path, windows=measured_nodes)
    model_at_nodes = task.predict(measured_nodes, flow.LONGEST_STEP, path, nodes.count)
    last = _run_pass(model_at_nodes, start, noise, WHOLE, LATER_DAMPING, below_belt=below_belt)
    if last is None:
        return None
    model.settle(*last.start, FOLLOWED)
    problem = least_squares_problem(model, noise, last.q, below_belt=below_belt)
    solution = levenberg_marquardt.take_last_step(problem, last.solution)
    if solution is None:
        return None
    return Fit(model, solution.u, solution.local, solution.residual, pass_noise, problem, solution, finished=True)


def _restart_slips_below_belt(fit: Fit, noise: PassNoise) -> Fit:
    """Refit slips that start faster than the belt from a slower start, and keep the better fit.

    Above the belt's speed friction is reversed until the mass sticks. Under noise that is a local minimum, with Fs up
    to 15 % too small. Bounds from the first pass on lead other fits into local minima.
    """
    problem, curve = fit.task.problem, fit.task.curve
    fastest = fit.windows.fastest_starts(fit.u)
    too_fast = (fit.local > fastest).any(axis=1) & noise.inliers
    if curve.ramp or curve.law is None or curve.law.kind.curve == "constant" or not too_fast.any():
        return fit
    smoothed_starts = cycle_starts(fit.windows, problem.motions, problem.cycles, fit.u)
    slower_starts = np.minimum(np.where(too_fast[:, None], smoothed_starts, fit.local), fastest)
    refit = _fit_every_sample(fit.task, FitStart(fit.q, slower_starts), noise, None, below_belt=True)
    return refit if refit is not None and refit.solution.cost < fit.solution.cost else fit


def fit_cycles(task: Task, start: FitStart, noise: PassNoise) -> FitStart:
    """Fit the cycles' own unknowns beside the shared ones of a start."""
    model = task.predict(task.problem.windows(thinned=True), flow.SEARCH_STEP)
    cycles = np.arange(len(task.problem.cycles))
    part = least_squares_problem(model, noise, start.q).of_cycles(start.q, cycles)
    end = None if part is None else levenberg_marquardt.minimise(part, np.empty(0), start.local, **CYCLE_RESTART)
    return start if end is None else start._replace(local=end.local)


def restart_outliers(fit: Fit) -> Array:
    """Restart outlier cycles from the smoothed motion where that costs less: a velocity step makes several minima."""
    cycles = np.flatnonzero(~fit.noise.inliers)
    outliers = fit.least_squares.of_cycles(fit.q, cycles)
    if outliers is None:
        return fit.local
    problem = fit.task.problem
    smoothed_starts = cycle_starts(fit.windows, problem.motions, problem.cycles, fit.u)[cycles]
    refit = levenberg_marquardt.minimise(outliers, np.empty(0), smoothed_starts, **CYCLE_RESTART)
    present = outliers.evaluate(outliers.prior, fit.local[cycles], False)
    if refit is None or present is None:
        return fit.local
    before = cost_by_cycle(outliers, fit.local[cycles], present[0])
    better = cost_by_cycle(outliers, refit.local, refit.residual) < CYCLE_GAIN * before
    local = fit.local.copy()
    local[cycles[better]] = refit.local[better]
    return local


def _update_noise(fit: Fit, *, first: bool) -> Fit:
    return replace(fit, noise=fit.noise.update(fit.task, fit.windows, fit.residual, fit.local, first=first))


def _run_pass(
    model: Model, start: FitStart, noise: PassNoise, limits: Limits, damping: float, *, below_belt: bool = False
) -> Fit | None:
    """Minimise under assumed noise; forces along the path are evaluated again until they are constant."""
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
    """Return the problem of a pass; with ``below_belt`` slips must start slower than the belt."""
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
    # A slip that starts faster than the belt distorts a free curve or a drag.
    bounded = not task.curve.ramp and bool(below_belt or task.curve.size or task.forces)
    u = problem.start.copy()
    u[index] = q[:p]
    return LeastSquaresProblem(
        evaluate=model.evaluate,
        evaluate_cycles=None if model.along else model.evaluate_cycles,
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


OVERTAKING_EXCESS = 0.5  # excess mean square of a cycle with overtaking, over that without: smaller confirms it


def find_overtaking(fit: Fit) -> Mask:
    candidates: Mask = fit.windows.spoilt(fit.residual) & ~fit.windows.overtaking
    overtaking = np.zeros(candidates.size, np.bool_)
    cycles = np.flatnonzero(candidates)
    problem = fit.task.problem.with_overtaking(candidates)
    task, windows = replace(fit.task, problem=problem), problem.windows(thinned=True)
    candidate_problem = least_squares_problem(
        task.predict(windows, fit.model.longest_step), fit.noise, fit.q
    ).of_cycles(fit.q, cycles)
    if candidate_problem is None:
        return overtaking
    smoothed_starts = cycle_starts(windows, problem.motions, problem.cycles, fit.u)[cycles]
    refit = levenberg_marquardt.minimise(candidate_problem, np.empty(0), smoothed_starts, **CYCLE_RESTART)
    if refit is not None:
        run = fit.windows.run
        usual_square = np.array([np.median(fit.cycle_rms[run == number]) for number in run[cycles]]) ** 2
        excess = windows.of_cycles(cycles).rms(refit.residual) ** 2 - usual_square
        overtaking[cycles] = excess < OVERTAKING_EXCESS * (fit.cycle_rms[cycles] ** 2 - usual_square)
    return overtaking


def refit_with_overtaking(fit: Fit, overtaking: Mask) -> Fit | None:
    problem = fit.task.problem.with_overtaking(overtaking)
    smoothed_starts = cycle_starts(problem.windows(thinned=True), problem.motions, problem.cycles, fit.u)
    local = np.where(overtaking[:, None], smoothed_starts, fit.local)
    return first_pass(replace(fit.task, problem=problem), FitStart(fit.q, local), fit.noise)
