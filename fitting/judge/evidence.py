"""Evidence between laws, and the model confidence set: the laws that the data cannot tell apart.

Evidence.  Residuals are correlated over tens of samples, so the unit of comparison is the cycle: the difference of the
log errors of two laws in it.  Where the best law's residual is white noise, a cycle is divided into pieces of
`PIECE_TIMES` correlation times, because a law may fail in a small part of it.  The score is a BIC.  N is the number of
effective samples: samples over the correlation time of the best law's residual.  A penalty of (p/2N) log N for the
law's p parameters, and 1/2N of the misfit to the calibrations, are added to the log error of each unit.  Cycles that
not even the best law describes are excluded.  The t-interval of a mean difference assumes independent units.

Set rule.  The winner has the smallest mean log error.  A law is in the set if the t-interval of its mean difference to
the winner includes zero, or if the difference is small and the winner is not nested in it.  Within the set a law is
preferred to the winner only if it is nested in the winner (1 in 3 and 5, 2 in 4 and 6, each jump law in its ramp law):
then the winner's extra parameter does not improve the fit.

Ramp and belt.  Without the belt's counts a ramp is confounded with a jump on a belt that slows under load
(`rig_sim.flow.modes`, droop).  So the jump law of the nearest ramp is also fitted with a compliant belt.  The
compliance is penalised as a parameter, as is the width of the ramp.  Runs at several belt speeds can distinguish the
two: a ramp has the same width at every speed, while each run has its own compliance.

Several contacts.  One joint law may describe runs of two contacts, since each run has its own levels and rest position.
So the nearest of the six is also fitted to each run separately, with a penalty for the parameters of every run.
"""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import special

from fitting import noise_levels
from fitting.judge import parameters
from fitting.judge.parameters import remove_level_errors
from fitting.laws import Law
from fitting.model.predict import FitStart, law_task
from fitting.model.problem import Run
from fitting.model.unknowns import PER_RUN, Global
from fitting.record.motion import MeasuredMotion
from fitting.search.exchange import NEAR_BEST, WORSE, fit_from_start
from fitting.search.fit import Fit
from stickslip.compute.arrays import Array, autocorrelation_time
from stickslip.units import Measured

DRAG_PIECES = 8  # equal pieces of a start-up drag, where it is the only evidence
COUNTING_LIMIT = 8.0  # residual of constant friction over an encoder's error: 2 on its own motion, 170 on short sticks
PIECE_TIMES = 16  # length of a piece in correlation times, chosen: shorter ones have skewed log errors
LONGEST_WHITE_TIME = 3.0  # correlation time in samples: with a longer one residuals are not white
# Difference of scores below which a law nested in the winner is as good.
TIED_SCORE = 1.0
# The same where neither law is nested in the other.  If the motions of two laws differ by S (chi square), their scores
# differ by S +- 2 sqrt(S): the wrong law leads by more than this in at most 2 % of the records.
OPEN = 4.0
SAME_SCORE = 1  # decimals of a score: the scores of one curve in two forms agree to these


@dataclass(frozen=True, eq=False)
class Evidence:
    laws: tuple[Law, ...]
    penalised_errors: Array  # (laws, units) log error of each unit, penalty included
    samples: float = 0.0  # effective samples, at least one a unit


@dataclass(frozen=True, eq=False)
class Units:
    """The units of the comparison, the same for every law."""

    sustained: bool  # whether the mass sticks repeatedly; else only the start-up drags are evidence
    inliers: NDArray[np.bool_]  # (cycles,) the cycles that are compared
    pieces: tuple[int, ...]  # units in each cycle or drag that is compared
    samples: float  # effective samples in all units together


def common_inliers(fits: Sequence[Fit]) -> NDArray[np.bool_]:
    """Return the cycles (cycles,) that the best law and related laws describe; all cycles where these are too few."""
    best = min(fits, key=lambda fit: fit.geometric_mean_rms)
    related_fits = [
        fit
        for fit in fits
        if fit.geometric_mean_rms < NEAR_BEST * best.geometric_mean_rms and _are_related(fit.law, best.law)
    ]
    inliers = np.logical_and.reduce([fit.inlier_cycles for fit in related_fits])
    return inliers if inliers.sum() >= noise_levels.FEWEST else np.ones_like(inliers)


def _are_related(law: Law, other: Law) -> bool:
    return law == other or law.contains(other) or other.contains(law)


def common_units(fits: Sequence[Fit], runs: Sequence[Run], *, sustained: bool) -> Units:
    """Return the units, from the best law's residual; a fit to a thinned record limits their number."""
    inliers = common_inliers(fits)
    best = min(fits, key=lambda fit: fit.geometric_mean_rms)
    judged_residuals = [residual for _, residual in _list_evidence(best, runs, inliers, sustained=sustained)]
    size = sum(residual.size for residual in judged_residuals)
    square = sum(float(np.sum(residual**2)) for residual in judged_residuals)
    pieces, samples = 1 if sustained else DRAG_PIECES, 0.0
    if square:
        tau = autocorrelation_time(judged_residuals)
        samples = size / tau
        floor = max(run.motion.resolution for run in runs)
        if best.geometric_mean_rms < noise_levels.NEAR * floor and tau < LONGEST_WHITE_TIME:
            usual_size = float(np.median([residual.size for residual in judged_residuals]))
            pieces = max(round(usual_size / (PIECE_TIMES * tau)), pieces)
    sizes = [[residual.size for _, residual in _list_evidence(fit, runs, inliers, sustained=sustained)] for fit in fits]
    return Units(sustained, inliers, tuple(min(pieces, *of_laws) for of_laws in zip(*sizes, strict=True)), samples)


def _list_evidence(
    fit: Fit, runs: Sequence[Run], inliers: NDArray[np.bool_], *, sustained: bool
) -> list[tuple[MeasuredMotion, Array]]:
    """Return the residuals that are evidence, with their motion: of each cycle, or of each start-up drag."""
    residuals = []
    for number, run in enumerate(runs):
        fit_of_run = fit.for_run(number)
        if sustained:
            inliers_of_run = inliers[fit.windows.run == number]
            rows = [rows for rows, is_inlier in zip(fit_of_run.rows, inliers_of_run, strict=True) if is_inlier]
        elif run.cut.drag != (0, 0) and run.cut.uses_start:
            rows = [_drag_rows(fit_of_run, run.cut.drag)]
        else:
            rows = []
        residuals += [(run.motion, fit_of_run.residual[samples]) for samples in rows]
    return residuals


def unit_errors(fit: Fit, runs: Sequence[Run], units: Units) -> Array:
    """Return the log error of every unit (units,), run by run; the resolution is its lower limit."""
    residuals = _list_evidence(fit, runs, units.inliers, sustained=units.sustained)
    log_errors = [
        0.5 * math.log(float(np.mean(piece**2)) + motion.resolution**2)
        for (motion, residual), pieces in zip(residuals, units.pieces, strict=True)
        for piece in np.array_split(residual, pieces)
    ]
    return np.array(log_errors) if log_errors else np.zeros(DRAG_PIECES)  # a drag too short to be evidence


def constant_friction_limit(motion: MeasuredMotion) -> float:
    """Return the largest residual of constant friction on a motion under constant friction, m rms."""
    counting = COUNTING_LIMIT * motion.step**2 / 12 / motion.resolution
    return math.hypot(counting, noise_levels.NEAR * motion.resolution)


def rules_out_constant_friction(fits: Sequence[Fit], runs: Sequence[Run]) -> bool:
    """Return whether the residual of constant friction is far above the noise on a motion without sustained sticks."""
    limit = max(constant_friction_limit(run.motion) for run in runs)
    return all(fit.geometric_mean_rms > limit for fit in fits)


def drag_error(fits: Sequence[Fit], runs: Sequence[Run]) -> float:
    """Return the smallest rms error of a law in the start-up drags, m; inf without a drag."""
    used = [number for number, run in enumerate(runs) if run.cut.drag != (0, 0) and run.cut.uses_start]
    errors = []
    for fit in fits if used else ():
        fits_of_runs = [fit.for_run(number) for number in used]
        rows = [
            fit_of_run.residual[_drag_rows(fit_of_run, runs[number].cut.drag)]
            for fit_of_run, number in zip(fits_of_runs, used, strict=True)
        ]
        errors.append(math.sqrt(float(np.mean(np.concatenate(rows) ** 2))))
    return min(errors, default=math.inf)


def _drag_rows(fit: Fit, drag: tuple[int, int]) -> slice:
    """Return the residuals of the start-up drag: the sine after it is the same under laws 1 and 2."""
    _, stick, first, count, *_ = fit.windows.table[0]
    if not stick or fit.cycles[0].stick != drag:
        raise RuntimeError("the first window is not the start-up drag")
    return slice(int(first), int(first + count))


def penalise(fit: Fit, errors: Array, units: Units, belts: int = 0) -> Array:
    """Add the penalties to log errors (units,); ``belts`` is the number of belts whose compliance only this fit has."""
    n = max(units.samples, errors.size)
    return errors + ((fit.law_parameters + belts) * math.log(n) + prior_misfit(fit)) / (2 * n)


def prior_misfit(fit: Fit) -> float:
    """Return the misfit to the calibrations, by Student's t: a wrong calibration must not decide alone."""
    return float(np.sum(5 * np.log1p(fit.calibration_deviations**2 / 4)))


@dataclass(frozen=True, eq=False)
class ModelSet:
    members: tuple[Law, ...]  # best first
    score: dict[Law, float]
    weight: dict[Law, float]
    behind: dict[Law, tuple[float, float]]  # mean paired difference of log error to the best law, and its error


def model_confidence_set(evidence: Evidence, alpha: float, among: Collection[Law] | None = None) -> ModelSet:
    """Apply the set rule to two units or more; only the laws ``among``, which describe the record, have weight."""
    laws, errors = evidence.laws, evidence.penalised_errors
    competing_rows = [k for k, law in enumerate(laws) if among is None or law in among]
    n = errors.shape[1]
    mean = errors.mean(axis=1)
    winner = min(competing_rows, key=lambda k: float(mean[k]))
    quantile = float(special.stdtrit(n - 1, 1 - alpha / 2))
    samples = max(n, evidence.samples)
    score = {law: float(2 * samples * (mean[i] - mean[winner])) for i, law in enumerate(laws)}
    behind = {law: _mean_difference(errors[i], errors[winner]) for i, law in enumerate(laws)}
    first, competing = laws[winner], [laws[k] for k in competing_rows]
    tied = {
        law
        for law in competing
        if score[law] < (TIED_SCORE if first.contains(law) else OPEN) and not law.contains(first)
    }
    compatible = {law for law in competing if behind[law][0] <= quantile * behind[law][1]} | tied
    # of two laws that are one curve, the first in the evidence comes first
    members = [law for law in sorted(competing, key=lambda law: round(score[law], SAME_SCORE)) if law in compatible]
    preferred = [law for law in members if first.contains(law)]
    members = [*preferred[:1], *(law for law in members if law not in preferred[:1])]
    total = sum(math.exp(-score[law] / 2) for law in competing)
    weight = {law: math.exp(-score[law] / 2) / total if law in competing else 0.0 for law in laws}
    return ModelSet(tuple(members), score, weight, behind)


def _mean_difference(errors: Array, reference: Array) -> tuple[float, float]:
    """Return the mean paired difference of log errors (units,), and its standard error."""
    difference = errors - reference
    return float(difference.mean()), float(np.std(difference, ddof=1)) / math.sqrt(difference.size)


def fits_as_well(errors: Array, best: Array, samples: float) -> bool:
    """Return whether log errors (units,), without penalties, exceed the best law's by no more than noise."""
    mean, error = _mean_difference(errors, best)
    return mean <= noise_levels.SHOWN * error or 2 * max(errors.size, samples) * mean < OPEN


def runs_differ(fits: Sequence[Fit], best: Array, runs: Sequence[Run], units: Units) -> bool:
    """Return whether separate fits of the nearest of the six have more evidence than the best joint fit.

    ``best`` are the penalised log errors (units,) of the joint fit.
    """
    kernels = [fit for fit in fits if fit.law.has_kernel]
    if len(runs) == 1 or not kernels:
        return False
    joint = min(kernels, key=lambda fit: fit.geometric_mean_rms)
    samples, first = max(units.samples, best.size), 0
    cost, errors = 0.0, []
    for number, run in enumerate(runs):
        fit = _fit_alone(joint, number, run)
        if fit is None:
            return False
        inliers = units.inliers[joint.windows.run == number]
        count = int(inliers.sum()) if units.sustained else int(run.cut.uses_start and run.cut.drag != (0, 0))
        units_of_run = Units(units.sustained, inliers, units.pieces[first : first + count], units.samples)
        errors.append(unit_errors(fit, [run], units_of_run))
        cost += fit.law_parameters * math.log(samples) + prior_misfit(fit)
        first += count
    return 2 * samples * float(np.mean(best) - np.mean(np.concatenate(errors))) - cost > OPEN


def _fit_alone(joint: Fit, number: int, run: Run) -> Fit | None:
    """Fit one run, with a joint fit as warm start."""
    task, cycles = law_task(joint.law, [run]), joint.windows.run == number
    u_of_run = joint.u[PER_RUN * number : PER_RUN * (number + 1)]
    noise = replace(joint.noise.without_fade, sigma=joint.noise.sigma[[number]], weights=joint.noise.weights[cycles])
    return fit_from_start(task, FitStart(u_of_run[list(task.places)], joint.local[cycles]), noise)


WIDEST_BELT_LOSS = 0.03  # largest speed that a belt loses under the load Fs, over its speed
SAME_ERROR = 0.05  # difference in log error, chosen: a hyperbola on a compliant belt and a ramp differ by less


def fit_on_compliant_belt(fits: Sequence[Fit], runs: Sequence[Run], alpha: float, *, sustained: bool) -> Fit | None:
    """Fit the jump law of the nearest ramp with a belt that slows under load.

    None where the belt was measured, the ramp is wider than any belt's loss, or its jump law fits as well.
    """
    if any(run.motion.belt_measured for run in runs):
        return None
    kernels = [fit for fit in fits if fit.law.has_kernel]
    pairs = [(jump, ramp) for jump in kernels for ramp in kernels if ramp.law.is_ramp_of(jump.law)]
    if not pairs:
        return None
    jump, nearest_ramp = min(pairs, key=lambda pair: pair[1].geometric_mean_rms)
    if jump.geometric_mean_rms <= WORSE * nearest_ramp.geometric_mean_rms:
        return None
    if _width(nearest_ramp, runs, alpha, sustained=sustained)[0] > WIDEST_BELT_LOSS:
        return None
    compliance = nearest_ramp.values.d * nearest_ramp.values.K / nearest_ramp.values.F
    u = nearest_ramp.u.copy()
    u[Global.COMPLIANCE :: PER_RUN] = compliance
    compliant = [replace(run, motion=replace(run.motion, compliance=Measured(compliance, compliance))) for run in runs]
    task = law_task(jump.law, compliant)
    fit = fit_from_start(task, FitStart(u[list(task.places)], nearest_ramp.local), nearest_ramp.noise.without_fade)
    return None if fit is None else remove_level_errors(fit)


def add_indistinct_contacts(
    chosen: ModelSet,
    fits: Mapping[Law, Fit],
    errors: Mapping[Law, Array],
    runs: Sequence[Run],
    alpha: float,
    *,
    sustained: bool,
) -> ModelSet:
    """Add to the set the jump law (on a belt that slows under load) of a ramp law in it, or the ramp of a jump law.

    A ramp law joins where its jump law has a compliant belt, or where its width is poorly constrained.
    """
    members = list(chosen.members)
    pairs = [(jump, ramp) for jump in fits.values() for ramp in fits.values() if ramp.law.is_ramp_of(jump.law)]
    for jump, ramp in pairs:
        if (jump.law in members) == (ramp.law in members):
            continue
        member, other = (jump, ramp) if jump.law in members else (ramp, jump)
        if float(np.mean(errors[other.law] - errors[member.law])) > SAME_ERROR:
            continue
        undetermined = other is ramp and _width(ramp, runs, alpha, sustained=sustained)[1] > WIDEST_BELT_LOSS
        if slows_under_load(jump) or undetermined:
            position = 0 if other is jump and members[0] == ramp.law else len(members)
            members.insert(position, other.law)
    return replace(chosen, members=tuple(members))


def slows_under_load(fit: Fit) -> bool:
    """Return whether the belt's compliance was fitted, not measured."""
    return any(motion.compliance is not None and not motion.belt_measured for motion in fit.problem.motions)


def _width(ramp: Fit, runs: Sequence[Run], alpha: float, *, sustained: bool) -> tuple[float, float]:
    """Return the interval of a ramp's width over the slowest belt's speed; all widths where it is undetermined."""
    width = parameters.derived_parameters(ramp, runs[0].motion, alpha, sustained=sustained).get("d")
    speed = min(run.motion.belt_speed for run in runs)
    return (0.0, math.inf) if width is None else (width.lo / speed, width.hi / speed)
