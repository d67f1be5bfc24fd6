"""The end of a fit: unknowns, residuals, path, derivatives and covariance."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fitting.driver.model import Model
from fitting.driver.noise import PassNoise
from fitting.driver.task import FitStart, Task
from fitting.least_squares.levenberg_marquardt import Solution
from fitting.least_squares.normal_equations import SchurComplement
from fitting.least_squares.problem import Block, Derivatives, LeastSquaresProblem
from fitting.model.windows import ShootingWindows
from fitting.sensitivity.path import Curve, Path
from stickslip.compute.arrays import Array


@dataclass(frozen=True, eq=False)
class TaskFit:
    model: Model  # its windows have every sample, or every so many where the fit was not brought to its end
    q: Array  # (p + n + m,) the task's unknowns (`Task`) and each cycle's own
    local: Array
    residual: Array  # (N,) model minus measurement, m
    noise: PassNoise  # what the next pass is to assume
    problem: LeastSquaresProblem  # what the last pass minimised; of every sample it is seen through nodes
    solution: Solution  # where it stopped
    whole: bool = False  # whether the last pass took every sample
    cpu_s: float = 0.0  # CPU time of all passes, s

    @property
    def task(self) -> Task:
        return self.model.task

    @property
    def windows(self) -> ShootingWindows:
        return self.model.windows

    @property
    def u(self) -> Array:
        return self.task.split(self.q)[0]

    @property
    def start(self) -> FitStart:
        """The start of another pass of the same task."""
        return FitStart(self.q, self.local)

    @property
    def path(self) -> Path | None:
        """The fitted motion, for tangents; None where it cannot be followed."""
        return self.model.path(self.q, self.local)

    @property
    def can_be_followed(self) -> bool:
        return all(self.path_in(block) is not None for block in self.windows.blocks)

    @property
    def curve_on_path(self) -> Curve | None:
        """The friction of a path."""
        return self.task.curve.on_path(self.task.split(self.q)[1], self.q[: len(self.task.places)])

    def path_in(self, block: Block) -> Path | None:
        return self.model.path_in(block, self.q, self.local)

    @property
    def derivatives(self) -> Derivatives:
        """Derivatives (N, p + n + m + 6) of the positions by all unknowns."""
        return self.model.all_derivatives(self.q, self.local)

    @cached_property
    def cycle_rms(self) -> Array:
        """RMS residual of each cycle, m, shape (cycles,)."""
        return self.windows.rms(self.residual)

    @property
    def geometric_mean_rms(self) -> float:
        """Geometric mean of the cycles' rms, m, robust to a few spoilt cycles."""
        return float(np.exp(np.mean(np.log(self.cycle_rms))))

    @property
    def misfit(self) -> float:
        """The geometric mean of the cycles' rms beyond noise (the largest of all runs), m."""
        noise = max(motion.resolution for motion in self.task.problem.motions)
        return math.sqrt(max(self.geometric_mean_rms**2 - noise**2, 0.0))

    def deviation(self, place: int) -> float:
        """Return the standard deviation of a shared unknown by the noise that the last pass assumed."""
        index = self.task.places.index(place)
        return math.sqrt(float(SchurComplement(self.solution.blocks).covariance[index, index]))
