"""Least squares without BLAS says what LAPACK says, and leaves a column out that says nothing new."""

import numpy as np
import pytest

from fitting.least_squares.elimination import least_squares


def test_it_agrees_with_lapack():
    rng = np.random.default_rng(3)
    t = np.linspace(0, 3, 200)
    matrix, target = np.c_[np.ones(200), t, t**2, np.cos(9 * t)], rng.standard_normal(200)
    x, residual = least_squares(matrix, target)
    assert x == pytest.approx(np.linalg.lstsq(matrix, target, rcond=None)[0], rel=1e-10)
    assert residual == pytest.approx(target - matrix @ x, abs=1e-12)


def test_columns_of_very_different_length_are_no_trouble():
    t = np.linspace(100.0, 101.0, 50)
    x, residual = least_squares(np.c_[1e-9 * t, 1e9 * np.ones(50)], 3.0 * t - 7.0)
    assert x == pytest.approx([3e9, -7e-9], rel=1e-9)
    assert np.abs(residual).max() < 1e-9


def test_a_dependent_column_gets_nothing():
    t = np.linspace(0, 1, 20)
    x, residual = least_squares(np.c_[t, 2 * t, np.zeros(20), np.ones(20)], 1 + t)
    assert x == pytest.approx([1, 0, 0, 1])
    assert np.abs(residual).max() < 1e-12


def test_matrix_and_target_stay_as_they_are():
    matrix, target = np.ones((3, 1)), np.arange(3.0)
    least_squares(matrix, target)
    assert np.array_equal(matrix, np.ones((3, 1)))
    assert np.array_equal(target, np.arange(3.0))
