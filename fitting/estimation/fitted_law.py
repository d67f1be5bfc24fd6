"""What every law that was fitted says of itself, one of the six or a formula: for pictures, levels and break-aways."""

from typing import Protocol

from daq.base.compute.arrays import Array, Mask
from fitting.data.cycles import Cycle
from fitting.model.parameters import Values
from fitting.model.problem import EstimationProblem
from fitting.model.windows import ShootingWindows
from fitting.sensitivity.path import Path


class FittedLaw(Protocol):
    """A law fitted to the runs, or its part of one run; units and shapes as in `fitting.estimation.fit.Fit`."""

    @property
    def law(self) -> int | str:
        """The law's number, or the formula's name."""

    @property
    def problem(self) -> EstimationProblem:
        """The runs, and the contact: a jump or a ramp."""

    @property
    def u(self) -> Array:
        """Shared unknowns (13 runs,); of a formula LOG_F is that of its friction at rest."""

    @property
    def values(self) -> Values:
        """The first run's by name."""

    @property
    def local(self) -> Array:
        """Each cycle's own unknowns (cycles, 6)."""

    @property
    def residual(self) -> Array:
        """Model minus measurement, m, (N,)."""

    @property
    def cycle_rms(self) -> Array:
        """Rms residual of each cycle, m."""

    @property
    def inlier_cycles(self) -> Mask:
        """Which cycles fit about as well as the others."""

    @property
    def windows(self) -> ShootingWindows:
        """The windows that were fitted."""

    @property
    def cycles(self) -> tuple[Cycle, ...]:
        """The cycles."""

    @property
    def rows(self) -> tuple[slice, ...]:
        """The residuals of each cycle."""

    @property
    def rms(self) -> float:
        """Root mean square of all residuals, m."""

    @property
    def misfit(self) -> float:
        """What noise does not explain of the usual error of a cycle, m."""

    @property
    def outcome(self) -> str:
        """How the minimisation ended (`fitting.least_squares.levenberg_marquardt.Solution`)."""

    def path(self) -> Path | None:
        """Return the motion along the windows, for tangents; None where it cannot be followed."""

    def force(self, w: Array, mass: float = 1.0) -> Array:
        """Return friction on a mass (kg), N, positive along the belt, at relative velocities w (n,), m/s."""

    def residual_in(self, windows: ShootingWindows, local: Array) -> Array | None:
        """Return what the law would leave of other windows of this run (N,), m; None where it cannot be followed."""
