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
# Of the misfit of a law.  Drag and weak guides explain 0.84 to 1.0 of it, wrong departures of other truths up to 1.0:
# these have a published form.
MOSTLY_EXPLAINED = 0.8
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
    tried: set[str] = set()
    for one in lists:
        found = _with_laws(one, fits, records, noise, revolution, law, tried)
        if found is None and one.curve is not None:
            refit = confirm_on_curve(one.tested[0], one.base, one.curve, noise)
            found = None if refit is None else one.with_first(0, refit, records)
        if found is not None:
            return found
    found = lists[0].found if lists else ()
    if free is not None and not described:
        explained = max((one.found[0].explained for one in lists if one.curve is not None), default=0.0)
        memory = suspect_memory(free, explained)
        found = found if memory is None else (memory, *found)
    return found


def explain_beside_curve(
    fits: Sequence[Fit], records: Sequence[MeasuredMotion], noise: float, revolution: float | None = None
) -> tuple[FoundDeparture, ...]:
    """Return the departures of the best law where the free curve describes the record, which no law does.

    Drag and a weak guide are nearly functions of the relative speed.  They are reported where the strongest departure
    explains most of what the law leaves.  The arguments are those of `explain_misfit`.
    """
    base = base_of(fits[0], records, revolution)
    one = None if base is None else _list(base, records, noise)
    if one is None or not one.tested or one.found[0].explained < MOSTLY_EXPLAINED:
        return ()
    return _with_laws(one, fits, records, noise, revolution, base, set()) or one.found


def _with_laws(
    one: "_List",
    fits: Sequence[Fit],
    records: Sequence[MeasuredMotion],
    noise: float,
    revolution: float | None,
    first: Base | None,
    tried: set[str],
) -> tuple[FoundDeparture, ...] | None:
    """Return a list with the departure first that describes the record together with a law; None where none does.

    Besides the strongest, drags are tried: their test, on a law that has ended far away without them, is a poor guess,
    and their refit does not start there.  Names are added to ``tried``, so that no list tries them again.
    """
    for place, tested in enumerate(one.tested):
        name, drag = tested.departure.name, tested.departure.drag is not None
        if place == 0 or (drag and name not in tried):
            refit = confirm(tested, fits, records, noise, revolution, first, hurried=place > 0)
            if refit is not None:
                return one.with_first(place, refit, records)
            tried.add(name)
    return None


@dataclass(frozen=True, eq=False)
class _List:
    """What was found on one base: on a law, or on the free curve."""

    base: Base
    tested: list[Tested]
    found: tuple[FoundDeparture, ...]
    curve: MeasuredCurve | None

    def with_first(self, place: int, refit: Refit, records: Sequence[MeasuredMotion]) -> tuple[FoundDeparture, ...]:
        """Return what was found, the one at ``place`` first and as fitted."""
        own, others = self.found[place], (*self.found[:place], *self.found[place + 1 :])
        first = describe(refitted(self.tested[place], refit), records[0], 0.0)
        return (replace(first, explained=own.explained, refitted=True, law=refit.law), *others)


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
    *,
    hurried: bool = False,
) -> Refit | None:
    """Fit a departure with the best laws; return the fit that leaves least where it reaches the noise, else None.

    ``first`` is the base of the best law, where it has been made; ``hurried`` as in `refit_with`.
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
        quick = hurried or _reached(best, noise) is not None
        found = None if base is None else refit_with(Host.of_law(fit), base, *tested.at, noise, hurried=quick)
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
