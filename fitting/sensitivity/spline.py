"""A friction curve as a cubic B-spline of the slip speed: its knots, its pieces as polynomials, its basis."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fitting.least_squares.normal_equations import scaled_inverse
from rig_sim.friction.spline import piece_of
from stickslip.compute.arrays import Array
from stickslip.compute.compile import compiled

DEGREE = 3  # degree of the pieces: slopes and curvatures are continuous


@dataclass(frozen=True, eq=False)
class FrictionSpline:
    knots: Array  # (n + 1,) slip speeds from 0, m/s, increasing
    # (n + 3,) friction per unit mass, m/s^2; the first is that at s = 0, the last that at the last knot
    coefficients: Array
    # (n + 3, n, 4) each basis function's polynomials: powers from 0 of the distance to the knot below
    basis_pieces: Array

    @classmethod
    def over(cls, knots: Array, coefficients: Array | None = None) -> "FrictionSpline":
        """Return a spline over knots (n + 1,), with coefficients (n + 3,) 0 unless given."""
        found = np.zeros(knots.size + DEGREE - 1) if coefficients is None else coefficients
        return cls(knots, found, _basis_pieces(knots))

    def with_coefficients(self, coefficients: Array) -> "FrictionSpline":
        return FrictionSpline(self.knots, coefficients, self.basis_pieces)

    def nearest(self, s: Array, values: Array) -> "FrictionSpline":
        """Return the least-squares spline with the same knots for values (k,) at speeds s (k,).

        Every piece holds at least four of the speeds, and none lies outside the knots.
        """
        found = np.zeros(self.coefficients.size)
        fit = compiled(fill_nearest, ("rig_sim.friction.spline", __name__), _nrt=False)
        fit(self.knots, self.basis_pieces, s, values, np.zeros((found.size, DEGREE + 1)), np.empty(DEGREE + 1), found)
        return self.with_coefficients(found)

    @cached_property
    def pieces(self) -> Array:
        """The spline's polynomials, shape (n, 4), as in `basis_pieces`."""
        return np.ascontiguousarray(np.einsum("j,jik->ik", self.coefficients, self.basis_pieces))

    @cached_property
    def table(self) -> Array:
        """The spline as kernels read it (`rig_sim.friction.spline`), without its last two numbers, shape (5 n + 5,)."""
        c0, c1, c2, c3 = self.pieces[-1]
        z = self.knots[-1] - self.knots[-2]
        line = c0 + z * (c1 + z * (c2 + z * c3)), c1 + z * (2.0 * c2 + z * 3.0 * c3), 0.0, 0.0
        return np.concatenate((self.knots, self.pieces.ravel(), line))

    def basis(self, s: Array) -> Array:
        """Return the basis functions at slip speeds s (k,), shape (k, n + 3)."""
        return np.ascontiguousarray(self.basis_along(s, np.eye(self.coefficients.size)).T)

    def basis_along(self, s: Array, directions: Array, factor: Array | float = 1.0) -> Array:
        """Return the basis at slip speeds s (k,) along directions (n + 3, m) times ``factor`` (k,), shape (m, k).

        Continued with a constant slope beyond the last knot; below 0 by the first polynomial.
        """
        found = np.zeros((directions.shape[1], s.size))
        fill = compiled(fill_basis, ("rig_sim.friction.spline", __name__), _nrt=False)
        each = np.broadcast_to(factor, s.shape).copy()
        fill(self.knots, self.basis_pieces, np.ascontiguousarray(s), each, np.ascontiguousarray(directions), found)
        return found

    def projection(self, s: Array) -> Array:
        """Return the matrix (n + 3, k) from values at speeds s (k,) to the coefficients of the nearest spline."""
        basis = self.basis(s)
        square = np.einsum("ki,kj->ij", basis, basis)
        scale, inverse = scaled_inverse(square, np.diag(square))
        return np.asarray(np.einsum("ij,kj->ik", inverse * scale[:, None] * scale, basis))

    def __call__(self, s: Array) -> Array:
        """Return friction per unit mass (m/s^2) at slip speeds s (k,), m/s."""
        return np.asarray(self.basis_along(np.asarray(s, float), self.coefficients[:, None])[0])


def _basis_pieces(knots: Array) -> Array:
    """Return the polynomials (n + 3, n, 4) of the basis functions over knots (n + 1,), as `basis_pieces`.

    By the recurrence of C. de Boor, A Practical Guide to Splines (2001), X, on all pieces at once.
    """
    t = np.concatenate(([knots[0]] * DEGREE, knots, [knots[-1]] * DEGREE))
    n = knots.size - 1
    piece = np.arange(n)
    # those of the four functions that act on a piece, in powers of s - t_i with i = piece + 3; the last one is 0 here
    found = np.zeros((DEGREE + 2, n, DEGREE + 1))
    found[DEGREE, :, 0] = 1.0
    below = t[piece + DEGREE]
    for k in range(1, DEGREE + 1):
        for row in range(DEGREE - k, DEGREE + 1):
            j = piece + row
            total = np.zeros((n, DEGREE + 1))
            if row > DEGREE - k:
                rise = (below - t[j])[:, None] * found[row] + np.roll(found[row], 1, axis=1)
                total += rise / (t[j + k] - t[j])[:, None]
            if row < DEGREE:
                fall = (t[j + k + 1] - below)[:, None] * found[row + 1] - np.roll(found[row + 1], 1, axis=1)
                total += fall / (t[j + k + 1] - t[j + 1])[:, None]
            found[row] = total
    pieces = np.zeros((n + DEGREE, n, DEGREE + 1))
    for row in range(DEGREE + 1):
        pieces[piece + row, piece] = found[row]
    return pieces


def fill_basis(knots: Array, pieces: Array, s: Array, factor: Array, directions: Array, out: Array) -> None:
    """Add ``factor`` (k,) times the basis at s (k,) along directions (n + 3, m) to ``out`` (m, k); a kernel."""
    last = knots[knots.size - 1]
    for column in range(s.size):
        if factor[column] == 0.0:
            continue
        i = piece_of(knots, knots.size - 1, s[column])
        beyond = max(s[column] - last, 0.0)
        z = s[column] - beyond - knots[i]
        for j in range(i, i + DEGREE + 1):  # the others are 0 on this piece
            c = pieces[j, i]
            rate = c[1] + z * (2.0 * c[2] + z * 3.0 * c[3])
            acting = factor[column] * (c[0] + z * (c[1] + z * (c[2] + z * c[3])) + beyond * rate)
            for m in range(out.shape[0]):
                out[m, column] += acting * directions[j, m]


def fill_nearest(
    knots: Array, pieces: Array, s: Array, values: Array, band: Array, acting: Array, coefficients: Array
) -> None:
    """Store the coefficients (n + 3,) of the spline nearest to values (k,) at speeds s (k,); a kernel.

    By normal equations with a band of four, as good as an orthogonal factorisation to 1e-13 where each piece holds
    several speeds. ``band`` (n + 3, 4) and ``coefficients`` are 0 at first, ``acting`` (4,) is scratch. Source: G.
    Golub, C. Van Loan, Matrix Computations, 4th ed., 4.3.5 (band Cholesky).
    """
    n = coefficients.size
    for row in range(s.size):
        i = piece_of(knots, knots.size - 1, s[row])
        z = s[row] - knots[i]
        for p in range(DEGREE + 1):
            c = pieces[i + p, i]
            acting[p] = c[0] + z * (c[1] + z * (c[2] + z * c[3]))
            coefficients[i + p] += acting[p] * values[row]
            for q in range(p + 1):
                band[i + p, p - q] += acting[p] * acting[q]
    for j in range(n):
        for i in range(j, min(j + DEGREE + 1, n)):
            for m in range(max(0, i - DEGREE), j):
                band[i, i - j] -= band[i, i - m] * band[j, j - m]
            if i == j:
                band[j, 0] = math.sqrt(band[j, 0])
            else:
                band[i, i - j] /= band[j, 0]
    for i in range(n):
        for m in range(max(0, i - DEGREE), i):
            coefficients[i] -= band[i, i - m] * coefficients[m]
        coefficients[i] /= band[i, 0]
    for i in range(n - 1, -1, -1):
        for m in range(i + 1, min(i + DEGREE + 1, n)):
            coefficients[i] -= band[m, m - i] * coefficients[m]
        coefficients[i] /= band[i, 0]
