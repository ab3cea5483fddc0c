"""Products in machine code, against values at points."""

from __future__ import annotations

import numpy as np
import pytest

from flexhinf.hinf import products
from flexhinf.polynomial import algebra, basis

CASES = [(3, 2, 2, 4), (5, 3, 1, 2), (4, 1, 4, 3), (9, 3, 2, 5), (7, 1, 1, 1), (1, 2, 3, 2), (12, 2, 3, 14)]


@pytest.fixture(autouse=True)
def _machine_code(monkeypatch):
    monkeypatch.setattr(products, "LARGE", 0)


def _value(coefficients: np.ndarray, k: int, x: np.ndarray) -> np.ndarray:
    return algebra.evaluate({k: coefficients}, x)


@pytest.mark.parametrize("zeros", [0.0, 0.7, 1.0])
@pytest.mark.parametrize(("n", "a", "b", "c"), CASES)
def test_product(monkeypatch, n, a, b, c, zeros):
    monkeypatch.setattr(products, "_KEPT", 50)
    rng = np.random.default_rng(n)
    left, right = rng.standard_normal((basis.count(n, a), c)), rng.standard_normal((c, basis.count(n, b)))
    right[:, rng.random(right.shape[1]) < zeros] = 0.0
    x = rng.standard_normal((5, n))
    expected = (_value(left.T, a, x) * _value(right, b, x)).sum(axis=1)
    found = _value(products.product(left, right, n, a, b), a + b, x)
    assert found == pytest.approx(expected, rel=1e-11, abs=1e-11)


@pytest.mark.parametrize(("n", "a", "b", "c"), CASES)
def test_square(n, a, b, c):
    rng = np.random.default_rng(n)
    rows, signs = rng.standard_normal((basis.count(n, a), c)), rng.choice((-1.0, 1.0), c)
    x = rng.standard_normal((5, n))
    expected = 0.5 * (_value(rows.T, a, x) ** 2 * signs).sum(axis=1)
    assert _value(products.square(rows, signs, n, a), 2 * a, x) == pytest.approx(
        expected, rel=1e-11, abs=1e-11
    )


@pytest.mark.parametrize(("n", "k"), [(1, 3), (2, 2), (5, 4), (9, 3), (13, 2), (26, 3)])
def test_derivative_along_a_linear_field(n, k):
    rng = np.random.default_rng(n)
    entries, matrix = rng.standard_normal(basis.count(n, k)), rng.standard_normal((n, n))
    x = rng.standard_normal((5, n))
    slopes = _value(algebra.gradient(entries, n, k).T, k - 1, x)
    expected = (slopes * (x @ matrix.T)).sum(axis=1)
    found = _value(products.derivative(entries, matrix, n, k), k, x)
    assert found == pytest.approx(expected, rel=1e-11, abs=1e-11)


def test_two_threads_compute_the_same(monkeypatch):
    n, k = 11, 4
    rng = np.random.default_rng(0)
    entries, matrix = rng.standard_normal(basis.count(n, k)), rng.standard_normal((n, n))
    rows, signs = rng.standard_normal((basis.count(n, 2), 3)), np.ones(3)
    results = []
    for threads in "12":
        monkeypatch.setenv("OMP_NUM_THREADS", threads)
        several = products.product(rows, rows.T, n, 2, 2), products.square(rows, signs, n, 2)
        results.append((*several, products.derivative(entries, matrix, n, k)))
    assert all(np.array_equal(one, two) for one, two in zip(*results, strict=True))
