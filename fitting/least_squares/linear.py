"""Linear least squares without BLAS: LAPACK adds in another order on every processor, these sums in one everywhere.

Source: A. Bjorck, Numerical Methods for Least Squares Problems, 2.4 (modified Gram-Schmidt, backward stable).
"""

import numpy as np

from stickslip.compute.arrays import Array

DEPENDENT = 1e-13  # share of a column's length: as little left of it beside the columns before it is rounding


def least_squares(matrix: Array, target: Array) -> tuple[Array, Array]:
    """Return the least-squares x of matrix (n, m) x = target (n,), and the residual; dependent columns get 0."""
    columns = np.array(np.transpose(matrix), np.float64, order="C")
    residual = np.array(target, np.float64)
    size = np.sum(columns**2, axis=1)
    triangle, x = np.zeros((len(columns), len(columns))), np.zeros(len(columns))
    for i, column in enumerate(columns):
        square = np.sum(column**2)
        if square <= DEPENDENT**2 * size[i]:
            continue
        for j in range(i + 1, len(columns)):
            triangle[i, j] = np.sum(column * columns[j]) / square
            columns[j] -= triangle[i, j] * column
        x[i] = np.sum(column * residual) / square
        residual -= x[i] * column
    for i in reversed(range(len(columns))):
        x[i] -= np.sum(triangle[i, i + 1 :] * x[i + 1 :])
    return x, residual
