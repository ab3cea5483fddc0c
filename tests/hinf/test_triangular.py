"""Substitution in Schur coordinates against the equation evaluated at points."""

from __future__ import annotations

import numpy as np
import pytest

from flexhinf.hinf import homological
from flexhinf.polynomial import algebra, basis


@pytest.mark.oracle
@pytest.mark.parametrize("chunk", [3, 100_000])
@pytest.mark.parametrize(("n", "k"), [(1, 3), (2, 4), (4, 3), (5, 4)])
def test_gradient_along_the_flow_is_the_right_side(monkeypatch, chunk, n, k):
    """V_z T z = r at random complex points, V from the substitution."""
    monkeypatch.setattr(homological, "_CHUNK", chunk)
    rng = np.random.default_rng(n + 10 * k)
    flow = np.triu(rng.standard_normal((n, n)) + 1j * rng.standard_normal((n, n))) - 3 * np.eye(n)
    known = rng.standard_normal(basis.count(n, k)) + 1j * rng.standard_normal(basis.count(n, k))
    slopes = algebra.gradient(homological.substitute(flow, known, k), n, k)
    z = rng.standard_normal((6, n)) + 1j * rng.standard_normal((6, n))
    powers = algebra.monomials(z, [k - 1, k])
    left = ((powers[k - 1] @ slopes) * (z @ flow.T)).sum(1)
    assert left == pytest.approx(powers[k] @ (known * basis.multiplicity(n, k)), rel=1e-11)


def test_defective_block_needs_no_eigenvectors():
    """One Jordan block of size 4: the substitution is exact where a division is not defined."""
    n, k = 4, 3
    flow = -np.eye(n) + np.eye(n, k=1)
    rng = np.random.default_rng(0)
    expected = rng.integers(-9, 10, basis.count(n, k)).astype(float)
    slopes = algebra.gradient(expected, n, k)
    known = np.zeros(basis.count(n, k))
    table = basis.insertion(n, k)
    np.add.at(known, table.ravel(), (slopes @ flow).ravel())
    found = homological.substitute(flow, known / basis.multiplicity(n, k), k)
    assert found == pytest.approx(expected, rel=1e-13, abs=1e-13)


def test_sums_of_the_diagonal():
    diagonal = np.diag([1.0, 10.0, 100.0])
    assert homological.diagonal_sums(diagonal, 2).tolist() == [2, 11, 101, 20, 110, 200]
