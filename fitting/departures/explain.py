"""Which assumption breaks: departures tested on a fit that misses the record, the strongest confirmed by a refit."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from fitting.curve.result import MeasuredCurve
from fitting.data.frame import MeasuredMotion
from fitting.departures.base import Base
from fitting.departures.host import Host
from fitting.departures.memory import suspect_memory
from fitting.departures.refit import Refit, refit_with
from fitting.departures.result import FoundDeparture
from fitting.departures.strongest import Tested, describe, misfit_beyond_noise, strongest
from fitting.estimation.fit import Fit
from fitting.estimation.linearised import LinearisedFit

# Usual error of a cycle over the noise, below which a law with a departure describes the record.  True departures end
# at 0.99 to 1.02; a wrong one that comes near, friction by position for a hard spring, at 1.1.
REACHED = 1.05
# Of the gain of the linear step: a refit of the free curve that gains less has not come to its end.  A curve often is
# near the noise without the departure, so its error alone does not tell.
LEAST_PART = 0.5
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
        The free curve.  Departures are tested on the best law and on it: a law that is wrong by itself can hide a
        departure, and a free curve can take part of one up.
    revolution : float, optional
        Travel per revolution of the encoder, m; scanned where it is not known.

    Returns
    -------
    tuple of FoundDeparture
        First where a law or the free curve describes the record together with it (``refitted``, ``law``): size and
        error are then those of that fit.  Else as tested, on the base of which the first explains more.  Where the
        free curve describes the record by itself, that is the curve.  Memory comes before them where it is suspected.
    """
    described = curve is not None and curve.chi < REACHED
    law = None if described else base_of(fits[0], records, revolution)
    free = None if curve is None else Base.of(curve.linear, curve.spline_fit.path, records, revolution)
    lists = [] if law is None else [_list(law, records, noise)]
    if free is not None:
        lists.append(_list(free, records, noise, curve))
    lists = sorted((one for one in lists if one.tested), key=lambda one: -one.found[0].explained)
    for one in lists:
        refit = confirm(one.tested[0], fits, records, noise, revolution, law)
        if refit is None and one.curve is not None:
            refit = confirm_on_curve(one.tested[0], one.base, one.curve, noise)
        if refit is not None:
            first = describe(refitted(one.tested[0], refit), records[0], 0.0)
            return (replace(first, explained=one.found[0].explained, refitted=True, law=refit.law), *one.found[1:])
    found = lists[0].found if lists else ()
    if free is not None and not described:
        explained = max((one.found[0].explained for one in lists if one.curve is not None), default=0.0)
        memory = suspect_memory(free, explained)
        found = found if memory is None else (memory, *found)
    return found


@dataclass(frozen=True, eq=False)
class _List:
    """What was found on one base: on a law, or on the free curve."""

    base: Base
    tested: list[Tested]
    found: tuple[FoundDeparture, ...]
    curve: MeasuredCurve | None


def _list(base: Base, records: Sequence[MeasuredMotion], noise: float, curve: MeasuredCurve | None = None) -> _List:
    excess, tested = misfit_beyond_noise(base.linear, noise), strongest(base)
    return _List(base, tested, tuple(describe(one, records[0], excess) for one in tested), curve)


def confirm(
    tested: Tested,
    fits: Sequence[Fit],
    records: Sequence[MeasuredMotion],
    noise: float,
    revolution: float | None = None,
    first: Base | None = None,
) -> Refit | None:
    """Fit a departure with the best laws; return the fit that leaves least where it reaches the noise, else None.

    ``first`` is the base of the best law, where it has been made.
    """
    curves: set[int] = set()
    best: Refit | None = None
    for fit in fits:
        if fit.problem.curve in curves:
            continue
        if len(curves) == MOST_LAWS:
            break
        curves.add(fit.problem.curve)
        base = first if first is not None and fit is fits[0] else base_of(fit, records, revolution)
        reached = _reached(best, noise) is not None
        found = None if base is None else refit_with(Host.of_law(fit), base, *tested.at, noise, hurried=reached)
        if found is not None and (best is None or found.usual_rms < best.usual_rms):
            best = found
    return _reached(best, noise)


def confirm_on_curve(tested: Tested, base: Base, curve: MeasuredCurve, noise: float) -> Refit | None:
    """Fit a departure with the free curve; None where that does not reach the noise, or stops before its end."""
    refit = _reached(refit_with(Host.of_curve(curve.spline_fit), base, *tested.at, noise), noise)
    return None if refit is None or refit.score.gain < LEAST_PART * tested.score.gain else refit


def _reached(refit: Refit | None, noise: float) -> Refit | None:
    """Return a refit that describes the record, else None."""
    return refit if refit is not None and refit.usual_rms < REACHED * noise else None


def refitted(tested: Tested, refit: Refit) -> Tested:
    """Return a tested departure with size and scale as fitted; how sure it is stays that of the test."""
    return replace(tested, scale=refit.scale, score=replace(refit.score, gain=tested.score.gain))


def base_of(fit: Fit, records: Sequence[MeasuredMotion], revolution: float | None = None) -> Base | None:
    """Linearise the fit of a law; None where the motion cannot be followed beside its solution."""
    linear = LinearisedFit.at(fit)
    path = fit.path()
    if linear is None or path is None or not math.isfinite(linear.cost):
        return None
    return Base.of(linear, path, records, revolution)
