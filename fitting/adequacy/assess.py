"""Whether a law describes a record; the friction curve without a law; and what else acts where none does.

`measure` judges the six and measures the curve; `assess` concludes, once it is known which laws are in the set.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fitting import noise_levels
from fitting.adequacy.goodness import GoodnessOfFit, RunSlips, goodness_of_fit, judge
from fitting.adequacy.result import ADEQUATE, NONE_FITTED, NONE_OF_SIX, NOT_OF_SPEED, Adequacy
from fitting.adequacy.struck import left_out
from fitting.adequacy.visible import smallest_visible
from fitting.competitors import ALL_LAWS
from fitting.curve.measure import band_exit, in_newtons, measure_curve
from fitting.curve.result import MeasuredCurve
from fitting.data.frame import MeasuredMotion
from fitting.departures.explain import Question, explain_beside_curve, explain_misfit
from fitting.departures.refit import Refit
from fitting.departures.result import FoundDeparture
from fitting.estimation.fit import Fit
from fitting.estimation.fitted_law import FittedLaw
from fitting.estimation.linearised import LinearisedFit
from fitting.model.windows import ShootingWindows
from fitting.sensitivity.path import Path
from stickslip.compute.arrays import Array


@dataclass(frozen=True, eq=False)
class Assessment:
    """The adequacy of all runs together, and of each, by the law that was judged."""

    law: int | str
    together: Adequacy
    runs: tuple[Adequacy, ...]
    beaten: bool = False

    def by_others(self, laws: int) -> "Assessment":
        """Return the assessment where a curve other than the ``laws`` of the six describes the runs better."""
        outcome = NONE_FITTED if laws < len(ALL_LAWS) else NONE_OF_SIX
        runs = tuple(replace(own, verdict=outcome) for own in self.runs)
        return replace(self, together=replace(self.together, verdict=outcome), runs=runs, beaten=True)


@dataclass(frozen=True, eq=False)
class Judged:
    fit: FittedLaw
    linearised: LinearisedFit | None
    usual: LinearisedFit | None
    slips: tuple[RunSlips, ...]
    together: GoodnessOfFit
    each: tuple[GoodnessOfFit, ...]


@dataclass(frozen=True, eq=False)
class Measurement:
    fits: Sequence[Fit]  # of the six, best first
    members: Sequence[int]  # their set
    judged: Judged  # the first of it that describes the runs, else the best
    curve: MeasuredCurve | None  # per unit mass
    noise: Array  # (runs,) standard deviation of one position of each run, m


def measure(
    fits: Sequence[Fit], members: Sequence[int], motions: Sequence[MeasuredMotion], alpha: float = 0.05
) -> Measurement:
    """Judge the compatible laws (``members``) until one fits, and measure the friction curve without a law."""
    judged = _first_not_rejected([fit for fit in fits if fit.law in members], motions)
    noise = np.array([own.noise_m for own in judged.slips])
    curve = measure_curve(_first(fits, judged.fit.law), noise, alpha)
    return Measurement(fits, members, judged, curve, noise)


def assess(
    measured: Measurement,
    members: Sequence[FittedLaw],
    motions: Sequence[MeasuredMotion],
    laws: int,
    revolution: float | None = None,
) -> Assessment:
    """Assess the compatible laws until one is not rejected, and test departures where all are.

    ``revolution`` is the travel per revolution of the encoder, m; None scans for it. Each run of several gets only a
    goodness of fit and a smallest detectable deviation.
    """
    of_six, curve, noise, fits = measured.judged, measured.curve, measured.noise, measured.fits
    chosen = _first_not_rejected(members, motions, {of_six.fit.law: of_six})
    rejected = chosen.together.rejected
    curve_goodness = None
    if curve is not None and (rejected or curve.chi > noise_levels.CLEARLY_ABOVE):
        curve_goodness = _judge_curve(curve, motions)
    of_speed = curve is not None and (curve_goodness is None or not curve_goodness.rejected)
    outcome: str | None
    if not rejected:
        outcome = ADEQUATE if chosen.together.judged else None
    elif laws < len(ALL_LAWS):
        outcome = NONE_FITTED
    else:
        outcome = NONE_OF_SIX if of_speed else NOT_OF_SPEED
    departures: tuple[FoundDeparture, ...] = ()
    if curve is not None and rejected:
        law = chosen.fit.law if isinstance(chosen.fit, Fit) else of_six.fit.law
        departures = _departures(_first(fits, law), curve, motions, noise, revolution, of_speed=of_speed)
    visible = _visible(chosen, motions)
    together = Adequacy(
        outcome,
        chosen.together.noise_m,
        chosen.together,
        min((size for size in visible if size is not None), default=None),
        departures=departures,
    )
    if curve is not None:
        mass = known_mass(motions[0], curve)
        together = replace(
            together,
            curve=_reported(curve, mass, trusted=of_speed),
            curve_goodness=curve_goodness,
            outside_band={fit.law: band_exit(curve, fit) for fit in fits},
            unit="N/kg" if mass is None else "N",
        )
    if len(motions) == 1:
        return Assessment(chosen.fit.law, together, (together,))
    each = [
        Adequacy(outcome if own.rejected else ADEQUATE if own.judged else None, own.noise_m, own, size)
        for own, size in zip(chosen.each, visible, strict=True)
    ]
    return Assessment(chosen.fit.law, together, tuple(each))


def describes_all(fits: Sequence[FittedLaw], motions: Sequence[MeasuredMotion]) -> frozenset[int | str]:
    """Return which formulas fit to within the noise; one that cannot be judged counts."""
    return frozenset(fit.law for fit in fits if not _judged(fit, motions).together.rejected)


def _first(fits: Sequence[Fit], law: int | str) -> list[Fit]:
    return sorted(fits, key=lambda fit: fit.law != law)


def _visible(chosen: Judged, motions: Sequence[MeasuredMotion]) -> tuple[float | None, ...]:
    if chosen.usual is None:
        return (None,) * len(motions)
    return smallest_visible(chosen.fit, chosen.usual, chosen.slips)


def describes(fits: Sequence[Fit], motions: Sequence[MeasuredMotion]) -> bool:
    """Return whether a law fits to within the noise; one that cannot be judged counts."""
    return not _first_not_rejected(fits, motions).together.rejected


def known_mass(motion: MeasuredMotion, curve: MeasuredCurve) -> float | None:
    """Return the mass that converts the curve to newtons, kg; None where neither mass nor stiffness is known."""
    if motion.mass is not None:
        return motion.mass.value
    return motion.stiffness.value / curve.k_over_m.value if motion.stiffness is not None else None


def _reported(curve: MeasuredCurve, mass: float | None, *, trusted: bool) -> MeasuredCurve:
    """Return the curve in newtons where the mass is known; k/m without its interval where it is not trusted."""
    curve = replace(curve, k_over_m=replace(curve.k_over_m, trusted=trusted))
    return curve if mass is None else in_newtons(curve, mass)


def _first_not_rejected(
    members: Sequence[FittedLaw],
    motions: Sequence[MeasuredMotion],
    known: Mapping[int | str, Judged] | None = None,
) -> Judged:
    first = None
    for fit in members:
        found = (known or {}).get(fit.law) or _judged(fit, motions)
        if not found.together.rejected:
            return found
        first = first or found
    if first is None:
        raise ValueError("no law to assess")
    return first


def _judged(fit: FittedLaw, motions: Sequence[MeasuredMotion]) -> Judged:
    linearised = LinearisedFit.at(fit.at)
    if linearised is None:
        # Without derivatives nothing is fitted again: the residuals of repetitions are then the larger.
        usual, nowhere = None, np.zeros(len(fit.cycles), np.bool_)
        slips = judge(fit.residual, _unchanged, fit, motions, nowhere)
    else:
        usual, slips = _judged_without_faults(linearised, fit.path, fit, fit.windows, motions)
    return Judged(fit, linearised, usual, slips, *goodness_of_fit(slips))


def _unchanged(residuals: Array) -> Array:
    return residuals


def _judged_without_faults(
    linear: LinearisedFit,
    path: Callable[[], Path | None],
    fit: FittedLaw,
    windows: ShootingWindows,
    motions: Sequence[MeasuredMotion],
) -> tuple[LinearisedFit, tuple[RunSlips, ...]]:
    """Return the fit without the cycles that a fault of the record spoilt, and the slips; makes ``path`` if needed."""
    spoilt = windows.spoilt(linear.residual)
    landings = np.array([cycle.landing for cycle in fit.cycles])
    faults = left_out(path() if spoilt.any() else None, linear, landings, spoilt, windows.run)
    usual = linear.without(faults)
    return usual, judge(usual.residual, usual.refit, fit, motions, faults, windows)


def _judge_curve(curve: MeasuredCurve, motions: Sequence[MeasuredMotion]) -> GoodnessOfFit:
    spline = curve.spline_fit
    path = spline.path
    _, slips = _judged_without_faults(curve.linear, lambda: path, spline.fit, path.windows, motions)
    return goodness_of_fit(slips)[0]


def _departures(
    fits: Sequence[Fit],
    curve: MeasuredCurve,
    motions: Sequence[MeasuredMotion],
    noise: Array,
    revolution: float | None,
    *,
    of_speed: bool,
) -> tuple[FoundDeparture, ...]:
    """Return the departures that explain the misfit of law and curve, or of the law alone if the curve hides them."""
    if of_speed and any(form.inside_band for form in curve.forms):
        return ()

    def describes(refit: Refit) -> bool:
        fit = next(fit for fit in fits if fit.law == refit.law)
        _, slips = _judged_without_faults(refit.linear, lambda: refit.path, fit, refit.path.windows, motions)
        return not goodness_of_fit(slips)[0].rejected

    asked = Question.of(fits, motions, float(np.max(noise)), revolution)
    return explain_beside_curve(asked, describes) if of_speed else explain_misfit(asked, curve, describes)
