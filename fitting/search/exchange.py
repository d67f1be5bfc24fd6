"""Tasks fitted to the same runs: the order of the passes, and the exchange of starts between tasks.

first pass   of every task, from the regression
settle       of those within `GIVEN_UP_BEYOND_BEST` times the best
exchange     a task that fits worse than a neighbour starts again from that one's fit
overtaking   of cycles in which the mass overtakes the belt
level        of a ramp's break-away, where it has a separate one; then one exchange
finish       with every sample, of those within `FINISHED_NEAR_BEST` times the best; then one exchange
"""

import logging
import math
from collections.abc import Callable, Sequence
from itertools import compress

import numpy as np

from fitting import noise_levels
from fitting.laws import SIX, Law
from fitting.model.curves import LawCurve
from fitting.model.predict import FitStart, Task, law_task
from fitting.model.problem import Run
from fitting.model.unknowns import PER_RUN, Global
from fitting.search.fit import Fit, PassNoise
from fitting.search.passes import (
    GIVEN_UP_BEYOND_BEST,
    assumed_noise,
    find_overtaking,
    finish,
    finish_from,
    first_pass,
    regressed_pass,
    restarted_windows,
    settle,
    with_overtaking,
    with_own_static,
)
from stickslip.compute.arrays import Array
from stickslip.compute.ordered import Map
from stickslip.compute.workers import workers

logger = logging.getLogger(__name__)
# Error over the best, or over the resolution, above which a task is not improved; at 3 no law is compatible.
FAR_BEYOND_BEST = 5.0
FINISHED_NEAR_BEST = 2.0  # error over the best when settled, up to which a fit takes every sample
LESS_NOISE_ASSUMED = 10.0  # noise over the resolution in another first pass, where no task reaches the noise
NARROW_START = 0.02  # width over the first one, of a ramp that starts next to none at its jump law's end
WORSE = 1.0005  # error over a neighbour's, from which a task starts again from that one's fit


def fit_from(task: Task, start: FitStart, noise: PassNoise) -> Fit | None:
    settled = best_end(task, [(start, noise)])
    return None if settled is None else finish(settled) or settled


def best_end(
    task: Task,
    starts: Sequence[tuple[FitStart, PassNoise | None]],
    noise_m: Array | None = None,
    least: float = math.inf,
) -> Fit | None:
    """Settle a task from each start, likeliest first, until one reaches the noise; return the best fit.

    The best after its first pass is settled first. Without the noise of a position ``noise_m`` (runs,), m, it is the
    resolution. Where every first pass is far beyond ``least``, the least error of other tasks, m, none is settled.
    """
    reached = noise_levels.DESCRIBES * (task.resolution if noise_m is None else float(np.max(noise_m)))
    tried: list[Fit] = []
    for start, noise in starts:
        first = first_pass(task, start, noise)
        tried += [] if first is None else [first]
        if first is not None and first.geometric_mean_rms < reached:
            break
    tried.sort(key=lambda one: one.geometric_mean_rms)
    if tried and tried[0].geometric_mean_rms > GIVEN_UP_BEYOND_BEST * least:
        return tried[0]
    best: Fit | None = None
    for first in tried:
        if best is not None and first.geometric_mean_rms > FAR_BEYOND_BEST * best.geometric_mean_rms:
            break
        best = select_better(best, settle(first, noise_m))
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
    """Fit laws to runs of one contact; all ``among`` are searched, so that a fit does not depend on the request."""
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
    fits = fit_first_passes(tasks, each, progress)
    fits = improve_near_best(fits, settle_lower, GIVEN_UP_BEYOND_BEST, each)
    fits = exchange_starts(tasks, fits, each)
    levelled = improve_near_best(mark_overtaking(fits, each), with_own_static, FAR_BEYOND_BEST, each)
    fits = exchange_starts(tasks, levelled, each, tried=fits)
    for fit in fits:
        if fit is not None:
            logger.debug("settled: law %s, %.4g um", fit.law.name, 1e6 * fit.geometric_mean_rms)
    wanted = [task for task in tasks if asked(task)]
    needed = [asked(task) or any(other.curve.contains(task.curve) for other in wanted) for task in tasks]
    fits, needed_tasks = list(compress(fits, needed)), list(compress(tasks, needed))
    finished = improve_near_best(fits, finish, FINISHED_NEAR_BEST, each)
    finished = exchange_starts(needed_tasks, finished, each, tried=fits)
    return [fit for fit in finished if fit is not None and asked(fit.task)]


def fit_first_passes(tasks: Sequence[Task], each: Map, progress: Callable[[int], None]) -> list[Fit | None]:
    fits: list[Fit | None] = []
    for fit in each(regressed_pass, tasks):
        fits.append(fit)
        progress(len(fits))
    if any(fit is not None and fit.geometric_mean_rms < noise_levels.NEAR * fit.task.resolution for fit in fits):
        return fits
    return list(each(retry_first_pass, list(zip(tasks, fits, strict=True))))


def retry_first_pass(first: tuple[Task, Fit | None]) -> Fit | None:
    """Repeat a first pass with less noise: much leads out of poor minima, less along the valley of a wrong law."""
    task, fit = first
    best = select_better(fit, regressed_pass(task, assumed_noise(task, LESS_NOISE_ASSUMED)))
    if best is None or best.solution.outcome == "converged":
        return best
    return select_better(best, first_pass(task, restarted_windows(best)))


def improve_near_best(
    fits: Sequence[Fit | None], improve: Callable[[Fit], Fit | None], times: float, each: Map
) -> list[Fit | None]:
    limit = times * least_error(fits)
    near = [fit for fit in fits if fit is not None and fit.geometric_mean_rms <= limit]
    improved = dict(zip(map(id, near), each(improve, near), strict=True))
    return [improved.get(id(fit)) or fit for fit in fits]


def settle_lower(fit: Fit) -> Fit:
    """Return the settled fit unless its error is larger: a wrong law may take all its cycles as outliers."""
    settled = settle(fit)
    return fit if settled is None or fits_worse(settled, fit) else settled


def least_error(fits: Sequence[Fit | None]) -> float:
    return min((fit.geometric_mean_rms for fit in fits if fit is not None), default=0.0)


def fits_worse(fit: Fit | None, other: Fit) -> bool:
    """Compare fits of the same samples only: a thinned record shows a smaller residual."""
    return fit is None or (fit.whole == other.whole and fit.geometric_mean_rms > WORSE * other.geometric_mean_rms)


def select_better(fit: Fit | None, other: Fit | None) -> Fit | None:
    if fit is None or other is None:
        return fit or other
    return other if other.geometric_mean_rms < fit.geometric_mean_rms else fit


def exchange_starts(
    tasks: Sequence[Task], fits: Sequence[Fit | None], each: Map, tried: Sequence[Fit | None] = ()
) -> list[Fit | None]:
    """Restart each task that fits worse than a neighbour from that fit, unless ``tried``; keep the better fit."""
    limit = FAR_BEYOND_BEST * least_error(fits)
    fresh = [fit for fit in fits if fit is not None and all(fit is not other for other in tried)]
    restarts = {
        k: (task, fit, neighbours)
        for k, (task, fit) in enumerate(zip(tasks, fits, strict=True))
        if (neighbours := list_better_neighbours(task, fit, fresh, limit))
    }
    ends = dict(zip(restarts, each(start_at_neighbours, list(restarts.values())), strict=True))
    return [ends.get(k) or fit for k, fit in enumerate(fits)]


def list_better_neighbours(task: Task, fit: Fit | None, others: Sequence[Fit], limit: float) -> list[Fit]:
    """Return better fits: of a curve contained or of its ramp; below the ``limit`` also on the contact and of all."""
    ranked = sorted((other for other in others if fits_worse(fit, other)), key=lambda other: other.geometric_mean_rms)
    best = [other for other in ranked if task.curve.contains(other.task.curve)][:1]
    best += [other for other in ranked if other.task.curve.is_ramp_of(task.curve)]  # a closed ramp is the jump
    if fit is None or not (fit.whole or fit.geometric_mean_rms > limit):
        best += [other for other in ranked if other.task.curve.ramp == task.curve.ramp][:1]
        best += ranked[:1]
    return list(dict.fromkeys(best))


def start_at_neighbours(restart: tuple[Task, Fit | None, Sequence[Fit]]) -> Fit | None:
    """Refit with the noise of each better neighbour; from one of every sample only by the last pass."""
    task, fit, neighbours = restart
    for neighbour in neighbours:
        if fits_worse(fit, neighbour):
            task = task if fit is None else fit.task
            start = start_beside(task, neighbour, NARROW_START)
            if neighbour.whole:
                end = finish_from(task, start, neighbour.noise)
            else:
                first = first_pass(task, start, neighbour.noise.without_fade)
                end = None if first is None else settle_lower(first)
            fit = select_better(fit, end)
    return fit


def start_beside(task: Task, donor: Fit, narrow: float = 1.0) -> FitStart:
    """Return a warm start from another fit; a new ramp starts with ``narrow`` of its first width."""
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


def mark_overtaking(fits: Sequence[Fit | None], each: Map) -> list[Fit | None]:
    """Share cycles with overtaking among fits of one curve: a ramp may fit one by a very low level."""
    limits = [0.0 if fit is None else FAR_BEYOND_BEST * fit.task.resolution for fit in fits]
    seen = [
        (fit.task.curve, find_overtaking(fit))
        for fit, limit in zip(fits, limits, strict=True)
        if fit is not None and fit.geometric_mean_rms < limit
    ]
    marked: dict[int, Fit] = {}
    for k, fit in enumerate(fits):
        if fit is not None:
            own = fit.task.curve
            same = [cycles for curve, cycles in seen if curve is own or curve.is_ramp_of(own) or own.is_ramp_of(curve)]
            if np.any(same):
                marked[k] = with_overtaking(fit, np.any(same, axis=0)) or fit
    settled = dict(zip(marked, each(settle, list(marked.values())), strict=True))
    return [settled.get(k) or marked.get(k) or fit for k, fit in enumerate(fits)]
