"""The passes of a fit: with much noise assumed, with the noise that the residuals show, with every sample.

first_pass   noise 30 times the resolution, on the thinned record: priors then hold what is far off
settle       again with the noise, weights and scatter that the pass before showed, until these stay
finish       every sample, seen through nodes, and a last step of all; levels may fade, outlying cycles hardly count

Cycles in which the mass overtakes the belt after landing although its velocity does not show it.
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
from fitting.model import problem as starts
from fitting.model.curves import LawCurve
from fitting.model.path import Path
from fitting.model.predict import FitStart, Model, Task
from fitting.model.problem import cycle_starts, thinned_to
from fitting.model.unknowns import PER_RUN, RIPPLE, Global
from fitting.model.windows import SampleNodes
from fitting.search.fit import Fit, PassNoise
from stickslip.compute.arrays import Array, Mask


class Limits(NamedTuple):
    """Limits of a minimisation: most steps, and the gain and the relative change of the rms below which it ends."""

    steps: int
    gain: float
    steady: float
    corrections: int = 0


# Noise that the first pass assumes, over the resolution.  At half a start that errs by a slip's tenth is held where it
# is; at twice the priors hold a true law too, which then needs one more pass.
FIRST_NOISE = 30.0
# Of each pass on the thinned record.  Half the steps end before a bent valley's floor; twice the steps cost laws that
# are wrong twice the time.  A wrong law's noise is large and its gain small: its rms says whether it still moves.
SEARCH = Limits(12, 1e-3, 1e-3)
WHOLE = Limits(30, 1e-5, np.inf, corrections=3)  # of every sample: at half, a level that fades is not at its end
MOST_PASSES = 4  # passes after the first; the noise of a true law stays after two
# Noise shown over the noise assumed: a pass that shows no less was the last.  At 0.9 each law takes one pass more.
NOISE_SETTLED = 0.8
NOISE_CUT = 4.0  # factor by which the noise assumed falls from pass to pass, where it is known
FIRST_DAMPING, LATER_DAMPING = 1e-4, 1e-6  # of the curvatures: far from the end, and near it
CYCLE_RESTART: dict[str, Any] = {"max_steps": 15, "tolerance": 1e-4}  # of the own unknowns of outlying cycles
# Error over the best after the first pass, from which a fit is not settled.  True laws reach 20 there in harsh records;
# twice costs time alone.
GIVEN_UP_BEYOND_BEST = 30.0
# Least gain in log likelihood of a ramp's break-away level of its own.  Half and twice decide the same on 26 records,
# of which two have one.
STATIC_GAIN = 5.0
# Starts of the break-away level over that of slip.  What the level's first step would gain does not say whether it is
# worth a search: with levels of 1.05 and of 1.5 it was nothing at the end without one.  From 1.1 alone a level of 1.5
# was missed, from 1.5 alone one of 1.3.
STATIC_STARTS = (1.1, 1.5)
# Shares of the way from the curve of a fit without a level to that of the regression, from which others start.  Of 24
# records of law 6 with levels of 1.2 to 1.6 the first alone misses about half, the second alone five, both three.
TOWARDS_REGRESSION = (1.0, 0.75)
CYCLE_GAIN = 0.99  # cost over that of a cycle before: another start of its own unknowns led to another minimum
# Of forces along an earlier path: how often the path is followed before a pass, the passes in which they settle, the
# most steps of each, and the change of their size at which they have.
FOLLOWED, FORCE_PASSES, FORCE_STEPS, FORCE_SETTLED = 4, 6, 8, 1e-3


def regressed_start(task: Task) -> FitStart:
    """Return the start: shared unknowns of the regression, forces of 0, windows at the smoothed motion."""
    problem = task.problem
    windows = problem.windows(thinned=True)
    local = starts.cycle_starts(windows, problem.motions, problem.cycles, problem.start)
    shared = problem.start[list(task.places)]
    return FitStart(np.concatenate([shared, task.curve.start, np.zeros(task.widths[2])]), local)


def restarted_windows(at: Fit) -> FitStart:
    """Return a restart: the fit's shared unknowns, with all windows at the smoothed motion.

    The first shared unknowns may have held some cycles in poor minima, and these held them in turn.
    """
    problem = at.task.problem
    return FitStart(at.q, starts.cycle_starts(at.windows, problem.motions, problem.cycles, at.u))


def assumed_noise(task: Task, times: float = FIRST_NOISE) -> PassNoise:
    """Return noise of so many resolutions, before the first pass."""
    resolution = np.array([motion.resolution for motion in task.problem.motions])
    return PassNoise(times * resolution, np.ones(len(task.problem.cycles)))


def first_pass(task: Task, start: FitStart, noise: PassNoise | None = None) -> Fit | None:
    """Fit on the thinned record; None where the start cannot be followed.

    ``noise`` is that of a fitted start; for others nearly any misfit is taken for noise.
    """
    begun = clock.process_time()
    windows = task.problem.windows(thinned=True)
    noise = assumed_noise(task) if noise is None else noise
    at = _one_pass(Model(task, windows, flow.SEARCH_STEP), start, noise, SEARCH, FIRST_DAMPING)
    if at is None:
        return None
    return replace(_with_noise(at, first=True), cpu_s=clock.process_time() - begun)


def regressed_pass(task: Task, noise: PassNoise | None = None) -> Fit | None:
    """Return the first pass from the regression; a belt's ripple is free only after the rest has converged.

    Under the large noise of a first pass any frequency fits as well as that of the sticks.
    """
    steady = task.without(*RIPPLE)
    if steady.places == task.places:
        return first_pass(task, regressed_start(task), noise)
    held = first_pass(steady, regressed_start(steady), noise)
    if held is None:
        return None
    return first_pass(task, FitStart(_beside(task, held.u, held), held.local), held.noise)


def settle(at: Fit, noise_m: Array | None = None) -> Fit | None:
    """Fit again with the noise and the weights of the previous pass, until these no longer change.

    A known noise of a position, ``noise_m`` (runs,), m, is approached in steps, whatever a pass shows.
    """
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
    """Return another pass on the thinned record, from the end of a fit."""
    model = Model(at.task, at.windows, flow.SEARCH_STEP, at.model.near)
    return _one_pass(model, FitStart(at.q, restarted(at)), at.noise, SEARCH, LATER_DAMPING)


def with_own_static(at: Fit) -> Fit:
    """Return the fit of a ramp with a separate break-away level where that gains on the thinned record.

    Starts whose first pass gains something are settled until one reaches the noise. A level free from the first pass on
    ends in poor minima.
    """
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

    A curve without a level rises towards rest to come near the break-aways, and the regression of the smoothed slips is
    too flat. The first have curves between the two, and the fit's friction at rest as the level; the others have the
    fit's friction in slip.
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
    """Return the unknowns of a task with other free places, at u (13 runs,) and the end of a fit."""
    u = np.clip(u, task.problem.lower, task.problem.upper)
    return np.concatenate([u[list(task.places)], at.q[len(at.task.places) :]])


def _set_static(task: Task, u: Array, level: float) -> None:
    """Change the break-away level in u (13 runs,), with the same friction in slip and slope in stick."""
    if isinstance(task.curve, LawCurve):
        for own in u.reshape(-1, PER_RUN):
            own[:] = unknowns.to_array(starts.with_static(task.curve.code, unknowns.values(own), level))


def _static_gain(at: Fit) -> float:
    """Return the approximate gain of a break-away level in log likelihood; inf where the ramp has none."""
    if Global.STATIC not in at.task.places:
        return math.inf
    excess, sd = float(at.u[Global.STATIC]) - 1.0, at.deviation(Global.STATIC)
    return 0.5 * (excess / sd) ** 2 if sd > 0 else 0.0


def finish(at: Fit, noise_m: Array | None = None) -> Fit | None:
    """Fit again with every sample, through nodes; None where these shorter steps cannot be followed.

    ``noise_m`` (runs,) is the noise of a position, m, where known better than by this curve's residual.
    """
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
    """Fit with every sample from near the end, with the noise of the pass before.

    A break-away level that gains nothing is left out again; slips that start faster than the belt start again.
    """
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
    nodes = SampleNodes.of(whole, [thinned_to(run) for run in task.problem.runs])
    every, sparse = Model(task, whole, flow.LONGEST_STEP), Model(task, nodes.windows, flow.LONGEST_STEP)
    for model in (every, sparse):
        model.settle(*start, FOLLOWED)
    residual, there = every.residual(*start), sparse.residual(*start)
    if residual is None or there is None:
        return None
    seen = nodes.seen(there + nodes.windows.position, residual)
    seen_by = Model(task, seen, flow.LONGEST_STEP, _over(sparse.near, seen), nodes.count)
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

    Beyond the belt's speed friction points the other way until the mass sticks, and the cycle's break-away then fixes
    its level: a local minimum under noise, with Fs up to 15 % too small. Bounds from the first pass on lead other fits
    into poor minima. On a ramp the two directions meet without a jump.
    """
    problem, curve = at.task.problem, at.task.curve
    fastest = at.windows.fastest_starts(at.u)
    beyond = (at.local > fastest).any(axis=1) & noise.inliers
    if curve.ramp or curve.law is None or curve.law.kind.curve == "constant" or not beyond.any():
        return at
    fresh = starts.cycle_starts(at.windows, problem.motions, problem.cycles, at.u)
    below = np.minimum(np.where(beyond[:, None], fresh, at.local), fastest)
    found = _whole(at.task, FitStart(at.q, below), noise, None, below_belt=True)
    return found if found is not None and found.solution.cost < at.solution.cost else at


def restarted(at: Fit) -> Array:
    """Return the cycles' own unknowns, those of outlying cycles from the smoothed motion where that costs less.

    A cycle with a velocity step has several minima, and a poor one distorts the fit although its weight is low.
    """
    cycles = np.flatnonzero(~at.noise.inliers)
    part = at.least_squares.of_cycles(at.q, cycles)
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
    """Return a path as one of other windows with the same times."""
    return None if near is None else replace(near, windows=windows)  # type: ignore[arg-type]


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
    """Return the problem of a pass: calibrations are priors; levels that do not fade keep their fade.

    ``below_belt`` bounds slips to start slower than the belt, as a separate curve or force requires.
    """
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


# Share of a spoilt cycle's mean square beyond the usual one: less is left where the mass overtakes.
LEFT_BY_OVERTAKING = 0.5


def find_overtaking(at: Fit) -> Mask:
    """Return the spoilt cycles (cycles,) whose residual an unseen overtaking of the belt explains."""
    asked: Mask = at.windows.spoilt(at.residual) & ~at.windows.overtaking
    overtaking = np.zeros(asked.size, np.bool_)
    cycles = np.flatnonzero(asked)
    problem = at.task.problem.with_overtaking(asked)
    task, windows = replace(at.task, problem=problem), problem.windows(thinned=True)
    part = least_squares_problem(Model(task, windows, at.model.longest_step), at.noise, at.q).of_cycles(at.q, cycles)
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
    """Return the thinned record fitted with the belt overtaken in these cycles (cycles,) too."""
    problem = at.task.problem.with_overtaking(overtaking)
    fresh = cycle_starts(problem.windows(thinned=True), problem.motions, problem.cycles, at.u)
    local = np.where(overtaking[:, None], fresh, at.local)
    return first_pass(replace(at.task, problem=problem), FitStart(at.q, local), at.noise)
