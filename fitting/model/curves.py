"""The friction of a fit: one of the six laws, or a curve given by a spline.

A curve has ``size`` parameters theta, with bounds and priors; ``shared`` are the shared unknowns fitted with it.

A free curve's theta are the second differences of its coefficients, and its two ends.  In these coordinates the prior,
a second difference of the order of half the friction, is independent for each, as Levenberg-Marquardt needs it.  The
data determine only K datum + friction, so the curve is defined relative to the datum: the remaining effect of the datum
is then a small number, not the difference of two large ones.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fitting.laws import Law, Undetermined
from fitting.model import unknowns
from fitting.model.path import Curve, FrictionSpline, Path, spline_curve
from fitting.model.tangents import shared_tangents, spline_tangents
from fitting.model.unknowns import PER_RUN
from rig_sim.friction.curve import magnitude
from stickslip.compute.arrays import Array

BEND_SD = 0.5  # standard deviation of a second difference, over the middle coefficient


@dataclass(frozen=True, eq=False)
class CurveCoordinates:
    """The map from n - 2 second differences and two end coefficients, in units of their sizes, to coefficients."""

    matrix: Array  # (n, n) coefficients (m/s^2) by coordinates
    inverse: Array  # (n, n) coordinates by coefficients
    precision: Array  # (n,) of the coordinates' priors: 1, and 0 for the ends
    offset: Array  # (p,) how the whole curve moves with each of the shared unknowns, and their values at offset 0
    start: Array

    @classmethod
    def around(cls, coefficients: Array, offset: Array, start: Array) -> "CurveCoordinates":
        n, size = coefficients.size, abs(float(np.median(coefficients)))
        if not size > 0:
            raise ValueError(f"middle coefficient is {size}; friction must not vanish")
        sd = BEND_SD * size
        inverse = np.zeros((n, n))
        inverse[: n - 2] = np.diff(np.eye(n), 2, axis=0) / sd
        inverse[n - 2, 0] = inverse[n - 1, n - 1] = 1 / size
        # C_j = C_0 + j g + sum_{i < j} (j - 1 - i) delta_i, with g from the last coefficient
        steps = np.array([[max(j - 1 - i, 0) for i in range(n - 2)] for j in range(n)], float)
        along = np.arange(n) / (n - 1)
        matrix = np.zeros((n, n))
        matrix[:, : n - 2] = sd * (steps - along[:, None] * steps[-1])
        matrix[:, n - 2], matrix[:, n - 1] = size * (1 - along), size * along
        return cls(matrix, inverse, np.concatenate((np.ones(n - 2), np.zeros(2))), offset, start)

    @property
    def slopes(self) -> Array:
        """Derivatives (n, p + n) of the coefficients by the unknowns outside the curve, then its coordinates."""
        return np.hstack([np.broadcast_to(self.offset, (self.precision.size, self.offset.size)), self.matrix])

    def coefficients(self, shared: Array, theta: Array) -> Array:
        shift = float(np.sum(self.offset * (shared - self.start)))
        return np.asarray(np.einsum("ij,j->i", self.matrix, theta) + shift)

    def unknowns(self, shared: Array, coefficients: Array) -> Array:
        """Return all unknowns (p + n,) from the shared ones and the curve's coefficients."""
        shift = float(np.sum(self.offset * (shared - self.start)))
        return np.concatenate((shared, np.einsum("ij,j->i", self.inverse, coefficients - shift)))


class FrictionCurve(ABC):
    law: Law | None = None  # none of a free curve
    free: tuple[str, ...] = ()  # the names of theta
    by_log: Array = np.empty(0)  # which of them are fitted by their logarithm
    together: tuple[Undetermined, ...] = ()  # groups of confounded parameters of a formula
    kind = ""  # "constant", "linear", "hyperbolic" of the six that their own kernels follow
    model: "type | None" = None  # that of `fitting.model.predict` which predicts its positions; None for `Model`
    ramp: bool  # whether slip begins beyond a ramp of half-width d, a shared unknown
    size: int  # how many numbers theta it has
    # (size,) of theta: where a fit starts, means and 1/sd^2 of the priors (0 where nothing is known), bounds
    start: Array
    prior: Array
    precision: Array
    lower: Array
    upper: Array

    @abstractmethod
    def on_path(self, theta: Array, shared: Array) -> Curve | None:
        """Return the curve of a path; None where theta gives no friction."""

    @abstractmethod
    def columns(self, path: Path, theta: Array, places: Sequence[int]) -> Array:
        """Return the position derivatives (N, p + size) by the shared unknowns at ``places`` (p,), then by theta."""

    @abstractmethod
    def friction(self, u: Array, theta: Array, shared: Array, s: Array) -> Array:
        """Return friction per unit mass (m/s^2) at slip speeds s (k,); ``u`` are the unknowns of all runs."""

    def values(self, theta: Array, u: Array) -> dict[str, float]:
        """Return the law's parameters by name, per unit mass; none of a free curve."""
        return {}

    def is_ramp_of(self, other: "FrictionCurve") -> bool:
        """Return whether this is the other curve with a ramp, so that the other is nested in it."""
        return self.law is not None and other.law is not None and self.law.is_ramp_of(other.law)

    def contains(self, other: "FrictionCurve") -> bool:
        return self.law is not None and other.law is not None and self.law.contains(other.law)


class LawCurve(FrictionCurve):
    """One of the six laws: its parameters are the shared unknowns LOG_F and SHAPE; theta is empty."""

    law: Law
    size = 0

    def __init__(self, law: Law) -> None:
        self.law, self.ramp, self.kind, self.code = law, law.ramp, law.kind.curve, law.kind.curve_code
        self.start = self.prior = self.precision = self.lower = self.upper = np.empty(0)

    def on_path(self, theta: Array, shared: Array) -> Curve:
        return Curve(self.code, self.ramp)

    def columns(self, path: Path, theta: Array, places: Sequence[int]) -> Array:
        return shared_tangents(path, places)

    def friction(self, u: Array, theta: Array, shared: Array, s: Array) -> Array:
        p = unknowns.values(u[:PER_RUN])
        return np.asarray(magnitude(self.code, s, p.F, p.shape * p.F, p.shape))

    def values(self, theta: Array, u: Array) -> dict[str, float]:
        p = unknowns.values(u[:PER_RUN])
        by_name = {"Fs": p.F, "gamma": p.shape, "G_slip": p.shape * p.F}
        return {name: by_name[name] for name in self.law.curve.parameters}


class FreeCurve(FrictionCurve):
    """A free spline of ``knots`` (n + 1,), m/s, and ``coefficients`` (n + 3,), m/s^2, in `CurveCoordinates`."""

    def __init__(self, knots: Array, *, ramp: bool, coefficients: Array, offset: Array, shared: Array) -> None:
        self.spline, self.ramp, self.size = FrictionSpline.over(knots), ramp, coefficients.size
        self.basis = CurveCoordinates.around(coefficients, offset, shared)
        self.prior, self.precision = np.zeros(self.size), self.basis.precision
        self.lower, self.upper = np.full(self.size, -np.inf), np.full(self.size, np.inf)
        self.start = self.basis.unknowns(shared, coefficients)[shared.size :]

    def on_path(self, theta: Array, shared: Array) -> Curve | None:
        return spline_curve(self._at(theta, shared), self.ramp)

    def columns(self, path: Path, theta: Array, places: Sequence[int]) -> Array:
        derivatives = spline_tangents(path, self.basis.slopes)
        derivatives[:, : len(places)] += shared_tangents(path, places)
        return derivatives

    def friction(self, u: Array, theta: Array, shared: Array, s: Array) -> Array:
        return self._at(theta, shared)(s)

    def _at(self, theta: Array, shared: Array) -> FrictionSpline:
        return self.spline.with_coefficients(self.basis.coefficients(shared, theta))
