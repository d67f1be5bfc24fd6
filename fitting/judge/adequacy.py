"""Whether a law describes a record; the friction curve without a law; and what else acts where none does.

`measure` judges the nearest of the six and measures the curve; `assess` concludes, once all laws have competed.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from fitting import noise_levels
from fitting.judge.curve import BandExit, MeasuredCurve, furthest_exit, in_newtons, measure_curve
from fitting.judge.departures import Base, FittedDeparture, Refit, explain_misfit
from fitting.judge.fluctuation import fluctuation_share
from fitting.judge.goodness import (
    GoodnessOfFit,
    RunSlips,
    cycle_squares,
    goodness_of_fit,
    judge,
    left_out,
    smallest_visible,
)
from fitting.judge.linearised import LinearisedFit, Repeat
from fitting.laws import ALL_LAWS, Law
from fitting.least_squares.normal_equations import Block
from fitting.record.motion import MeasuredMotion
from fitting.search.fit import Fit
from stickslip.compute.arrays import Array, Mask

ADEQUATE = "adequate"
NONE_OF_SIX = "none of the six"
NOT_OF_SPEED = "not a function of relative speed"
NONE_FITTED = "none of the laws fitted"
NOT_JUDGED = "not judged"


@dataclass(frozen=True, eq=False)
class Adequacy:
    # `NONE_OF_SIX`: a curve may; `NOT_OF_SPEED`: not even a curve; `NONE_FITTED`: of fewer than six; None: not judged
    verdict: str | None
    noise_m: float  # standard deviation of one position, m
    goodness: GoodnessOfFit | None = None  # of the law that was judged; None where no law could be fitted at all
    smallest_visible: float | None = None  # departure, % of Fs, that half of all repetitions of the record would show
    # friction against relative speed without a law, in newtons where mass or stiffness is known
    curve: MeasuredCurve | None = None
    curve_goodness: GoodnessOfFit | None = None  # None where the curve was not judged
    outside_band: Mapping[int | str, BandExit] = field(default_factory=dict)  # where each law leaves the band furthest
    unit: str = "N/kg"  # of the curve's friction
    departures: tuple[FittedDeparture, ...] = ()  # those with which a law describes the record, strongest first
    # standard deviation of random friction within slips, over Fs, where that is what no law describes
    fluctuation: float | None = None

    @property
    def said(self) -> str:
        return self.verdict or NOT_JUDGED

    @property
    def adequate(self) -> bool:
        return self.verdict == ADEQUATE

    @property
    def rejected(self) -> bool:
        """Whether no law describes the record; neither this nor `adequate` holds where nothing could be judged."""
        return self.verdict is not None and not self.adequate

    @property
    def of_speed(self) -> bool:
        return self.curve is not None and (self.curve_goodness is None or not self.curve_goodness.rejected)

    def as_json(self) -> dict[str, Any]:
        found = self.goodness
        return {
            "verdict": self.verdict,
            "noise_m": self.noise_m,
            "misfit": found and found.misfit,
            "lag1": found and found.lag1,
            "repeat": found and found.repeat,
            "p_value": found and found.p_value,
            "smallest_visible": self.smallest_visible,
            "departures": [departure.as_json() for departure in self.departures],
            "curve": None if self.curve is None else curve_as_json(self.curve, self.unit),
        }


def curve_as_json(curve: MeasuredCurve, unit: str) -> dict[str, Any]:
    k_over_m = curve.k_over_m.as_json()
    del k_over_m["unit"]
    return {
        "speed": curve.speed.tolist(),
        "friction": curve.friction.tolist(),
        "lo": curve.lo.tolist(),
        "hi": curve.hi.tolist(),
        "unit": unit,
        "k_over_m": k_over_m,
        "chi": curve.chi,
    }


@dataclass(frozen=True, eq=False)
class Judged:
    fit: Fit
    faults: Mask | None  # (cycles,) those that a fault of the record spoilt; None where derivatives cannot be followed
    slips: tuple[RunSlips, ...]
    together: GoodnessOfFit
    each: tuple[GoodnessOfFit, ...]

    @property
    def noise(self) -> Array:
        """(runs,) standard deviation of one position, m."""
        return np.array([own.noise_m for own in self.slips])

    @property
    def usual(self) -> LinearisedFit | None:
        """The linearised fit without the spoilt cycles."""
        linear = LinearisedFit.at(self.fit)
        return None if linear is None or self.faults is None else linear.without(self.faults)


def measure(
    fits: Sequence[Fit], motions: Sequence[MeasuredMotion], alpha: float = 0.05
) -> tuple[Judged, MeasuredCurve | None]:
    """Judge the nearest of the six, and measure the friction curve, per unit mass, with a band of 1 - alpha."""
    judged = _judged(min(fits, key=lambda fit: fit.geometric_mean_rms), motions)
    return judged, measure_curve(sorted(fits, key=lambda fit: fit.law != judged.fit.law), judged.noise, alpha)


def assess(
    ranked: Sequence[Fit],
    chosen: Judged,
    curve: MeasuredCurve | None,
    noise: Array,
    nearest: Sequence[Fit],
    motions: Sequence[MeasuredMotion],
    laws: int,
    revolution: float | None = None,
    *,
    rejected: bool,
    explain: bool = True,
) -> list[Adequacy]:
    """Return how well the first of the ``ranked`` laws describes the runs, and what else acts where it is ``rejected``.

    The first result is of all runs together; of several runs one follows for each, without curve and departures.
    ``nearest`` are the fits to try departures with, best first; ``laws`` is how many of the six were requested; without
    ``explain`` the cause is known already; a ``revolution`` (encoder travel, m) of None is scanned for.
    """
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
    departures: tuple[FittedDeparture, ...] = ()
    if curve is not None and rejected and explain:
        departures = _departures(nearest, curve, motions, noise, revolution)
    fluctuation = None
    if rejected and explain and not departures:
        base = Base.at(chosen.fit, motions, revolution)
        if base is not None:
            count_repeated, repeated = partial(_count_repeated, chosen), chosen.together.repeat
            fluctuation = fluctuation_share(base, repeated, count_repeated, float(np.max(noise)))
    usual = chosen.usual
    visible: tuple[float | None, ...] = (None,) * len(motions)
    if usual is not None:
        visible = smallest_visible(chosen.fit, usual, chosen.slips)
    together = Adequacy(
        outcome,
        chosen.together.noise_m,
        chosen.together,
        min((size for size in visible if size is not None), default=None),
        departures=departures,
        fluctuation=fluctuation,
    )
    if curve is not None:
        mass = known_mass(motions[0], curve)
        shown = replace(curve, k_over_m=replace(curve.k_over_m, trusted=of_speed))
        together = replace(
            together,
            curve=shown if mass is None else in_newtons(shown, mass),
            curve_goodness=curve_goodness,
            outside_band={fit.law.key: furthest_exit(curve, np.abs(fit.force(-curve.speed))) for fit in ranked},
            unit="N/kg" if mass is None else "N",
        )
    if len(motions) == 1:
        return [together]
    return [
        together,
        *(
            Adequacy(outcome if own.rejected else ADEQUATE if own.judged else None, own.noise_m, own, size)
            for own, size in zip(chosen.each, visible, strict=True)
        ),
    ]


def judge_near_laws(
    fits: Sequence[Fit], motions: Sequence[MeasuredMotion], noise: float, known: Mapping[Law, Judged]
) -> dict[Law, Judged]:
    """Return the goodness of fit of the nearest law, and of those within `noise_levels.LOST` times the ``noise``, m."""
    nearest = min(fits, key=lambda fit: fit.geometric_mean_rms)
    return {
        fit.law: known.get(fit.law) or _judged(fit, motions)
        for fit in fits
        if fit is nearest or fit.geometric_mean_rms < noise_levels.LOST * noise
    }


def _count_repeated(chosen: Judged, residuals: Array) -> Array:
    """Return the share of residuals (N, B) that repeats from slip to slip, the mean over the runs' slips, (B,)."""
    judged, squares = [own for own in chosen.slips if own.bins.judged], cycle_squares(residuals, chosen.fit.rows)
    repeated = [own.bins.statistics(residuals, squares[own.counted]).repeat for own in judged]
    return np.asarray(np.average(repeated, axis=0, weights=[own.bins.slips for own in judged]))


def describes(fits: Sequence[Fit], motions: Sequence[MeasuredMotion]) -> bool:
    """Return whether one of the laws leaves no more than noise, as far as that can be judged."""
    return any(not _judged(fit, motions).together.rejected for fit in fits)


def known_mass(motion: MeasuredMotion, curve: MeasuredCurve) -> float | None:
    """Return the mass that converts the curve to newtons, kg; None where neither mass nor stiffness is known."""
    if motion.mass is not None:
        return motion.mass.value
    return motion.stiffness.value / curve.k_over_m.value if motion.stiffness is not None else None


def _judged(fit: Fit, motions: Sequence[MeasuredMotion]) -> Judged:
    linearised = LinearisedFit.at(fit)
    if linearised is None:
        # Without derivatives nothing is fitted again: the residuals of repetitions are then the larger.
        faults, nowhere = None, np.zeros(len(fit.cycles), np.bool_)
        slips = judge(fit.residual, partial(_unchanged, fit.windows.blocks), fit, motions, nowhere)
    else:
        faults, slips = _judged_without_faults(linearised, fit, motions)
    return Judged(fit, faults, slips, *goodness_of_fit(slips))


def _unchanged(blocks: Sequence[Block], residuals: Repeat) -> Iterator[tuple[Block, Array]]:
    return zip(blocks, residuals(blocks), strict=True)


def _judged_without_faults(
    linear: LinearisedFit, fit: Fit, motions: Sequence[MeasuredMotion]
) -> tuple[Mask, tuple[RunSlips, ...]]:
    """Return the cycles (cycles,) that a fault of the record spoilt, and the slips of the fit without them."""
    landings = np.array([cycle.landing for cycle in fit.cycles])
    faults = left_out(linear, fit.windows, landings, fit.windows.spoilt(linear.residual))
    usual = linear.without(faults)
    return faults, judge(usual.residual, usual.refit, fit, motions, faults)


def _judge_curve(curve: MeasuredCurve, motions: Sequence[MeasuredMotion]) -> GoodnessOfFit:
    return goodness_of_fit(_judged_without_faults(curve.linear, curve.spline_fit, motions)[1])[0]


def _departures(
    fits: Sequence[Fit],
    curve: MeasuredCurve,
    motions: Sequence[MeasuredMotion],
    noise: Array,
    revolution: float | None,
) -> tuple[FittedDeparture, ...]:
    """Return the departures with which a law describes the runs; ``fits``, best first."""

    def describes(refit: Refit) -> bool:
        _, slips = _judged_without_faults(refit.base.linear, refit.fit, motions)
        return not goodness_of_fit(slips)[0].rejected

    return explain_misfit(fits, curve, motions, float(np.max(noise)), revolution, describes)
