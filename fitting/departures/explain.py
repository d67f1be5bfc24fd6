"""Which assumption breaks: departures tested on a fit that misses the record, the strongest confirmed by a refit."""

import math
from collections.abc import Sequence
from dataclasses import replace

from fitting.curve.result import MeasuredCurve
from fitting.data.frame import MeasuredMotion
from fitting.departures.base import Base
from fitting.departures.host import Host
from fitting.departures.refit import Refit, refit_with
from fitting.departures.result import FoundDeparture
from fitting.departures.strongest import Tested, describe, misfit_beyond_noise, strongest
from fitting.estimation.fit import Fit
from fitting.estimation.linearised import LinearisedFit
from fitting.sensitivity.path import follow, law_curve

# Usual error of a cycle over the noise, below which a law with a departure describes the record.  True departures end
# at 0.99 to 1.02; a wrong one that comes near, friction by position for a hard spring, at 1.1.
REACHED = 1.05
# Of the gain of the linear step: a refit of the free curve that gains less has not come to its end.  A curve often is
# near the noise without the departure, so its error alone does not tell.
LEAST_PART = 0.8
MOST_LAWS = 2  # that a departure is fitted with: the best, and the best of another curve


def explain_misfit(
    fits: Sequence[Fit],
    records: Sequence[MeasuredMotion],
    noise: float,
    *,
    curve: MeasuredCurve | None = None,
    revolution: float | None = None,
) -> tuple[FoundDeparture, ...]:
    """Return the departures that a record shows, the strongest first.

    To be asked where no law describes the record.

    Parameters
    ----------
    fits : sequence of Fit
        The laws, best first.
    records : sequence of MeasuredMotion
        The runs.
    noise : float
        Standard deviation of one measured position, m.
    curve : MeasuredCurve, optional
        The free curve; departures are tested on it, and without it on the best law.
    revolution : float, optional
        Travel per revolution of the encoder, m; scanned where it is not known.

    Returns
    -------
    tuple of FoundDeparture
        Size and error of the first are those of a fit with it where a law or the free curve then describes the record
        (``refitted``, ``law``), else those of one linear step.
    """
    base = base_of(fits[0], records, revolution)
    if curve is not None:
        base = Base.of(curve.linear, curve.spline_fit.path, records, revolution)
    if base is None:
        return ()
    tested = strongest(base)
    excess = misfit_beyond_noise(base.linear, noise)
    found = [describe(one, records[0], excess) for one in tested]
    if tested:
        refit = confirm(tested[0], fits, records, noise, revolution)
        if refit is None and curve is not None:
            refit = _reached(refit_with(Host.of_curve(curve.spline_fit), base, *tested[0].at, noise), noise)
            if refit is not None and refit.score.gain < LEAST_PART * tested[0].score.gain:
                refit = None
        if refit is not None:
            found[0] = describe(refitted(tested[0], refit), records[0], excess)
            found[0] = replace(found[0], refitted=True, law=refit.law)
    return tuple(found)


def confirm(
    tested: Tested,
    fits: Sequence[Fit],
    records: Sequence[MeasuredMotion],
    noise: float,
    revolution: float | None = None,
) -> Refit | None:
    """Fit a departure with the best laws in turn; return the first fit that reaches the noise, None without one."""
    curves: set[int] = set()
    for fit in fits:
        if fit.problem.curve in curves:
            continue
        if len(curves) == MOST_LAWS:
            break
        curves.add(fit.problem.curve)
        base = base_of(fit, records, revolution)
        found = None if base is None else refit_with(Host.of_law(fit), base, *tested.at, noise)
        if _reached(found, noise) is not None:
            return found
    return None


def _reached(refit: Refit | None, noise: float) -> Refit | None:
    """Return a refit that describes the record, else None."""
    return refit if refit is not None and refit.usual_rms < REACHED * noise else None


def refitted(tested: Tested, refit: Refit) -> Tested:
    """Return a tested departure with size and scale as fitted; how sure it is stays that of the test."""
    return replace(tested, scale=refit.scale, score=replace(refit.score, gain=tested.score.gain))


def base_of(fit: Fit, records: Sequence[MeasuredMotion], revolution: float | None = None) -> Base | None:
    """Linearise the fit of a law; None where the motion cannot be followed beside its solution."""
    linear = LinearisedFit.at(fit)
    path = follow(fit.windows, law_curve(fit.problem.curve, fit.problem.ramp), fit.u, fit.local)
    if linear is None or path is None or not math.isfinite(linear.cost):
        return None
    return Base.of(linear, path, records, revolution)
