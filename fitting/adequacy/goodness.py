"""Goodness of fit in absolute terms: whether noise alone could have produced the residuals of a law.

Null distribution: the fitted motion is measured repeatedly with the record's noise (`fitting.adequacy.noise`), all
unknowns are fitted again, linearly, and the statistics of the slips (`fitting.adequacy.statistics`) are taken of what
is left.  The other two statistics are of whole cycles, sticks included: the largest mean square over the usual one, and
the rms of all.  Rounding makes patterns that repeat from cycle to cycle; the repetitions have them too.  A statistic
that is the same in all repetitions distinguishes nothing and is not judged.  The draws are seeded: the same record
gives the same number.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fitting.adequacy.noise import PositionNoise, estimate_noise
from fitting.adequacy.statistics import CycleSquares, SlipBins, SlipStatistics, cycle_squares
from fitting.data.frame import MeasuredMotion
from fitting.distributions import gamma_tail, gamma_upper_quantile
from fitting.driver.fit import Fit
from fitting.model.windows import SPOILT, ShootingWindows
from stickslip.compute.arrays import Array, Mask

REPETITIONS = 60  # the spread of a statistic is then known to 9 %
SEED = 13  # seed of the repetitions: the same for every record
MOST_AT_ONCE = 2_000_000  # residuals held at a time: 16 MB an array
FEWEST_SLIPS = 2  # at least: what repeats needs two
# Probability below which noise is not what made the residuals.  The tails are those of a gamma distribution with the
# moments of 60 repetitions of a linearised refit, so small probabilities are rough; 1e-6 is five standard deviations.
REJECTED = 1e-6
TESTS = 4  # what repeats, what is smooth, the worst cycle, and the size of all
# Noise of all judged cycles together over that of the repetitions, at the most: a noise that is not quite that
# of the model is no misfit.  True laws leave 0.97 to 1.04.
NOISE_KNOWN = 1.2
ROUNDING = 1e-9  # difference over a statistic's mean: numbers that differ by less are equal but for rounding


@dataclass(frozen=True)
class GoodnessOfFit:
    noise_m: float  # standard deviation of one position, from the record, m
    misfit: float  # rms of the residuals of the judged cycles over ``noise_m``
    lag1: float  # as in `fitting.adequacy.statistics.SlipStatistics`; 0 where no slip can be judged
    repeat: float
    # probability of statistics at least as large by noise alone; None where nothing could be judged: fewer than
    # `FEWEST_SLIPS` slips, or no statistic that differs between repetitions
    p_value: float | None
    # numbers of the cycles that are not judged (`fitting.adequacy.struck`); of several runs together none
    left_out: tuple[int, ...] = ()

    @property
    def judged(self) -> bool:
        return self.p_value is not None

    @property
    def adequate(self) -> bool:
        return self.p_value is not None and self.p_value >= REJECTED

    @property
    def rejected(self) -> bool:
        return self.p_value is not None and self.p_value < REJECTED


@dataclass(frozen=True, eq=False)
class RunSlips:
    """Noise and slips of a run, and their statistics in the record and in the repetitions."""

    noise: PositionNoise
    noise_m: float  # standard deviation of one position, m
    bins: SlipBins
    seen: SlipStatistics  # of the record
    null_sums: Array  # (bins, B) sums of the residuals of the repetitions, and of their squares, in each bin
    null_squares: Array
    cycles: CycleSquares  # of the record, and of the repetitions
    null_cycles: CycleSquares
    counted: Mask  # (cycles,) which cycles of all runs these are
    left_out: tuple[int, ...]  # numbers of the run's cycles that are not judged

    @cached_property
    def null(self) -> SlipStatistics:
        return self.bins.combine(self.null_sums, self.null_squares)

    @property
    def judged(self) -> bool:
        return self.bins.slips >= FEWEST_SLIPS

    def limits(self, p: float) -> tuple[float, float, float]:
        """Return the values of `repeat`, `smooth` and rms (m) that reject noise; inf for a statistic not judged."""
        found = (self.null.repeat - least(self.bins), self.null.smooth, self.null_cycles.rms)
        repeat, smooth, rms = (limit(p / TESTS, null) for null in found)
        return repeat, smooth, NOISE_KNOWN * rms


def judge(
    residual: Array,
    refit: Callable[[Array], Array],
    fit: Fit,
    motions: Sequence[MeasuredMotion],
    left_out: Mask,
    windows: ShootingWindows | None = None,
) -> tuple[RunSlips, ...]:
    """Return the statistics of each run's slips with their null distribution.

    ``residual`` (N,), m, is that of a fit without the cycles ``left_out``, as ``refit`` is: a slip that the belt's
    joint has struck pulls at the parameters it shares with the others, which then have smooth residuals under the true
    law (p = 1e-15 with 6 slips). ``windows`` replace the fit's where the residuals are of others.
    """
    windows = fit.windows if windows is None else windows
    owner = np.repeat(windows.table[:, 5], windows.table[:, 3])
    position = windows.position + residual
    velocity = np.empty_like(position)
    noises = []
    for run, motion in enumerate(motions):
        own = owner == run
        velocity[own] = motion.velocity[windows.source[own]]
        noises.append(estimate_noise(windows, residual, fit.inlier_cycles, motion, run))
    landings = np.array([cycle.landing for cycle in fit.cycles])
    judged = [~left_out & (windows.run == run) for run in range(len(motions))]
    bins = [SlipBins.cut(windows, landings, own, run) for run, own in enumerate(judged)]
    repeated: list[list[tuple[Array, Array, Array]]] = [[] for _ in motions]
    rng = np.random.default_rng(SEED)
    at_once = max(1, min(REPETITIONS, MOST_AT_ONCE // position.size))
    for first in range(0, REPETITIONS, at_once):
        drawn = np.empty((position.size, min(at_once, REPETITIONS - first)))
        for j in range(drawn.shape[1]):
            for run, noise in enumerate(noises):
                own = owner == run
                drawn[own, j] = noise.draw(position[own], velocity[own], rng)
        left = refit(drawn)
        for run, cut in enumerate(bins):
            if cut.slips >= FEWEST_SLIPS:
                squares = cycle_squares(left, windows.rows)[judged[run]]
                repeated[run].append((cut.sums(left), cut.sums(left**2), squares))
    seen_squares = cycle_squares(residual[:, None], windows.rows)
    found = []
    for run, (noise, cut, draws) in enumerate(zip(noises, bins, repeated, strict=True)):
        parts = [np.hstack(part) for part in zip(*draws, strict=True)] if draws else [np.zeros((0, 1))] * 3
        own = np.flatnonzero(windows.run == run)
        found.append(
            RunSlips(
                noise=noise,
                noise_m=noise.sd(velocity[owner == run]),
                bins=cut,
                seen=cut.statistics(residual[:, None]) if draws else SlipStatistics(*np.zeros((4, 1))),
                null_sums=parts[0],
                null_squares=parts[1],
                cycles=CycleSquares(seen_squares[judged[run]]),
                null_cycles=CycleSquares(parts[2]),
                counted=judged[run],
                left_out=tuple(fit.cycles[k].number for k in own if left_out[k]),
            )
        )
    return tuple(found)


def goodness_of_fit(slips: Sequence[RunSlips]) -> tuple[GoodnessOfFit, tuple[GoodnessOfFit, ...]]:
    each = [
        GoodnessOfFit(
            noise_m=own.noise_m,
            misfit=float(own.cycles.rms[0]) / own.noise_m if own.noise_m > 0 else math.inf,
            lag1=float(own.seen.lag1[0]),
            repeat=float(own.seen.repeat[0]),
            p_value=probability(own),
            left_out=own.left_out,
        )
        for own in slips
    ]
    if len(each) == 1:
        return each[0], tuple(each)
    share = np.array([own.bins.slips for own in slips], float)
    share /= max(share.sum(), 1.0)
    together = GoodnessOfFit(
        noise_m=math.sqrt(float(np.sum(share * [one.noise_m**2 for one in each]))),
        misfit=math.sqrt(float(np.sum(share * [one.misfit**2 for one in each]))),
        lag1=float(np.sum(share * [one.lag1 for one in each])),
        repeat=float(np.sum(share * [one.repeat for one in each])),
        p_value=_corrected([one.p_value for one in each], len(each)),
    )
    return together, tuple(each)


def probability(slips: RunSlips) -> float | None:
    if not slips.judged:
        return None
    begin, cycles, null = least(slips.bins), slips.cycles, slips.null_cycles
    worst = float(cycles.worst[0])
    found = (
        tail(float(slips.seen.repeat[0]) - begin, slips.null.repeat - begin),
        tail(float(slips.seen.smooth[0]), slips.null.smooth),
        tail(worst, null.worst) if worst > SPOILT else None,
        tail(float(cycles.rms[0]) / NOISE_KNOWN, null.rms),
    )
    return _corrected(found, TESTS)


def _corrected(found: Sequence[float | None], tests: int) -> float | None:
    """Return the least probability, corrected for the number of tests; None without one."""
    judged = [p for p in found if p is not None]
    return min(1.0, tests * min(judged)) if judged else None


def least(bins: SlipBins) -> float:
    """Return the least possible `repeat`, where its gamma distribution begins."""
    return -1 / max(bins.slips - 1, 1)


def tail(value: float, null: Array) -> float | None:
    """Return the p-value under a gamma distribution with the moments of ``null``; None where the repetitions agree."""
    moments = _moments(null)
    return None if moments is None else gamma_tail(value, *moments)


def limit(p: float, null: Array) -> float:
    """Return the value exceeded with probability p under that distribution; inf without one."""
    moments = _moments(null)
    return math.inf if moments is None else gamma_upper_quantile(p, *moments)


def _moments(null: Array) -> tuple[float, float] | None:
    """Return mean and standard deviation of the repetitions; None where they agree."""
    mean, spread = float(np.mean(null)), float(np.std(null, ddof=1))
    # The mean of equal numbers differs from them by rounding, and so would their spread from 0.
    return (mean, spread) if mean > 0 and spread > ROUNDING * mean else None
