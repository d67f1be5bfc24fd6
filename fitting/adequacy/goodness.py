"""Goodness of fit in absolute terms: whether noise alone could have produced the residuals of a law.

Null distribution: the fitted motion is measured repeatedly with the record's noise (`fitting.adequacy.noise`), all
unknowns are fitted again, linearly, and the statistics of the slips (`fitting.adequacy.statistics`) are taken of what
is left.  The other two statistics are of whole cycles, sticks included: the largest mean square over the usual one, and
the rms of all.  Rounding makes patterns that repeat from cycle to cycle; the repetitions have them too.  A statistic
that is the same in all repetitions distinguishes nothing and is not judged.  The draws are seeded: the same record
gives the same number.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from fitting.adequacy.noise import PositionNoise, estimate_noise
from fitting.adequacy.statistics import SlipBins, Statistics, cycle_squares
from fitting.data.frame import MeasuredMotion
from fitting.distributions import gamma_tail
from fitting.driver.fit import Fit
from fitting.estimation.linearised import Repeat
from fitting.least_squares.problem import MOST_AT_ONCE, Block
from fitting.model.windows import SPOILT, ShootingWindows
from stickslip.compute.arrays import Array, Integers, Mask

REPETITIONS = 60  # the spread of a statistic is then known to 9 %
SEED = 13  # seed of the repetitions: the same for every record
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
    lag1: float  # autocorrelation of neighbouring residuals of the record
    seen: Statistics  # of the record
    null: Statistics  # of the repetitions
    counted: Mask  # (cycles,) which cycles of all runs these are
    left_out: tuple[int, ...]  # numbers of the run's cycles that are not judged


class Repetitions:
    """Draws of a run's noise, repeated block by block of its samples: the same each time."""

    def __init__(self, noise: PositionNoise, rng: np.random.Generator, samples: int) -> None:
        self.noise, self.begin = noise, rng.bit_generator.state
        for first in range(0, 0 if noise.rounded_alone else samples, MOST_AT_ONCE):
            rng.standard_normal(min(MOST_AT_ONCE, samples - first))
        self.shift = float(rng.uniform(-0.5, 0.5)) if noise.pitch else 0.0

    def restart(self) -> np.random.Generator:
        rng = np.random.default_rng()
        rng.bit_generator.state = self.begin
        return rng


def draw_noise(
    repeated: Sequence[Sequence[Repetitions]],
    position: Array,
    velocity: Array,
    owner: Integers,
    blocks: Sequence[Block],
) -> Iterator[Array]:
    """Yield repetitions (n, B) of the noise in each block, m, from those ``repeated`` of each run."""
    rngs = [[one.restart() for one in runs] for runs in repeated]
    for block in blocks:
        run, x, v = owner[block.rows], position[block.rows], velocity[block.rows]
        drawn = np.empty((run.size, len(repeated)))
        for j, runs in enumerate(repeated):
            for k, (one, rng) in enumerate(zip(runs, rngs[j], strict=True)):
                own = run == k
                drawn[own, j] = one.noise.draw(x[own], v[own], rng, one.shift)
        yield drawn


def judge(
    residual: Array,
    refit: Callable[[Repeat], Iterable[tuple[Block, Array]]],
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
    rng, samples = np.random.default_rng(SEED), np.bincount(owner, minlength=len(motions)).tolist()
    repeated = [
        [Repetitions(noise, rng, n) for noise, n in zip(noises, samples, strict=True)] for _ in range(REPETITIONS)
    ]
    parts = []
    for block, left in refit(partial(draw_noise, repeated, position, velocity, owner)):
        squares = cycle_squares(left, windows.rows[block.cycles])
        parts.append((squares, *(part for cut in bins for part in (cut.sums(left, block), cut.sums(left**2, block)))))
    null_squares, *null_sums = (np.concatenate(part) for part in zip(*parts, strict=True))
    squares = cycle_squares(residual[:, None], windows.rows)
    return tuple(
        RunSlips(
            noise=noise,
            noise_m=noise.sd(velocity[owner == run]),
            bins=cut,
            lag1=cut.lag1(residual),
            seen=cut.statistics(residual[:, None], squares[judged[run]]),
            null=cut.combine(null_sums[2 * run], null_sums[2 * run + 1], null_squares[judged[run]]),
            counted=judged[run],
            left_out=tuple(fit.cycles[k].number for k in np.flatnonzero(left_out & (windows.run == run))),
        )
        for run, (noise, cut) in enumerate(zip(noises, bins, strict=True))
    )


def goodness_of_fit(slips: Sequence[RunSlips]) -> tuple[GoodnessOfFit, tuple[GoodnessOfFit, ...]]:
    each = [
        GoodnessOfFit(
            noise_m=own.noise_m,
            misfit=float(own.seen.rms[0]) / own.noise_m if own.noise_m > 0 else math.inf,
            lag1=own.lag1,
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
    if not slips.bins.judged:
        return None
    begin, null = least(slips.bins), slips.null
    repeat, smooth, worst, rms = (float(seen[0]) for seen in slips.seen)
    found = (
        tail(repeat - begin, null.repeat - begin),
        tail(smooth, null.smooth),
        tail(worst, null.worst) if worst > SPOILT else None,
        tail(rms / NOISE_KNOWN, null.rms),
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
    mean, spread = float(np.mean(null)), float(np.std(null, ddof=1))
    # The mean of equal numbers differs from them by rounding, and so would their spread from 0.
    return gamma_tail(value, mean, spread) if mean > 0 and spread > ROUNDING * mean else None
