"""Goodness of fit of the laws, the model-free friction curve, and departures where no law describes the record.

`measure` judges the nearest of the six and measures the curve. `assess` draws the conclusions once all laws are ranked.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from fitting import noise_levels
from fitting.judge.curve import BandExit, MeasuredCurve, furthest_exit, in_newtons, measure_curve
from fitting.judge.departures import Base, FittedDeparture, Refit, explain_misfit, fluctuation_share
from fitting.judge.friction import mass, unit
from fitting.judge.goodness import (
    GoodnessOfFit,
    RunSlips,
    cycle_squares,
    goodness_of_fit,
    judge,
    select_left_out,
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
    # `NONE_OF_SIX`: another curve may describe it; `NOT_OF_SPEED`: no curve does; `NONE_FITTED`: of fewer than six laws
    verdict: str | None
    noise_m: float  # standard deviation of one position, m
    goodness: GoodnessOfFit | None = None  # of the law that was judged; None where no law could be fitted at all
    smallest_visible: float | None = None  # departure, % of Fs, detected in half of all repetitions of the record
    # model-free friction against relative speed, in newtons where mass or stiffness is known
    curve: MeasuredCurve | None = None
    curve_goodness: GoodnessOfFit | None = None  # None where the curve was not judged
    outside_band: Mapping[int | str, BandExit] = field(
        default_factory=dict
    )  # each law's largest distance from the band
    unit: str = "N/kg"  # of the curve's friction
    departures: tuple[FittedDeparture, ...] = ()  # with which a law describes the record, strongest first
    # standard deviation of random friction within slips, over Fs, where that explains the misfit
    fluctuation: float | None = None

    @property
    def said(self) -> str:
        return self.verdict or NOT_JUDGED

    @property
    def adequate(self) -> bool:
        return self.verdict == ADEQUATE

    @property
    def rejected(self) -> bool:
        """Whether no law describes the record. False, as is `adequate`, where nothing could be judged."""
        return self.verdict is not None and not self.adequate

    @property
    def of_speed(self) -> bool:
        return self.curve is not None and (self.curve_goodness is None or not self.curve_goodness.rejected)

    def as_json(self) -> dict[str, Any]:
        goodness = self.goodness
        return {
            "verdict": self.verdict,
            "noise_m": self.noise_m,
            "misfit": goodness and goodness.misfit,
            "lag1": goodness and goodness.lag1,
            "repeat": goodness and goodness.repeat,
            "p_value": goodness and goodness.p_value,
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
class LawJudgement:
    fit: Fit
    faults: Mask | None  # (cycles,) cycles with a fault of the record; None where the fit cannot be linearised
    slips: tuple[RunSlips, ...]
    joint: GoodnessOfFit
    by_run: tuple[GoodnessOfFit, ...]

    @property
    def noise(self) -> Array:
        """(runs,) standard deviation of one position, m."""
        return np.array([run.noise_m for run in self.slips])

    @property
    def without_faults(self) -> LinearisedFit | None:
        """The linearised fit without the cycles that have faults."""
        linear = LinearisedFit.at(self.fit)
        return None if linear is None or self.faults is None else linear.without(self.faults)


def measure(
    fits: Sequence[Fit], motions: Sequence[MeasuredMotion], alpha: float = 0.05
) -> tuple[LawJudgement, MeasuredCurve | None]:
    """Judge the nearest of the six, and measure the friction curve, per unit mass, with a band of 1 - alpha."""
    judged = _judge_fit(min(fits, key=lambda fit: fit.geometric_mean_rms), motions)
    return judged, measure_curve(sorted(fits, key=lambda fit: fit.law != judged.fit.law), judged.noise, alpha)


def assess(
    ranked: Sequence[Fit],
    judgement: LawJudgement,
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
    """Return how well the first of the ``ranked`` laws describes the runs, with departures where it is ``rejected``.

    The first result is for all runs together. If there are several, one result per run follows, without curve and
    departures. ``nearest`` are the fits to combine with departures, best first. ``laws`` is how many of the six were
    requested. ``explain`` is false where the cause is known already. The encoder's travel per ``revolution``, m, is
    scanned if it is None.
    """
    curve_goodness = None
    if curve is not None and (rejected or curve.chi > noise_levels.CLEARLY_ABOVE):
        curve_goodness = _judge_curve(curve, motions)
    of_speed = curve is not None and (curve_goodness is None or not curve_goodness.rejected)
    outcome: str | None
    if not rejected:
        outcome = ADEQUATE if judgement.joint.judged else None
    elif laws < len(ALL_LAWS):
        outcome = NONE_FITTED
    else:
        outcome = NONE_OF_SIX if of_speed else NOT_OF_SPEED
    departures: tuple[FittedDeparture, ...] = ()
    if curve is not None and rejected and explain:
        departures = _fit_departures(nearest, curve, motions, noise, revolution)
    fluctuation = None
    if rejected and explain and not departures:
        base = Base.at(judgement.fit, motions, revolution)
        if base is not None:
            count_repeated, repeated = partial(_count_repeated, judgement), judgement.joint.repeat
            fluctuation = fluctuation_share(base, repeated, count_repeated, float(np.max(noise)))
    usual = judgement.without_faults
    visible: tuple[float | None, ...] = (None,) * len(motions)
    if usual is not None:
        visible = smallest_visible(judgement.fit, usual, judgement.slips)
    together = Adequacy(
        outcome,
        judgement.joint.noise_m,
        judgement.joint,
        min((size for size in visible if size is not None), default=None),
        departures=departures,
        fluctuation=fluctuation,
    )
    if curve is not None:
        curve_of_record = replace(curve, k_over_m=replace(curve.k_over_m, trusted=of_speed))
        together = replace(
            together,
            curve=in_newtons(curve_of_record, mass(motions[0], curve.spline_fit)),
            curve_goodness=curve_goodness,
            outside_band={fit.law.key: furthest_exit(curve, np.abs(fit.force(-curve.speed))) for fit in ranked},
            unit=unit(motions[0]),
        )
    if len(motions) == 1:
        return [together]
    return [
        together,
        *(
            Adequacy(outcome if run.rejected else ADEQUATE if run.judged else None, run.noise_m, run, size)
            for run, size in zip(judgement.by_run, visible, strict=True)
        ),
    ]


def judge_near_laws(
    fits: Sequence[Fit], motions: Sequence[MeasuredMotion], noise: float, judged: Mapping[Law, LawJudgement]
) -> dict[Law, LawJudgement]:
    """Return the goodness of fit of the nearest law, and of laws within `noise_levels.LOST` times the ``noise``, m."""
    nearest = min(fits, key=lambda fit: fit.geometric_mean_rms)
    return {
        fit.law: judged.get(fit.law) or _judge_fit(fit, motions)
        for fit in fits
        if fit is nearest or fit.geometric_mean_rms < noise_levels.LOST * noise
    }


def _count_repeated(judgement: LawJudgement, residuals: Array) -> Array:
    """Return the share of residuals (N, B) that repeats from slip to slip, averaged over all slips, (B,)."""
    runs, squares = [run for run in judgement.slips if run.bins.judged], cycle_squares(residuals, judgement.fit.rows)
    repeated = [run.bins.statistics(residuals, squares[run.judged_cycles]).repeat for run in runs]
    return np.asarray(np.average(repeated, axis=0, weights=[run.bins.slips for run in runs]))


def describes(fits: Sequence[Fit], motions: Sequence[MeasuredMotion]) -> bool:
    """Return whether the residual of one of the laws is noise, as far as that can be judged."""
    return any(not _judge_fit(fit, motions).joint.rejected for fit in fits)


def _judge_fit(fit: Fit, motions: Sequence[MeasuredMotion]) -> LawJudgement:
    linearised = LinearisedFit.at(fit)
    if linearised is None:
        # Without derivatives the repetitions are not fitted again, and their residuals are larger.
        faults, nowhere = None, np.zeros(len(fit.cycles), np.bool_)
        slips = judge(fit.residual, partial(_return_unchanged, fit.windows.blocks), fit, motions, nowhere)
    else:
        faults, slips = _judge_without_faults(linearised, fit, motions)
    return LawJudgement(fit, faults, slips, *goodness_of_fit(slips))


def _return_unchanged(blocks: Sequence[Block], residuals: Repeat) -> Iterator[tuple[Block, Array]]:
    return zip(blocks, residuals(blocks), strict=True)


def _judge_without_faults(
    linear: LinearisedFit, fit: Fit, motions: Sequence[MeasuredMotion]
) -> tuple[Mask, tuple[RunSlips, ...]]:
    """Return the cycles (cycles,) with a fault of the record, and the slips of the fit without them."""
    landings = np.array([cycle.landing for cycle in fit.cycles])
    faults = select_left_out(linear, fit.windows, landings, fit.windows.spoilt(linear.residual))
    usual = linear.without(faults)
    return faults, judge(usual.residual, usual.refit, fit, motions, faults)


def _judge_curve(curve: MeasuredCurve, motions: Sequence[MeasuredMotion]) -> GoodnessOfFit:
    return goodness_of_fit(_judge_without_faults(curve.linear, curve.spline_fit, motions)[1])[0]


def _fit_departures(
    fits: Sequence[Fit],
    curve: MeasuredCurve,
    motions: Sequence[MeasuredMotion],
    noise: Array,
    revolution: float | None,
) -> tuple[FittedDeparture, ...]:
    """Return the departures with which a law describes the runs; ``fits``, best first."""

    def describes_record(refit: Refit) -> bool:
        _, slips = _judge_without_faults(refit.base.linear, refit.fit, motions)
        return not goodness_of_fit(slips)[0].rejected

    return explain_misfit(fits, curve, motions, float(np.max(noise)), revolution, describes_record)
