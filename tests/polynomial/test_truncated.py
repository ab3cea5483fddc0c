from __future__ import annotations

import itertools
from collections import defaultdict

import numpy as np
import pytest
from hypothesis import given, strategies as st

from flexhinf.polynomial import basis, truncated
from flexhinf.polynomial.truncated import add, compose, degree_slice, multiply, size, space

SPACES = [(1, 0), (1, 6), (2, 5), (3, 4), (6, 3), (9, 2)]


def exponents_of(n: int, degree: int) -> list[tuple[int, ...]]:
    """All monomials of the space in its order, from the basis of each degree."""
    return [tuple(row) for k in range(degree + 1) for row in basis.exponents(n, k).tolist()]


def as_dictionary(home, support, values) -> dict[tuple[int, ...], float]:
    names = exponents_of(home.n, home.degree)
    return {names[i]: v for i, v in zip(support.monomials, values, strict=True)}


def schoolbook(a: dict, b: dict, degree: int) -> dict[tuple[int, ...], float]:
    """Product of {exponents: coefficient} by its definition."""
    result = defaultdict(float)
    for (e, x), (f, y) in itertools.product(a.items(), b.items()):
        together = tuple(i + j for i, j in zip(e, f, strict=True))
        if sum(together) <= degree:
            result[together] += x * y
    return dict(result)


def assert_same(a: dict, b: dict, tolerance: float = 1e-13) -> None:
    for key in a.keys() | b.keys():
        assert a.get(key, 0.0) == pytest.approx(b.get(key, 0.0), rel=tolerance, abs=tolerance)


@st.composite
def polynomials(draw, count: int):
    """Some sparse polynomials of one space."""
    n, degree = draw(st.sampled_from(SPACES))
    home = space(n, degree)
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    drawn = []
    for _ in range(count):
        density = draw(st.sampled_from([0.0, 0.1, 0.5, 1.0]))
        support = home.support(np.flatnonzero(rng.random(home.size) < density))
        drawn.append((support, rng.integers(-9, 10, len(support.monomials)).astype(float)))
    return home, drawn


def test_size_counts_the_monomials():
    for n, degree in SPACES:
        assert size(n, degree) == len(exponents_of(n, degree)) == space(n, degree).size
    assert size(4, -1) == 0


def test_degree_slice_selects_exactly_one_degree():
    names = exponents_of(3, 4)
    for k in range(5):
        assert {sum(e) for e in names[degree_slice(3, k)]} == {k}
        assert len(names[degree_slice(3, k)]) == basis.count(3, k)


def test_equal_spaces_and_supports_are_one_object():
    assert space(3, 4) is space(3, 4)
    home = space(3, 4)
    assert home.support(np.array([0, 5])) is home.support(np.array([0, 5], dtype=np.int32))
    assert home.support(np.array([0, 5])) is not home.support(np.array([0, 6]))


def test_a_space_stays_the_same_while_a_polynomial_of_it_lives():
    kept = space(2, 3).constant
    for n in range(40, 70):  # more than the cache of spaces holds
        space(n, 1)
    assert space(2, 3) is kept.space


@pytest.mark.property
@given(polynomials(2))
def test_product_is_the_schoolbook_product(drawn):
    home, ((a, x), (b, y)) = drawn
    expected = schoolbook(as_dictionary(home, a, x), as_dictionary(home, b, y), home.degree)
    assert as_dictionary(home, *multiply(a, x, b, y)) == expected  # integers: no rounding


@pytest.mark.property
@given(polynomials(2))
def test_sum_is_the_sum_by_monomial(drawn):
    home, ((a, x), (b, y)) = drawn
    left, right = as_dictionary(home, a, x), as_dictionary(home, b, y)
    expected = {key: left.get(key, 0.0) + right.get(key, 0.0) for key in left.keys() | right.keys()}
    assert as_dictionary(home, *add(a, x, b, y)) == expected


@pytest.mark.property
@given(polynomials(3))
def test_products_associate_and_distribute_after_truncation(drawn):
    home, (a, b, c) = drawn
    assert_same(
        as_dictionary(home, *multiply(*multiply(*a, *b), *c)),
        as_dictionary(home, *multiply(*a, *multiply(*b, *c))),
    )
    assert_same(
        as_dictionary(home, *multiply(*a, *add(*b, *c))),
        as_dictionary(home, *add(*multiply(*a, *b), *multiply(*a, *c))),
    )


@pytest.mark.property
@given(polynomials(1), st.lists(st.integers(-3, 3), min_size=7, max_size=7))
def test_composition_is_the_sum_of_powers(drawn, series):
    home, [(support, values)] = drawn
    if support.has_constant:
        support, values = home.support(support.monomials[1:]), values[1:]
    inner = as_dictionary(home, support, values)
    power, expected = {(0,) * home.n: 1.0}, defaultdict(float)
    for coefficient in series[: home.degree + 1]:
        for key, value in power.items():
            expected[key] += coefficient * value
        power = schoolbook(power, inner, home.degree)
    result = as_dictionary(home, *compose([float(c) for c in series], support, values))
    assert_same(result, dict(expected))
    assert all(value != 0.0 for value in result.values())  # exact zeros are dropped


def test_forgetting_changes_no_result(monkeypatch):
    home = space(4, 4)
    rng = np.random.default_rng(0)
    x = rng.normal(size=home.size)
    full = home.support(np.arange(home.size))
    inner = home.support(np.arange(1, home.size))
    series = [1.0, -1.0, 0.5, 2.0, -3.0]
    before = multiply(full, x, full, x), compose(series, inner, x[1:])
    monkeypatch.setattr(truncated, "CACHED_PAIRS", 10)
    home.count_cached(11)
    after = multiply(full, x, full, x), compose(series, inner, x[1:])
    for (a, u), (b, v) in zip(before, after, strict=True):
        assert a is b
        np.testing.assert_array_equal(u, v)
