"""Laws given as formulas: the requested and every published one, fitted to the positions of every window.

Windows, noise and calibrations are those of the measured curve, so that a fit differs from it in the curve alone. The
search starts at each minimum of the formula on the measured curve. A formula with a constant hides the rest position
where no calibration gives that: it is then assumed as in `fitting.judge.curve`.

All are fitted, whatever the measured curve looks like: where the rest position is unknown, so is the level of friction,
and the six are then richer than they look. A law that contains another one is not fitted where the record cannot refute
that one. `fitting.judge.evidence` compares them with the six.
"""

import logging
import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from operator import attrgetter

import numpy as np

from fitting import noise_levels
from fitting.judge.calibrations import apply_to_formula
from fitting.judge.curve import MeasuredCurve, band_speeds, curve_target
from fitting.laws import MEMORY, MEMORY_LIMITS, PUBLISHED, Competitors, Law, natural_size
from fitting.model.predict import KNOT_POWER, OF_THE_LAW, FitStart, Task
from fitting.model.problem import EstimationProblem, Run
from fitting.model.unknowns import PER_RUN, Global
from fitting.search.exchange import (
    FAR_BEYOND_BEST,
    NEAR_BEST,
    WORSE,
    fits_worse,
    select_better,
    settle_from_starts,
    warm_start,
)
from fitting.search.fit import Fit, PassNoise, Unfitted
from fitting.search.formula import SPLINE_ERROR, SPLINE_REACH, FormulaCurve, Target, find_starts
from fitting.search.memory import fit_memory
from fitting.search.passes import finish, finish_from
from stickslip.compute.arrays import Array
from stickslip.errors import InputError

GRID_SPEEDS = 300  # speeds at which a formula is compared with a fitted law, as dense as the curve's knots


def fit_formula(law: Law, seen: MeasuredCurve, *, others: Sequence[Fit]) -> Fit | None:
    """Fit a law to the measured curve's runs, also from the end of ``others`` where it fits worse than they require."""
    host, noise = seen.spline_fit, seen.noise
    fastest = SPLINE_REACH * (float(host.spline.knots[-1]) + (0.0 if law.ramp else seen.ramp))
    target, level_sd = curve_target(seen)
    curve = FormulaCurve(law, fastest, target.with_unknown_constant(level_sd))
    problem = _problem(curve, host)
    task = Task(problem, curve, tuple(place for place in problem.active if place % PER_RUN not in OF_THE_LAW))
    beside = warm_start(task, host)
    starts = []
    for start in curve.starts:
        if start.misfit <= NEAR_BEST**2 * curve.starts[0].misfit:
            theta = curve.theta_at(start.values)
            friction = curve.at_speeds(theta, target.speeds)
            rise = target.nearest_constant(friction, level_sd) / host.u[Global.K]
            shared = beside.q[: len(task.places)] + [rise * _is_free_rest(problem, place) for place in task.places]
            starts.append(beside._replace(q=np.concatenate([shared, theta])))
    position = float(np.max(noise))
    # On one contact no law is nearer to the record than the free curve.
    hopeless = seen.chi > noise_levels.LOST
    starts = starts[:1] if hopeless else starts
    by_error = attrgetter("geometric_mean_rms")
    nearest = min(others, key=by_error, default=host)
    inner = min((one for one in others if contained(law, one.law)), key=by_error, default=None)
    least = nearest.geometric_mean_rms
    tried = [(start, host.noise.without_fade) for start in starts]
    if law.name not in PUBLISHED:  # it may be the nearest law, written in another way
        tried = [*_starts_beside(task, nearest), *tried]
    found = settle_from_starts(task, tried, noise, least)
    error = math.inf if found is None else found.geometric_mean_rms
    limited = inner is not None and error > WORSE * inner.geometric_mean_rms
    behind = not hopeless and WORSE * least < error < FAR_BEYOND_BEST * least
    if (found is None or limited or behind) and error > noise_levels.DESCRIBES * position:
        neighbours = dict.fromkeys([inner, nearest] if inner is not None and limited else [nearest])
        again = [start for neighbour in neighbours for start in _starts_beside(task, neighbour)]
        found = select_better(found, settle_from_starts(task, again, noise, least))
    limit = min(noise_levels.LOST * position, noise_levels.NEAR * max(least, position))
    if found is not None and found.geometric_mean_rms < limit:
        found = finish(found, noise) or found
        same = min((other for other in others if other.law.ramp == law.ramp), key=by_error, default=found)
        if law.name not in PUBLISHED and not (fits_worse(found, same) or fits_worse(same, found)):
            # perhaps the same curve in another form: its cycles get the same weights
            found = finish_from(found.task, found.start, same.noise) or found
    return found if found is not None and found.can_be_followed else None


def contained(law: Law, other: Law) -> bool:
    """Return whether the other is constant friction or a limit; a ramp of the six may have a break-away level."""
    constant = other.number == 1 and law.depends_on_speed
    return (law.contains(other) or constant) and not (other.number and other.ramp)


def _starts_beside(task: Task, neighbour: Fit) -> list[tuple[FitStart, PassNoise]]:
    """Return starts nearest to another law's friction, at the assumed rest position, with its noise."""
    curve, knots = task.curve, np.linspace(0.0, 1.0, GRID_SPEEDS)
    if not isinstance(curve, FormulaCurve):
        raise TypeError("not the task of a formula")
    beside = warm_start(task, neighbour)
    speeds = curve.fastest / SPLINE_REACH * knots**KNOT_POWER
    u = task.split(beside.q)[0]
    raised = float(u[Global.K] * (neighbour.u[Global.DATUM] - u[Global.DATUM]))
    friction = neighbour.task.friction(neighbour.q, speeds) + raised
    try:
        nearest = find_starts(
            curve.law.given(fix=curve.fixed),
            Target.of(speeds, friction, float(np.median(np.abs(friction)))),
            curve.fastest,
        )
    except InputError:
        return []
    shared = beside.q[: len(task.places)]
    noise = neighbour.noise.without_fade
    return [(beside._replace(q=np.concatenate([shared, curve.theta_at(start.values)])), noise) for start in nearest]


def _is_free_rest(problem: EstimationProblem, place: int) -> bool:
    run, slot = divmod(place, PER_RUN)
    given = problem.motions[run].datum_prior is not None or problem.fixed[place]
    return slot == Global.DATUM and not given


def _has_constant(curve: FormulaCurve) -> bool:
    """Return whether the parameters can add a constant, which then hides the rest position."""
    speeds = np.linspace(0.0, curve.fastest, GRID_SPEEDS)
    slopes = curve.slopes(curve.start, speeds)
    slopes = slopes / np.maximum(np.linalg.norm(slopes, axis=0), 1e-300)
    one = np.ones(speeds.size)
    left = one - np.einsum("kp,p->k", slopes, np.linalg.lstsq(slopes, one, rcond=None)[0])
    return bool(np.max(np.abs(left)) < SPLINE_ERROR)


def _problem(curve: FormulaCurve, host: Fit) -> EstimationProblem:
    """Return the problem of a formula, with the measured curve's rest positions if it has a constant."""
    own = EstimationProblem.build(curve.law, host.problem.runs)
    if not _has_constant(curve):
        return own
    changed = {name: getattr(own, name).copy() for name in ("start", "prior", "precision", "lower", "upper")}
    for place in range(Global.DATUM, own.start.size, PER_RUN):
        if not own.fixed[place]:
            for name, values in changed.items():
                values[place] = getattr(host.problem, name)[place]
    return replace(own, **changed)


logger = logging.getLogger(__name__)
SAME_CURVE = 1e-3  # difference of equal curves over the friction; other families differ by more than a hundredth
RUN_AWAY = 1e4  # size of a parameter over that by its unit, above which the search has no end


def fit_formulas(
    competitors: Competitors, curve: MeasuredCurve | None, six: Sequence[Fit], *, sustained: bool = True
) -> tuple[list[Fit], list[Unfitted], list[str]]:
    """Fit requested and published laws; also return those that cannot be fitted, and warnings.

    Under friction that falls a mass sticks again and again: without ``sustained`` sticks no published law competes, as
    of the six only those of constant friction do.
    """
    fits: list[Fit] = []
    missing: list[Unfitted] = []
    warned: list[str] = []
    for law in _candidates(competitors, curve, six):
        asked = competitors.asks(law)
        others = [other for other in (*six, *fits) if not other.law.rate]
        fit: Fit | str = "the friction curve could not be measured"
        if law.rate:
            fit = fit_memory(law, six[0].problem.runs, _nearest(others))
            fit = (isinstance(fit, Fit) and name_better_limit(fit, others)) or fit
        elif not (sustained or asked):
            fit = "the mass does not stick repeatedly, as it does if friction decreases with speed"
        elif curve is not None:
            fit = _fit(law, curve, others, asked=asked)
        if isinstance(fit, str):
            missing.append(Unfitted(law, fit, asked))
            logger.info("law %s was not fitted: %s", law.name, fit)
            continue
        logger.info("law %s: %.4g um rms, %s, %.2f s", law.name, 1e6 * fit.rms, fit.outcome, fit.cpu_s)
        fits.append(fit)
        warned += [_said(law, str(group), group.names) for group in fit.task.curve.together] if asked else []
    return fits, missing, warned


def _nearest(fits: Sequence[Fit]) -> Fit:
    return min(fits, key=attrgetter("geometric_mean_rms"))


def fit_memory_laws(competitors: Competitors, runs: Sequence[Run], others: Sequence[Fit], noise: Array) -> list[Fit]:
    """Fit the laws with memory that were not requested, except limits of another one, as far as they can be fitted.

    ``others`` are the fits of all other laws; ``noise`` (runs,) is that of a position, m.
    """
    limits = {name for names in MEMORY_LIMITS.values() for name in names}
    laws = [law for law in MEMORY.values() if law.name not in limits and not competitors.asks(law)]
    return [fit for law in laws for fit in [fit_memory(law, runs, _nearest(others), noise)] if isinstance(fit, Fit)]


def _candidates(competitors: Competitors, curve: MeasuredCurve | None, six: Sequence[Fit]) -> Iterator[Law]:
    """Yield the requested formulas, the published ones with the measured curve's contact, and laws with memory."""
    motion = six[0].problem.motions[0]
    requested = [law for law in (*competitors.formulas, *competitors.six) if not competitors.by_kernel(law)]
    given = [apply_to_formula(law, competitors.of_law(law), motion) for law in requested]
    ramp = curve is not None and curve.spline_fit.problem.ramp
    yield from (law for law in given if not law.rate)
    yield from (replace(law, ramp=ramp) for law in PUBLISHED.values() if not competitors.asks(law))
    yield from (law for law in given if law.rate)


def _fit(law: Law, curve: MeasuredCurve, others: Sequence[Fit], *, asked: bool) -> Fit | str:
    """Fit one formula, or return why it is not fitted."""
    if not asked:
        host = curve.spline_fit
        for other in others:
            # The free curve contains every law: where it gains no more than its parameters and one of a law are worth,
            # no law can.
            gain = 2 * host.residual.size * math.log(other.geometric_mean_rms / host.geometric_mean_rms)
            worth = host.task.curve.size - other.law_parameters + math.log(host.residual.size)
            if law.contains(other.law) and gain < worth:
                return f"it contains law {other.law.name} as a special case, and no curve fits better than that law"
    try:
        fit = fit_formula(law, curve, others=others)
    except InputError as error:
        return error.what.removeprefix(f"law {law.name} is ")
    if fit is None:
        return "its motion could not be computed"
    spline, found = curve.spline_fit.spline, fit.law_values
    friction, fastest = float(np.median(spline.coefficients)), float(spline.knots[-1])
    free = fit.task.curve.free
    if any(abs(found[name]) > RUN_AWAY * natural_size(law, name, friction, fastest) for name in free):
        return "its parameters grow without bound"
    if worse := name_better_limit(fit, others):
        return worse
    for other in others:
        if not (asked or other.law.number or other.law.name in PUBLISHED) and _draws(other.law, fit, curve.spline_fit):
            return f"law {other.law.name} can have the same curve"
    return fit


def name_better_limit(fit: Fit, others: Sequence[Fit]) -> str | None:
    """Return the reason to reject a fit that is worse than that of a contained law: its search has not ended."""
    for other in others:
        limit = fit.law.contains(other.law) if fit.law.has_kernel else contained(fit.law, other.law)
        worse = fit.geometric_mean_rms > WORSE * other.geometric_mean_rms
        if limit and (worse or fit.rms > WORSE * other.rms):
            return f"its residual is larger than that of law {other.law.name}, which it contains"
    return None


def _draws(law: Law, rival: Fit, host: Fit) -> bool:
    if law.ramp != rival.problem.ramp:
        return False
    speeds = band_speeds(host)
    friction = rival.task.friction(rival.q, speeds)
    nearest = find_starts(law, Target.of(speeds, friction, float(np.max(friction))))[0]
    return nearest.misfit < SAME_CURVE**2 * speeds.size


def _said(law: Law, how: str, names: Sequence[str]) -> str:
    if len(names) == 1:
        return f"law {law.name}: {how}; omit it"
    return (
        f"law {law.name}: {how}, so the data cannot determine them separately, and their errors are withheld. "
        f"Fix all but one, as in --fix {law.name}.{names[-1]}=1, or replace them by one parameter"
    )
