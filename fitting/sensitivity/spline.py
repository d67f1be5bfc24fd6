"""A friction curve as a cubic B-spline of the slip speed: its knots, its pieces as polynomials, its basis."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from daq.compute.arrays import Array

DEGREE = 3


@dataclass(frozen=True, eq=False)
class FrictionSpline:
    """A cubic B-spline, clamped at its ends.

    Attributes
    ----------
    knots : (n + 1,) f8
        Slip speeds from 0, m/s, increasing.
    coefficients : (n + 3,) f8
        Friction per unit mass, m/s^2; the first is that at s = 0, the last that at the last knot.
    """

    knots: Array
    coefficients: Array

    @property
    def clamped(self) -> Array:
        """The knots with the first and the last repeated, as scipy wants them."""
        return np.concatenate(([self.knots[0]] * DEGREE, self.knots, [self.knots[-1]] * DEGREE))

    @cached_property
    def basis_pieces(self) -> Array:
        """Each basis function's polynomials, shape (n + 3, n, 4): powers from 0 of the distance to the knot below."""
        from scipy.interpolate import PPoly

        count, n = self.knots.size + DEGREE - 1, self.knots.size - 1
        found = np.zeros((count, n, DEGREE + 1))
        for j in range(count):
            unit = np.zeros(count)
            unit[j] = 1.0
            pieces = PPoly.from_spline((self.clamped, unit, DEGREE))
            found[j] = pieces.c[::-1, DEGREE : DEGREE + n].T
        return found

    @cached_property
    def pieces(self) -> Array:
        """The spline's polynomials, shape (n, 4), as in `basis_pieces`."""
        return np.ascontiguousarray(np.einsum("j,jik->ik", self.coefficients, self.basis_pieces))

    def basis(self, s: Array) -> Array:
        """Return the basis functions at slip speeds s (k,), shape (k, n + 3), continued as the kernels continue them.

        Beyond the last knot the slope is constant; below 0 the first polynomial goes on.
        """
        inside = np.minimum(s, self.knots[-1])
        i = np.clip(np.searchsorted(self.knots, inside, side="right") - 1, 0, self.knots.size - 2)
        z = inside - self.knots[i]
        c = self.basis_pieces
        # only four functions are not 0 on a piece: those numbered from it
        four = i[:, None] + np.arange(DEGREE + 1)
        own = c[four, i[:, None]]
        values = own[..., 0] + z[:, None] * (own[..., 1] + z[:, None] * (own[..., 2] + z[:, None] * own[..., 3]))
        rates = own[..., 1] + z[:, None] * (2 * own[..., 2] + 3 * z[:, None] * own[..., 3])
        found = np.zeros((s.size, c.shape[0]))
        np.put_along_axis(found, four, values + (s - inside)[:, None] * rates, axis=1)
        return found

    def __call__(self, s: Array) -> Array:
        """Return friction per unit mass (m/s^2) at slip speeds s (k,), m/s."""
        return np.asarray(self.basis(np.asarray(s, float)) @ self.coefficients)
