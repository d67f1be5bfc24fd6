"""The friction of a fit: one of the six laws, or a curve followed through a spline.

A curve has ``size`` parameters theta, with bounds and priors; ``beside`` are the shared unknowns fitted with it.  It
gives the friction along a path and the derivatives of the positions.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence

import numpy as np

from fitting.driver.coordinates import CurveCoordinates
from fitting.law import Law
from fitting.model import parameters
from fitting.model.parameters import PER_RUN
from fitting.sensitivity.columns import shared_tangents, spline_tangents
from fitting.sensitivity.path import Curve, Path, law_curve, spline_curve
from fitting.sensitivity.spline import FrictionSpline
from fitting.undetermined import Undetermined
from rig_sim.friction.curve import magnitude
from stickslip.compute.arrays import Array


class FrictionCurve(ABC):
    law: Law | None = None  # none of a free curve
    free: tuple[str, ...] = ()  # the names of theta
    together: tuple[Undetermined, ...] = ()  # parameters that a formula has only together
    kind = ""  # "constant", "linear", "hyperbolic" of the six that their own kernels follow
    ramp: bool  # whether slip begins beyond a ramp of half-width d, a shared unknown
    size: int  # how many numbers theta it has
    # (size,) of theta: where a fit starts, means and 1/sd^2 of the priors (0 where nothing is known), bounds
    start: Array
    prior: Array
    precision: Array
    lower: Array
    upper: Array

    @abstractmethod
    def on_path(self, theta: Array, beside: Array) -> Curve | None:
        """Return the curve of a path; None where theta gives no friction."""

    @abstractmethod
    def columns(self, path: Path, theta: Array, places: Sequence[int]) -> Array:
        """Return the position derivatives (N, p + size) by the shared unknowns at ``places`` (p,), then by theta."""

    @abstractmethod
    def friction(self, u: Array, theta: Array, beside: Array, s: Array) -> Array:
        """Return friction per unit mass (m/s^2) at slip speeds s (k,); ``u`` are the unknowns of all runs."""

    def values(self, theta: Array, u: Array) -> dict[str, float]:
        """Return the law's parameters by name, per unit mass; none of a free curve."""
        return {}

    def is_ramp_of(self, other: "FrictionCurve") -> bool:
        """Return whether this is the other curve with a ramp, and so contains it."""
        return self.law is not None and other.law is not None and self.law.is_ramp_of(other.law)

    def contains(self, other: "FrictionCurve") -> bool:
        """Return whether the other curve is a limit of this one."""
        return self.law is not None and other.law is not None and self.law.contains(other.law)


class LawCurve(FrictionCurve):
    """One of the six laws: its parameters are the shared unknowns LOG_F and SHAPE; theta is empty."""

    law: Law
    size = 0

    def __init__(self, law: Law) -> None:
        self.law, self.ramp, self.kind, self.code = law, law.ramp, law.kind.curve, law.kind.curve_code
        self.start = self.prior = self.precision = self.lower = self.upper = np.empty(0)

    def on_path(self, theta: Array, beside: Array) -> Curve:
        return law_curve(self.code, self.ramp)

    def columns(self, path: Path, theta: Array, places: Sequence[int]) -> Array:
        return shared_tangents(path, places)

    def friction(self, u: Array, theta: Array, beside: Array, s: Array) -> Array:
        p = parameters.values(u[:PER_RUN])
        return np.asarray(magnitude(self.code, s, p.F, p.shape * p.F, p.shape))

    def values(self, theta: Array, u: Array) -> dict[str, float]:
        p = parameters.values(u[:PER_RUN])
        found = {"Fs": p.F, "gamma": p.shape, "G_slip": p.shape * p.F}
        return {name: found[name] for name in self.law.curve.parameters}


class FreeCurve(FrictionCurve):
    """A free spline of ``knots`` (n + 1,), m/s, and ``coefficients`` (n + 3,), m/s^2; theta are `CurveCoordinates`.

    The whole curve moves by ``offset`` (p,) with the unknowns ``beside`` (p,).
    """

    def __init__(self, knots: Array, *, ramp: bool, coefficients: Array, offset: Array, beside: Array) -> None:
        self.spline, self.ramp, self.size = FrictionSpline.over(knots), ramp, coefficients.size
        self.basis = CurveCoordinates.around(coefficients, offset, beside)
        self.prior, self.precision = np.zeros(self.size), self.basis.precision
        self.lower, self.upper = np.full(self.size, -np.inf), np.full(self.size, np.inf)
        self.start = self.basis.unknowns(beside, coefficients)[beside.size :]

    def on_path(self, theta: Array, beside: Array) -> Curve | None:
        return spline_curve(self.spline.with_coefficients(self.coefficients(theta, beside)[0]), self.ramp)

    def columns(self, path: Path, theta: Array, places: Sequence[int]) -> Array:
        found = spline_tangents(path, self.coefficients(theta, path.u[list(places)])[1])
        found[:, : len(places)] += shared_tangents(path, places)
        return found

    def friction(self, u: Array, theta: Array, beside: Array, s: Array) -> Array:
        return self.spline.with_coefficients(self.coefficients(theta, beside)[0])(s)

    def coefficients(self, theta: Array, beside: Array) -> tuple[Array, Array]:
        """Return the spline's coefficients (n,), m/s^2, and their derivatives (n, beside + size)."""
        return self.basis.coefficients(np.concatenate([beside, theta])), self.basis.slopes
