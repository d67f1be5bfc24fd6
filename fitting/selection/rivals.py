"""Laws given as formulas: the requested ones, and published ones that the measured curve prefers.

A published form is fitted without a request where its information criterion on the measured curve is below that of
every form of the six, or so little above that the set rule would not exclude it, and near the best form that could be
fitted.  Evidence and set rule are those of the six (`fitting.selection.evidence`).
"""

import logging
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from operator import itemgetter

import numpy as np

from fitting.competitors import Competitors
from fitting.curve.band import seen_speeds
from fitting.curve.forms import FORM_OF_LAW
from fitting.curve.formula_fit import FormulaFit, fit_formula
from fitting.curve.result import FormFit, MeasuredCurve
from fitting.curve.spline_fit import SplineFit
from fitting.driver.start_search import Target, find_starts
from fitting.estimation.fit import Fit
from fitting.law import PUBLISHED, Law
from fitting.model.problem import Run
from fitting.selection import evidence
from fitting.selection.evidence import OPEN, Candidate, Evidence, ModelSet
from fitting.selection.given import formula_given
from fitting.selection.result import UnfittedLaw
from fitting.undetermined import natural_size, undetermined
from rig_sim.friction.law import LAWS
from stickslip.errors import InputError

logger = logging.getLogger(__name__)
# Difference over the friction: curves that differ by less are one.  Half or twice decides the same for formulas written
# in another way, which agree to rounding, and for other families, which are off by more than a hundredth.
SAME_CURVE = 1e-3
OF_THE_SIX = ("constant", "linear", "hyperbolic")


@dataclass(frozen=True, eq=False)
class Formulas:
    """The fitted formulas, the requested ones that could not be fitted, and notes on parameters."""

    fits: tuple[FormulaFit, ...]
    unfitted: tuple[UnfittedLaw, ...] = ()
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Competition:
    """All laws together: the six, requested formulas, and rivals that were not requested."""

    # best first, members of the set before all others; the six between themselves as they were judged alone
    order: tuple[int | str, ...]
    members: tuple[int | str, ...]  # the combined set, best first
    score: dict[int | str, float]  # of each law, as `fitting.selection.evidence.ModelSet`
    weight: dict[int | str, float]
    behind: dict[int | str, tuple[float, float]]
    asked: frozenset[int | str]  # which were asked for

    @classmethod
    def of_six(cls, chosen: ModelSet) -> "Competition":
        return cls(chosen.order, chosen.members, chosen.score, chosen.weight, chosen.behind, frozenset(chosen.order))

    @property
    def best(self) -> int | str:
        """The best requested law, one of the six where any are in the set, as in the verdict."""
        asked = [law for law in self.order if law in self.asked]
        return next((law for law in asked if isinstance(law, int) and law in self.members), asked[0])

    @property
    def beaten(self) -> bool:
        """Whether rivals that were not requested are alone in the set."""
        return not any(law in self.asked for law in self.members)

    def lead(self, law: int | str, other: int | str) -> float:
        """Lead of a law over another one, in log evidence."""
        return 0.5 * (self.score[other] - self.score[law])


def preferred_forms(forms: Sequence[FormFit]) -> list[tuple[Law, float]]:
    """Return the published laws that the measured curve prefers to the six, or nearly, best first.

    Each with its information criterion.
    """
    by_name = {form.name: form for form in forms}
    limit = min(by_name[name].bic for name in OF_THE_SIX) + OPEN
    found = [(PUBLISHED[name], by_name[form].bic) for name, form in FORM_OF_LAW.items() if by_name[form].bic < limit]
    return sorted(found, key=itemgetter(1))


def fit_formulas(competitors: Competitors, curve: MeasuredCurve | None, *, rivals: bool) -> Formulas:
    """Fit the requested formulas, from the measured curve, and with ``rivals`` those that it prefers."""
    if curve is None:
        laws: tuple[int | Law, ...] = (*competitors.formulas, *competitors.restated)
        return Formulas((), tuple(unfitted(law, "the friction curve could not be measured") for law in laws))
    host = curve.spline_fit
    found: list[FormulaFit] = []
    missing: list[UnfittedLaw] = []
    warned: list[str] = []
    for law, number in _named(competitors, host):
        one = _fitted(law, host, number)
        if isinstance(one, str):
            missing.append(unfitted(law if number is None else number, one))
            continue
        found.append(one)
        warned += [_said(law, str(group), group.names) for group in one.together]
    named = [fit for fit in found if fit.number is None]
    least = math.inf  # criterion of the best form that was fitted
    for law, criterion in preferred_forms(curve.forms) if rivals else ():  # best first
        if criterion >= least + OPEN:
            break
        if law.name in {own.name for own in competitors.formulas}:  # perhaps with parameters given
            fitted = any(fit.law == law.name for fit in named)
        else:
            one = _fitted(replace(law, ramp=bool(host.path.curve.ramp)), host)
            fitted = not isinstance(one, str)
            found += [] if isinstance(one, str) or any(_draws(fit.asked_for, one, host) for fit in named) else [one]
        least = min(least, criterion) if fitted else least
    for fit in found:
        logger.info("law %s: %.4g um rms, %s, %.2f s", fit.law, 1e6 * fit.rms, fit.outcome, fit.cpu_s)
    for row in missing:
        logger.info("law %s was not fitted: %s", row.law, row.reason)
    return Formulas(tuple(found), tuple(missing), tuple(warned))


def unfitted(law: int | Law, reason: str) -> UnfittedLaw:
    if isinstance(law, int):
        return UnfittedLaw(law, LAWS[law].name, reason)
    return UnfittedLaw(law.name, law.name.replace("-", " "), reason, law.formula)


def _named(competitors: Competitors, host: SplineFit) -> Iterator[tuple[Law, int | None]]:
    """Yield the requested formulas with the conditions on them, and the six that are fitted as formulas."""
    motion = host.fit.problem.motions[0]
    for law in competitors.formulas:
        yield formula_given(law, competitors.of_law(law), motion), None
    for number, law in competitors.restated.items():
        yield formula_given(law, competitors.of_law(number), motion), number


def _fitted(law: Law, host: SplineFit, number: int | None = None) -> FormulaFit | str:
    """Fit one formula, or return why not; of jointly determined parameters some are fixed."""
    friction, fastest = float(np.median(host.spline.coefficients)), float(host.spline.knots[-1])
    together = undetermined(law, friction, fastest)
    held = [name for group in together for name in group.names[len(group.names) - group.free :]]
    start = law.start or {}
    free = law.given(fix={name: start.get(name, natural_size(law, name, friction, fastest)) for name in held})
    try:
        fit = fit_formula(free, host, asked_for=law, number=number, together=together)
    except InputError as error:
        return error.what.removeprefix(f"law {law.name} is ")
    return "its motion cannot be followed" if fit is None else fit


def _draws(law: Law, rival: FormulaFit, host: SplineFit) -> bool:
    """Return whether a requested law can draw the curve of another one, which is then not a rival."""
    if law.ramp != rival.problem.ramp:
        return False
    speeds = seen_speeds(host)
    friction = rival.curve.at_speeds(rival.theta, speeds)
    nearest = find_starts(law, Target.of(speeds, friction, float(np.max(friction))))[0]
    return nearest.misfit < SAME_CURVE**2 * speeds.size


def _said(law: Law, how: str, names: Sequence[str]) -> str:
    if len(names) == 1:
        return f"law {law.name}: {how}; leave it out"
    return (
        f"law {law.name}: {how}: the record cannot determine them apart, and their errors are withheld (fix all but "
        f"one, as in --fix {law.name}.{names[-1]}=1, or write one parameter for them)"
    )


def compete(
    fits: Sequence[Fit],
    chosen: ModelSet | None,
    formulas: Sequence[FormulaFit],
    runs: Sequence[Run],
    alpha: float,
    asked: frozenset[int | str],
    *,
    sustained: bool,
) -> Competition:
    """Judge the six and the formulas by the same evidence and set rule.

    The six keep their order and set ``chosen`` among themselves; ``asked`` are the requested laws. Unless
    ``sustained``, the start-up drags alone are evidence.
    """
    every: list[Candidate] = [*fits, *formulas]
    units = evidence.common_units(every, runs, sustained=sustained)
    errors = np.array([evidence.penalised(fit, evidence.unit_errors(fit, runs, units), units) for fit in every])
    together = evidence.model_confidence_set(Evidence(tuple(fit.law for fit in every), errors, units.samples), alpha)
    if chosen is None:
        return Competition(together.order, together.members, together.score, together.weight, together.behind, asked)
    beside = {fit.law for fit in formulas}
    led_by_other = min(together.score, key=together.score.__getitem__) in beside
    left = not led_by_other or any(law in together.members for law in chosen.members)
    six = chosen.members if left else ()
    lag = min(together.score[fit.law] for fit in fits)
    score = {law: own + lag for law, own in chosen.score.items()} | {law: together.score[law] for law in beside}
    total = sum(math.exp(-own / 2) for own in score.values())
    behind = {law: together.behind[law] if led_by_other else own for law, own in chosen.behind.items()}
    members = {*six, *(law for law in together.members if law in beside)}
    ordered = [*six, *(law for law in chosen.order if law not in six)]
    order = _merged(ordered, sorted(beside, key=score.__getitem__), members, score)
    return Competition(
        order=order,
        members=tuple(law for law in order if law in members),
        score=score,
        weight={law: math.exp(-own / 2) / total for law, own in score.items()},
        behind=behind | {law: together.behind[law] for law in beside},
        asked=asked,
    )


def _merged(
    six: Sequence[int | str], others: Sequence[int | str], members: set[int | str], score: dict[int | str, float]
) -> tuple[int | str, ...]:
    """Return all laws in order, members of the set first; a limit of the best law may precede it."""
    found = sorted([*six, *others], key=lambda law: (law not in members, score[law]))
    own = iter(six)
    return tuple(law if law in others else next(own) for law in found)
