"""A law given as a formula, fitted by the driver to the positions of every window.

Windows, noise and calibrations are those of the measured curve, so that the fit differs from it in the curve alone.
The search starts where the measured curve ended, at each minimum of the formula on it.

A formula with a constant hides the rest position where no calibration gives that: it is then assumed, as for the
measured curve (`fitting.judge.curve`).  The shape of one without a constant says where the spring rests.

Laws given as formulas beside the six: those that were named, and every published one.

All are fitted, whatever the measured curve looks like: where the rest position is unknown, the level of friction is,
and the six are then richer than they look.  A law that contains another one that reaches the noise is not fitted, since
the record cannot refute it.  What is evidence and who is in the set is decided as between the six
(`fitting.judge.evidence`).
"""

import logging
import math
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from operator import attrgetter

import numpy as np

from fitting import noise_levels
from fitting.judge.calibrations import formula_given
from fitting.judge.curve import (
    GRID_SPEEDS,
    MeasuredCurve,
    MeasuredTarget,
    friction_target,
    measured_target,
    seen_speeds,
)
from fitting.laws import PUBLISHED, Competitors, Law, natural_size
from fitting.model.predict import KNOT_POWER, OF_THE_LAW, FitStart, Task
from fitting.model.problem import EstimationProblem
from fitting.model.unknowns import PER_RUN, Global
from fitting.search.exchange import WORSE, best_end, start_beside
from fitting.search.fit import Fit, PassNoise, Unfitted
from fitting.search.formula import SPLINE_REACH, FormulaCurve, Target, find_starts
from fitting.search.passes import finish
from stickslip.errors import InputError

CONSTANT_LEFT = 1e-6  # share of a constant: what is left of it beside the derivatives of a formula that has one
# Other minima on the measured curve are starts too: those that are off it by less than its errors, or by less than so
# many times the nearest one's chi square.  A fall over which the record has few samples has two such minima; at twice a
# wrong formula is started once or twice more.  A formula whose nearest is off by more than so many times the curve's
# errors starts where friction itself is nearest.
START_MISFIT = 4.0


def fit_formula(
    law: Law, seen: MeasuredCurve, *, others: Sequence[Fit] = (), target: MeasuredTarget | None = None
) -> Fit | None:
    """Fit a law with a jump or its own ramp to the measured curve's runs; None where its motion cannot be followed.

    law: With a jump or a ramp of its own.
    seen: The measured curve.
    others: Other laws fitted to the runs: where the law errs more than constant friction, or than another one that it
        contains, it starts again where the best of them ended.
    target: The measured curve in the metric of the record, where it is known already.
    Raises InputError: with none of the values tried is the formula a friction curve.
    """
    host, noise = seen.spline_fit, seen.noise
    fastest = SPLINE_REACH * (float(host.spline.knots[-1]) + (0.0 if law.ramp else seen.ramp))
    curve, measured, within_errors = _started(law, seen, fastest, target)
    problem = _problem(curve, host)
    task = Task(problem, curve, tuple(place for place in problem.active if place % PER_RUN not in OF_THE_LAW))
    beside = start_beside(task, host)
    starts = []
    for start in curve.starts:
        if start.misfit <= max(START_MISFIT * curve.starts[0].misfit, within_errors):
            theta = curve.theta_at(start.values)
            friction = curve.at_speeds(theta, measured.alone.speeds)
            rise = measured.alone.constant_beside(friction, measured.level_sd) / host.u[Global.K]
            shared = beside.q[: len(task.places)] + [rise * _is_free_rest(problem, place) for place in task.places]
            starts.append(beside._replace(q=np.concatenate([shared, theta])))
    position = float(np.max(noise))
    # On one contact no law is nearer to the record than the free curve.
    hopeless = seen.chi > noise_levels.LOST
    starts = starts[:1] if hopeless else starts
    best = min(others, key=lambda one: one.geometric_mean_rms, default=None)
    inner = min((one.geometric_mean_rms for one in others if contained(law, one.law)), default=math.inf)
    least = math.inf if best is None else best.geometric_mean_rms
    settled = best_end(task, [(start, host.noise.without_fade) for start in starts], noise, least)
    again: list[tuple[FitStart, PassNoise | None]] = []
    if not hopeless and (settled is None or WORSE * least < settled.geometric_mean_rms < noise_levels.LOST * least):
        again += [(start, None) for start in starts]
    if best is not None and (settled is None or settled.geometric_mean_rms > WORSE * inner):
        again += [(start, best.noise.without_fade) for start in _at_end_of(task, best)]
    if again and not (settled and settled.geometric_mean_rms < noise_levels.DESCRIBES * position):
        ends = (settled, best_end(task, again, noise, least))
        settled = min((end for end in ends if end), key=attrgetter("geometric_mean_rms"), default=None)
    found = settled
    limit = min(noise_levels.LOST * position, noise_levels.NEAR * max(least, position))
    if settled is not None and settled.geometric_mean_rms < limit:
        found = finish(settled, noise) or settled
    return found if found is not None and found.can_be_followed else None


def contained(law: Law, other: Law) -> bool:
    """Return whether the other law can err no less than this one: constant friction, or a limit of it.

    A ramp of the six may have a break-away level of its own, which none of a formula has.
    """
    return (law.contains(other) or other.number == 1) and not (other.number and other.ramp)


def _at_end_of(task: Task, neighbour: Fit) -> list[FitStart]:
    """Return where a formula starts from another law's end: nearest to its friction, at the rest that is assumed."""
    curve, knots = task.curve, np.linspace(0.0, 1.0, GRID_SPEEDS)
    if not isinstance(curve, FormulaCurve):
        raise TypeError("not the task of a formula")
    beside = start_beside(task, neighbour)
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
    return [beside._replace(q=np.concatenate([shared, curve.theta_at(start.values)])) for start in nearest]


def _started(
    law: Law, seen: MeasuredCurve, fastest: float, target: MeasuredTarget | None
) -> tuple[FormulaCurve, MeasuredTarget, float]:
    """Return the formula with its starts, what these are near, and the misfit of one that is off by the curve's errors.

    A formula that is far off starts where friction itself is nearest, unless it is no friction there.
    """
    measured, curve = target or measured_target(seen), None
    within_errors = float(measured.alone.aim.size)
    try:
        curve = FormulaCurve(law, fastest, measured.near)
    except InputError as error:
        refused = error
    if curve is not None and curve.starts[0].misfit <= START_MISFIT * within_errors:
        return curve, measured, within_errors
    nearest = friction_target(seen.spline_fit)
    with suppress(InputError):
        return FormulaCurve(law, fastest, nearest.near), nearest, 0.0
    if curve is None:
        raise refused
    return curve, measured, within_errors


def _is_free_rest(problem: EstimationProblem, place: int) -> bool:
    """Return whether a shared unknown is a rest position without calibration and without assumption."""
    run, slot = divmod(place, PER_RUN)
    given = problem.motions[run].datum_prior is not None or problem.held[place]
    return slot == Global.DATUM and not given


def _has_constant(curve: FormulaCurve) -> bool:
    """Return whether the parameters can add a constant to the formula, which then hides the rest position."""
    speeds = np.linspace(0.0, curve.fastest, 41)
    slopes = curve.slopes(curve.start, speeds)
    slopes = slopes / np.maximum(np.linalg.norm(slopes, axis=0), 1e-300)
    one = np.ones(speeds.size)
    left = one - np.einsum("kp,p->k", slopes, np.linalg.lstsq(slopes, one, rcond=None)[0])
    return bool(np.max(np.abs(left)) < CONSTANT_LEFT)


def _problem(curve: FormulaCurve, host: Fit) -> EstimationProblem:
    """Return the problem of a formula; a constant of it takes the rest position as the measured curve does."""
    own = EstimationProblem.build(curve.law, host.problem.runs)
    if not _has_constant(curve):
        return own
    changed = {name: getattr(own, name).copy() for name in ("start", "prior", "precision", "lower", "upper")}
    for place in range(Global.DATUM, own.start.size, PER_RUN):
        if not own.held[place]:
            for name, values in changed.items():
                values[place] = getattr(host.problem, name)[place]
    return replace(own, **changed)


logger = logging.getLogger(__name__)
# Difference over the friction: curves that differ by less are one.  Half or twice decides the same for formulas written
# in another way, which agree to rounding, and for other families, which are off by more than a hundredth.
SAME_CURVE = 1e-3
# Size of a parameter over that by its unit: beyond it the search has left every curve that the record may show.
RUN_AWAY = 1e4


def fit_formulas(
    competitors: Competitors, curve: MeasuredCurve | None, six: Sequence[Fit]
) -> tuple[list[Fit], list[Unfitted], list[str]]:
    """Fit the laws that were named, and every published law; also return those that cannot be fitted, and warnings.

    curve: From which each fit starts.
    six: Of the six; a formula that errs more than one that it contains starts again where the best of them ended.
    """
    fits: list[Fit] = []
    missing: list[Unfitted] = []
    warned: list[str] = []
    target = None if curve is None else measured_target(curve)
    for law in _candidates(competitors, curve, six):
        asked = competitors.asks(law)
        fit: Fit | str = "the friction curve could not be measured"
        if curve is not None and target is not None:
            fit = _fit(law, curve, target, [*six, *fits], asked=asked)
        if isinstance(fit, str):
            missing.append(Unfitted(law, fit, asked))
            logger.info("law %s was not fitted: %s", law.name, fit)
            continue
        logger.info("law %s: %.4g um rms, %s, %.2f s", law.name, 1e6 * fit.rms, fit.outcome, fit.cpu_s)
        fits.append(fit)
        warned += [_said(law, str(group), group.names) for group in fit.task.curve.together] if asked else []
    return fits, missing, warned


def _candidates(competitors: Competitors, curve: MeasuredCurve | None, six: Sequence[Fit]) -> Iterator[Law]:
    """Yield the laws that were named and are followed by their formulas, with what is given; then the published.

    A published law has the contact of the measured curve.
    """
    motion = six[0].problem.motions[0]
    for law in (*competitors.formulas, *competitors.six):
        if not competitors.by_kernel(law):
            yield formula_given(law, competitors.of_law(law), motion)
    ramp = curve is not None and curve.spline_fit.problem.ramp
    yield from (replace(law, ramp=ramp) for law in PUBLISHED.values() if not competitors.asks(law))


def _fit(law: Law, curve: MeasuredCurve, target: MeasuredTarget, others: Sequence[Fit], *, asked: bool) -> Fit | str:
    """Fit one formula, or return why it is not fitted."""
    if not asked:
        host = curve.spline_fit
        for other in others:
            # The free curve contains every law: where it gains no more than its parameters and one of a law are worth,
            # no law can.
            gain = 2 * host.residual.size * math.log(other.geometric_mean_rms / host.geometric_mean_rms)
            worth = host.task.curve.size - other.law_parameters + math.log(host.residual.size)
            if law.contains(other.law) and gain < worth:
                return f"it contains law {other.law.name}, which no curve fits better: the record cannot exclude it"
    try:
        fit = fit_formula(law, curve, others=others, target=target)
    except InputError as error:
        return error.what.removeprefix(f"law {law.name} is ")
    if fit is None:
        return "its motion cannot be followed"
    spline, found = curve.spline_fit.spline, fit.own_values
    friction, fastest = float(np.median(spline.coefficients)), float(spline.knots[-1])
    free = fit.task.curve.free
    if any(abs(found[name]) > RUN_AWAY * natural_size(law, name, friction, fastest) for name in free):
        return "its parameters grow without bound"
    if worse := name_better_limit(fit, others):
        return worse
    for other in others:
        if not (asked or other.law.number or other.law.name in PUBLISHED) and _draws(other.law, fit, curve.spline_fit):
            return f"law {other.law.name} can be the same curve"
    return fit


def name_better_limit(fit: Fit, others: Sequence[Fit]) -> str | None:
    """Return which of the laws that it contains a fit errs more than: it has not come to its end; None for none."""
    for other in others:
        limit = fit.law.contains(other.law) if fit.law.has_kernel else contained(fit.law, other.law)
        worse = fit.geometric_mean_rms > WORSE * other.geometric_mean_rms
        if limit and (worse or fit.rms > WORSE * other.rms):
            return f"its fit errs more than law {other.law.name}"
    return None


def _draws(law: Law, rival: Fit, host: Fit) -> bool:
    """Return whether a requested law can draw the curve of another one, which is then not a rival."""
    if law.ramp != rival.problem.ramp:
        return False
    speeds = seen_speeds(host)
    friction = rival.task.friction(rival.q, speeds)
    nearest = find_starts(law, Target.of(speeds, friction, float(np.max(friction))))[0]
    return nearest.misfit < SAME_CURVE**2 * speeds.size


def _said(law: Law, how: str, names: Sequence[str]) -> str:
    if len(names) == 1:
        return f"law {law.name}: {how}; leave it out"
    return (
        f"law {law.name}: {how}: the record cannot determine them apart, and their errors are withheld (fix all but "
        f"one, as in --fix {law.name}.{names[-1]}=1, or write one parameter for them)"
    )
