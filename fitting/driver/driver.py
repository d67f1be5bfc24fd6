"""Tasks fitted to the same runs: warm starts between them, and which are worth every sample.

Three levels of error decide.  A task that is `noise_levels.LOST` after its first pass may start from others too.  One
with an error `GIVEN_UP_BEYOND_BEST` times that of the best one is then not settled, one with `FAR_BEYOND_BEST` times
that of the best one when settled is fitted to the thinned record alone.
"""

import logging
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from fitting import noise_levels
from fitting.driver.curves import LawCurve
from fitting.driver.fit import Fit
from fitting.driver.noise import PassNoise
from fitting.driver.overtaking import find_overtaking, with_overtaking
from fitting.driver.passes import (
    GIVEN_UP_BEYOND_BEST,
    assumed_noise,
    finish,
    first_pass,
    regressed_pass,
    restarted_windows,
    settle,
    unmoved,
    with_cycles_of,
    with_own_static,
)
from fitting.driver.task import FitStart, Task, law_task
from fitting.law import SIX, Law
from fitting.model.parameters import PER_RUN, Global
from fitting.model.problem import Run
from stickslip.compute.arrays import Array
from stickslip.compute.ordered import Map
from stickslip.compute.workers import workers

logger = logging.getLogger(__name__)
# Error over the best, or over the resolution, from which a task is not looked at more closely: no law that errs 5 times
# as much was in a set, and at 20 every sample costs time.
FAR_BEYOND_BEST = 10.0
# Error over the best, where that is lost: what errs less starts again.  At half a wrong law is judged by a poor
# minimum, at twice laws that cannot be the nearest take time.
RESTART_NEAR_BEST = 3.0
# Noise, over the resolution, assumed in another first pass where every task leaves more than noise.
LESS_NOISE_ASSUMED = 10.0
DONOR_ERROR = 0.8  # error over a task's: another that errs less gives it a start; at 0.95 neighbours in noise do
NARROW_START = 0.02  # width over the first one, of a ramp that starts next to none at its jump law's end
CONTAINED_ERROR = 1.0005  # error over that of the curve that it contains: a ramp that errs more is in a poor minimum
# Width over the belt's speed: a ramp so narrow, or one that noise hides, is the jump.  Where it errs less than
# `CONTAINED_ERROR` allows, the jump is in a poor minimum.
CLOSED_RAMP = 0.02


def fit_from(task: Task, start: FitStart, noise: PassNoise) -> Fit | None:
    """Fit a task from the end of another fit, with its noise; None where the motion cannot be followed."""
    first = first_pass(task, start, noise)
    settled = None if first is None else settle(first)
    return None if settled is None else finish(settled) or settled


def best_end(
    task: Task, starts: Sequence[tuple[FitStart, PassNoise | None]], noise_m: Array | None = None
) -> Fit | None:
    """Settle a task from each start until one reaches the noise; return the best fit.

    Starts come with the noise of their fit, likeliest first; the best after its first pass is settled first, and one
    that reaches the noise ends the search. ``noise_m`` (runs,) is the noise of a position, m, if known; else the
    resolution.
    """
    reached = noise_levels.DESCRIBES * (task.resolution if noise_m is None else float(np.max(noise_m)))
    best: Fit | None = None
    tried: list[Fit] = []
    for start, noise in starts:
        first = first_pass(task, start, noise)
        tried += [] if first is None else [first]
        if first is not None and first.geometric_mean_rms < reached:
            break
    for first in sorted(tried, key=lambda one: one.geometric_mean_rms):
        settled = settle(first, noise_m)
        if settled is not None and (best is None or settled.geometric_mean_rms < best.geometric_mean_rms):
            best = settled
        if best is not None and best.geometric_mean_rms < reached:
            break
    return best


def fit_laws(
    laws: Sequence[Law],
    runs: Sequence[Run],
    among: Sequence[Law] = tuple(SIX.values()),
    *,
    jobs: int = 1,
    progress: Callable[[float], None] | None = None,
    scheduler: str | None = None,
) -> list[Fit]:
    """Fit laws to runs of one contact; jump laws first, without those whose motion cannot be followed.

    All laws ``among`` are searched, so that a fit does not depend on which others are requested.
    """
    tasks = [law_task(law, runs) for law in sorted(among, key=lambda law: law.name)]
    asked = set(laws)

    def searched(done: int) -> None:
        if progress is not None:
            progress(len(asked) * done / len(tasks))

    with workers(min(jobs, len(tasks)), scheduler) as each:
        found = fit_all(tasks, lambda task: task.curve.law in asked, each, searched)
    return sorted(found, key=lambda one: one.task.curve.ramp)


def fit_all(
    tasks: Sequence[Task],
    asked: Callable[[Task], bool] = lambda _: True,
    each: Map = map,
    progress: Callable[[int], None] = lambda _: None,
) -> list[Fit]:
    """Fit tasks to the same runs, and return those ``asked`` for in the order given.

    A curve that contains another comes after it; each starts from the regression and from others better after one pass.
    """
    first = _from_regression(tasks, each, progress)
    chosen = list(each(partial(_from_donors, tasks=tasks, first=tuple(first)), range(len(tasks))))
    begun = [(one, own) for one, own in zip(chosen, first, strict=True) if one is not None]
    found = _again([one for one, _ in begun], each)
    limit = GIVEN_UP_BEYOND_BEST * min((one.geometric_mean_rms for one in found), default=0.0)
    found = list(each(partial(_settled, limit=limit), found))
    left = [own if own is not None and not np.array_equal(own.q, one.q) else None for one, own in begun]
    found = from_left_starts(found, left, each)
    found = _overtaking(found, each)
    # Before, so that a law can start beside a ramp that opened; after, a ramp that started from its jump may have ended
    # below it.
    found = _contained(beside_better(_opened(found, each), each), settle, each)
    found = _opened(found, each)
    limit = FAR_BEYOND_BEST * min((one.geometric_mean_rms for one in found), default=0.0)
    found = list(each(partial(_with_static, limit=limit), found))
    for one in found:
        logger.debug("settled: law %s, %.4g um", one.law.name, 1e6 * one.geometric_mean_rms)
    limit = FAR_BEYOND_BEST * min((one.geometric_mean_rms for one in found), default=0.0)
    wanted = [one for one in found if asked(one.task)]
    needed = [
        one for one in found if asked(one.task) or any(other.task.curve.contains(one.task.curve) for other in wanted)
    ]
    needed = _contained(list(each(partial(_finished, limit=limit), needed)), finish, each)
    return [one for one in needed if asked(one.task)]


def _from_regression(tasks: Sequence[Task], each: Map, progress: Callable[[int], None]) -> list[Fit | None]:
    """Return the first pass of each task from the regression, or one with less assumed noise where that is better.

    Much noise leads out of poor minima of single cycles; less lets a wrong law follow a valley that calibrations as
    strong as that noise close. Once a task reaches the noise, others start from it instead.
    """
    found: list[Fit | None] = []
    for one in each(regressed_pass, tasks):
        found.append(one)
        progress(len(found))
    if any(one is not None and one.geometric_mean_rms < noise_levels.NEAR * one.task.resolution for one in found):
        return found
    others = each(_with_less_noise, tasks)
    return [other if one is None else _better(one, other) for one, other in zip(found, others, strict=True)]


def _with_less_noise(task: Task) -> Fit | None:
    return regressed_pass(task, assumed_noise(task, LESS_NOISE_ASSUMED))


def _from_donors(k: int, tasks: Sequence[Task], first: Sequence[Fit | None]) -> Fit | None:
    """Return the first pass of task k, or a better one that starts from another fit."""
    task, own = tasks[k], first[k]
    far = noise_levels.LOST * task.resolution
    for donor in _donors(task, k, first):
        if own is None or (
            far < own.geometric_mean_rms and donor.geometric_mean_rms < DONOR_ERROR * own.geometric_mean_rms
        ):
            trial = first_pass(task, start_beside(task, donor))
            if trial is not None and (own is None or trial.geometric_mean_rms < own.geometric_mean_rms):
                own = trial
    return own


def _settled(at: Fit, limit: float) -> Fit:
    return at if at.geometric_mean_rms > limit else settle(at) or at


def _with_static(at: Fit, limit: float) -> Fit:
    return at if at.geometric_mean_rms > limit else with_own_static(at)


def _finished(at: Fit, limit: float) -> Fit:
    return at if at.geometric_mean_rms > limit else finish(at) or at


def start_beside(task: Task, donor: Fit, narrow: float = 1.0) -> FitStart:
    """Return a warm start of a task from another fit: its shared unknowns, windows and friction.

    A new ramp starts with ``narrow`` of its first width.
    """
    u = donor.u
    mine, other = task.curve, donor.task.curve
    if isinstance(mine, LawCurve) and isinstance(other, LawCurve):
        u = task.problem.start_near(other.law, u)
        if mine.ramp and not other.ramp:
            u[Global.D :: PER_RUN] *= narrow
    elif mine.ramp and not other.ramp:
        u[Global.D :: PER_RUN] = narrow * task.problem.start[Global.D :: PER_RUN]
    u = np.clip(u, task.problem.lower, task.problem.upper)
    return FitStart(np.concatenate([u[list(task.places)], mine.start, np.zeros(task.widths[2])]), donor.local)


def _donors(task: Task, k: int, first: Sequence[Fit | None]) -> list[Fit]:
    """Return the fits a task may start from: its curve without a ramp, and the best other."""
    others = [one for j, one in enumerate(first) if j != k and one is not None]
    inner = [one for one in others if task.curve.is_ramp_of(one.task.curve)]
    best = sorted((one for one in others if one not in inner), key=lambda one: one.geometric_mean_rms)[:1]
    return [*inner, *best]


def _again(found: list[Fit], each: Map) -> list[Fit]:
    """Restart tasks with their windows at the smoothed motion, where even the best of them is lost."""
    lowest = min((one.geometric_mean_rms for one in found), default=0.0)
    if not found or lowest <= noise_levels.LOST * found[0].task.resolution:
        return found
    near = [one for one in found if one.geometric_mean_rms < RESTART_NEAR_BEST * lowest]
    trials = dict(zip(map(id, near), each(_restarted, near), strict=True))
    return [_better(one, trials.get(id(one))) for one in found]


def from_left_starts(found: list[Fit], left: Sequence[Fit | None], each: Map) -> list[Fit]:
    """Settle tasks from their own regression too where even the best of them is lost.

    ``left`` are these first passes, None where already chosen. With few samples a slip the regression is far off, and
    its search is not over when a wrong law's fit seems the better start.
    """
    lowest = min((one.geometric_mean_rms for one in found), default=0.0)
    if not found or lowest <= noise_levels.LOST * found[0].task.resolution:
        return found
    trials = each(_resettled, left)
    return [_better(one, trial) for one, trial in zip(found, trials, strict=True)]


def _restarted(at: Fit) -> Fit | None:
    return first_pass(at.task, restarted_windows(at))


def _better(one: Fit, other: Fit | None) -> Fit:
    return other if other is not None and other.geometric_mean_rms < one.geometric_mean_rms else one


def _overtaking(found: Sequence[Fit], each: Map) -> list[Fit]:
    """Settle fits of one curve again with the cycles that one of them finds overtaking the belt.

    A ramp may fit such a cycle by a very low level, where its jump shows that it is spoilt.
    """
    near = [one for one in found if one.geometric_mean_rms < FAR_BEYOND_BEST * one.task.resolution]
    seen = {id(one): find_overtaking(one) for one in near}
    out, moved = list(found), []
    for k, one in enumerate(found):
        own = [seen[id(other)] for other in near if other is one or _is_ramp_of(one, other) or _is_ramp_of(other, one)]
        cycles = np.any(own, axis=0) if own else np.zeros(1, np.bool_)
        if cycles.any():
            moved.append((k, with_overtaking(one, cycles)))
    again = each(_resettled, [one for _, one in moved])
    for (k, start), settled in zip(moved, again, strict=True):
        out[k] = settled or start or out[k]
    return out


def _resettled(at: Fit | None) -> Fit | None:
    return None if at is None else settle(at)


def _is_ramp_of(one: Fit, other: Fit) -> bool:
    return one.task.curve.is_ramp_of(other.task.curve)


def beside_better(found: list[Fit], each: Map) -> list[Fit]:
    """Restart a curve slightly worse than another on the same contact from that one.

    Without a datum, a ramp with constant levels determines v_dr - d alone: a search stops anywhere in that valley.
    """
    pairs = []
    for one in found:
        others = [other for other in found if other.task.curve.ramp == one.task.curve.ramp]
        best = min(others, key=lambda other: other.geometric_mean_rms)
        if (
            CONTAINED_ERROR * best.geometric_mean_rms
            < one.geometric_mean_rms
            < RESTART_NEAR_BEST * best.geometric_mean_rms
        ):
            pairs.append((one, best))
    return _kept(found, pairs, each, settle)


def _contained(found: list[Fit], again: Callable[[Fit], Fit | None], each: Map) -> list[Fit]:
    """Restart a curve with a larger error than one that it contains from there: it can only improve."""
    pairs = []
    for one in found:
        inner = [other for other in found if one.task.curve.contains(other.task.curve)]
        best = min(inner, key=lambda other: other.geometric_mean_rms, default=one)
        if one.geometric_mean_rms > CONTAINED_ERROR * best.geometric_mean_rms:
            pairs.append((one, best))
    return _kept(found, pairs, each, again)


def _opened(found: list[Fit], each: Map) -> list[Fit]:
    """Restart a jump with a larger error than the same curve with a closed ramp from there.

    Otherwise only single cycles are restarted: in harsh records one in twenty has a better minimum.
    """
    closed = [(jump, ramp) for ramp, jump in _with_ramps(found) if _is_closed(ramp, jump)]
    errs = [jump.geometric_mean_rms > CONTAINED_ERROR * ramp.geometric_mean_rms for jump, ramp in closed]
    found = _kept(found, [pair for pair, more in zip(closed, errs, strict=True) if more], each, settle)
    pairs = [pair for pair, more in zip(closed, errs, strict=True) if not more]
    trials = zip(pairs, each(with_cycles_of, pairs), strict=True)
    by_id = {id(jump): trial for (jump, _), trial in trials}
    return [by_id.get(id(one)) or one for one in found]


def _with_ramps(found: Sequence[Fit]) -> list[tuple[Fit, Fit]]:
    """Return each ramp with the same curve without it."""
    return [(one, other) for one in found for other in found if _is_ramp_of(one, other)]


def _kept(
    found: list[Fit],
    pairs: Sequence[tuple[Fit, Fit]],
    each: Map,
    again: Callable[[Fit], Fit | None],
) -> list[Fit]:
    """Return the fits; the first of each pair is replaced by a better one started from the second."""
    trials = zip(pairs, each(partial(_moved, again=again), pairs), strict=True)
    by_id = {id(pair[0]): trial for pair, trial in trials}
    return [_better(one, by_id.get(id(one))) for one in found]


def _is_closed(ramp: Fit, jump: Fit) -> bool:
    slowest = min(motion.belt_speed for motion in ramp.task.problem.motions)
    hidden = jump.geometric_mean_rms < noise_levels.NEAR * jump.task.resolution
    return hidden or float(ramp.u[Global.D]) < CLOSED_RAMP * slowest


def _moved(pair: tuple[Fit, Fit], again: Callable[[Fit], Fit | None]) -> Fit | None:
    """Return the first task fitted from the second's end, with its noise; None where it cannot be followed.

    A law that is far off takes the misfit for noise: where it ends worse than the second, its first pass or start
    stays.
    """
    one, inner = pair
    start, noise = start_beside(one.task, inner, NARROW_START), inner.noise.without_fade
    trial = first_pass(one.task, start, noise)
    settled = None if trial is None else again(trial)
    if settled is not None and settled.geometric_mean_rms <= CONTAINED_ERROR * inner.geometric_mean_rms:
        return settled
    ends = [settled, trial, unmoved(one.task, start, inner)]
    return min((end for end in ends if end is not None), key=lambda end: end.geometric_mean_rms, default=None)
