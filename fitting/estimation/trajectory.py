"""One law fitted to the measured positions of every window at once: multiple shooting on the exact flow.

Shared by all windows: k/m, Fs/m, belt speed, the curve's shape, the ramp's half-width, the spring's rest position,
the damping, how fast a level fades, and how much the belt gives under load.  Each cycle has six unknowns of its
own: where its slip window starts (x, v), its kinetic level, the level after the next landing, and where its stick
window starts (x, v).  The levels are factors whose logarithms have mean 0; their prior carries their own scatter, so
that Fs/m means the mean level and its interval the error of that mean.

The noise of a position is not white: a law that is slightly wrong errs for many samples in a row.  Residuals therefore
count with sigma^2 = mean square x correlation time, found from the fit before, and a cycle that fits far worse than
the others (a velocity step, lost counts) counts less.
"""

import math
import time as clock
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from daq.base.compute.arrays import Array, Integers, Mask
from fitting.estimation.fit import INLIER_WEIGHT, Fit, PassState, without_outliers
from fitting.estimation.objective import active_unknowns, fitted_windows, pass_objective, priors
from fitting.least_squares import levenberg_marquardt
from fitting.least_squares.problem import LeastSquaresProblem, cost_by_cycle
from fitting.model import parameters, starts
from fitting.model.parameters import PER_RUN, Global
from fitting.model.problem import EstimationProblem
from fitting.model.windows import ShootingWindows
from rig_sim.friction.law import LAWS

# Starting values and limits of the search.  Chosen by trial on the runs of docs/identification.md; none was swept by
# itself.  After the first pass, estimates from the fit replace those named FIRST.
FIRST_SCATTER = 0.1  # standard deviation of the friction levels before the fit has seen them
FIRST_SIGMA = 10.0  # of the resolution: nearly any misfit outweighs the calibrations in the first pass
NARROW_RAMP = 0.02  # of the belt's speed: a jump law may start from a ramp law with a narrower ramp
PASSES = ((30, 1e-3), (15, 1e-4), (10, 1e-4))  # most steps of each, and the gain at which it stops
LONG_PASSES = ((200, 1e-5), (30, 1e-4), (10, 1e-4))  # without a datum: down a long bent valley, datum against Fs
FADE_PASS = (40, 1e-5)
# First break-away levels of a ramp over Fs: from 1.1 alone, one of 1.5 ends in poor minima; from 1.5 alone, these few
# steps do not find one of 1.1.
FIRST_STATIC, STATIC_PASS = (1.5, 1.1), (5, 1e-4)
STATIC_GAIN = 5.0  # least gain in log likelihood for which a ramp's break-away level is estimated
# The same on the thinned record, for a trial on the whole one, where the gain is up to 8 times as large.  One contact
# in six without a level of its own has as much.
STATIC_HINT = 0.5
FINE_PASS = (60, 1e-6)  # most steps, and the gain at which it stops; chosen by trial
CENTRED_PASS = (5, 1e-6)
CYCLE_PASS: dict[str, Any] = {"max_steps": 15, "tolerance": 1e-4}  # of the cycles' own unknowns alone
CYCLE_GAIN = 0.99  # of a cycle's cost: another start of its own unknowns led to another minimum
LEFT_BY_OVERTAKING = 0.5  # of a spoilt cycle's mean square beyond the usual one: less is left where the mass overtakes
ALTERNATIVE_FACTOR = 10.0  # times the best start's error after the first pass: beyond it a start is given up
LOST_MINIMUM = 1.05  # times the error before: a pass that ends so much worse has left its minimum and is undone
CONTAINED = 1.0005  # times its jump law's error: a ramp law that errs more is in a poor minimum
SAME_MINIMUM = 1.001  # times the best start's error: a start that ends so near it has led to the same minimum


def coarse_fit(
    problem: EstimationProblem, near: Fit | None = None, *, alone: bool = False, max_steps: int | None = None
) -> Fit | None:
    """Fit one law roughly to the thinned records.

    Parameters
    ----------
    problem : EstimationProblem
        Its runs have one used cycle or more each.
    near : Fit, optional
        Another law, fitted before to the same windows: a second start (`EstimationProblem.start_near`).  A ramp law
        takes its jump law with a very narrow ramp, and so begins where that ended.  From an earlier fit of this law the
        shared unknowns alone are taken: the cycles' own start at the smoothed motion again, since some may have been
        held in poor minima by the first shared unknowns, and have held these where they were.
    alone : bool
        Start from ``near`` alone.
    max_steps : int, optional
        Fewer than the search's own limit, where only a rough misfit is wanted.

    Returns
    -------
    Fit or None
        The better of what the starts lead to, after one pass in which nothing is known of the noise.  None when the
        flow cannot be followed from any of them: the law then has no place in the ranking.
    """
    begun = clock.process_time()
    windows = fitted_windows(problem, thinned=True)
    begin = [_starting_state(problem, windows, problem.start)]
    if near is not None:
        second = _starting_state(problem, windows, problem.start_near(near.law, near.u))
        if near.law != problem.law:
            second = replace(second, local=near.local)
        begin = [second] if alone else [*begin, second]
    ended = [_search_pass(problem, windows, first, 0, max_steps) for first in begin]
    found = sorted((state for state in ended if state is not None), key=lambda state: state.geometric_mean_rms)
    if not found:
        return None
    lowest = found[0].geometric_mean_rms
    others = tuple(
        state for state in found[1:] if SAME_MINIMUM < state.geometric_mean_rms / lowest < ALTERNATIVE_FACTOR
    )
    return replace(_fit(problem, windows, found[0], clock.process_time() - begun), alternatives=others)


def refine(fit: Fit) -> Fit | None:
    """Fit again with noise level, weights and scatter as the passes before show them; None where that leads nowhere."""
    begun = clock.process_time()
    ended = []
    for first in (fit.state, *fit.alternatives):
        state: PassState | None = first
        for number in range(1, len(PASSES)):
            if state is not None:
                state = _search_pass(fit.problem, fit.windows, state, number)
        if state is not None:
            ended.append(state)
    if not ended:
        return None
    best = min(ended, key=lambda state: state.geometric_mean_rms)
    if best.geometric_mean_rms > LOST_MINIMUM * fit.geometric_mean_rms:
        return None
    return _fit(fit.problem, fit.windows, best, fit.cpu_s + clock.process_time() - begun)


def contain(problem: EstimationProblem, near: Fit) -> Fit | None:
    """Fit a ramp law from where its jump law's fit ended, with the noise and the samples of that fit.

    The error is never above the jump law's: where a lower cost comes with a larger usual error, the ramp stays next to
    none.  None where the flow cannot be followed.
    """
    begun = clock.process_time()
    first = replace(near.state, u=problem.start_near(near.law, near.u))
    for max_steps in (FINE_PASS[0], 1):
        state = _minimise(problem, near.windows, first, max_steps, FINE_PASS[1])
        if state is not None and state.geometric_mean_rms <= CONTAINED * near.geometric_mean_rms:
            return _fit(problem, near.windows, state, clock.process_time() - begun)
    return None


def fit_from(problem: EstimationProblem, near: Fit) -> Fit | None:
    """Fit one law from another's fit alone, refined where that succeeds; None where it leads nowhere."""
    first = coarse_fit(problem, near, alone=True)
    return None if first is None else refine(first) or first


def final_fit(fit: Fit) -> Fit:
    """Fit the whole record, fading included, from where the search on the thinned one ended.

    The search's own fit is returned when that leads nowhere.
    """
    begun = clock.process_time()
    problem = fit.problem
    first = _restart_cycles(problem, fit.windows, replace(fit.state, fade_sd=fit.fade_sd))
    last = _minimise(problem, fit.windows, first, *FADE_PASS)
    trial = False
    if last is not None:
        freed, gain = _with_static(problem, fit.windows, last)
        last, trial = (freed, False) if gain > STATIC_GAIN else (last, gain > STATIC_HINT)
    windows = fitted_windows(problem, thinned=False)
    if last is not None and windows.time.size > fit.windows.time.size:
        noise = last.with_noise(fit.windows, problem.motions, first=False)
        noise = _restart_cycles(problem, fit.windows, noise)
        last = _minimise(problem, windows, replace(noise, weights=without_outliers(noise.weights)), *FINE_PASS)
    else:
        windows = fit.windows
    if last is None:
        return fit
    if problem.level_prior > 1:  # the pass has moved the levels' mean a little
        last = _minimise(problem, windows, last, *CENTRED_PASS) or last
    if trial:
        freed, gain = _with_static(problem, windows, last, FIRST_STATIC[1:], FINE_PASS)
        last = freed if gain > STATIC_GAIN else last
    last = _started_below_belt(problem, windows, last)
    return _fit(problem, windows, last, fit.cpu_s + clock.process_time() - begun)


def _fit(problem: EstimationProblem, windows: ShootingWindows, state: PassState, cpu_s: float) -> Fit:
    active = active_unknowns(problem, state)
    index = list(active)
    solution = state.solution
    if solution is None or state.precision is None:
        raise RuntimeError("a state without a solution is a start, not a fit")
    return Fit(
        problem=problem,
        u=state.u,
        active=active,
        local=state.local,
        residual=solution.residual,
        cycle_rms=state.cycle_rms,
        inlier_cycles=state.weights > INLIER_WEIGHT,
        sigma=state.sigma,
        prior_deviations=(state.u[index] - problem.prior[index]) * np.sqrt(problem.precision[index]),  # none of a fade
        solution=solution,
        precision=state.precision[index],
        windows=windows,
        cycles=problem.cycles,
        state=state,
        cpu_s=cpu_s,
    )


def _starting_state(problem: EstimationProblem, windows: ShootingWindows, u: Array) -> PassState:
    """Return a start at shared unknowns u, with no noise known yet."""
    return PassState(
        u=u,
        local=starts.cycle_starts(windows, problem.motions, problem.cycles, u),
        sigma=np.array([FIRST_SIGMA * motion.resolution for motion in problem.motions]),
        scatter=FIRST_SCATTER,
        weights=np.ones(len(windows.rows)),
        cycle_rms=np.ones(len(windows.rows)),
        solution=None,
    )


def _search_pass(
    problem: EstimationProblem, windows: ShootingWindows, state: PassState, number: int, max_steps: int | None = None
) -> PassState | None:
    """Make one of the search's passes, then settle noise level, weights and scatter by it."""
    valley = LAWS[problem.law].curve != "constant" and any(motion.datum_prior is None for motion in problem.motions)
    passes = LONG_PASSES if valley else PASSES
    limit, tolerance = passes[number]
    first = _restart_cycles(problem, windows, state) if number == 1 else state
    found = _minimise(problem, windows, first, limit if max_steps is None else max_steps, tolerance)
    return None if found is None else found.with_noise(windows, problem.motions, first=number == 0)


def _minimise(
    problem: EstimationProblem,
    windows: ShootingWindows,
    state: PassState,
    max_steps: int,
    tolerance: float,
    fastest: Array | float = math.inf,
) -> PassState | None:
    """Minimise once with the noise assumed so far; ``fastest`` are upper bounds of the cycles' own unknowns."""
    index = list(active_unknowns(problem, state))
    movable = Global.COMPLIANCE not in [place % PER_RUN for place in index] and not problem.held[Global.LOG_F]
    if problem.level_prior > 1 and movable:
        state = state.centred()
    task = replace(pass_objective(problem, windows, state, index), local_upper=fastest)
    solution = levenberg_marquardt.minimise(task, state.u[index], state.local, max_steps=max_steps, tolerance=tolerance)
    if solution is None:
        return None
    u = state.u.copy()
    u[index] = solution.u
    u = parameters.copy_shared(u)
    prior, precision = priors(problem, state)
    found = replace(state, u=u, local=solution.local, cycle_rms=windows.rms(solution.residual), solution=solution)
    return replace(found, prior=prior, precision=precision)


def _restart_cycles(problem: EstimationProblem, windows: ShootingWindows, state: PassState) -> PassState:
    """Let outlying cycles start again from the smoothed motion, and keep what fits better.

    A cycle with a velocity step has several minima, and one pass can leave it in a poor one: from there it distorts the
    law's error although its weight is low.
    """
    cycles = np.flatnonzero(state.weights <= INLIER_WEIGHT)
    if state.solution is None or (found := _from_smoothed(problem, windows, state, cycles)) is None:
        return state
    part, solution = found
    residual = np.concatenate([state.solution.residual[windows.rows[k]] for k in cycles])
    before = cost_by_cycle(part, state.local[cycles], residual)
    better = cost_by_cycle(part, solution.local, solution.residual) < CYCLE_GAIN * before
    local = state.local.copy()
    local[cycles[better]] = solution.local[better]
    return replace(state, local=local)


def _from_smoothed(
    problem: EstimationProblem, windows: ShootingWindows, state: PassState, cycles: Integers
) -> tuple[LeastSquaresProblem, levenberg_marquardt.Solution] | None:
    """Fit the own unknowns of these cycles (indices) from the smoothed motion; return what was minimised, and how."""
    part = pass_objective(problem, windows, state, []).of_cycles(np.empty(0), cycles)
    if part is None:
        return None
    first = starts.cycle_starts(windows, problem.motions, problem.cycles, state.u)[cycles]
    found = levenberg_marquardt.minimise(part, np.empty(0), first, **CYCLE_PASS)
    return None if found is None else (part, found)


def find_overtaking(fit: Fit) -> Mask:
    """Return in which spoilt cycles (cycles,) the mass overtakes the belt unseen: that explains what they leave."""
    asked: Mask = fit.windows.spoilt(fit.residual) & ~fit.windows.overtaking
    overtaking = np.zeros(asked.size, np.bool_)
    if not asked.any():
        return overtaking
    cycles = np.flatnonzero(asked)
    trial = with_overtaking(fit, asked)
    found = _from_smoothed(trial.problem, trial.windows, fit.state, cycles)
    if found is not None:
        usual = np.array([np.median(fit.cycle_rms[fit.windows.run == run]) for run in fit.windows.run[cycles]]) ** 2
        left = trial.windows.some(cycles).rms(found[1].residual) ** 2 - usual
        overtaking[cycles] = left < LEFT_BY_OVERTAKING * (fit.cycle_rms[cycles] ** 2 - usual)
    return overtaking


def with_overtaking(fit: Fit, overtaking: Mask) -> Fit:
    """Return where a fit starts again with a mass that overtakes the belt after landing in these cycles (cycles,)."""
    problem = fit.problem.with_overtaking(overtaking)
    windows = fitted_windows(problem, thinned=True)
    first = starts.cycle_starts(windows, problem.motions, problem.cycles, fit.u)
    state = replace(fit.state, local=np.where(overtaking[:, None], first, fit.local))
    return replace(fit, problem=problem, windows=windows, cycles=problem.cycles, state=state)


def _started_below_belt(problem: EstimationProblem, windows: ShootingWindows, state: PassState) -> PassState:
    """Return the state, or a better one where slips that it starts beyond the belt's speed start below it.

    Beyond the belt's speed friction points the other way until the mass sticks, and the cycle's own break-away then
    fixes its level: under noise a local minimum, with Fs up to 15 % too small.  Bounds from the first pass on lead
    other fits into poor minima.  On a ramp the two directions meet without a jump.
    """
    fastest = windows.fastest_starts(state.u)
    beyond = (state.local > fastest).any(axis=1) & (state.weights > INLIER_WEIGHT)
    if problem.ramp or LAWS[problem.law].curve == "constant" or state.solution is None or not beyond.any():
        return state
    first = starts.cycle_starts(windows, problem.motions, problem.cycles, state.u)
    below = replace(state, local=np.minimum(np.where(beyond[:, None], first, state.local), fastest))
    found = _minimise(problem, windows, below, *FINE_PASS, fastest=fastest)
    better = found is not None and found.solution is not None and found.solution.cost < state.solution.cost
    return found if found is not None and better else state


def _with_static(
    problem: EstimationProblem,
    windows: ShootingWindows,
    state: PassState,
    levels: Sequence[float] = FIRST_STATIC,
    limits: tuple[int, float] = STATIC_PASS,
) -> tuple[PassState, float]:
    """Let a ramp's break-away level differ from that of slip; return the better state and its gain in log likelihood.

    ``levels`` are starts of the level over Fs, ``limits`` most steps and the gain at which they stop.  The gain is 0
    where there is no ramp of a width to speak of, or where nothing is gained.
    """
    narrow = state.u[Global.D] < NARROW_RAMP * min(motion.belt_speed for motion in problem.motions)
    settled = Global.STATIC not in problem.active or problem.held[Global.STATIC]
    if settled or narrow or state.solution is None:
        return state, 0.0
    best, cost = state, state.solution.cost
    for level in levels:
        u = state.u.copy()
        for own in u.reshape(-1, PER_RUN):
            own[:] = parameters.to_array(
                starts.with_static(LAWS[problem.law].curve_code, parameters.values(own), level)
            )
        freed = _minimise(problem, windows, replace(state, u=u, static=True), *limits)
        if freed is not None and freed.solution is not None and freed.solution.cost < cost:
            best, cost = freed, freed.solution.cost
    return best, best.gain_over(state, windows)
