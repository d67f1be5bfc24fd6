"""Laws given as formulas beside the six: those that were named, and every published one.

All are fitted, whatever the measured curve looks like: where the rest position is unknown, the level of friction is,
and the six are then richer than they look.  A law that contains another one that reaches the noise is not fitted, since
the record cannot refute it.  What is evidence and who is in the set is decided as between the six
(`fitting.selection.evidence`).
"""

import logging
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from fitting import noise_levels
from fitting.competitors import Competitors
from fitting.curve.band import seen_speeds
from fitting.curve.formula_fit import contained, fit_formula
from fitting.curve.metric import MeasuredTarget, measured_target
from fitting.curve.result import MeasuredCurve
from fitting.driver.driver import WORSE
from fitting.driver.fit import Fit
from fitting.driver.start_search import Target, find_starts
from fitting.law import PUBLISHED, Law
from fitting.selection.given import formula_given
from fitting.selection.result import UnfittedLaw
from fitting.undetermined import natural_size
from stickslip.errors import InputError

logger = logging.getLogger(__name__)
# Difference over the friction: curves that differ by less are one.  Half or twice decides the same for formulas written
# in another way, which agree to rounding, and for other families, which are off by more than a hundredth.
SAME_CURVE = 1e-3
# Size of a parameter over that by its unit: beyond it the search has left every curve that the record may show.
RUN_AWAY = 1e4


def fit_formulas(
    competitors: Competitors, curve: MeasuredCurve | None, six: Sequence[Fit]
) -> tuple[list[Fit], list[UnfittedLaw], list[str]]:
    """Fit the laws that were named, and every published law; also return those that cannot be fitted, and warnings.

    curve: From which each fit starts.
    six: Of the six; a formula that errs more than one that it contains starts again where the best of them ended.
    """
    fits: list[Fit] = []
    missing: list[UnfittedLaw] = []
    warned: list[str] = []
    target = None if curve is None else measured_target(curve)
    for law in _candidates(competitors, curve, six):
        asked = competitors.asks(law)
        fit: Fit | str = "the friction curve could not be measured"
        if curve is not None and target is not None:
            fit = _fit(law, curve, target, [*six, *fits], asked=asked)
        if isinstance(fit, str):
            missing.append(replace(unfitted(law, fit), asked=asked))
            logger.info("law %s was not fitted: %s", missing[-1].law, fit)
            continue
        logger.info("law %s: %.4g um rms, %s, %.2f s", law.name, 1e6 * fit.rms, fit.outcome, fit.cpu_s)
        fits.append(fit)
        warned += [_said(law, str(group), group.names) for group in fit.task.curve.together] if asked else []
    return fits, missing, warned


def unfitted(law: Law, reason: str) -> UnfittedLaw:
    """Return the row of a law that was not fitted."""
    return UnfittedLaw(law.key, law.words, reason, None if law.number else law.formula)


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
        least = min(other.geometric_mean_rms for other in others)
        reached = min(noise_levels.DESCRIBES * float(np.max(curve.noise)), WORSE * least)
        for other in others:
            if law.contains(other.law) and other.geometric_mean_rms < reached:
                return f"it contains law {other.law.name}, which no other law fits better: the record cannot exclude it"
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
