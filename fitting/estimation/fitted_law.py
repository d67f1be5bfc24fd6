"""The fit of a law, one of the six or a formula: unknowns, residuals, friction, of all runs or of one."""

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from fitting.data.cycles import Cycle
from fitting.driver.fit import TaskFit
from fitting.least_squares.levenberg_marquardt import Solution
from fitting.model import parameters, wear
from fitting.model.parameters import PER_RUN, Global
from fitting.model.problem import EstimationProblem
from fitting.model.windows import ShootingWindows
from fitting.sensitivity.path import Curve, Path
from fitting.sensitivity.values import positions
from stickslip.compute.arrays import Array, Mask


@dataclass(frozen=True, eq=False)
class FittedLaw(ABC):
    """One law fitted to the runs, per unit mass and in the fit's frame."""

    at: TaskFit  # where the driver ended
    problem: EstimationProblem  # the runs, and the contact: a jump or a ramp
    # (13 runs,) of each run K = k/m (1/s^2), log of F = Fs/m (m/s^2), v_dr (m/s), shape (gamma or G_slip/Fs, s/m), d
    # (m/s), datum (m), c/m (1/s), fade (fraction of the first level lost per second), compliance (belt speed lost per
    # metre of spring stretch, 1/s), the belt's ripple: cosine and sine amplitude (m/s), angular frequency (rad/s), and
    # a ramp's break-away level over F; see `fitting.model.parameters`.  Of a formula F is its friction at rest.
    u: Array
    active: tuple[int, ...]  # which of them the fit moves
    local: Array  # (cycles, 6)
    residual: Array  # (N,) model minus measurement, m, cycle by cycle
    cycle_rms: Array  # (cycles,) m
    inlier_cycles: Mask  # (cycles,) false where a cycle fits so badly (a kick, lost counts) that its level says nothing
    sigma: Array  # (runs,) effective standard deviation of one residual, m: rms x sqrt(correlation time in samples)
    # (p,) how far the active unknowns are from their calibrations, in standard deviations; 0 where there is none
    prior_deviations: Array
    solution: Solution  # in the active unknowns, then a formula's own
    precision: Array  # (p,) 1/sd^2 of the calibrations, for the active unknowns
    windows: ShootingWindows
    cycles: tuple[Cycle, ...]

    @staticmethod
    def read(at: TaskFit) -> dict[str, Any]:
        """Return the attributes from the end of a driver's fit."""
        problem, active, u = at.task.problem, at.task.places, at.u
        index = list(active)
        return {
            "at": at,
            "problem": problem,
            "u": u,
            "active": active,
            "local": at.local,
            "residual": at.residual,
            "cycle_rms": at.cycle_rms,
            "inlier_cycles": at.noise.inliers,
            "sigma": at.noise.sigma,
            "prior_deviations": (u[index] - problem.prior[index]) * np.sqrt(problem.precision[index]),  # none of a fade
            "solution": at.solution,
            "precision": at.problem.precision[: len(active)],
            "windows": at.windows,
            "cycles": problem.cycles,
        }

    @property
    @abstractmethod
    def law(self) -> int | str:
        """The law's number, or the name of one given as a formula."""

    @property
    @abstractmethod
    def law_parameters(self) -> int:
        """Number of the law's own free unknowns, without those of every law (datum, damping, fade, belt)."""

    @property
    def values(self) -> parameters.Values:
        """Global parameters by name, of the first run."""
        return parameters.values(self.u[:PER_RUN])

    @property
    def rows(self) -> tuple[slice, ...]:
        return self.windows.rows

    @property
    def outcome(self) -> str:
        """The reason for the end of the last minimisation (`levenberg_marquardt.Solution`)."""
        return self.solution.outcome

    @property
    def cpu_s(self) -> float:
        return self.at.cpu_s

    @property
    def rms(self) -> float:
        return float(np.sqrt(np.mean(self.residual**2)))

    @property
    def geometric_mean_rms(self) -> float:
        """Geometric mean of the cycles' rms, m, robust to a few spoilt cycles."""
        return float(np.exp(np.mean(np.log(self.cycle_rms))))

    @property
    def misfit(self) -> float:
        """The geometric mean of the cycles' rms beyond noise (the largest of all runs), m."""
        return self.at.misfit

    @property
    def calibration_deviations(self) -> Array:
        """Deviations of the active unknowns from stated calibrations, in standard deviations; else 0."""
        guessed = [
            place % PER_RUN == Global.DATUM and self.problem.motions[place // PER_RUN].datum_prior is None
            for place in self.active
        ]
        return np.where(guessed, 0.0, self.prior_deviations)

    @property
    def runs(self) -> int:
        return self.u.size // PER_RUN

    @property
    def curve_on_path(self) -> Curve | None:
        """The friction of a path."""
        return self.at.curve_on_path

    def path(self) -> Path | None:
        """Return the fitted motion along the windows, for tangents; None where it cannot be followed."""
        return self.at.path

    def force(self, w: Array, mass: float = 1.0) -> Array:
        """Return friction on a mass (kg), N, positive along the belt, at relative velocities w (n,), m/s."""
        w, d = np.asarray(w, float), self.values.d if self.problem.ramp else 0.0
        slip = np.sign(w) * self.at.task.friction(self.at.q, np.maximum(np.abs(w) - d, 0.0))
        ramp = self.values.static * self.values.F * w / d if d else np.zeros(w.shape)
        return np.asarray(-mass * np.where(np.abs(w) <= d, ramp, slip))

    def residual_in(self, windows: ShootingWindows, local: Array) -> Array | None:
        """Return the residual (N,) in other windows of this run, m; None where it cannot be followed."""
        curve = self.curve_on_path
        found = None if curve is None else positions(windows, curve, self.u, local)
        return None if found is None else found - windows.position

    def level_trend(self, run: int = 0) -> wear.Wear | None:
        """Return the line through the levels of one run's inlier cycles (`fitting.model.wear`)."""
        return wear.of_cycles(self.windows, self.inlier_cycles, self.local, run)

    def for_run(self, run: int) -> Self:
        """Return the fit of one run: its unknowns, cycles and residuals; the solution stays that of all."""
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
