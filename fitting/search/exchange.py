"""Fit several tasks to the same runs: the order of the passes, and the exchange of starts between tasks.

first pass   every task is fitted from the regression
settle       tasks within `GIVEN_UP_BEYOND_BEST` times the best error are fitted until their noise is constant
exchange     a task that fits worse than a neighbour is fitted again, with the neighbour's fit as warm start
overtaking   cycles in which the mass overtakes the belt are found
level        a ramp gets a separate break-away level where that improves its fit; one more exchange follows
finish       tasks within `NEAR_BEST` times the best error are fitted to every sample; one exchange follows
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
    assume_noise,
    find_overtaking,
    finish,
    finish_from,
    first_pass,
    first_pass_from_regression,
    fit_break_away_level,
    refit_with_overtaking,
    restart_windows,
    settle,
)
from stickslip.compute.arrays import Array
from stickslip.compute.ordered import Map
from stickslip.compute.workers import workers

logger = logging.getLogger(__name__)
# Error over the best, or over the resolution, above which a task is not improved. At 3 no law is compatible.
FAR_BEYOND_BEST = 5.0
NEAR_BEST = 2.0  # error over the best, or the noise, up to which a start is tried and a fit takes every sample
LESS_NOISE_ASSUMED = 10.0  # noise over the resolution in a second first pass, made where no task fits to the noise
NARROW_START = 0.02  # width of a ramp that starts from its jump law's fit, over the width from the regression
WORSE = 1.0005  # error over a neighbour's, above which a task is fitted again from the neighbour's fit


def fit_from_start(task: Task, start: FitStart, noise: PassNoise) -> Fit | None:
    settled = settle_from_starts(task, [(start, noise)])
    return None if settled is None else finish(settled) or settled


def settle_from_starts(
    task: Task,
    starts: Sequence[tuple[FitStart, PassNoise | None]],
    noise_m: Array | None = None,
    smallest_other_error: float = math.inf,
) -> Fit | None:
    """Fit a task from several starts until one fits to within the noise, and return the best fit.

    The fit with the smallest error after its first pass is settled first. The noise of a position is ``noise_m``
    (runs,), m, by default the resolution. No fit is settled where all first passes are far worse than the other tasks'
    ``smallest_other_error``, m.
    """
    noise_limit = noise_levels.DESCRIBES * (task.resolution if noise_m is None else float(np.max(noise_m)))
    first_passes: list[Fit] = []
    for start, noise in starts:
        first = first_pass(task, start, noise)
        first_passes += [] if first is None else [first]
        if first is not None and first.geometric_mean_rms < noise_limit:
            break
    first_passes.sort(key=lambda fit: fit.geometric_mean_rms)
    if first_passes and first_passes[0].geometric_mean_rms > GIVEN_UP_BEYOND_BEST * smallest_other_error:
        return first_passes[0]
    best: Fit | None = None
    for first in first_passes:
        if best is not None and first.geometric_mean_rms > FAR_BEYOND_BEST * best.geometric_mean_rms:
            break
        best = select_better(best, settle(first, noise_m))
        if best is not None and best.geometric_mean_rms < noise_limit:
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
    """Fit laws to runs of one contact. All laws ``among`` are fitted, so that a fit does not depend on the request."""
    tasks = [law_task(law, runs) for law in sorted(among, key=lambda law: law.name)]
    requested = set(laws)

    def report_progress(done: int) -> None:
        if progress is not None:
            progress(len(requested) * done / len(tasks))

    with workers(min(jobs, len(tasks)), scheduler) as map_tasks:
        fits = fit_all(tasks, lambda task: task.curve.law in requested, map_tasks, report_progress)
    return sorted(fits, key=lambda fit: fit.task.curve.ramp)


def fit_all(
    tasks: Sequence[Task],
    is_requested: Callable[[Task], bool] = lambda _: True,
    map_tasks: Map = map,
    progress: Callable[[int], None] = lambda _: None,
) -> list[Fit]:
    fits = fit_first_passes(tasks, map_tasks, progress)
    fits = improve_near_best(fits, settle_unless_worse, GIVEN_UP_BEYOND_BEST, map_tasks)
    fits = exchange_starts(tasks, fits, map_tasks)
    levelled = improve_near_best(mark_overtaking(fits, map_tasks), fit_break_away_level, FAR_BEYOND_BEST, map_tasks)
    fits = exchange_starts(tasks, levelled, map_tasks, old_fits=fits)
    for fit in fits:
        if fit is not None:
            logger.debug("settled: law %s, %.4g um", fit.law.name, 1e6 * fit.geometric_mean_rms)
    requested = [task for task in tasks if is_requested(task)]
    needed = [is_requested(task) or any(other.curve.contains(task.curve) for other in requested) for task in tasks]
    fits, needed_tasks = list(compress(fits, needed)), list(compress(tasks, needed))
    finished = improve_near_best(fits, finish, NEAR_BEST, map_tasks)
    finished = exchange_starts(needed_tasks, finished, map_tasks, old_fits=fits)
    return [fit for fit in finished if fit is not None and is_requested(fit.task)]


def fit_first_passes(tasks: Sequence[Task], map_tasks: Map, progress: Callable[[int], None]) -> list[Fit | None]:
    fits: list[Fit | None] = []
    for fit in map_tasks(first_pass_from_regression, tasks):
        fits.append(fit)
        progress(len(fits))
    if any(fit is not None and fit.geometric_mean_rms < noise_levels.NEAR * fit.task.resolution for fit in fits):
        return fits
    return list(map_tasks(retry_first_pass, list(zip(tasks, fits, strict=True))))


def retry_first_pass(first: tuple[Task, Fit | None]) -> Fit | None:
    """Repeat a first pass with less noise: much noise avoids local minima, less follows the valley of a wrong law."""
    task, fit = first
    best = select_better(fit, first_pass_from_regression(task, assume_noise(task, LESS_NOISE_ASSUMED)))
    if best is None or best.solution.outcome == "converged":
        return best
    return select_better(best, first_pass(task, restart_windows(best)))


def improve_near_best(
    fits: Sequence[Fit | None], improve: Callable[[Fit], Fit | None], factor: float, map_tasks: Map
) -> list[Fit | None]:
    limit = factor * least_error(fits)
    near_best = [fit for fit in fits if fit is not None and fit.geometric_mean_rms <= limit]
    improved = dict(zip(map(id, near_best), map_tasks(improve, near_best), strict=True))
    return [improved.get(id(fit)) or fit for fit in fits]


def settle_unless_worse(fit: Fit) -> Fit:
    """Return the settled fit unless its error is larger, as when a wrong law treats all its cycles as outliers."""
    settled = settle(fit)
    return fit if settled is None or fits_worse(settled, fit) else settled


def least_error(fits: Sequence[Fit | None]) -> float:
    return min((fit.geometric_mean_rms for fit in fits if fit is not None), default=0.0)


def fits_worse(fit: Fit | None, other: Fit) -> bool:
    """Compare fits of the same samples only, since the residual of a thinned record is smaller."""
    return fit is None or (fit.finished == other.finished and fit.geometric_mean_rms > WORSE * other.geometric_mean_rms)


def select_better(fit: Fit | None, other: Fit | None) -> Fit | None:
    if fit is None or other is None:
        return fit or other
    return other if other.geometric_mean_rms < fit.geometric_mean_rms else fit


def exchange_starts(
    tasks: Sequence[Task], fits: Sequence[Fit | None], map_tasks: Map, old_fits: Sequence[Fit | None] = ()
) -> list[Fit | None]:
    """Fit each task that is worse than a neighbour, not in ``old_fits``, from the neighbour's fit; keep the better."""
    limit = FAR_BEYOND_BEST * least_error(fits)
    new_fits = [fit for fit in fits if fit is not None and all(fit is not other for other in old_fits)]
    restarts = {
        k: (task, fit, neighbours)
        for k, (task, fit) in enumerate(zip(tasks, fits, strict=True))
        if (neighbours := list_better_neighbours(task, fit, new_fits, limit))
    }
    ends = dict(zip(restarts, map_tasks(start_at_neighbours, list(restarts.values())), strict=True))
    return [ends.get(k) or fit for k, fit in enumerate(fits)]


def list_better_neighbours(task: Task, fit: Fit | None, fits: Sequence[Fit], limit: float) -> list[Fit]:
    """Return the best nested law, the ramp of this law and, for errors below ``limit``, the best fits of all."""
    ranked = sorted((other for other in fits if fits_worse(fit, other)), key=lambda other: other.geometric_mean_rms)
    best = [other for other in ranked if task.curve.contains(other.task.curve)][:1]
    best += [other for other in ranked if other.task.curve.is_ramp_of(task.curve)]  # a ramp of no width is the jump
    if fit is None or not (fit.finished or fit.geometric_mean_rms > limit):
        best += [other for other in ranked if other.task.curve.ramp == task.curve.ramp][:1]
        best += ranked[:1]
    return list(dict.fromkeys(best))


def start_at_neighbours(restart: tuple[Task, Fit | None, Sequence[Fit]]) -> Fit | None:
    """Fit from each better neighbour, with its noise; only the last pass follows where it used every sample."""
    task, fit, neighbours = restart
    for neighbour in neighbours:
        if fits_worse(fit, neighbour):
            task = task if fit is None else fit.task
            start = warm_start(task, neighbour, NARROW_START)
            if neighbour.finished:
                end = finish_from(task, start, neighbour.noise)
            else:
                first = first_pass(task, start, neighbour.noise.without_fade)
                end = None if first is None else settle_unless_worse(first)
            fit = select_better(fit, end)
    return fit


def warm_start(task: Task, donor: Fit, narrowing: float = 1.0) -> FitStart:
    """Return a start from another task's fit; a new ramp starts with ``narrowing`` times its regressed width."""
    u = donor.u
    curve, donor_curve = task.curve, donor.task.curve
    if isinstance(curve, LawCurve) and isinstance(donor_curve, LawCurve):
        u = task.problem.start_near(donor_curve.law, u)
        if curve.ramp and not donor_curve.ramp:
            u[Global.D :: PER_RUN] *= narrowing
    elif curve.ramp and not donor_curve.ramp:
        u[Global.D :: PER_RUN] = narrowing * task.problem.start[Global.D :: PER_RUN]
    u = np.clip(u, task.problem.lower, task.problem.upper)
    return FitStart(np.concatenate([u[list(task.places)], curve.start, np.zeros(task.widths[2])]), donor.local)


def mark_overtaking(fits: Sequence[Fit | None], map_tasks: Map) -> list[Fit | None]:
    """Apply the overtaking found with one curve to its jump and ramp: a ramp may fit it with a very low level."""
    limits = [0.0 if fit is None else FAR_BEYOND_BEST * fit.task.resolution for fit in fits]
    overtaking_by_curve = [
        (fit.task.curve, find_overtaking(fit))
        for fit, limit in zip(fits, limits, strict=True)
        if fit is not None and fit.geometric_mean_rms < limit
    ]
    marked_fits: dict[int, Fit] = {}
    for k, fit in enumerate(fits):
        if fit is not None:
            curve = fit.task.curve
            of_same_curve = [
                cycles
                for other, cycles in overtaking_by_curve
                if other is curve or other.is_ramp_of(curve) or curve.is_ramp_of(other)
            ]
            if np.any(of_same_curve):
                marked_fits[k] = refit_with_overtaking(fit, np.any(of_same_curve, axis=0)) or fit
    settled = dict(zip(marked_fits, map_tasks(settle, list(marked_fits.values())), strict=True))
    return [settled.get(k) or marked_fits.get(k) or fit for k, fit in enumerate(fits)]
