"""What a search knows after a pass, and the fit that it ends in."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from daq.base.compute.arrays import Array, autocorrelation_time
from fitting.data.cycles import Cycle
from fitting.data.frame import MeasuredMotion
from fitting.estimation import wear
from fitting.least_squares import levenberg_marquardt
from fitting.model import parameters
from fitting.model.parameters import NUISANCE, PER_CYCLE, PER_RUN, Global, PerCycle
from fitting.model.problem import EstimationProblem
from fitting.model.shooting import evaluator
from fitting.model.windows import ShootingWindows
from fitting.sensitivity.path import Path, follow, law_curve
from rig_sim.friction.contact import force
from rig_sim.friction.law import LAWS

DEFAULT_FADE_SD = 0.005  # a slip: what a friction level may fade by where a run has too few cycles to show wear
INLIER_WEIGHT = 0.2  # least weight 2/(1 + e^2) of an inlier: its error e is three times the median one
LEAST_FADE_SD = 5e-7  # a slip
# In the last pass an outlier's weight is this power of weight/`INLIER_WEIGHT` times as large, and at least that share.
OUTLIER_POWER, LEAST_OUTLIER_SHARE = 3, 0.02
OUTLIER_LEVEL_SD = 10.0  # of the log level of an outlier cycle, so that it has no weight in the mean
# Times the levels' scatter, for one under which the mass overtakes the belt: it is low for that reason, and it is the
# next cycle's as well.  With 20 it counts in the mean by 1 in 400; unbounded, a search that leaves the overtaking
# loses it.
OVERTAKING_FACTOR = 20.0


def without_outliers(weights: Array) -> Array:
    """Return weights (cycles,) under which outlying cycles hardly count.

    Those of `cycle_weights` are enough for an outlier to pull: its residuals keep one sign over much of a slip, those
    of noise do not.  Not 0, since the cycle's own unknowns must still follow it.
    """
    return weights * np.clip((weights / INLIER_WEIGHT) ** OUTLIER_POWER, LEAST_OUTLIER_SHARE, 1.0)


def cycle_weights(errors: Array, usual: float) -> Array:
    """Return weights (cycles,) of cycles with these errors: 1, and less for one that fits worse than the usual one."""
    return np.minimum(2 / (1 + (errors / usual) ** 2), 1.0)


@dataclass(frozen=True, eq=False)
class PassState:
    """Where a pass ended: unknowns of all runs, the cycles' own, and what the next pass is to assume of the noise."""

    u: Array
    local: Array
    sigma: Array  # (runs,)
    scatter: float
    weights: Array
    cycle_rms: Array
    solution: levenberg_marquardt.Solution | None
    fade_sd: tuple[float, ...] | None = None  # standard deviation of each run's fade, 1/s; None before the last passes
    static: bool = False  # whether a ramp's break-away level is estimated, or that of slip
    prior: Array | None = None
    precision: Array | None = None

    @property
    def geometric_mean_rms(self) -> float:
        """Geometric mean of the cycles' errors, m."""
        return float(np.exp(np.mean(np.log(self.cycle_rms))))

    def centred(self) -> "PassState":
        """Return the same motion with logarithms of the levels that have the mean 0, and Fs/m changed by as much.

        Only the prior of the levels distinguishes the two.  Where it is wide, the search would stop before their mean
        is 0.  On a belt that slows under load the motion is another one, as its speed is per Fs.
        """
        levels = slice(PerCycle.LEVEL, PerCycle.NEXT_LEVEL + 1)
        shift = float(np.mean(self.local[self.weights > INLIER_WEIGHT, PerCycle.LEVEL]))
        u, local = self.u.copy(), self.local.copy()
        u[Global.LOG_F :: PER_RUN] += shift
        local[:, levels] -= shift
        return replace(self, u=u, local=local)

    def level_sd(self, windows: ShootingWindows, wider: float) -> Array:
        """Return the standard deviations (cycles, 2) of the priors of the log levels: ``wider`` times the scatter."""
        found = np.full((len(windows.rows), 2), wider * self.scatter)
        found[windows.overtaking, 1] *= OVERTAKING_FACTOR
        found[self.weights <= INLIER_WEIGHT] = OUTLIER_LEVEL_SD
        return found

    def with_noise(self, windows: ShootingWindows, motions: Sequence[MeasuredMotion], *, first: bool) -> "PassState":
        """Return the state with noise level, weights and scatter from the residuals of the pass, run by run."""
        if self.solution is None:
            return self
        weights, sigma = np.ones(len(windows.rows)), self.sigma.copy()
        for run, motion in enumerate(motions):
            own = np.flatnonzero(windows.run == run)
            middle = max(float(np.median(self.cycle_rms[own])), motion.resolution)
            weights[own] = cycle_weights(self.cycle_rms[own], middle)
            seen = effective_sigma(self.solution.residual, [windows.rows[k] for k in own if weights[k] > 0.5])
            # Only downwards after the first pass: a wrong law must not talk itself into noise that excuses it.
            sigma[run] = max(seen if first else min(seen, float(sigma[run])), motion.resolution)
        scatter = float(np.clip(np.std(self.local[weights > INLIER_WEIGHT, PerCycle.LEVEL]), 0.01, 0.5))
        return replace(self, weights=weights, sigma=sigma, scatter=scatter)

    def gain_over(self, before: "PassState", windows: ShootingWindows) -> float:
        """Return by how much the cost has fallen, without what spoilt cycles have gained.

        Two slips struck by the belt's joint gave a ramp a break-away level (1.2 +- 0.1) that the contact did not have.
        """
        if self.solution is None or before.solution is None:
            return 0.0
        fallen = before.solution.residual**2 - self.solution.residual**2
        own = 0.5 * before.weights / before.sigma[windows.run] ** 2 * [np.sum(fallen[rows]) for rows in windows.rows]
        spoilt = float(np.sum(own[windows.spoilt(before.solution.residual)]))
        return before.solution.cost - self.solution.cost - max(spoilt, 0.0)


@dataclass(frozen=True, eq=False)
class Fit:
    """One law fitted to one record, per unit mass and in the fit's frame.

    Attributes
    ----------
    problem : EstimationProblem
        The law and the runs.
    u : (13 runs,) f8
        Of each run K = k/m (1/s^2), log of F = Fs/m (m/s^2), v_dr (m/s), shape (gamma or G_slip/Fs, s/m), d (m/s),
        datum (m), c/m (1/s), fade (fraction of the first level lost per second), compliance (belt speed lost per metre
        of spring stretch, 1/s), the belt's ripple: cosine and sine amplitude (m/s), angular frequency (rad/s), and a
        ramp's break-away level over F; see `fitting.model.parameters`.
    active : tuple of int
        Which of them this law has and the fit moves.
    local : (cycles, 6) f8
    residual : (N,) f8
        Model minus measurement, m, cycle by cycle.
    cycle_rms : (cycles,) f8
        m.
    inlier_cycles : (cycles,) bool
        False where a cycle fits so badly (a kick, lost counts) that its level says nothing.
    sigma : (runs,) f8
        Effective standard deviation of one residual, m: rms x sqrt(correlation time in samples).
    prior_deviations : (p,) f8
        How far the active unknowns are from their calibrations, in standard deviations; 0 where there is none.
    solution : Solution
        In the active unknowns only.
    precision : (p,) f8
        1/sd^2 of the calibrations, for the active unknowns.
    windows : ShootingWindows
    cycles : tuple of Cycle
    state : PassState
        Where the last pass ended.
    cpu_s : float
    alternatives : tuple of PassState
        Where other starts led after the first pass, if not much worse.
    """

    problem: EstimationProblem
    u: Array
    active: tuple[int, ...]
    local: Array
    residual: Array
    cycle_rms: Array
    inlier_cycles: NDArray[np.bool_]
    sigma: Array
    prior_deviations: Array
    solution: levenberg_marquardt.Solution
    precision: Array
    windows: ShootingWindows
    cycles: tuple[Cycle, ...]
    state: PassState
    cpu_s: float
    alternatives: tuple[PassState, ...] = ()

    @property
    def values(self) -> parameters.Values:
        """Global parameters by name; the first run's where there are several."""
        return parameters.values(self.u[:PER_RUN])

    @property
    def law(self) -> int:
        """The law's number."""
        return self.problem.law

    @property
    def rows(self) -> tuple[slice, ...]:
        """The residuals of each cycle."""
        return self.windows.rows

    @property
    def outcome(self) -> str:
        """How the last minimisation ended (`levenberg_marquardt.Solution`)."""
        return self.solution.outcome

    @property
    def rms(self) -> float:
        """Root mean square of all residuals, m."""
        return float(np.sqrt(np.mean(self.residual**2)))

    @property
    def geometric_mean_rms(self) -> float:
        """Geometric mean of the cycles' errors, m: a few spoilt cycles hardly move it."""
        return float(np.exp(np.mean(np.log(self.cycle_rms))))

    @property
    def misfit(self) -> float:
        """What noise (the largest of all runs) does not explain of the geometric mean of the cycles' errors, m."""
        noise = max(motion.resolution for motion in self.problem.motions)
        return math.sqrt(max(self.geometric_mean_rms**2 - noise**2, 0.0))

    @property
    def calibration_deviations(self) -> Array:
        """How far the active unknowns are from calibrations that were given, in standard deviations; else 0."""
        guessed = [
            place % PER_RUN == Global.DATUM and self.problem.motions[place // PER_RUN].datum_prior is None
            for place in self.active
        ]
        return np.where(guessed, 0.0, self.prior_deviations)

    @property
    def law_parameters(self) -> int:
        """Number of the law's own free unknowns; what every law has besides (datum, damping, fade, belt) not."""
        held = self.problem.held
        return sum(place % PER_RUN not in NUISANCE and not held[place] for place in self.active)

    @property
    def runs(self) -> int:
        """How many runs were fitted together."""
        return self.u.size // PER_RUN

    def path(self) -> Path | None:
        """Follow the fitted motion along the windows, for tangents; None where it cannot be followed."""
        return follow(self.windows, law_curve(self.problem.curve, self.problem.ramp), self.u, self.local)

    def force(self, w: Array, mass: float = 1.0) -> Array:
        """Return friction on a mass (kg), N, positive along the belt, at relative velocities w (n,), m/s."""
        p = self.values
        Fs = p.F * mass
        numbers = {"Fs": Fs, "G_slip": p.shape * Fs, "gamma": p.shape, "d": p.d or 1.0, "static": p.static}
        return np.asarray(force(LAWS[self.law], w, **numbers))

    def residual_in(self, windows: ShootingWindows, local: Array) -> Array | None:
        """Return what the law would leave of other windows of this run (N,), m; None where it cannot be followed."""
        scales = np.ones(self.u.size), np.ones(PER_CYCLE)
        evaluate = evaluator(self.problem.curve, self.problem.ramp, windows, self.u, [Global.K], *scales)
        found = evaluate(self.u[[Global.K]], local, False)
        return None if found is None else found[0]

    def level_trend(self, run: int = 0) -> wear.Wear | None:
        """Return the line through the friction levels of one run's inlier cycles (`fitting.estimation.wear`)."""
        return wear.of_cycles(self.windows, self.inlier_cycles, self.local, run)

    @property
    def fade_sd(self) -> tuple[float, ...]:
        """How much the levels of each run may fade within a cycle, 1/s: about what they lose from cycle to cycle."""
        found = []
        for run, motion in enumerate(self.problem.motions):
            trend = self.level_trend(run)
            lost = DEFAULT_FADE_SD / motion.slip_s if trend is None else math.hypot(trend.rate.value, trend.rate.sd)
            found.append(max(lost, LEAST_FADE_SD / motion.slip_s))
        return tuple(found)

    def for_run(self, run: int) -> "Fit":
        """Return what the fit says of one run: its unknowns, cycles and residuals; the solution stays that of all."""
        if self.runs == 1:
            return self
        own = np.flatnonzero(self.windows.run == run)
        windows = self.windows.parts[run]
        slots = parameters.columns(self.active, self.runs)[run]
        return replace(
            self,
            u=self.u[PER_RUN * run : PER_RUN * (run + 1)],
            active=tuple(int(slot) for slot in slots if slot >= 0),
            local=self.local[own],
            residual=np.concatenate([self.residual[self.rows[k]] for k in own]),
            cycle_rms=self.cycle_rms[own],
            inlier_cycles=self.inlier_cycles[own],
            sigma=self.sigma[[run]],
            prior_deviations=self.prior_deviations[slots >= 0],
            precision=self.precision[slots >= 0],
            windows=windows,
            cycles=tuple(self.cycles[k] for k in own),
        )


def effective_sigma(residual: Array, rows: list[slice]) -> float:
    """Return rms x sqrt(tau), tau their integrated autocorrelation time in samples, pooled over the cycles."""
    parts = [residual[own] for own in rows]
    square, count = sum(float(np.sum(r**2)) for r in parts), sum(r.size for r in parts)
    return math.sqrt(square / count * autocorrelation_time(parts)) if square > 0 else 0.0
