"""`judge`: compares the laws by their evidence and returns the set of those that the record cannot distinguish."""

from collections.abc import Sequence

import numpy as np

from fitting.estimation.fit import Fit
from fitting.model.problem import Run
from fitting.selection import equivalence, evidence
from fitting.selection.evidence import Evidence, ModelSet


def judge(
    fits: Sequence[Fit], laws: Sequence[int], runs: Sequence[Run], alpha: float, *, sustained: bool
) -> tuple[list[Fit], ModelSet]:
    """Compare the competing ``laws`` by their evidence; return all fits, best first, and the set.

    An equivalent jump law on a compliant belt replaces the best ramp law. Where only formulas compete, the best fit is
    the set: other fits start from it.
    """
    competing = [fit for fit in fits if fit.law in laws]
    others = sorted((fit for fit in fits if fit.law not in laws), key=lambda fit: fit.geometric_mean_rms)
    if not competing:
        order = tuple(fit.law for fit in others)
        none = dict.fromkeys(order, 0.0)
        return others, ModelSet(order, order[:1], none, none, dict.fromkeys(order, (0.0, 0.0)))
    competing, chosen = _compared(competing, runs, alpha, sustained=sustained)
    by_law = {fit.law: fit for fit in competing}
    return [*(by_law[law] for law in chosen.order), *others], chosen


def _compared(fits: list[Fit], runs: Sequence[Run], alpha: float, *, sustained: bool) -> tuple[list[Fit], ModelSet]:
    units = evidence.common_units(fits, runs, sustained=sustained)
    errors = {fit.law: evidence.unit_errors(fit, runs, units) for fit in fits}
    for jump, ramp in equivalence.closed_ramps(fits):
        if errors[ramp].mean() < errors[jump].mean():
            errors[ramp] = errors[jump]
    place = {fit.law: i for i, fit in enumerate(fits)}
    penalised = np.array([evidence.penalised(fit, errors[fit.law], units) for fit in fits])

    def choose() -> ModelSet:
        return evidence.model_confidence_set(Evidence(tuple(place), penalised, units.samples), alpha)

    chosen = choose()
    double = equivalence.equivalent_jump_law(fits, chosen.members, runs)
    if double is not None:
        jump, ramp = double.law, double.law + 1
        own = evidence.unit_errors(double, runs, units)
        lag = equivalence.mean_excess(own, errors[ramp])
        if lag < equivalence.SAME:  # one observable, one piece of evidence, unless runs at several speeds split it
            apart = len(runs) > 1 and lag < -equivalence.SAME
            fits = [double if fit.law == jump else fit for fit in fits]
            penalised[place[jump]] = evidence.penalised(double, own, units) if apart else penalised[place[ramp]]
            chosen = choose()
    if (
        not sustained
        and chosen.members == (2,)
        and 1 in place
        and equivalence.explained_by_belt_ripple(fits[place[2]], errors[2], runs)
    ):
        penalised[place[1]] = penalised[place[2]]
        chosen = choose()
    return fits, equivalence.with_open_ramps(chosen, fits, runs, alpha, units.samples, sustained=sustained)
