"""What a departure is fitted together with: a law, or the free curve, as unknowns, path and priors."""

from dataclasses import dataclass

import numpy as np

from daq.base.compute.arrays import Array, Mask
from fitting.curve.coordinates import CurveCoordinates
from fitting.curve.spline_fit import SplineFit
from fitting.estimation.fit import Fit
from fitting.estimation.objective import fit_objective
from fitting.least_squares.problem import LeastSquaresProblem
from fitting.model import parameters
from fitting.model.parameters import PerCycle
from fitting.model.problem import EstimationProblem
from fitting.sensitivity.columns import shared_tangents, spline_tangents
from fitting.sensitivity.path import Curve, Path, law_curve, with_coefficients

MOSTLY = 0.5  # of the slips: without an eccentric wheel 19 of 21 started faster than the belt, and with it none


@dataclass(frozen=True, eq=False)
class Host:
    """A fit that a departure joins.

    Attributes
    ----------
    law : int or None
        None for the free curve.
    shared, local : (p,), (cycles, 6) f8
        Its unknowns at the solution: those at ``places``, then the coordinates of a free curve.
    u : (13 runs,) f8
    places : tuple of int
    curve : Curve
    basis : CurveCoordinates or None
        Of a free curve.
    task : LeastSquaresProblem
        Its priors and bounds.
    first, fastest : (cycles, 6) f8
        The cycles' own unknowns by the smoothed motion, and their upper bounds.
    problem : EstimationProblem
        Of the law, or of that whose windows a free curve has.
    """

    law: int | None
    shared: Array
    local: Array
    u: Array
    places: tuple[int, ...]
    curve: Curve
    basis: CurveCoordinates | None
    task: LeastSquaresProblem
    first: Array
    fastest: Array
    problem: EstimationProblem

    @property
    def too_fast(self) -> Mask:
        """Which slips start faster than they may, shape (cycles,)."""
        return np.asarray(self.local[:, PerCycle.V_SLIP] > self.fastest[:, PerCycle.V_SLIP])

    @property
    def astray(self) -> bool:
        """Whether a law by itself ended too far away for a search to come back: most slips start too fast."""
        return self.basis is None and float(self.too_fast.mean()) > MOSTLY

    @classmethod
    def of_law(cls, fit: Fit) -> "Host":
        """Join the fit of a law; on a jump a slip then starts slower than the belt, as it does for the free curve."""
        free = np.full(fit.local.shape, np.inf)
        return cls(
            law=fit.law,
            shared=fit.u[list(fit.active)],
            local=fit.local,
            u=fit.u,
            places=fit.active,
            curve=law_curve(fit.problem.curve, fit.problem.ramp),
            basis=None,
            task=fit_objective(fit),
            first=fit.windows.starting_values(fit.problem.motions),
            fastest=free if fit.problem.ramp else fit.windows.fastest_starts(fit.u),
            problem=fit.problem,
        )

    @classmethod
    def of_curve(cls, fit: SplineFit) -> "Host":
        """Join the free curve."""
        return cls(
            law=None,
            shared=fit.solution.u,
            local=fit.solution.local,
            u=fit.u,
            places=fit.places,
            curve=fit.path.curve,
            basis=fit.basis,
            task=fit.task,
            first=fit.solution.local,
            fastest=np.broadcast_to(fit.task.local_upper, fit.solution.local.shape),
            problem=fit.fit.problem,
        )

    def apart(self, shared: Array) -> tuple[Array, Curve]:
        """Return the unknowns of all runs and the curve for shared unknowns (p,)."""
        u, count = self.u.copy(), len(self.places)
        u[list(self.places)] = shared[:count]
        curve = self.curve
        if self.basis is not None:
            curve = with_coefficients(curve, self.basis.coefficients(shared))
        return parameters.copy_shared(u), curve

    def columns(self, path: Path) -> Array:
        """Return the derivatives of the positions by the shared unknowns, shape (N, p)."""
        found = shared_tangents(path, self.places)
        if self.basis is None:
            return found
        bend = np.einsum("ni,ij->nj", spline_tangents(path), self.basis.slopes)
        bend[:, : found.shape[1]] += found
        return np.asarray(bend)
