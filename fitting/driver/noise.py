"""The noise that a pass of a fit assumes, and that its residuals show."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fitting.driver.task import Task
from fitting.model import wear
from fitting.model.parameters import PerCycle
from fitting.model.windows import ShootingWindows
from stickslip.compute.arrays import Array, Mask, autocorrelation_time

DEFAULT_FADE_SD = 0.005  # a slip: what a friction level may fade by where a run has too few cycles to show wear
LEAST_FADE_SD = 5e-7  # least of that, a slip
INLIER_WEIGHT = 0.2  # least weight 2/(1 + e^2) of an inlier: its error e is three times the median one
# In the last pass an outlier's weight is this power of weight/`INLIER_WEIGHT` times as large, and at least that share.
OUTLIER_POWER, LEAST_OUTLIER_SHARE = 3, 0.02
OUTLIER_LEVEL_SD = 10.0  # standard deviation of the log level of an outlier cycle, so that it has no weight in the mean
# Scatter over that of the levels, for one under which the mass overtakes the belt: it is low for that reason, and it is
# the next cycle's as well.  With 20 it counts in the mean by 1 in 400; unbounded, a search that leaves the overtaking
# loses it.
OVERTAKING_FACTOR = 20.0
STICK_SPEED_SD = 0.05  # error over the belt's speed: how well smoothing knows the speed in the middle of a stick
# Of the logarithms of the friction levels: their standard deviation before a fit has seen them, and within what limits
# one that was seen is believed.  At half the lower limit a record of few cycles holds its levels together; at twice the
# upper one a level runs off where its slip shows next to none.
FIRST_SCATTER, LEAST_SCATTER, MOST_SCATTER = 0.1, 0.01, 0.5
# Weight of a cycle in the noise; its error is at most 1.7 times the median, twice that lets kicks in.
COUNTED_WEIGHT = 0.5
START_SD = 0.1  # distance over the travel: how far a window may start from the smoothed motion


@dataclass(frozen=True, eq=False)
class PassNoise:
    sigma: Array  # (runs,) effective standard deviation of one residual, m
    weights: Array  # (cycles,) of each cycle: 1, and less for one that errs more than the usual one
    scatter: float = FIRST_SCATTER  # standard deviation of the logarithms of the friction levels
    fade_sd: Array | None = None  # (runs,) how much a level may fade within a cycle, 1/s; None while it does not

    @property
    def inliers(self) -> Mask:
        """Inlier cycles (cycles,)."""
        return np.asarray(self.weights > INLIER_WEIGHT)

    @property
    def for_last_pass(self) -> "PassNoise":
        """The same with outlying cycles nearly ignored."""
        return replace(self, weights=without_outliers(self.weights))

    @property
    def without_fade(self) -> "PassNoise":
        """The same with constant levels within a cycle."""
        return replace(self, fade_sd=None)

    def with_fade(self, task: Task, windows: ShootingWindows, local: Array) -> "PassNoise":
        """Return the same with levels that may fade within a cycle as they do between cycles."""
        sd = []
        for run, motion in enumerate(task.problem.motions):
            table = windows.table
            own = (table[:, 1] == 0) & (table[:, 5] == run) & self.inliers[table[:, 0]]
            levels = np.exp(local[table[own, 0], PerCycle.LEVEL])
            trend = wear.level_trend(windows.level_epoch[own], levels)
            lost = DEFAULT_FADE_SD / motion.slip_s if trend is None else math.hypot(trend.rate.value, trend.rate.sd)
            sd.append(max(lost, LEAST_FADE_SD / motion.slip_s))
        return replace(self, fade_sd=np.array(sd))

    def seen(self, task: Task, windows: ShootingWindows, residual: Array, local: Array, *, first: bool) -> "PassNoise":
        """Return the noise that residuals (N,) show, run by run.

        After the first pass it only decreases: a wrong curve must not be excused by its own misfit.
        """
        rms, run = windows.rms(residual), windows.run
        weights, sigma = np.ones(rms.size), self.sigma.copy()
        for k, motion in enumerate(task.problem.motions):
            own = np.flatnonzero(run == k)
            weights[own] = cycle_weights(rms[own], max(float(np.median(rms[own])), motion.resolution))
            seen = effective_sigma(residual, [windows.rows[c] for c in own if weights[c] > COUNTED_WEIGHT])
            sigma[k] = max(seen if first else min(seen, float(sigma[k])), motion.resolution)
        levels = local[weights > INLIER_WEIGHT, PerCycle.LEVEL]
        scatter = float(np.clip(np.std(levels), LEAST_SCATTER, MOST_SCATTER))
        return replace(self, sigma=sigma, weights=weights, scatter=scatter)

    def local_precision(self, task: Task, windows: ShootingWindows) -> Array:
        """Return the precisions (cycles, 6) of each cycle's own unknowns: about the smoothed motion, and its level."""
        wide = [(START_SD * motion.travel, motion.belt_speed) for motion in task.problem.motions]
        sd = np.array([[x, v, 0.0, 0.0, x, STICK_SPEED_SD * v] for x, v in wide])[windows.run]
        sd[:, PerCycle.LEVEL : PerCycle.NEXT_LEVEL + 1] = self.level_sd(windows, task.problem.level_prior)
        return np.asarray(1 / sd**2)

    def level_sd(self, windows: ShootingWindows, wider: float) -> Array:
        """Return the standard deviations (cycles, 2) of the priors of the log levels: ``wider`` times the scatter."""
        found = np.full((len(windows.rows), 2), wider * self.scatter)
        found[windows.overtaking, 1] *= OVERTAKING_FACTOR
        found[~self.inliers] = OUTLIER_LEVEL_SD
        return found


def without_outliers(weights: Array) -> Array:
    """Return weights (cycles,) that nearly ignore outlying cycles.

    Those of `cycle_weights` still let an outlier pull: its residuals keep one sign over much of a slip. Not 0, since
    the cycle's own unknowns must still follow it.
    """
    return weights * np.clip((weights / INLIER_WEIGHT) ** OUTLIER_POWER, LEAST_OUTLIER_SHARE, 1.0)


def cycle_weights(errors: Array, usual: float) -> Array:
    """Return weights (cycles,): 1, less for a cycle that fits worse than the ``usual`` one."""
    return np.minimum(2 / (1 + (errors / usual) ** 2), 1.0)


def effective_sigma(residual: Array, rows: Sequence[slice]) -> float:
    """Return rms x sqrt(tau), tau their integrated autocorrelation time in samples, pooled over the cycles."""
    parts = [residual[own] for own in rows]
    square, count = sum(float(np.sum(r**2)) for r in parts), sum(r.size for r in parts)
    return math.sqrt(square / count * autocorrelation_time(parts)) if square > 0 else 0.0
