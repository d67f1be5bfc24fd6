"""Which assumption breaks: departures with which a law describes a record that no law describes alone."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fitting import noise_levels
from fitting.curve.result import MeasuredCurve
from fitting.data.frame import MeasuredMotion
from fitting.departures.base import Base
from fitting.departures.library import departures
from fitting.departures.refit import Refit, refit_with
from fitting.departures.result import FoundDeparture
from fitting.departures.scores import sigmas
from fitting.departures.strongest import LEAST_SIGMAS, Tested, describe, misfit_beyond_noise, strongest
from fitting.driver.fit import Fit
from fitting.estimation.linearised import LinearisedFit
from fitting.forces.departure import Departure
from stickslip.compute.arrays import Array

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


def explain_misfit(asked: Question, curve: MeasuredCurve, describes: Judge) -> tuple[FoundDeparture, ...]:
    """Return the departures with which a law describes a record that no law describes alone, the strongest first.

    A score test on the best law and on the free curve chooses the order: a law that is wrong by itself can hide a
    departure, and a free curve can take part of one up.  Drags are tried whatever it shows: the test of a drag, on a
    law that has ended far away without it, is a poor guess, and its fit does not start there.
    """
    near = curve.chi < noise_levels.DESCRIBES
    bases = [] if asked.first is None else [asked.first]
    path = curve.spline_fit.path
    bases += [] if near or path is None else [Base.of(curve.linear, path, asked.records, asked.revolution)]
    lists = [(base, strongest(base)) for base in bases]
    lists = sorted((one for one in lists if one[1]), key=lambda one: -_explained(one[0], one[1], asked))
    tried: list[Tested] = []
    refits: list[Refit] = []
    for base, tested in lists:
        # Near the noise a share of the misfit says nothing.
        if refits or not (near or _explained(base, tested, asked) > LEAST_EXPLAINED):
            break
        for rival in tested:
            strong = rival is tested[0] or (refits and rival.score.gain > RIVAL_GAIN * tested[0].score.gain)
            if strong and not any(rival.near(other) for other in tried):
                tried.append(rival)
                refits += _confirmed(rival.at, asked, describes, hurried=bool(refits))
    drags = [one for one in departures() if one.drag is not None and all(one is not rival.departure for rival in tried)]
    for drag in [] if refits else drags:
        refits += _confirmed((drag, math.nan, np.zeros(drag.columns)), asked, describes, hurried=True)
    found = [_described(refit, asked) for refit in refits]
    return tuple(one for _, one in sorted(zip(refits, found, strict=True), key=lambda pair: pair[0].usual_rms))


def _explained(base: Base, tested: Sequence[Tested], asked: Question) -> float:
    """Return the share of the misfit that the strongest departure explains in one linear step."""
    excess = misfit_beyond_noise(base.linear, asked.noise)
    return min(tested[0].score.gain / excess, 1.0) if excess > 0 else 0.0


def _confirmed(at: tuple[Departure, float, Array], asked: Question, describes: Judge, *, hurried: bool) -> list[Refit]:
    """Return the fit of a law together with a departure that describes the record; empty where there is none."""
    refit = confirm(at, asked, hurried=hurried)
    shown = refit is not None and sigmas(refit.score.log_p, len(departures())) > LEAST_SIGMAS and describes(refit)
    return [refit] if refit is not None and shown else []


def _described(refit: Refit, asked: Question) -> FoundDeparture:
    """Return a departure as fitted, in the units of the rig."""
    excess = refit.score.gain + misfit_beyond_noise(refit.linear, asked.noise)
    sure = sigmas(refit.score.log_p, len(departures()))
    found = describe(Tested(refit.departure, refit.scale, refit.score, sure), asked.records[0], excess)
    return replace(found, refitted=True, law=None if refit.law is None else refit.law.number)


def confirm(at: tuple[Departure, float, Array], asked: Question, *, hurried: bool = False) -> Refit | None:
    """Fit a departure (with scale and coefficients as tested) with the best laws; None where none reaches the noise."""
    curves: set[str] = set()
    best: Refit | None = None
    for fit in asked.fits:
        if fit.law.formula in curves:
            continue
        if len(curves) == MOST_LAWS:
            break
        curves.add(fit.law.formula)
        quick = hurried or _reached(best, asked.noise) is not None
        refit = refit_with(fit, fit.law, *at, asked.noises, hurried=quick)
        if refit is not None and (best is None or refit.usual_rms < best.usual_rms):
            best = refit
    return _reached(best, asked.noise)


def _reached(refit: Refit | None, noise: float) -> Refit | None:
    """Return a refit that describes the record, else None."""
    return refit if refit is not None and refit.usual_rms < noise_levels.DESCRIBES * noise else None


def base_of(fit: Fit, records: Sequence[MeasuredMotion], revolution: float | None = None) -> Base | None:
    """Linearise the fit of a law; None where the motion near its solution cannot be followed."""
    linear = LinearisedFit.at(fit)
    path = fit.path
    if linear is None or path is None or not math.isfinite(linear.cost):
        return None
    return Base.of(linear, path, records, revolution)
