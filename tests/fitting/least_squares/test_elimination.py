"""The kernels of the normal equations agree with LAPACK, interpreted as well as compiled."""

import numpy as np
import pytest

from fitting.least_squares import elimination
from stickslip.compute.compile import compiled

CYCLES, SAMPLES, SHARED, LOCAL = 3, 8, 4, 2


@pytest.fixture(params=[False, True], ids=["interpreted", "compiled"])
def kernel(request):
    """Give a function that returns a kernel as it runs."""
    return lambda function: compiled(function, (elimination.__name__,)) if request.param else function


@pytest.fixture
def rng():
    return np.random.default_rng(2)


def positive(rng, *shape):
    root = rng.standard_normal((*shape, shape[-1]))
    return root @ np.swapaxes(root, -1, -2)


def test_sums_run_over_each_cycle(kernel, rng):
    m = SHARED + LOCAL
    jacobian, residual = rng.standard_normal((CYCLES * SAMPLES, m)), rng.standard_normal(CYCLES * SAMPLES)
    first = np.arange(CYCLES + 1) * SAMPLES
    square, gradient, again = np.zeros((CYCLES, m, m)), np.zeros((CYCLES, m)), np.zeros((CYCLES, m))
    kernel(elimination.sum_products)(jacobian, residual, first, square, gradient)
    kernel(elimination.sum_gradients)(jacobian, residual, first, again)
    step, out = rng.standard_normal((CYCLES, m)), np.empty(CYCLES * SAMPLES)
    kernel(elimination.along)(jacobian, first, step, out)
    for k in range(CYCLES):
        J, r = jacobian[first[k] : first[k + 1]], residual[first[k] : first[k + 1]]
        assert square[k] == pytest.approx(J.T @ J)
        assert gradient[k] == pytest.approx(J.T @ r)
        assert out[first[k] : first[k + 1]] == pytest.approx(J @ step[k])
    assert np.array_equal(gradient, again)


def test_inverses_are_those_of_lapack_whatever_the_units(kernel, rng):
    matrices = positive(rng, 5, 6)
    units = 10.0 ** rng.uniform(-9, 9, (5, 6))
    matrices *= units[:, :, None] * units[:, None, :]
    inverse = np.empty_like(matrices)
    kernel(elimination.invert)(matrices, inverse)
    for matrix, found, unit in zip(matrices, inverse, units, strict=True):
        scaled = np.outer(1 / unit, 1 / unit)
        assert found / scaled == pytest.approx(np.linalg.inv(matrix * scaled), rel=1e-6, abs=1e-9)


def test_a_singular_matrix_has_a_finite_inverse(kernel):
    matrices, inverse = np.ones((2, 3, 3)), np.empty((2, 3, 3))
    matrices[1] = 0.0
    kernel(elimination.invert)(matrices, inverse)
    assert np.isfinite(inverse).all()


def test_elimination_is_the_schur_complement(kernel, rng):
    own, cross, H = positive(rng, CYCLES, LOCAL), rng.standard_normal((CYCLES, SHARED, LOCAL)), positive(rng, SHARED)
    reduced, follow = H.copy(), np.empty((CYCLES, LOCAL, SHARED))
    kernel(elimination.eliminate)(cross, np.linalg.inv(own), reduced, follow)
    expected = H - sum(c @ np.linalg.solve(o, c.T) for c, o in zip(cross, own, strict=True))
    assert reduced == pytest.approx(expected)
    assert follow == pytest.approx(np.linalg.solve(own, np.swapaxes(cross, 1, 2)))


@pytest.mark.parametrize("n", [1, 2, 7, 20])
def test_eigenvectors_turn_a_matrix_diagonal(kernel, rng, n):
    matrix = positive(rng, n)
    matrix *= np.outer(*2 * [10.0 ** rng.uniform(-3, 3, n)])
    turned, vectors = matrix.copy(), np.empty((n, n))
    kernel(elimination.eigen)(turned, vectors)
    size = np.diag(turned)
    assert np.sort(size) == pytest.approx(np.linalg.eigvalsh(matrix), rel=1e-9, abs=1e-13 * size.max())
    assert vectors.T @ vectors == pytest.approx(np.eye(n), abs=1e-13)
    assert matrix @ vectors == pytest.approx(vectors * size, abs=1e-12 * size.max())


def test_least_squares_agree_with_lapack():
    rng = np.random.default_rng(3)
    t = np.linspace(0, 3, 200)
    matrix, target = np.c_[np.ones(200), t, t**2, np.cos(9 * t)], rng.standard_normal(200)
    before = matrix.copy(), target.copy()
    x, residual = elimination.least_squares(matrix, target)
    assert np.array_equal(matrix, before[0])
    assert np.array_equal(target, before[1])
    assert x == pytest.approx(np.linalg.lstsq(matrix, target, rcond=None)[0], rel=1e-10)
    assert residual == pytest.approx(target - matrix @ x, abs=1e-12)


def test_columns_of_very_different_length_are_no_trouble():
    t = np.linspace(100.0, 101.0, 50)
    x, residual = elimination.least_squares(np.c_[1e-9 * t, 1e9 * np.ones(50)], 3.0 * t - 7.0)
    assert x == pytest.approx([3e9, -7e-9], rel=1e-9)
    assert np.abs(residual).max() < 1e-9


def test_a_dependent_column_of_least_squares_gets_nothing():
    t = np.linspace(0, 1, 20)
    x, residual = elimination.least_squares(np.c_[t, 2 * t, np.zeros(20), np.ones(20)], 1 + t)
    assert x == pytest.approx([1, 0, 0, 1])
    assert np.abs(residual).max() < 1e-12
