from __future__ import annotations

from itertools import permutations

import casadi as ca
import mpmath
import numpy as np
import pytest
import scipy.linalg
from hypothesis import given, strategies as st

from flexhinf.scalars import (
    Symbol,
    cholesky,
    coefficients,
    gram,
    householder,
    jets,
    residual,
    solve_lower,
    solve_lower_transposed,
    trace,
)


def positive_definite(n: int, seed: int) -> np.ndarray:
    root = np.random.default_rng(seed).normal(size=(n, n))
    return root @ root.T + 0.1 * np.eye(n)


def on_symbols(code, *arrays) -> np.ndarray:
    result = trace(code, *[a.shape for a in arrays])(*[a.ravel() for a in arrays])
    return np.asarray(result, dtype=float).ravel()


sizes_and_seeds = (st.integers(1, 7), st.integers(0, 2**32 - 1))


@pytest.mark.oracle
@given(*sizes_and_seeds)
def test_cholesky_is_scipys(n, seed):
    matrix = positive_definite(n, seed)
    factor = cholesky(matrix)
    assert factor.dtype == float
    np.testing.assert_allclose(factor, scipy.linalg.cholesky(matrix, lower=True), rtol=1e-9, atol=1e-12)
    np.testing.assert_array_equal(np.triu(factor, 1), 0)


@pytest.mark.oracle
@given(*sizes_and_seeds)
def test_triangular_solves_are_scipys(n, seed):
    rng = np.random.default_rng(seed)
    factor = np.tril(rng.normal(size=(n, n)), -1) + np.diag(rng.uniform(0.5, 2, n))
    for right in (rng.normal(size=n), rng.normal(size=(n, 3))):
        expected = scipy.linalg.solve_triangular(factor, right, lower=True)
        np.testing.assert_allclose(solve_lower(factor, right), expected, rtol=1e-9, atol=1e-9)
        expected = scipy.linalg.solve_triangular(factor, right, lower=True, trans="T")
        np.testing.assert_allclose(solve_lower_transposed(factor, right), expected, rtol=1e-9, atol=1e-9)


def test_solves_read_only_the_lower_triangle():
    factor = np.array([[2.0, 99.0], [1.0, 4.0]])
    np.testing.assert_allclose(solve_lower(factor, np.array([2.0, 5.0])), [1.0, 1.0])
    np.testing.assert_allclose(solve_lower_transposed(factor, np.array([3.0, 4.0])), [1.0, 1.0])


def test_known_states_give_zero_columns():
    matrix = np.zeros((3, 3))
    np.testing.assert_array_equal(cholesky(matrix), matrix)
    matrix[1, 1] = 4.0
    np.testing.assert_array_equal(cholesky(matrix), np.diag([0.0, 2.0, 0.0]))


def test_a_matrix_of_low_rank():
    columns = np.array([[1.0, 0.0], [2.0, 1.0], [3.0, -1.0], [4.0, 2.0]])
    matrix = columns @ columns.T
    factor = cholesky(matrix)
    np.testing.assert_allclose(factor @ factor.T, matrix, atol=1e-12)
    np.testing.assert_array_equal(factor[:, 2:], 0)


def of_low_rank(rng, n: int, rank: int) -> np.ndarray:
    """V Vᵀ, rows and columns of V scaled over decades."""
    root = rng.normal(size=(n, rank)) * 10.0 ** rng.uniform(-3, 3, rank)
    if rng.random() < 0.5:
        root = np.cumsum(root, axis=0)  # neighbours alike, as in a covariance of positions over time
    root *= 10.0 ** rng.uniform(-6, 6, (n, 1))
    return root @ root.T


@pytest.mark.parametrize("seed", range(4))
def test_every_product_of_low_rank_has_a_factor(seed):
    """Elimination leaves pivots a little below zero, whose rounding is not that of their diagonal entry."""
    rng = np.random.default_rng(seed)
    for n in (*range(2, 29), *range(2, 12), *range(2, 12)):
        for rank in (n - 1, rng.integers(0, n + 1)):
            matrix = of_low_rank(rng, n, rank)
            factor, size = cholesky(matrix), np.sqrt(np.diag(matrix))
            error = np.abs(factor @ factor.T - matrix)
            assert np.all(error <= 1e-6 * np.outer(size, size)), (n, rank)


def test_a_pivot_is_compared_with_the_rounding_of_what_was_subtracted():
    """The first two states are alike to 1e-6: their difference has 1e12 units of the last place of the third."""

    def matrix(below: float) -> np.ndarray:
        root = np.array([[1.0, 0.0], [1.0, 1e-6], [0.0, 1.0]])
        return root @ root.T - np.diag([0.0, 0.0, below])

    assert np.isfinite(cholesky(matrix(1e-4))).all()
    assert np.isnan(cholesky(matrix(0.5))).any()
    apart = np.array([[1.0, 0.5, 0.0], [0.5, 1.0, 0.0], [0.0, 0.0, -1e-9]])
    assert np.isnan(cholesky(apart)).any()  # nothing was subtracted there


def test_a_matrix_that_is_not_positive_gives_nan():
    assert np.isnan(cholesky(np.array([[1.0, 2.0], [2.0, 1.0]]))).any()
    assert np.isnan(cholesky(np.array([[-1.0]]))).all()


@pytest.mark.oracle
@pytest.mark.parametrize("n", [1, 3, 5])
def test_on_symbols_they_equal_the_floats(n):
    matrix = positive_definite(n, n)
    factor, right = cholesky(matrix), np.random.default_rng(n).normal(size=(n, 2))
    np.testing.assert_allclose(on_symbols(cholesky, matrix), factor.ravel(), rtol=1e-13)
    for solve in (solve_lower, solve_lower_transposed):
        np.testing.assert_allclose(on_symbols(solve, factor, right), solve(factor, right).ravel(), rtol=1e-12)
    np.testing.assert_array_equal(on_symbols(cholesky, np.zeros((n, n))), np.zeros(n * n))
    assert np.isnan(on_symbols(cholesky, -matrix)).any()


@pytest.mark.oracle
def test_solves_on_jets_invert_the_product():
    x = jets([0.5, -0.2], 4)
    factor = np.array([[2 + x[0], 0.0], [x[1], 1 + x[0] * x[1]]], dtype=object)
    right = np.array([np.sin(x[0]), x[1]])
    for code, matrix in ((solve_lower, factor), (solve_lower_transposed, factor.T)):
        again = matrix @ code(factor, right)
        np.testing.assert_allclose(coefficients(again, 2, 4), coefficients(right, 2, 4), atol=1e-14)


@pytest.mark.oracle
def test_gram_is_the_weighted_sum():
    rng = np.random.default_rng(0)
    columns, other, weights = rng.normal(size=(3, 7)), rng.normal(size=(2, 7)), rng.normal(size=7)
    expected = sum(w * np.outer(a, a) for w, a in zip(weights, columns.T, strict=True))
    result = gram(columns, weights)
    np.testing.assert_allclose(result, expected, rtol=1e-13)
    np.testing.assert_array_equal(result, result.T)
    expected = sum(w * np.outer(a, b) for w, a, b in zip(weights, columns.T, other.T, strict=True))
    np.testing.assert_allclose(gram(columns, weights, other), expected, rtol=1e-13)
    np.testing.assert_allclose(on_symbols(gram, columns, weights), result.ravel(), rtol=1e-13)


@pytest.mark.oracle
@pytest.mark.parametrize("order", list(permutations(range(4))))
def test_reflections_keep_the_digits_of_small_rows_in_any_order(order):
    """Rows of 1e-9 to 1e9; noise, in the last row, is all that is known of one direction."""
    table = np.array([[1e9, 2e9, 3e9], [1.0, -2.0, 0.5], [3e-9, 1e-9, 5e-9], [1e-3, 4e-3, -2e-3]])
    with mpmath.workdps(60):
        exact = mpmath.qr(mpmath.matrix(table.tolist()), mode="skinny")[1]
        expected = np.abs(np.array(exact.tolist(), dtype=float))
    found = householder(table[list(order)], 3)
    np.testing.assert_array_equal(np.tril(found, -1), 0.0)
    np.testing.assert_allclose(np.abs(found[:3]), expected, rtol=1e-13)


def test_reflections_and_residuals_on_symbols_equal_the_floats():
    rng = np.random.default_rng(3)
    table, rows, slope = rng.normal(size=(5, 3)), rng.normal(size=(2, 7)), rng.normal(size=(2, 3))
    reflected = on_symbols(lambda t: householder(t, 2), table)
    np.testing.assert_allclose(reflected, householder(table, 2).ravel(), atol=1e-14)
    np.testing.assert_allclose(on_symbols(residual, rows, slope), residual(rows, slope).ravel(), atol=1e-14)


def test_rows_that_are_zero_in_a_column_whatever_comes_are_not_compared() -> None:
    """The exported C of a root has no choice that never comes, and the numbers are those of rows of floats."""
    rng = np.random.default_rng(3)
    numbers = np.vstack([rng.standard_normal((2, 2)), np.triu(rng.standard_normal((2, 2)))])
    numbers[3, 0] = 0.0
    names = ca.SX.sym("t", 4, 2)

    def reduced(zero: bool) -> ca.Function:
        table = np.array([[Symbol(names[i, j]) for j in range(2)] for i in range(4)], dtype=object)
        if zero:
            table[3, 0] = 0
        rows = [one.sx if isinstance(one, Symbol) else ca.SX(one) for one in householder(table, 1).ravel()]
        return ca.Function("f", [names], [ca.vertcat(*rows)])

    short, whole = reduced(True), reduced(False)
    expected = householder(numbers, 1).ravel()
    for one in (short, whole):
        np.testing.assert_allclose(one(numbers).full().ravel(), expected, rtol=1e-12, atol=1e-14)
    assert short.n_instructions() < 0.9 * whole.n_instructions()


def test_the_first_row_may_be_zero_whatever_comes() -> None:
    name = ca.SX.sym("t")
    table = np.array([[0.0, Symbol(name)], [Symbol(name), Symbol(name)], [0.0, Symbol(name)]], dtype=object)
    rows = [one.sx if isinstance(one, Symbol) else ca.SX(one) for one in householder(table, 1).ravel()]
    found = ca.Function("f", [name], [ca.vertcat(*rows)])(2.0).full().ravel()
    np.testing.assert_allclose(
        found, householder(2.0 * np.array([[0, 1], [1, 1], [0, 1]]), 1).ravel(), rtol=1e-12
    )
