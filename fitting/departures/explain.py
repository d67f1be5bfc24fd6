"""Departures tested on a fit that misses the record, the strongest confirmed by a refit."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fitting import noise_levels
from fitting.curve.result import MeasuredCurve
from fitting.data.frame import MeasuredMotion
from fitting.departures.base import Base
from fitting.departures.library import departures
from fitting.departures.memory import suspect_memory
from fitting.departures.refit import Refit, refit_with
from fitting.departures.result import FoundDeparture
from fitting.departures.scores import sigmas
from fitting.departures.strongest import LEAST_SIGMAS, Tested, describe, misfit_beyond_noise, strongest
from fitting.estimation.fit import Fit
from fitting.estimation.linearised import LinearisedFit
from fitting.forces.departure import Departure
from stickslip.compute.arrays import Array

# Gain of a refit of the free curve over that of the linear step: one that gains less has not come to its end.  A curve
# often is near the noise without the departure, so its error alone does not tell.
LEAST_GAIN_KEPT = 0.5
# Share of the misfit explained in one linear step: a departure with less is not fitted, and not reported.  True
# departures but forces by the velocity explain 0.72 to 1; of LuGre contacts the strongest explained 0.1 to 1.
LEAST_EXPLAINED = 0.5
MOST_LAWS = 2  # laws that a departure is fitted with: the best, and the best of another curve
# Gain over the strongest's, in one linear step: a departure with more is fitted too, as one step does not tell them
# apart.  A spring that hardens by 1 % gained 0.94 of what friction by position did, and left 3.76 um instead of 4.07.
RIVAL_GAIN = 0.9

# Whether noise may have made what a refit leaves over.
Judge = Callable[[Refit], bool]


@dataclass(frozen=True, eq=False)
class Question:
    """The record that no law describes, with its best laws."""

    fits: Sequence[Fit]  # the laws, best first
    records: Sequence[MeasuredMotion]  # the runs
    noise: float  # standard deviation of one measured position, m
    revolution: float | None  # travel per revolution of the encoder, m; scanned where it is not known
    first: Base | None  # of the best law; None where the motion cannot be followed beside its solution

    @classmethod
    def of(
        cls, fits: Sequence[Fit], records: Sequence[MeasuredMotion], noise: float, revolution: float | None = None
    ) -> "Question":
        return cls(fits, records, noise, revolution, base_of(fits[0], records, revolution))

    @property
    def noises(self) -> Array:
        """Standard deviation of a position of each run, (runs,), m."""
        return np.full(len(self.records), self.noise)


def explain_misfit(
    asked: Question, curve: MeasuredCurve | None = None, describes: Judge | None = None
) -> tuple[FoundDeparture, ...]:
    """Return the departures that a record shows, the strongest first, where neither a law nor the free curve fits.

    They are tested on the best law and on the free ``curve``: a wrong law can hide a departure, and a free curve can
    absorb part of one. The first is the one with which law or curve fits (``refitted``, ``law``), else suspected
    memory, else the strongest; ``describes`` judges drags where the curve nearly reaches the noise.
    """
    near = curve is not None and curve.chi < noise_levels.DESCRIBES
    free = None
    if curve is not None:
        free = Base.of(curve.linear, curve.spline_fit.path, asked.records, asked.revolution)
    lists = [] if asked.first is None or near else [_list(asked.first, asked)]
    if free is not None:
        lists.append(_list(free, asked, curve))
    # Near the noise a share of the misfit says nothing: there a law with the departure must describe the record.
    lists = [one for one in lists if one.tested and (near or one.explained > LEAST_EXPLAINED)]
    lists = sorted(lists, key=lambda one: -one.explained)
    judge = describes if near else None
    explained = _with_laws(lists, asked, judge) or _drag_with_laws(lists, asked, judge)
    if explained is None and not near:
        explained = _with_curve(lists, asked)
    if explained is not None or near:
        return explained or ()
    # what a drag explains in one step, its fit would have confirmed
    lists = [one for one in lists if one.tested[0].departure.drag is None]
    explained = lists[0].found if lists else ()
    agreed = len(lists) > 1 and lists[0].tested[0].departure is lists[1].tested[0].departure
    if free is not None and not agreed:
        memory = suspect_memory(free, max((one.explained for one in lists if one.curve is not None), default=0.0))
        explained = explained if memory is None else (memory, *explained)
    return explained


def explain_beside_curve(asked: Question, describes: Judge) -> tuple[FoundDeparture, ...]:
    """Return the departure with which a law describes a record that the free curve describes, and the others.

    Drag and a weak guide are nearly functions of the relative speed, and a law with one has fewer unknowns than the
    curve. A linear step is not enough: wrong departures explain up to all of the misfit of a law.
    """
    explained = _drag_with_laws([], asked, describes)
    if explained is not None or asked.first is None:
        return explained or ()
    one = _list(asked.first, asked)
    return _with_laws([one], asked, describes) or () if one.explained > LEAST_EXPLAINED else ()


def _with_laws(
    lists: Sequence["_List"], asked: Question, describes: Judge | None = None
) -> tuple[FoundDeparture, ...] | None:
    """Return the first list whose strongest departure describes the record with a law; None without one."""
    tried: list[Tested] = []
    for one in lists:
        tested = one.tested[0]
        if any(tested.near(other) for other in tried):
            continue
        tried.append(tested)
        refit = confirm(tested.at, asked)
        if refit is not None and (describes is None or describes(refit)):
            return one.with_first(*_least_left(refit, one.tested, asked), asked)
    return None


def _least_left(refit: Refit, listed: Sequence[Tested], asked: Question) -> tuple[Refit, float]:
    """Return the refit of the first departure or of a better rival, and the significance of its test."""
    best, sure = refit, listed[0].sigmas
    for rival in listed[1:]:
        if rival.score.gain > RIVAL_GAIN * listed[0].score.gain:
            again = confirm(rival.at, asked, hurried=True)
            if again is not None and again.usual_rms < best.usual_rms:
                best, sure = again, rival.sigmas
    return best, sure


def _drag_with_laws(
    lists: Sequence["_List"], asked: Question, describes: Judge | None
) -> tuple[FoundDeparture, ...] | None:
    """Return the departures, first a drag that describes the record with a law; None without one.

    It is fitted whether the test shows it or not: that test, on a law far away, is a poor guess.
    """
    tried = [one.tested[0].departure for one in lists]
    refits = [
        confirm((departure, math.nan, np.zeros(departure.columns)), asked, hurried=True)
        for departure in departures()
        if departure.drag is not None and departure not in tried
    ]
    sure = [one for one in refits if one is not None and sigmas(one.score.log_p) > LEAST_SIGMAS]
    for refit in sorted(sure, key=lambda one: one.linear.cost):
        if describes is None or describes(refit):
            others = lists[0].found if lists else ()
            return _in_front(refit, sigmas(refit.score.log_p, len(departures())), others, asked)
    return None


def _with_curve(lists: Sequence["_List"], asked: Question) -> tuple[FoundDeparture, ...] | None:
    """Return the departures of the free curve, if it fits with the strongest; else None."""
    for one in lists:
        refit = None if one.curve is None else confirm_on_curve(one.tested[0], one.curve, asked.noise)
        if refit is not None:
            return one.with_first(refit, one.tested[0].sigmas, asked)
    return None


@dataclass(frozen=True, eq=False)
class _List:
    """The departures of one base: of a law, or of the free curve."""

    base: Base
    tested: list[Tested]
    found: tuple[FoundDeparture, ...]
    curve: MeasuredCurve | None

    @property
    def explained(self) -> float:
        """Share of the misfit that the strongest explains; 0 without one."""
        return self.found[0].explained if self.found else 0.0

    def with_first(self, refit: Refit, sure: float, asked: Question) -> tuple[FoundDeparture, ...]:
        """Return the departures, that of the refit first with the significance of its test."""
        return _in_front(refit, sure, self.found, asked)


def _in_front(
    refit: Refit, sure: float, others: Sequence[FoundDeparture], asked: Question
) -> tuple[FoundDeparture, ...]:
    """Return a fitted departure, ``sure`` standard deviations from 0, and then the others."""
    excess = refit.score.gain + misfit_beyond_noise(refit.linear, asked.noise)
    first = describe(Tested(refit.departure, refit.scale, refit.score, sure), asked.records[0], excess)
    kept = tuple(one for one in others if one.name != first.name)
    return (replace(first, refitted=True, law=refit.law), *kept)


def _list(base: Base, asked: Question, curve: MeasuredCurve | None = None) -> _List:
    excess, tested = misfit_beyond_noise(base.linear, asked.noise), strongest(base)
    return _List(base, tested, tuple(describe(one, asked.records[0], excess) for one in tested), curve)


def confirm(at: tuple[Departure, float, Array], asked: Question, *, hurried: bool = False) -> Refit | None:
    """Fit a departure (with scale and coefficients as tested) with the best laws; None where none reaches the noise."""
    curves: set[int] = set()
    best: Refit | None = None
    for fit in asked.fits:
        if fit.problem.curve in curves:
            continue
        if len(curves) == MOST_LAWS:
            break
        curves.add(fit.problem.curve)
        quick = hurried or _reached(best, asked.noise) is not None
        refit = refit_with(fit.at, fit.law, *at, asked.noises, hurried=quick)
        if refit is not None and (best is None or refit.usual_rms < best.usual_rms):
            best = refit
    return _reached(best, asked.noise)


def confirm_on_curve(tested: Tested, curve: MeasuredCurve, noise: float) -> Refit | None:
    """Fit a departure with the free curve; None where that stops early or does not reach the noise."""
    refit = _reached(refit_with(curve.spline_fit.at, None, *tested.at, curve.spline_fit.noise), noise)
    return None if refit is None or refit.score.gain < LEAST_GAIN_KEPT * tested.score.gain else refit


def _reached(refit: Refit | None, noise: float) -> Refit | None:
    """Return a refit that describes the record, else None."""
    return refit if refit is not None and refit.usual_rms < noise_levels.DESCRIBES * noise else None


def base_of(fit: Fit, records: Sequence[MeasuredMotion], revolution: float | None = None) -> Base | None:
    """Linearise the fit of a law; None where the motion near its solution cannot be followed."""
    linear = LinearisedFit.at(fit.at)
    path = fit.path()
    if linear is None or path is None or not math.isfinite(linear.cost):
        return None
    return Base.of(linear, path, records, revolution)
