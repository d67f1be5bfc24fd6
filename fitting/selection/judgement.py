"""`compete`: the one competition of all laws: which describe the record, and which of these it cannot distinguish."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from fitting.adequacy.assess import Judged, describing
from fitting.curve.result import MeasuredCurve
from fitting.driver.fit import Fit
from fitting.law import SIX, Law
from fitting.model.problem import Run
from fitting.selection import equivalence, evidence
from fitting.selection.evidence import Evidence, ModelSet, Units
from fitting.selection.result import UnfittedLaw
from stickslip.compute.arrays import Array


@dataclass(frozen=True, eq=False)
class Competition:
    """All laws that were fitted, in the order of the rows, and the goodness of fit of those near the noise.

    ``misfit`` is the rms of each law's residual in the usual cycles, over the noise of a position.  ``not_excluded``
    are laws outside the set whose residual is no larger than the best law's within the noise of the comparison:
    parsimony, not the record, excludes them.  Those that contain the best law, which cannot do worse, come last.
    """

    fits: tuple[Fit, ...]
    judged: Mapping[Law, Judged]
    chosen: ModelSet
    misfit: Mapping[Law, float]
    not_excluded: tuple[Law, ...] = ()
    runs: tuple[Run, ...] = ()
    sustained: bool = True  # whether the mass sticks in the long run
    curve: MeasuredCurve | None = None  # friction without a law, per unit mass
    noise: Array = field(default_factory=lambda: np.empty(0))  # (runs,) standard deviation of one position, m
    six: tuple[Fit, ...] = ()  # all of the six that were fitted, requested or not
    unfitted: tuple[UnfittedLaw, ...] = ()
    warnings: tuple[str, ...] = ()  # about formulas that could not be fitted, or not in all their parameters

    @property
    def members(self) -> tuple[Law, ...]:
        """The set, best first; empty where no law describes the record."""
        return self.chosen.members

    @property
    def best(self) -> Fit:
        """The law of the first row."""
        return self.fits[0]

    @property
    def described(self) -> bool:
        """Whether a law describes the record."""
        return bool(self.chosen.members)

    def describes(self, law: Law) -> bool:
        """Return whether a law describes the record, as far as that can be judged."""
        return law in self.judged and not self.judged[law].together.rejected


def compete(
    fits: Sequence[Fit], noise: Array, known: Judged, runs: Sequence[Run], alpha: float, *, sustained: bool
) -> Competition:
    """Compare all laws by one evidence; the set is one of those that describe the record.

    A jump law on a compliant belt that is equivalent to the best ramp law takes its place.

    noise: (runs,) Standard deviation of one position of each run, m.
    known: A law whose goodness of fit is known already.
    sustained: Whether the mass sticks in the long run; else the start-up drags alone are evidence.
    """
    motions, by_law = [run.motion for run in runs], {fit.law: fit for fit in fits}
    units = evidence.common_units(fits, runs, sustained=sustained)
    judged = describing(fits, motions, float(np.max(noise)), {known.fit.law: known})
    misfit = {law: _misfit(fit, units, noise) for law, fit in by_law.items()}
    described = {law for law, own in judged.items() if law in by_law and not own.together.rejected}
    if not described:  # a jump on a belt that slows under load may describe what no ramp does at several speeds
        ramps = [law for law in sorted(misfit, key=misfit.__getitem__) if law.number and law.ramp]
        double = equivalence.equivalent_jump_law(fits, ramps[:1], runs)
        seen = {} if double is None else describing([double], motions, float(np.max(noise)))
        if double is not None and not seen[double.law].together.rejected:
            by_law[double.law], judged, described = double, judged | seen, {double.law}
            misfit[double.law] = _misfit(double, units, noise)
    if not described:
        order = sorted(fits, key=lambda fit: misfit[fit.law])
        judged = describing(order[:1], motions, float(np.max(noise)), judged) | judged
        return Competition(tuple(order), judged, ModelSet((), {}, {}, {}), misfit)
    errors = {law: evidence.unit_errors(fit, runs, units) for law, fit in by_law.items()}
    for jump, ramp in equivalence.closed_ramps(list(by_law.values())):
        if errors[ramp].mean() < errors[jump].mean():
            errors[ramp] = errors[jump]
    penalised = {law: evidence.penalised(fit, errors[law], units) for law, fit in by_law.items()}

    def choose() -> ModelSet:
        table = np.array(list(penalised.values()))
        return evidence.model_confidence_set(Evidence(tuple(penalised), table, units.samples), alpha, described)

    chosen = choose()
    double = equivalence.equivalent_jump_law(list(by_law.values()), chosen.members, runs)
    if double is not None:
        jump = double.law
        ramp = next(law for law in by_law if law.is_ramp_of(jump))
        own = evidence.unit_errors(double, runs, units)
        lag = equivalence.mean_excess(own, errors[ramp])
        seen = describing([double], motions, float(np.max(noise)))
        # one observable, one piece of evidence, unless runs at several speeds split it
        if lag < equivalence.SAME and not seen[jump].together.rejected:
            apart = len(runs) > 1 and lag < -equivalence.SAME
            by_law[jump], judged, described = double, judged | seen, described | {jump}
            errors[jump], misfit[jump] = own, _misfit(double, units, noise)
            penalised[jump] = evidence.penalised(double, own, units) if apart else penalised[ramp]
            chosen = choose()
    if not sustained and chosen.members == (SIX[2],) and SIX[1] in described:
        if equivalence.explained_by_belt_ripple(by_law[SIX[2]], errors[SIX[2]], runs):
            penalised[SIX[1]] = penalised[SIX[2]]
            chosen = choose()
    chosen = equivalence.with_open_ramps(
        chosen,
        [fit for fit in by_law.values() if fit.law in described],
        runs,
        alpha,
        units.samples,
        sustained=sustained,
    )
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
    )


def _misfit(fit: Fit, units: Units, noise: Array) -> float:
    """Return the rms residual of the usual cycles over the noise of a position."""
    usual = [
        (fit.residual[rows], noise[run])
        for rows, run, counts in zip(fit.rows, fit.windows.run, units.inliers, strict=True)
        if counts
    ]
    return float(np.sqrt(np.mean(np.concatenate([residual / own for residual, own in usual]) ** 2)))
