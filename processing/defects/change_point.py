"""Change points of a count: where the motion before and after does not fit together, and which change explains it.

Two parabolas, one on the samples before a place and one on those after, find the suspects.  Around each suspect models
of what may have happened (a step, a kink, a corner at each of many times) are fitted by least squares beside a smooth
polynomial, and their mean squares are compared: a generalised likelihood ratio test.
"""

from dataclasses import dataclass

import numpy as np

from daq.base.compute.arrays import Array

ROUNDED = 1 / 12  # counts^2: the mean square of rounding to whole counts; no model explains more
TINY = 1e-300  # a determinant of two changes outside the samples, whose coefficients are then 0
RIDGE = 1e-9  # of a column's own square: keeps pairs of nearly equal columns solvable, far below what a test compares


def jump_weights(side: int, width: int, derivative: int) -> Array:
    """Return the weights, (2 side + width - 1,), of a jump of the motion in the middle of so many samples.

    The jump is the parabola through the last ``side`` samples less the one through the first ``side``: its value
    (``derivative`` 0, counts) or its slope (1, counts per sample).
    """
    j = np.arange(2 * side + width - 1) - (side + (width - 2) / 2)
    weights = np.zeros(j.size)
    for own, sign in ((slice(0, side), -1.0), (slice(j.size - side, None), 1.0)):
        weights[own] = sign * np.linalg.pinv(np.vander(j[own], 3))[2 - derivative]
    return weights


@dataclass(frozen=True, eq=False)
class ChangeModels:
    """m models of a change, each a sum of k columns beside a smooth polynomial.

    Attributes
    ----------
    columns : array of shape (m, k, n)
        Less what the polynomial explains.
    inverse : array of shape (m, k, k)
        Of their normal equations.
    smooth : array of shape (n, d)
        Orthonormal basis of the polynomials.
    """

    columns: Array
    inverse: Array
    smooth: Array

    def fit(self, count: Array) -> tuple[Array, Array]:
        """Fit n counts, or b times as many, (n, b).

        Returns the coefficients, (m, k) or (m, k, b), and the mean squares left, counts^2, (m,) or (m, b), at least
        `ROUNDED`.
        """
        y = self._deviations(count)
        product = self.columns @ y
        solved = np.einsum("mij,mj...->mi...", self.inverse, product)
        squares = (_square(y) - np.einsum("mi...,mi...->m...", solved, product)) / len(y)
        return solved, np.maximum(squares, ROUNDED)

    def fit_beside(self, column: Array, count: Array) -> tuple[Array, Array]:
        """Fit each model of one column together with another ``column``, (n, b), to counts (n, b).

        Returns the coefficients of the other column, (m, b), and the mean squares left, (m, b), as `fit`.
        """
        other, y = self._deviations(column), self._deviations(count)
        columns = self.columns[:, 0]
        own = np.einsum("mn,mn->m", columns, columns)[:, None] * (1 + RIDGE)
        beside, square = columns @ other, _square(other) * (1 + RIDGE)
        shared = np.maximum(own * square - beside**2, TINY)
        product, wanted = columns @ y, np.einsum("n...,n...->...", other, y)
        size = (own * wanted - beside * product) / shared
        corner = (square * product - beside * wanted) / shared
        squares = (_square(y) - size * wanted - corner * product) / len(y)
        return size, np.maximum(squares, ROUNDED)

    def _deviations(self, count: Array) -> Array:
        """Return counts less what the polynomial explains of them."""
        return np.asarray(count - self.smooth @ (self.smooth.T @ count))


def _square(count: Array) -> Array:
    return np.asarray(np.einsum("n...,n...->...", count, count))


def change_models(columns: Array, times: Array, degree: int) -> ChangeModels:
    """Return the models with columns (m, k, n) beside polynomials of ``degree`` in ``times``, (n,)."""
    smooth = np.linalg.qr(np.vander(times, degree + 1))[0]
    columns = columns - (columns @ smooth) @ smooth.T
    square = columns @ columns.transpose(0, 2, 1)
    size = np.sqrt(np.einsum("mii->mi", square))
    size[size < 1e-6] = 1.0  # a change outside the samples
    scale = size[:, :, None] * size[:, None, :]
    return ChangeModels(columns, np.linalg.inv(square / scale + RIDGE * np.eye(size.shape[1])) / scale, smooth)
