"""p(Mz) as a polynomial in z, against evaluation at Mz."""

from __future__ import annotations

import numpy as np
import pytest

from flexhinf.hinf import contraction, homological as transform
from flexhinf.polynomial import algebra, algebra as threads, basis


@pytest.mark.quick_cases(11)
@pytest.mark.parametrize("way", ["at once", "in tiles", "machine code"])
@pytest.mark.parametrize("kind", [float, complex])
@pytest.mark.parametrize(
    ("n", "k"), [(1, 3), (2, 5), (5, 4), (8, 5), (9, 3), (11, 6), (13, 2), (23, 3), (26, 4)]
)
def test_change_of_variables(monkeypatch, way, kind, n, k):
    monkeypatch.setattr(transform, "_SMALL", 10**9 if way == "at once" else 0)
    monkeypatch.setattr(threads, "_TILE_PRODUCTS", 10**9 if way == "at once" else 700)
    monkeypatch.setattr(transform, "_WORTH", 0 if way == "machine code" else 10**9)
    monkeypatch.setattr(transform, "_TILE_BYTES", 5_000)
    monkeypatch.setattr(contraction, "_ROWS", 5)
    rng = np.random.default_rng(n * 10 + k)
    entries, matrix = rng.standard_normal(basis.count(n, k)), rng.standard_normal((n, n)).astype(kind)
    if kind is complex:
        matrix += 1j * rng.standard_normal((n, n))
    multiplicity = basis.multiplicity(n, k)
    z = rng.standard_normal((4, n))
    moved = algebra.monomials(z, [k])[k] @ (transform.change_variables(entries, n, k, matrix) * multiplicity)
    expected = algebra.monomials(z @ matrix.T, [k])[k] @ (entries * multiplicity)
    assert moved == pytest.approx(expected, rel=1e-11)


def test_inverse_brings_it_back():
    n, k = 6, 4
    rng = np.random.default_rng(0)
    entries, matrix = rng.standard_normal(basis.count(n, k)), rng.standard_normal((n, n)) + 6 * np.eye(n)
    there = transform.change_variables(entries, n, k, matrix)
    assert transform.change_variables(there, n, k, np.linalg.inv(matrix)) == pytest.approx(
        entries, rel=1e-10, abs=1e-11
    )
