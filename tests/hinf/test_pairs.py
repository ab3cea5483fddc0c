"""Division by sums of eigenvalues in one pass: the same as in complex eigenvectors."""

from __future__ import annotations

import numpy as np
import pytest

from flexhinf.hinf import homological, pairs
from flexhinf.hinf.homological import HomologicalEquation, change_variables, diagonal_sums
from flexhinf.polynomial import basis


def _eigenvalues(n: int, number: int, rng: np.random.Generator) -> np.ndarray:
    upper = -0.1 - rng.random(number) + 1j * rng.random(number)
    return np.concatenate(
        [np.stack([upper, upper.conj()], axis=1).ravel(), -0.1 - rng.random(n - 2 * number)]
    )


CASES = [
    (2, 2, 1),
    (3, 3, 1),
    (5, 4, 2),
    (4, 6, 0),
    (7, 4, 3),
    (12, 3, 5),
    (20, 2, 10),
    (5, 9, 2),
    (3, 20, 1),
]


@pytest.mark.parametrize(("n", "k", "number"), CASES)
def test_one_pass_is_there_division_and_back(monkeypatch, n, k, number):
    monkeypatch.setattr(pairs, "_BLOCKS", 16)
    rng = np.random.default_rng(n + k)
    eigenvalues, given = _eigenvalues(n, number, rng), rng.standard_normal(basis.count(n, k))
    mixed = np.eye(n, dtype=complex)
    for i in range(0, 2 * number, 2):
        mixed[i : i + 2, i : i + 2] = homological._PAIR
    there = change_variables(given.astype(complex), n, k, mixed)
    expected = change_variables(there / -diagonal_sums(np.diag(eigenvalues), k), n, k, mixed.conj().T)
    results = []
    for threads in "12":
        monkeypatch.setenv("OMP_NUM_THREADS", threads)
        monkeypatch.setattr(pairs, "_LARGE", 0)
        found = given.copy()
        pairs.divide_by_sums(found, eigenvalues, homological._powers(k), k)
        results.append(found)
    scale = np.abs(expected).max()
    assert np.abs(results[0] - expected).max() < 1e-13 * k * scale
    assert np.array_equal(*results)


@pytest.mark.parametrize(("n", "k"), [(6, 5), (9, 4)])
def test_machine_code_solves_the_equation(monkeypatch, n, k):
    rng = np.random.default_rng(n)
    equation = HomologicalEquation(rng.standard_normal((n, n)) - 3 * np.sqrt(n) * np.eye(n))
    known = rng.standard_normal(basis.count(n, k))
    expected = equation.solve(known, k)
    monkeypatch.setattr(homological, "_WORTH", 0)
    found = equation.solve(known, k)
    assert found.method.startswith("eigenbasis")
    assert found.residual < 1e-14
    assert found.entries == pytest.approx(expected.entries, rel=1e-11, abs=1e-13)
