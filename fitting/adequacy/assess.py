"""`assess`: whether the best law, or another that the record cannot distinguish from it, describes the record."""

from collections.abc import Sequence
from dataclasses import dataclass

from daq.compute.arrays import Array
from fitting.adequacy.goodness import goodness_of_fit, judge
from fitting.adequacy.result import ADEQUATE, NONE_FITTED, NONE_OF_SIX, Adequacy
from fitting.data.frame import MeasuredMotion
from fitting.estimation.fit import Fit
from fitting.estimation.linearised import LinearisedFit

NUMBER_OF_LAWS = 6


@dataclass(frozen=True)
class Assessment:
    """The adequacy of all runs together and of each, by the law that was judged."""

    law: int
    together: Adequacy
    runs: tuple[Adequacy, ...]


def assess(members: Sequence[Fit], motions: Sequence[MeasuredMotion], laws: int) -> Assessment:
    """Assess the laws of a set until one describes the record.

    Parameters
    ----------
    members : sequence of Fit
        The laws that the record cannot distinguish, best first.
    motions : sequence of MeasuredMotion
        Of each run.
    laws : int
        How many laws were asked for.

    Returns
    -------
    Assessment
        By the first law that describes the record, or by the best where none does.
    """
    first = None
    for fit in members:
        found = _assess(fit, motions, NONE_OF_SIX if laws == NUMBER_OF_LAWS else NONE_FITTED)
        if found.together.adequate:
            return found
        first = first or found
    if first is None:
        raise ValueError("no law to assess")
    return first


def _assess(fit: Fit, motions: Sequence[MeasuredMotion], otherwise: str) -> Assessment:
    linearised = LinearisedFit.at(fit)
    # Without derivatives nothing is fitted again: the residuals of repetitions are then the larger.
    refit = _unchanged if linearised is None else linearised.refit
    slips = judge(fit.residual, refit, fit, motions)
    together, each = goodness_of_fit(slips, fit.residual, fit)
    adequacies = [
        Adequacy(ADEQUATE if found.adequate else otherwise, found.noise_m, found) for found in (together, *each)
    ]
    return Assessment(fit.law, adequacies[0], tuple(adequacies[1:]))


def _unchanged(residuals: Array) -> Array:
    return residuals
