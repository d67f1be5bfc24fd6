"""Kernels: sums over each cycle's residuals, elimination of its own unknowns, eigenvalues, linear least squares.

BLAS and LAPACK add in a processor-dependent order, and the last bit of a sum can lead a search to another minimum.
These matrices are tiny: plain loops cost next to nothing and add in one order everywhere.  Every kernel runs as written
or compiled (`stickslip.compute.compile`).

Sources: G. Golub, C. Van Loan, Matrix Computations, 4th ed., 4.2 (Cholesky) and 8.5 (cyclic Jacobi); A. Bjorck,
Numerical Methods for Least Squares Problems, 2.4 (modified Gram-Schmidt, backward stable).
"""

import math

import numpy as np

from stickslip.compute.arrays import Array, Integers

LEAST_PIVOT = 1e-14  # least pivot over a unit diagonal, where rounding alone leaves about 1e-16 times the size
MOST_SWEEPS = 40  # sweeps of Jacobi rotations; matrices of 12 rows take 6 to 9
TINY = 1e-200  # least curvature: its inverse stays a number


def sum_products(jacobian: Array, residual: Array, first: Integers, square: Array, gradient: Array) -> None:
    """Add J'J to ``square`` (c, m, m) and J'r to ``gradient`` (c, m); ``first`` (c + 1,) are the cycles' first rows."""
    cycles, m = gradient.shape
    for k in range(cycles):
        for row in range(first[k], first[k + 1]):
            for i in range(m):
                slope = jacobian[row, i]
                gradient[k, i] += slope * residual[row]
                for j in range(i + 1):
                    square[k, i, j] += slope * jacobian[row, j]
        for i in range(m):
            for j in range(i):
                square[k, j, i] = square[k, i, j]


def sum_gradients(jacobian: Array, residual: Array, first: Integers, gradient: Array) -> None:
    """Add J'r to ``gradient`` (c, m), cycle by cycle."""
    cycles, m = gradient.shape
    for k in range(cycles):
        for row in range(first[k], first[k + 1]):
            for i in range(m):
                gradient[k, i] += jacobian[row, i] * residual[row]


def sum_cross(left: Array, right: Array, first: Integers, out: Array) -> None:
    """Add L'R to ``out`` (c, m, n), cycle by cycle; L (N, m), R (N, n)."""
    cycles, m, n = out.shape
    for k in range(cycles):
        for row in range(first[k], first[k + 1]):
            for i in range(m):
                slope = left[row, i]
                for j in range(n):
                    out[k, i, j] += slope * right[row, j]


def add_along(jacobian: Array, first: Integers, steps: Array, out: Array) -> None:
    """Add J steps to ``out`` (N, n); ``steps`` (c, m, n) are each cycle's own."""
    cycles, m, n = steps.shape
    for k in range(cycles):
        for row in range(first[k], first[k + 1]):
            for i in range(m):
                slope = jacobian[row, i]
                for j in range(n):
                    out[row, j] += slope * steps[k, i, j]


def along(jacobian: Array, first: Integers, step: Array, out: Array) -> None:
    """Store J step in ``out`` (N,); ``step`` (c, m) is each cycle's own."""
    cycles, m = step.shape
    for k in range(cycles):
        for row in range(first[k], first[k + 1]):
            total = 0.0
            for i in range(m):
                total += jacobian[row, i] * step[k, i]
            out[row] = total


def invert(matrices: Array, inverse: Array) -> None:
    """Store the inverses of positive definite matrices (c, q, q), of which only the lower triangle is read."""
    cycles, q, _ = matrices.shape
    for k in range(cycles):
        a = inverse[k]
        for i in range(q):
            for j in range(i + 1):
                size = math.sqrt(max(matrices[k, i, i], TINY)) * math.sqrt(max(matrices[k, j, j], TINY))
                a[i, j] = matrices[k, i, j] / size
        for j in range(q):
            for n in range(j):
                a[j, j] -= a[j, n] * a[j, n]
            a[j, j] = math.sqrt(max(a[j, j], LEAST_PIVOT))
            for i in range(j + 1, q):
                for n in range(j):
                    a[i, j] -= a[i, n] * a[j, n]
                a[i, j] /= a[j, j]
        # the inverse of the lower factor, in its place
        for j in range(q):
            a[j, j] = 1 / a[j, j]
            for i in range(j + 1, q):
                total = 0.0
                for n in range(j, i):
                    total -= a[i, n] * a[n, j]
                a[i, j] = total / a[i, i]
        for i in range(q):
            for j in range(i + 1):
                total = 0.0
                for n in range(i, q):
                    total += a[n, i] * a[n, j]
                size = math.sqrt(max(matrices[k, i, i], TINY)) * math.sqrt(max(matrices[k, j, j], TINY))
                a[j, i] = total / size  # above the factor, whose column j is still needed
        for i in range(q):
            for j in range(i):
                a[i, j] = a[j, i]


def eliminate(cross: Array, inverse: Array, reduced: Array, follow: Array) -> None:
    """Subtract cross inverse cross' from ``reduced`` (p, p), and fill ``follow`` (c, q, p) with inverse cross'."""
    cycles, p, q = cross.shape
    for k in range(cycles):
        for i in range(q):
            for j in range(p):
                total = 0.0
                for n in range(q):
                    total += inverse[k, i, n] * cross[k, j, n]
                follow[k, i, j] = total
        for i in range(p):
            for j in range(i + 1):
                for n in range(q):
                    reduced[i, j] -= cross[k, i, n] * follow[k, n, j]
    for i in range(p):
        for j in range(i):
            reduced[j, i] = reduced[i, j]


def eigen(matrix: Array, vectors: Array) -> None:
    """Diagonalise a symmetric ``matrix`` (n, n) in place, with the eigenvectors as columns of ``vectors``."""
    n = matrix.shape[0]
    vectors[:] = 0.0
    for i in range(n):
        vectors[i, i] = 1.0
    for _ in range(MOST_SWEEPS):
        off, size = 0.0, 0.0
        for i in range(n):
            size += matrix[i, i] * matrix[i, i]
            for j in range(i):
                off += matrix[i, j] * matrix[i, j]
        if off <= 1e-40 * size:
            return
        for i in range(n - 1):
            for j in range(i + 1, n):
                if matrix[i, j] == 0.0:
                    continue
                theta = (matrix[j, j] - matrix[i, i]) / (2 * matrix[i, j])
                t = math.copysign(1.0, theta) / (abs(theta) + math.hypot(1.0, theta))
                c = 1 / math.sqrt(1 + t * t)
                s = t * c
                for k in range(n):
                    left, right = matrix[k, i], matrix[k, j]
                    matrix[k, i], matrix[k, j] = c * left - s * right, s * left + c * right
                for k in range(n):
                    left, right = matrix[i, k], matrix[j, k]
                    matrix[i, k], matrix[j, k] = c * left - s * right, s * left + c * right
                matrix[i, j] = matrix[j, i] = 0.0
                for k in range(n):
                    left, right = vectors[k, i], vectors[k, j]
                    vectors[k, i], vectors[k, j] = c * left - s * right, s * left + c * right


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
