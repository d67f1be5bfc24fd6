"""Where a fit ended: unknowns, residuals, path, derivatives and covariance."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from daq.base.compute.arrays import Array
from fitting.driver.model import Model
from fitting.driver.noise import PassNoise
from fitting.driver.task import FitStart, Task
from fitting.estimation.covariance import scaled_inverse, upper_bound
from fitting.least_squares.levenberg_marquardt import Solution
from fitting.least_squares.normal_equations import SchurComplement
from fitting.least_squares.problem import LeastSquaresProblem
from fitting.model.windows import ShootingWindows
from fitting.sensitivity.path import Path


@dataclass(frozen=True, eq=False)
class TaskFit:
    """A task fitted to its runs.

    Attributes
    ----------
    model : Model
        Its windows have every sample, or every so many where the fit was not brought to its end.
    q, local : (p + n + m,), (cycles, 6) f8
        The task's unknowns (`Task`) and each cycle's own.
    residual : (N,) f8
        Model minus measurement, m.
    noise : PassNoise
        What the next pass is to assume.
    problem : LeastSquaresProblem
        What the last pass minimised; of every sample it is seen through nodes.
    solution : Solution
        Where it stopped.
    whole : bool
        Whether the last pass took every sample.
    """

    model: Model
    q: Array
    local: Array
    residual: Array
    noise: PassNoise
    problem: LeastSquaresProblem
    solution: Solution
    whole: bool = False

    @property
    def task(self) -> Task:
        """What was fitted."""
        return self.model.task

    @property
    def windows(self) -> ShootingWindows:
        """Those of the residuals."""
        return self.model.windows

    @property
    def u(self) -> Array:
        """The unknowns of all runs, (13 runs,)."""
        return self.task.split(self.q)[0]

    @property
    def start(self) -> FitStart:
        """Where another pass of the same task starts."""
        return FitStart(self.q, self.local)

    @cached_property
    def path(self) -> Path | None:
        """The fitted motion, for tangents; None where it cannot be followed."""
        return self.model.path(self.q, self.local)

    @cached_property
    def jacobian(self) -> Array | None:
        """Derivatives of the positions by all unknowns, shape (N, p + n + m + 6); None without a path."""
        return None if self.path is None else self.model.jacobian(self.path, self.q)

    @cached_property
    def cycle_rms(self) -> Array:
        """Error of each cycle, m, shape (cycles,)."""
        return self.windows.rms(self.residual)

    @property
    def rms(self) -> float:
        """Geometric mean of the cycles' errors, m: a few spoilt cycles hardly move it."""
        return float(np.exp(np.mean(np.log(self.cycle_rms))))

    @cached_property
    def covariance(self) -> Array:
        """Covariance of q: in no direction smaller than by the curvature, or by how the cycles' gradients differ."""
        blocks = self.solution.blocks
        reduced = SchurComplement(blocks)
        scale, bread = scaled_inverse(reduced.H, np.diag(blocks.H))
        own = (blocks.cycle_g - np.einsum("cpq,cq->cp", blocks.cross, reduced.local_step(blocks.gl))) * scale
        cycles = own.shape[0]
        meat = np.einsum("ci,cj->ij", own, own) * (cycles / max(cycles - 1, 1))
        meat += np.diag(self.problem.precision * scale**2)  # a prior's own error is one more independent source
        sandwich = np.einsum("ik,kl,lj->ij", bread, meat, bread)
        units = scale[:, None] * scale
        return upper_bound(sandwich * units, bread * units)
