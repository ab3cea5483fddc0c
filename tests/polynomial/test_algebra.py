"""Values, gradients and products against point evaluation of plain monomials."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from flexhinf.polynomial import algebra, basis


def _plain(coefficients: np.ndarray, n: int, k: int, x: np.ndarray) -> np.ndarray:
    return np.array([coefficients @ np.prod(point ** basis.exponents(n, k), axis=1) for point in x])


@pytest.mark.parametrize("n", [1, 3, 6])
def test_monomials_and_values(n):
    rng = np.random.default_rng(n)
    x = rng.standard_normal((4, n))
    parts = {k: rng.standard_normal((2, basis.count(n, k))) for k in (0, 1, 3, 4)}
    expected = sum(np.stack([_plain(row, n, k, x) for row in part], axis=1) for k, part in parts.items())
    assert algebra.evaluate(parts, x) == pytest.approx(expected, rel=1e-12)


def test_monomials_take_any_element_type():
    x = np.array([[Fraction(1, 2), Fraction(1, 3)]], dtype=object)
    assert algebra.monomials(x, [3])[3][0].tolist() == [
        Fraction(1, 8),
        Fraction(1, 12),
        Fraction(1, 18),
        Fraction(1, 27),
    ]


@pytest.mark.parametrize(("n", "k"), [(1, 4), (2, 2), (4, 3), (5, 5)])
def test_gradient_is_the_derivative(n, k):
    rng = np.random.default_rng(k)
    coefficients = rng.standard_normal(basis.count(n, k))
    slopes = algebra.gradient(coefficients / basis.multiplicity(n, k), n, k)
    x = rng.standard_normal((3, n)).astype(complex)
    for j in range(n):
        shifted = x + 1e-30j * np.eye(n)[j]  # complex step: exact to rounding
        exact = _plain(coefficients, n, k, shifted).imag / 1e-30
        assert algebra.evaluate({k - 1: slopes[:, j]}, x.real) == pytest.approx(exact, rel=1e-11)


@pytest.mark.parametrize("cached", [True, False])
@pytest.mark.parametrize(("n", "a", "b", "c"), [(1, 2, 3, 1), (3, 2, 2, 4), (5, 3, 1, 2), (4, 1, 4, 3)])
def test_product_with_and_without_a_kept_table(monkeypatch, cached, n, a, b, c):
    if not cached:
        monkeypatch.setattr(algebra, "_CACHED_TABLE", 0)
        monkeypatch.setattr(algebra, "_ROWS", 2)
    rng = np.random.default_rng(a)
    left, right = rng.standard_normal((basis.count(n, a), c)), rng.standard_normal((c, basis.count(n, b)))
    right[:, rng.random(right.shape[1]) < 0.5] = 0
    x = rng.standard_normal((5, n))
    expected = sum(_plain(left[:, i], n, a, x) * _plain(right[i], n, b, x) for i in range(c))
    total = algebra.product(left, right, n, a, b)
    assert algebra.evaluate({a + b: total}, x) == pytest.approx(expected, rel=1e-11, abs=1e-12)


@pytest.mark.parametrize("n", [1, 3, 7])
def test_monomials_of_few_points_are_those_among_many(n):
    x = np.random.default_rng(n).standard_normal((200, n))
    many, few = (algebra.monomials(points, [0, 1, 2, 5]) for points in (x, x[:3]))
    for k, values in few.items():
        np.testing.assert_array_equal(values, many[k][:3])
