"""Eigenvector and Schur coordinates, with complex pairs kept apart or joined in."""

from __future__ import annotations

import numpy as np
import pytest

from flexhinf.hinf import homological as coordinates
from flexhinf.hinf.homological import HomologicalEquation
from flexhinf.polynomial import algebra, basis


@pytest.mark.parametrize("apart", [True, False])
@pytest.mark.parametrize("which", ["eigenbasis", "schur_basis"])
@pytest.mark.parametrize(("n", "k"), [(1, 2), (2, 3), (5, 4), (8, 3)])
def test_polynomial_goes_in_and_comes_back(monkeypatch, apart, which, n, k):
    monkeypatch.setattr(coordinates, "_SMALL", 0 if apart else 10**9)
    rng = np.random.default_rng(n + 10 * k)
    matrix = rng.standard_normal((n, n))
    if n == 5:
        matrix[:2, 2:] = matrix[2:, :2] = 0
        matrix[:2, :2] = [[-1, 2], [-2, -1]]
    place = getattr(HomologicalEquation(matrix), which)
    full = place.real @ place._pairs()
    assert full @ place.flow == pytest.approx(matrix @ full, abs=1e-12)
    assert np.array_equal(place.flow, np.triu(place.flow))
    entries, multiplicity = rng.standard_normal(basis.count(n, k)), basis.multiplicity(n, k)
    inside = place.enter(entries, k)
    z = rng.standard_normal((3, n)) + 1j * rng.standard_normal((3, n))
    values = algebra.monomials(z, [k])[k] @ (inside * multiplicity)
    assert values == pytest.approx(
        algebra.monomials(z @ full.T, [k])[k] @ (entries * multiplicity), rel=1e-10
    )
    assert place.leave(inside, k) == pytest.approx(entries, rel=1e-9, abs=1e-10)


def test_condition_is_that_of_normalised_eigenvectors():
    matrix = np.array([[-1.0, 1.0], [0.0, -1.0 - 1e-6]])
    _, vectors = np.linalg.eig(matrix)
    assert HomologicalEquation(matrix).eigenbasis.condition == pytest.approx(
        np.linalg.cond(vectors), rel=1e-6
    )
    assert HomologicalEquation(np.array([[0.0, 1.0], [0.0, 0.0]])).eigenbasis.condition > 1e15
