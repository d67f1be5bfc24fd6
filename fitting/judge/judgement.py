"""The competition of all laws: which laws describe the record, and which of these the data cannot tell apart."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from fitting.judge import evidence
from fitting.judge.adequacy import LawJudgement, judge_near_laws
from fitting.judge.curve import MeasuredCurve
from fitting.judge.evidence import Evidence, ModelSet, Units
from fitting.laws import Law
from fitting.model.problem import Run
from fitting.search.fit import Fit, Unfitted
from stickslip.compute.arrays import Array


@dataclass(frozen=True, eq=False)
class Competition:
    """All fitted laws, in the order of the rows, and the goodness of fit of those near the noise."""

    fits: tuple[Fit, ...]
    judgements: Mapping[Law, LawJudgement]
    model_set: ModelSet
    misfit: Mapping[Law, float]  # rms residual of the usual cycles over the noise of a position
    # laws outside the set whose residual, without penalties, is as small as the best law's; those it is nested in last
    not_excluded: tuple[Law, ...] = ()
    runs: tuple[Run, ...] = ()
    sustained: bool = True  # whether the mass sticks repeatedly
    curve: MeasuredCurve | None = None  # friction without a law, per unit mass
    noise: Array = field(default_factory=lambda: np.empty(0))  # (runs,) standard deviation of one position, m
    six: tuple[Fit, ...] = ()  # all of the six that were fitted, requested or not
    runs_differ: bool = False  # whether separate fits of the runs have more evidence than any joint fit
    unfitted: tuple[Unfitted, ...] = ()
    warnings: tuple[str, ...] = ()  # about formulas that could not be fitted, or not in all their parameters

    @property
    def members(self) -> tuple[Law, ...]:
        return self.model_set.members

    @property
    def compatible(self) -> tuple[int | str, ...]:
        """The set, and the laws that fit as well and in which the best law is not nested."""
        equally_good = (law for law in self.not_excluded if not law.contains(self.best.law))
        return tuple(law.key for law in (*self.members, *equally_good))

    @property
    def best(self) -> Fit:
        return self.fits[0]

    @property
    def described(self) -> bool:
        return bool(self.model_set.members)

    @property
    def undescribed(self) -> "Competition":
        """The same competition, with no law that describes the runs together."""
        return replace(self, model_set=ModelSet((), {}, {}, {}), not_excluded=())

    def describes(self, law: Law) -> bool:
        """Whether a law describes the record, as far as that can be judged."""
        return self.described and law in self.judgements and not self.judgements[law].joint.rejected


def compete(
    fits: Sequence[Fit],
    noise: Array,
    known: Collection[LawJudgement],
    runs: Sequence[Run],
    alpha: float,
    *,
    sustained: bool,
) -> Competition:
    """Compare all laws; the set contains only laws that describe the record. Fits in ``known`` are judged already.

    The jump law of a narrow ramp is also fitted with a compliant belt. The better of the two fits is the law's row.
    """
    compliant = evidence.fit_on_compliant_belt(fits, runs, alpha, sustained=sustained)
    contenders = [*fits, *([] if compliant is None else [compliant])]
    units = evidence.common_units(contenders, runs, sustained=sustained)
    by_law: dict[Law, Fit] = {}
    errors: dict[Law, Array] = {}
    penalised: dict[Law, Array] = {}
    for fit in contenders:
        errors_of_fit = evidence.unit_errors(fit, runs, units)
        penalised_errors = evidence.penalise(fit, errors_of_fit, units, belts=len(runs) if fit is compliant else 0)
        if fit.law not in by_law or penalised_errors.mean() < penalised[fit.law].mean():
            by_law[fit.law], errors[fit.law], penalised[fit.law] = fit, errors_of_fit, penalised_errors
    misfit = {law: _misfit(fit, units, noise) for law, fit in by_law.items()}
    motions, largest = [run.motion for run in runs], float(np.max(noise))
    known_judgements = {judged.fit.law: judged for judged in known if judged.fit is by_law.get(judged.fit.law)}
    judgements = judge_near_laws(list(by_law.values()), motions, largest, known_judgements)
    rejected_laws = [law for law, fit in judgements.items() if fit.joint.rejected]
    # a law does not describe the record if a rejected law, in which it is nested, fits better
    fit_worse = {
        law for law in judgements for other in rejected_laws if other.contains(law) and misfit[other] < misfit[law]
    }
    judgements = {law: fit for law, fit in judgements.items() if law in rejected_laws or law not in fit_worse}
    describing_laws = {law for law in judgements if law not in rejected_laws}
    if not describing_laws:
        order = sorted(by_law.values(), key=lambda fit: misfit[fit.law])
        judgements = judge_near_laws(order[:1], motions, largest, judgements) | judgements
        return Competition(tuple(order), judgements, ModelSet((), {}, {}, {}), misfit)
    table = Evidence(tuple(penalised), np.array(list(penalised.values())), units.samples)
    chosen = evidence.model_confidence_set(table, alpha, describing_laws)
    fitting = {law: by_law[law] for law in describing_laws}
    chosen = evidence.add_indistinct_contacts(chosen, fitting, errors, runs, alpha, sustained=sustained)
    outside = sorted(describing_laws.difference(chosen.members), key=chosen.score.__getitem__)
    first = chosen.members[0]
    equal = [law for law in outside if evidence.fits_as_well(errors[law], errors[first], units.samples)]
    rest = sorted((law for law in by_law if law not in describing_laws), key=misfit.__getitem__)
    return Competition(
        tuple(by_law[law] for law in (*chosen.members, *outside, *rest)),
        judgements,
        chosen,
        misfit,
        tuple(sorted(equal, key=lambda law: law.contains(first))),
        runs_differ=evidence.runs_differ([by_law[law] for law in judgements], penalised[first], runs, units),
    )


def _misfit(fit: Fit, units: Units, noise: Array) -> float:
    residuals_and_noise = [
        (fit.residual[rows], noise[run])
        for rows, run, counts in zip(fit.rows, fit.windows.run, units.inliers, strict=True)
        if counts
    ]
    return float(np.sqrt(np.mean(np.concatenate([residual / sd for residual, sd in residuals_and_noise]) ** 2)))
