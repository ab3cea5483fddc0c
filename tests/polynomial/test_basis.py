"""The tables of the symmetric basis against plain enumeration."""

from itertools import combinations_with_replacement
from math import factorial, prod

import numpy as np
import pytest

from flexhinf.polynomial import basis

SIZES = [(1, 1), (1, 5), (2, 3), (3, 1), (3, 4), (5, 2), (5, 5), (7, 3)]


@pytest.mark.parametrize(("n", "k"), [*SIZES, (3, 0)])
def test_tuples_are_the_sorted_ones_in_lexicographic_order(n, k):
    expected = list(combinations_with_replacement(range(n), k))
    assert [tuple(row) for row in basis.indices(n, k)] == expected
    assert basis.count(n, k) == len(expected)
    assert np.array_equal(basis.rank(n, basis.indices(n, k)), np.arange(len(expected)))


@pytest.mark.parametrize(("n", "k"), SIZES)
def test_exponents_and_multiplicity(n, k):
    exponents = basis.exponents(n, k)
    for row, index_tuple, orderings in zip(
        exponents, basis.indices(n, k), basis.multiplicity(n, k), strict=True
    ):
        assert list(row) == [list(index_tuple).count(i) for i in range(n)]
        assert orderings == factorial(k) // prod(factorial(int(a)) for a in row)
    assert basis.multiplicity(n, k).sum() == n**k


@pytest.mark.parametrize(("n", "k"), SIZES)
def test_insertion_is_the_rank_of_the_longer_tuple(n, k):
    table = basis.insertion(n, k)
    assert table.shape == (basis.count(n, k - 1), n)
    for beta, row in zip(basis.indices(n, k - 1), table, strict=True):
        expected = basis.rank(n, np.array([sorted([*beta, j]) for j in range(n)]))
        assert np.array_equal(row, expected)


@pytest.mark.parametrize(("n", "a", "b"), [(2, 3, 2), (4, 2, 3), (3, 1, 1), (5, 3, 0), (3, 0, 2)])
def test_merge_is_the_rank_of_the_union(n, a, b):
    table = basis.merge(n, a, b)
    left, right = basis.indices(n, a), basis.indices(n, b)
    expected = [basis.rank(n, np.array([sorted([*p, *q]) for q in right])) for p in left]
    assert np.array_equal(table, expected)


def test_tables_are_read_only():
    with pytest.raises(ValueError, match="read-only"):
        basis.insertion(3, 2)[0, 0] = 1


def test_insertion_refuses_degree_zero():
    with pytest.raises(ValueError, match="k >= 1, got 0"):
        basis.insertion(3, 0)


@pytest.mark.parametrize(("n", "k"), SIZES)
def test_removal_is_the_rank_of_the_shorter_tuple(n, k):
    tuples, table = basis.indices(n, k), basis.removal(n, k)
    for position in range(k):
        assert np.array_equal(table[:, position], basis.rank(n, np.delete(tuples, position, axis=1)))
