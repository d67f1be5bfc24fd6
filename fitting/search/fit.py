"""The result of a fit, and the noise that a pass assumes and that its residuals give."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from fitting.laws import Law
from fitting.least_squares.levenberg_marquardt import Solution
from fitting.least_squares.normal_equations import Block, Derivatives, LeastSquaresProblem, SchurComplement
from fitting.model import unknowns
from fitting.model.path import Curve, FrictionSpline, Path, positions
from fitting.model.predict import FitStart, Model, Task
from fitting.model.problem import EstimationProblem
from fitting.model.unknowns import NUISANCE, PER_RUN, Global, PerCycle
from fitting.model.windows import ShootingWindows, Wear, fit_wear, level_trend
from fitting.record.cycles import Cycle
from stickslip.compute.arrays import Array, Mask, autocorrelation_time
from stickslip.units import Measured

DEFAULT_FADE_SD = 0.005  # a slip: prior of the fading of a level, where a run has too few cycles to estimate wear
LEAST_FADE_SD = 5e-7  # smallest value of that, a slip
INLIER_WEIGHT = 0.2  # least weight 2/(1 + e^2) of an inlier: its error e is three times the median one
# Power of weight/`INLIER_WEIGHT`, and its least value, by which the last pass lowers the weight of an outlier.
OUTLIER_POWER, LEAST_OUTLIER_SHARE = 3, 0.02
OUTLIER_LEVEL_SD = 10.0  # standard deviation of the log level of an outlier, so that it has no weight in the mean
OVERTAKING_FACTOR = (
    20.0  # prior width over that of other levels, where the mass overtakes the belt: 1/400 of the weight
)
STICK_SPEED_SD = 0.05  # error of the smoothed speed in the middle of a stick, over the belt's speed
# Standard deviation of the log friction levels before the first pass, and the limits of one estimated from residuals.
FIRST_SCATTER, LEAST_SCATTER, MOST_SCATTER = 0.1, 0.01, 0.5
COUNTED_WEIGHT = 0.5  # smallest weight of a cycle used to estimate the noise: its error is 1.7 times the median
START_SD = 0.1  # distance over the travel: how far a window may start from the smoothed motion


@dataclass(frozen=True, eq=False)
class PassNoise:
    sigma: Array  # (runs,) effective standard deviation of one residual, m
    weights: Array  # (cycles,) of each cycle: 1, and less for one that fits worse than the median
    scatter: float = FIRST_SCATTER  # standard deviation of the logarithms of the friction levels
    fade_sd: Array | None = None  # (runs,) how much a level may fade within a cycle, 1/s; None while it does not

    @property
    def inliers(self) -> Mask:
        return np.asarray(self.weights > INLIER_WEIGHT)

    @property
    def for_last_pass(self) -> "PassNoise":
        return replace(self, weights=without_outliers(self.weights))

    @property
    def without_fade(self) -> "PassNoise":
        return replace(self, fade_sd=None)

    def with_fade(self, task: Task, windows: ShootingWindows, local: Array) -> "PassNoise":
        """Let levels fade within a cycle as they do between cycles."""
        sd = []
        for run, motion in enumerate(task.problem.motions):
            table = windows.table
            slips_of_run = (table[:, 1] == 0) & (table[:, 5] == run) & self.inliers[table[:, 0]]
            levels = np.exp(local[table[slips_of_run, 0], PerCycle.LEVEL])
            trend = level_trend(windows.level_epoch[slips_of_run], levels)
            lost = DEFAULT_FADE_SD / motion.slip_s if trend is None else math.hypot(trend.rate.value, trend.rate.sd)
            sd.append(max(lost, LEAST_FADE_SD / motion.slip_s))
        return replace(self, fade_sd=np.array(sd))

    def update(
        self, task: Task, windows: ShootingWindows, residual: Array, local: Array, *, first: bool
    ) -> "PassNoise":
        """Estimate the noise from residuals; after the first pass it never rises, so misfit is not taken for noise."""
        rms, run = windows.rms(residual), windows.run
        weights, sigma = np.ones(rms.size), self.sigma.copy()
        for k, motion in enumerate(task.problem.motions):
            cycles = np.flatnonzero(run == k)
            weights[cycles] = cycle_weights(rms[cycles], max(float(np.median(rms[cycles])), motion.resolution))
            run_sigma = effective_sigma(residual, [windows.rows[c] for c in cycles if weights[c] > COUNTED_WEIGHT])
            sigma[k] = max(run_sigma if first else min(run_sigma, float(sigma[k])), motion.resolution)
        levels = local[weights > INLIER_WEIGHT, PerCycle.LEVEL]
        scatter = float(np.clip(np.std(levels), LEAST_SCATTER, MOST_SCATTER))
        return replace(self, sigma=sigma, weights=weights, scatter=scatter)

    def local_precision(self, task: Task, windows: ShootingWindows) -> Array:
        """Return the prior precisions (cycles, 6): about the smoothed motion, and of the levels."""
        wide = [(START_SD * motion.travel, motion.belt_speed) for motion in task.problem.motions]
        sd = np.array([[x, v, 0.0, 0.0, x, STICK_SPEED_SD * v] for x, v in wide])[windows.run]
        sd[:, PerCycle.LEVEL : PerCycle.NEXT_LEVEL + 1] = self.level_sd(windows, task.problem.level_prior)
        return np.asarray(1 / sd**2)

    def level_sd(self, windows: ShootingWindows, wider: float) -> Array:
        sd = np.full((len(windows.rows), 2), wider * self.scatter)
        sd[windows.overtaking, 1] *= OVERTAKING_FACTOR
        sd[~self.inliers] = OUTLIER_LEVEL_SD
        return sd


def without_outliers(weights: Array) -> Array:
    """Nearly ignore outliers; a small weight remains, since each cycle's unknowns are still fitted to it."""
    return weights * np.clip((weights / INLIER_WEIGHT) ** OUTLIER_POWER, LEAST_OUTLIER_SHARE, 1.0)


def cycle_weights(errors: Array, usual: float) -> Array:
    return np.minimum(2 / (1 + (errors / usual) ** 2), 1.0)


def effective_sigma(residual: Array, rows: Sequence[slice]) -> float:
    """Return rms x sqrt(tau), tau the integrated autocorrelation time in samples, pooled over the cycles."""
    parts = [residual[rows_of_cycle] for rows_of_cycle in rows]
    square, count = sum(float(np.sum(r**2)) for r in parts), sum(r.size for r in parts)
    return math.sqrt(square / count * autocorrelation_time(parts)) if square > 0 else 0.0


@dataclass(frozen=True, eq=False)
class Fit:
    """A task fitted to the runs, per unit mass and in the fit's frame."""

    model: Model  # its windows have every sample, or a thinned record where the fit is not finished
    q: Array  # (p + n + m,) the task's unknowns (`Task`), of all runs, and each cycle's own
    local: Array
    residual: Array  # (N,) model minus measurement, m, cycle by cycle
    noise: PassNoise  # for the next pass
    least_squares: LeastSquaresProblem  # of the last pass
    solution: Solution  # where it stopped
    finished: bool = False  # whether the last pass took every sample
    cpu_s: float = 0.0  # CPU time of all passes, s
    run: int | None = None  # whose windows, cycles, residuals and unknowns ``u`` these are; None for those of all runs

    @property
    def task(self) -> Task:
        return self.model.task

    @property
    def problem(self) -> EstimationProblem:
        return self.task.problem

    @property
    def law(self) -> Law:
        law = self.task.curve.law
        if law is None:
            raise TypeError("the fit of a free curve has no law")
        return law

    @property
    def places(self) -> tuple[int, ...]:
        return self.task.places

    @property
    def theta(self) -> Array:
        """The unknowns of the curve."""
        return self.task.split(self.q)[1]

    @property
    def runs(self) -> int:
        return len(self.problem.runs) if self.run is None else 1

    @property
    def u(self) -> Array:
        """The unknowns (13 runs,) as in `fitting.model.unknowns`; F of a formula is friction at rest."""
        u, theta, _ = self.task.split(self.q)
        if theta.size and self.task.curve.law is not None:
            u[Global.LOG_F :: PER_RUN] = math.log(float(self.task.friction(self.q, np.zeros(1))[0]))
        return u if self.run is None else u[PER_RUN * self.run : PER_RUN * (self.run + 1)]

    @cached_property
    def values(self) -> unknowns.Values:
        return unknowns.values(self.u[:PER_RUN])

    @property
    def law_values(self) -> dict[str, float]:
        return self.task.curve.values(self.theta, self.u)

    @property
    def start(self) -> FitStart:
        return FitStart(self.q, self.local)

    @cached_property
    def windows(self) -> ShootingWindows:
        return self.model.windows if self.run is None else self.model.windows.parts[self.run]

    @property
    def rows(self) -> tuple[slice, ...]:
        return self.windows.rows

    @cached_property
    def cycles(self) -> tuple[Cycle, ...]:
        return self.problem.cycles if self.run is None else self.problem.runs[self.run].cut.used

    @property
    def inlier_cycles(self) -> Mask:
        """Cycles (cycles,) with a usual residual: without a kick or lost counts."""
        inliers = self.noise.inliers
        return inliers if self.run is None else inliers[self.model.windows.run == self.run]

    @property
    def path(self) -> Path | None:
        return self.model.path(self.q, self.local)

    @property
    def can_be_followed(self) -> bool:
        return all(self.path_in(block) is not None for block in self.model.windows.blocks)

    def path_in(self, block: Block) -> Path | None:
        return self.model.path_in(block, self.q, self.local)

    @property
    def derivatives(self) -> Derivatives:
        return self.model.all_derivatives(self.q, self.local)

    @cached_property
    def cycle_rms(self) -> Array:
        return self.windows.rms(self.residual)

    @property
    def rms(self) -> float:
        return float(np.sqrt(np.mean(self.residual**2)))

    @property
    def geometric_mean_rms(self) -> float:
        """Robust against a few outlier cycles."""
        return float(np.exp(np.mean(np.log(self.cycle_rms))))

    @property
    def misfit(self) -> float:
        """The geometric mean rms beyond the resolution, m."""
        return math.sqrt(max(self.geometric_mean_rms**2 - self.task.resolution**2, 0.0))

    @property
    def outcome(self) -> str:
        return self.solution.outcome

    @property
    def assumed_rest(self) -> Measured | None:
        """The assumed rest position of the spring; None where it was calibrated or fitted."""
        problem = self.problem
        if problem.motions[0].datum_prior is not None or not problem.fixed[Global.DATUM]:
            return None
        return Measured(float(problem.prior[Global.DATUM]), float(problem.precision[Global.DATUM]) ** -0.5)

    @property
    def law_parameters(self) -> int:
        """Number of free unknowns without those that every law has (datum, damping, fade, belt)."""
        fixed = self.problem.fixed
        shared = sum(place % PER_RUN not in NUISANCE and not fixed[place] for place in self.places)
        return shared + self.task.curve.size - (self.assumed_rest is not None)

    @property
    def calibration_deviations(self) -> Array:
        """Distance from stated calibrations in standard deviations; 0 without one."""
        problem, index = self.problem, list(self.places)
        deviations = (self.task.split(self.q)[0][index] - problem.prior[index]) * np.sqrt(problem.precision[index])
        guessed = [
            place % PER_RUN == Global.DATUM and problem.motions[place // PER_RUN].datum_prior is None for place in index
        ]
        return np.where(guessed, 0.0, deviations)

    @property
    def curve_on_path(self) -> Curve | None:
        return self.task.curve.on_path(self.theta, self.q[: len(self.places)])

    @cached_property
    def spline(self) -> FrictionSpline:
        curve = self.curve_on_path
        if curve is None or curve.spline is None:
            raise RuntimeError("no spline follows this curve")
        return curve.spline

    def deviation(self, place: int) -> float:
        """Return the standard deviation of a shared unknown under the noise assumed in the last pass."""
        index = self.places.index(place)
        return math.sqrt(float(SchurComplement(self.solution.blocks).covariance[index, index]))

    def force(self, w: Array, mass: float = 1.0) -> Array:
        """Return friction on a mass (kg), N, positive along the belt, at relative velocities w, m/s."""
        w, d = np.asarray(w, float), self.values.d if self.problem.ramp else 0.0
        slip = np.sign(w) * self.task.friction(self.q, np.maximum(np.abs(w) - d, 0.0))
        ramp = self.values.static * self.values.F * w / d if d else np.zeros(w.shape)
        return np.asarray(-mass * np.where(np.abs(w) <= d, ramp, slip))

    def residual_in(self, windows: ShootingWindows, local: Array) -> Array | None:
        curve = self.curve_on_path
        predicted = None if curve is None else positions(windows, curve, self.u, local)
        return None if predicted is None else predicted - windows.position

    def motion_in(self, windows: ShootingWindows) -> Array | None:
        """Return positions, m, and velocities, m/s, (2, N) in windows of the fit; None where it cannot be followed."""
        return self.model.motion_in(windows, self.q, self.local, self.run)

    @property
    def loop(self) -> Array | None:
        """Slip speed and friction (2, n) of the cycle of median error, of a law with memory."""
        cycle = int(np.argsort(self.cycle_rms, kind="stable")[self.cycle_rms.size // 2])
        return self.model.loop(self.windows, self.q, self.local, self.run, cycle)

    def level_trend(self, run: int = 0) -> Wear | None:
        return fit_wear(self.windows, self.inlier_cycles, self.local, run)

    def for_run(self, run: int) -> "Fit":
        """Return the cycles, residuals and unknowns of one run; the solution stays that of all."""
        if self.runs == 1:
            return self
        cycles_of_run = np.flatnonzero(self.windows.run == run)
        residual = np.concatenate([self.residual[self.rows[k]] for k in cycles_of_run])
        return replace(self, run=run, local=self.local[cycles_of_run], residual=residual)


class Unfitted(NamedTuple):
    """A law that was not fitted, or whose fit is not valid."""

    law: Law
    reason: str
    asked: bool = True
