"""Evidence between laws, and the model confidence set: the laws that it cannot distinguish.

Residuals are correlated over tens of samples, so the unit is the cycle: its log error, paired over cycles between laws.
The score is a BIC with the cycle as the unit: each of n cycles pays (p/2n) log n in log error for the law's p
parameters, and 1/2n of the misfit to the calibrations.  Cycles that not even the best law describes (a kick) are no
evidence.  The t-interval of a mean difference assumes that the cycles are independent of each other.

Set rule.  The winner has the smallest mean.  A law joins its set when the t-interval of its mean difference reaches
zero, or when the difference, however regular, is next to nothing and the winner is no limit of it.  Inside the set a
law is preferred to the winner only when it is nested in the winner (1 in 3 and 5, 2 in 4 and 6, each jump law in its
ramp law): then the winner's extra parameter does not improve the fit.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from daq.compute.arrays import Array
from fitting.data.frame import MeasuredMotion
from fitting.estimation.fit import Fit
from fitting.model.problem import Run

NESTED = {1: (), 2: (1,), 3: (1,), 4: (3, 2, 1), 5: (1,), 6: (5, 2, 1)}  # laws that are a limit of the key
FEWEST_CYCLES = 4
DRAG_BLOCKS = 8
RELATED_FACTOR = 2.0  # times the best law's error: a limit of it that is further off is no near relative
# Times the encoder's error.  Constant friction leaves 2 even with 200 us of jitter and a belt that ripples; the
# shortest sticks tested leave 170 (test_ranking): half or twice the value changes neither.
CONSTANT_FRICTION_FACTOR = 8.0
TIE = 1.0  # score: laws with equally many parameters whose evidence differs by less are not distinguished by it


@dataclass(frozen=True, eq=False)
class Evidence:
    """Paired evidence: log error of each unit for each law, penalty included; shapes (laws, units) and (laws,)."""

    laws: tuple[int, ...]
    penalised: Array


def _log_error(residual: Array, motion: MeasuredMotion) -> float:
    """Return the log of the rms, with the encoder's own error as the floor below which nothing is better."""
    return 0.5 * math.log(float(np.mean(residual**2)) + motion.resolution**2)


def common_inliers(fits: Sequence[Fit]) -> NDArray[np.bool_]:
    """Return which cycles are judged by, shape (cycles,): those that the best law describes, if these are enough.

    A cycle with a velocity step in its slip is described by no law, and does not help to decide between them.  Laws
    that are limits of each other differ there by where their minimisers ended, so near relatives must all describe it.
    """
    best = min(fits, key=lambda fit: fit.geometric_mean_rms)
    related = [
        fit
        for fit in fits
        if fit.geometric_mean_rms < RELATED_FACTOR * best.geometric_mean_rms and _related(fit.law, best.law)
    ]
    trusted = np.logical_and.reduce([fit.inlier_cycles for fit in related])
    return trusted if trusted.sum() >= FEWEST_CYCLES else np.ones_like(trusted)


def _related(law: int, other: int) -> bool:
    return law == other or law in NESTED[other] or other in NESTED[law]


def unit_errors(fit: Fit, runs: Sequence[Run], taken: NDArray[np.bool_], *, sustained: bool) -> Array:
    """Return the log error of every cycle of every run that is ``taken``, or of every piece of the start-up drags."""
    found = []
    for number, run in enumerate(runs):
        part = fit.for_run(number)
        if sustained:
            own = taken[fit.windows.run == number]
            kept = [rows for rows, good in zip(part.rows, own, strict=True) if good]
            found.append(np.array([_log_error(part.residual[rows], run.motion) for rows in kept]))
        elif run.cut.drag != (0, 0) and not run.cut.cycles[0].flag:
            found.append(_drag_errors(part, run.motion, run.cut.drag))
    return np.concatenate(found) if found else np.zeros(DRAG_BLOCKS)  # a drag too short to be evidence


def rules_out_constant_friction(fits: Sequence[Fit], runs: Sequence[Run]) -> bool:
    """Return whether constant friction leaves far more of a motion without sustained sticks than counting explains."""
    floor = max(run.motion.resolution for run in runs)
    return all(fit.geometric_mean_rms > CONSTANT_FRICTION_FACTOR * floor for fit in fits)


def _drag_errors(fit: Fit, motion: MeasuredMotion, drag: tuple[int, int]) -> Array:
    """Return the log error of equal pieces of the start-up drag: the sine after it is the same under laws 1 and 2."""
    _, stick, first, count, *_ = fit.windows.table[0]
    if not stick or fit.cycles[0].stick != drag:
        raise RuntimeError("the first window is not the start-up drag")
    end = first + count
    return np.array([_log_error(part, motion) for part in np.array_split(fit.residual[first:end], DRAG_BLOCKS)])


def penalised(fit: Fit, errors: Array) -> Array:
    """Return the log errors plus the penalties for the law's parameters and for contradicting its calibrations."""
    n = errors.size
    return errors + (fit.law_parameters * math.log(n) + prior_misfit(fit)) / (2 * n)


def prior_misfit(fit: Fit) -> float:
    """Return what a fit pays for contradicting its calibrations, like a squared deviation where that is small.

    Student's t with 4 degrees of freedom: a calibration can be plainly wrong, and then must not decide alone.
    """
    return float(np.sum(5 * np.log1p(fit.prior_deviations**2 / 4)))


@dataclass(frozen=True, eq=False)
class ModelSet:
    """Order of the laws, members of the set (best first), and score, weight and lag of each law."""

    order: tuple[int, ...]
    members: tuple[int, ...]
    score: dict[int, float]
    weight: dict[int, float]
    behind: dict[int, tuple[float, float]]


def model_confidence_set(evidence: Evidence, alpha: float) -> ModelSet:
    """Apply the set rule to the evidence.

    Parameters
    ----------
    evidence : Evidence
        At least two units (cycles).
    alpha : float
        1 - confidence of the t-interval.
    """
    from scipy.stats import t as student

    laws, errors = evidence.laws, evidence.penalised
    n = errors.shape[1]
    mean = errors.mean(axis=1)
    winner = int(np.argmin(mean))
    quantile = float(student.ppf(1 - alpha / 2, n - 1))
    score = {law: float(2 * n * (mean[i] - mean[winner])) for i, law in enumerate(laws)}
    behind = {}
    for i, law in enumerate(laws):
        difference = errors[i] - errors[winner]
        half = quantile * float(np.std(difference, ddof=1)) / math.sqrt(n)
        behind[law] = (float(difference.mean()), half)
    alike = {law for law in laws if score[law] < TIE and laws[winner] not in NESTED[law]}
    near = {law for law in laws if behind[law][0] - behind[law][1] <= 0} | alike
    members = [law for law in sorted(laws, key=score.__getitem__) if law in near]
    preferred = [law for law in members if law in NESTED[laws[winner]]]
    if preferred:
        first = preferred[0]
        members = [first, *(law for law in members if law != first)]
    others = [law for law in sorted(laws, key=score.__getitem__) if law not in members]
    total = sum(math.exp(-value / 2) for value in score.values())
    weight = {law: math.exp(-value / 2) / total for law, value in score.items()}
    return ModelSet((*members, *others), tuple(members), score, weight, behind)
