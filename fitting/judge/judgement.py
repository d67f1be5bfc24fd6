"""The one competition of all laws: which describe the record, and which of these it cannot distinguish."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from fitting.judge import evidence
from fitting.judge.adequacy import Judged, describing
from fitting.judge.curve import MeasuredCurve
from fitting.judge.evidence import Evidence, ModelSet, Units
from fitting.laws import Law
from fitting.model.problem import Run
from fitting.search.fit import Fit, Unfitted
from stickslip.compute.arrays import Array


@dataclass(frozen=True, eq=False)
class Competition:
    """All laws that were fitted, in the order of the rows, and the goodness of fit of those near the noise."""

    fits: tuple[Fit, ...]
    judged: Mapping[Law, Judged]
    chosen: ModelSet
    misfit: Mapping[Law, float]  # rms residual of the usual cycles over the noise of a position
    # laws outside the set whose residual, without penalties, is as small as the best law's; those that contain it last
    not_excluded: tuple[Law, ...] = ()
    runs: tuple[Run, ...] = ()
    sustained: bool = True  # whether the mass sticks in the long run
    curve: MeasuredCurve | None = None  # friction without a law, per unit mass
    noise: Array = field(default_factory=lambda: np.empty(0))  # (runs,) standard deviation of one position, m
    six: tuple[Fit, ...] = ()  # all of the six that were fitted, requested or not
    runs_differ: bool = False  # whether a law describes each run better by itself than any law does all of them
    unfitted: tuple[Unfitted, ...] = ()
    warnings: tuple[str, ...] = ()  # about formulas that could not be fitted, or not in all their parameters

    @property
    def members(self) -> tuple[Law, ...]:
        return self.chosen.members

    @property
    def compatible(self) -> tuple[int | str, ...]:
        """The set, and the laws that fit as well without containing the best law."""
        others = (law for law in self.not_excluded if not law.contains(self.best.law))
        return tuple(law.key for law in (*self.members, *others))

    @property
    def best(self) -> Fit:
        return self.fits[0]

    @property
    def described(self) -> bool:
        return bool(self.chosen.members)

    @property
    def undescribed(self) -> "Competition":
        """The same where no law describes the runs together."""
        return replace(self, chosen=ModelSet((), {}, {}, {}), not_excluded=())

    def describes(self, law: Law) -> bool:
        """Whether a law describes the record, as far as that can be judged."""
        return self.described and law in self.judged and not self.judged[law].together.rejected


def compete(
    fits: Sequence[Fit], noise: Array, known: Judged, runs: Sequence[Run], alpha: float, *, sustained: bool
) -> Competition:
    """Compare all laws by one evidence; the set is one of those that describe the record.

    The jump law of a narrow ramp competes on a compliant belt too; of both fits of a law the better one is its row.
    """
    compliant = evidence.fit_on_compliant_belt(fits, runs, alpha, sustained=sustained)
    contenders = [*fits, *([] if compliant is None else [compliant])]
    units = evidence.common_units(contenders, runs, sustained=sustained)
    by_law: dict[Law, Fit] = {}
    errors: dict[Law, Array] = {}
    penalised: dict[Law, Array] = {}
    for fit in contenders:
        own = evidence.unit_errors(fit, runs, units)
        paid = evidence.penalised(fit, own, units, belts=len(runs) if fit is compliant else 0)
        if fit.law not in by_law or paid.mean() < penalised[fit.law].mean():
            by_law[fit.law], errors[fit.law], penalised[fit.law] = fit, own, paid
    misfit = {law: _misfit(fit, units, noise) for law, fit in by_law.items()}
    motions, largest = [run.motion for run in runs], float(np.max(noise))
    seen = {known.fit.law: known} if known.fit is by_law.get(known.fit.law) else {}
    judged = describing(list(by_law.values()), motions, largest, seen)
    rejected = [law for law, own in judged.items() if own.together.rejected]
    # what a law that contains it does not explain although it errs less, a law does not
    lost = {law for law in judged for other in rejected if other.contains(law) and misfit[other] < misfit[law]}
    judged = {law: own for law, own in judged.items() if law in rejected or law not in lost}
    described = {law for law in judged if law not in rejected}
    if not described:
        order = sorted(by_law.values(), key=lambda fit: misfit[fit.law])
        judged = describing(order[:1], motions, largest, judged) | judged
        return Competition(tuple(order), judged, ModelSet((), {}, {}, {}), misfit)
    table = Evidence(tuple(penalised), np.array(list(penalised.values())), units.samples)
    chosen = evidence.model_confidence_set(table, alpha, described)
    fitting = {law: by_law[law] for law in described}
    chosen = evidence.with_indistinct_contacts(chosen, fitting, errors, runs, alpha, sustained=sustained)
    outside = sorted(described.difference(chosen.members), key=chosen.score.__getitem__)
    first = chosen.members[0]
    equal = [law for law in outside if evidence.no_larger(errors[law], errors[first], units.samples)]
    rest = sorted((law for law in by_law if law not in described), key=misfit.__getitem__)
    return Competition(
        tuple(by_law[law] for law in (*chosen.members, *outside, *rest)),
        judged,
        chosen,
        misfit,
        tuple(sorted(equal, key=lambda law: law.contains(first))),
        runs_differ=evidence.runs_differ([by_law[law] for law in judged], penalised[first], runs, units),
    )


def _misfit(fit: Fit, units: Units, noise: Array) -> float:
    usual = [
        (fit.residual[rows], noise[run])
        for rows, run, counts in zip(fit.rows, fit.windows.run, units.inliers, strict=True)
        if counts
    ]
    return float(np.sqrt(np.mean(np.concatenate([residual / own for residual, own in usual]) ** 2)))
