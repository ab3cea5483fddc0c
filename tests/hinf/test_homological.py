"""The homological equation: dense twin, and residuals where eigenvectors fail."""

from __future__ import annotations

import numpy as np
import pytest

from flexhinf.hinf.homological import Coordinates, HomologicalEquation
from flexhinf.polynomial import basis


def _kronecker_operator(matrix: np.ndarray, k: int) -> np.ndarray:
    """Σ_i I ⊗ … ⊗ Aᵀ ⊗ … ⊗ I on full tensors."""
    n, total = len(matrix), 0
    for position in range(k):
        factors = [np.eye(n)] * k
        factors[position] = matrix.T
        term = np.eye(1)
        for factor in factors:
            term = np.kron(term, factor)
        total = total + term
    return np.asarray(total)


@pytest.mark.oracle
@pytest.mark.parametrize(("n", "k"), [(1, 3), (2, 5), (3, 4), (5, 3)])
@pytest.mark.parametrize(("condition", "route"), [(1.0, "eigenbasis"), (np.inf, "Schur")])
def test_both_routes_equal_a_dense_kronecker_solve(n, k, condition, route, monkeypatch):
    monkeypatch.setattr(Coordinates, "condition", condition)
    rng = np.random.default_rng(n)
    matrix = rng.standard_normal((n, n)) / np.sqrt(n) - 2 * np.eye(n)
    known = rng.standard_normal(basis.count(n, k))
    full = np.sort(np.indices((n,) * k).reshape(k, -1).T, axis=1)
    ranks = basis.rank(n, full)
    dense = np.linalg.solve(_kronecker_operator(matrix, k), -known[ranks])
    solution = HomologicalEquation(matrix).solve(known, k)
    assert solution.method.startswith(route)
    assert solution.entries[ranks] == pytest.approx(dense, rel=1e-10, abs=1e-11)


def _near_defective(n: int, gap: float, rng: np.random.Generator) -> np.ndarray:
    """Pairs of modes −j with coupling 1 one way and −gap² the other, seen through a random rotation."""
    matrix = -np.diag(1.0 + np.arange(n) // 2)
    for i in range(0, n - 1, 2):
        matrix[i, i + 1], matrix[i + 1, i] = 1.0, -(gap**2)
    rotation = np.linalg.qr(rng.standard_normal((n, n)))[0]
    return rotation @ matrix @ rotation.T


@pytest.mark.parametrize("gap", [1.0, 1e-2, 1e-4, 1e-6, 0.0])
@pytest.mark.parametrize(("n", "k"), [(4, 3), (6, 5), (8, 4)])
def test_residual_of_near_defective_loops(n, k, gap):
    rng = np.random.default_rng(3)
    matrix = _near_defective(n, gap, rng)
    known = rng.standard_normal(basis.count(n, k))
    equation = HomologicalEquation(matrix)
    solution = equation.solve(known, k)
    left = equation.residual(solution.entries, known, k)
    size = np.linalg.norm(matrix, 2) * np.linalg.norm(solution.entries) + np.linalg.norm(known)
    assert np.linalg.norm(left) / size == pytest.approx(solution.residual, rel=1e-6)
    assert solution.residual <= 1e-13
    if gap in (0.0, 1e-6, 1.0):
        assert solution.method.startswith("eigenbasis" if gap == 1.0 else "Schur")


@pytest.mark.oracle
def test_reported_residual_is_that_of_the_dense_operator():
    n, k = 3, 3
    rng = np.random.default_rng(1)
    matrix, entries = rng.standard_normal((n, n)), rng.standard_normal(basis.count(n, k))
    full = np.sort(np.indices((n,) * k).reshape(k, -1).T, axis=1)
    ranks = basis.rank(n, full)
    dense = _kronecker_operator(matrix, k) @ entries[ranks]
    assert HomologicalEquation(matrix).residual(entries, 0 * entries, k)[ranks] == pytest.approx(
        dense, rel=1e-12
    )
