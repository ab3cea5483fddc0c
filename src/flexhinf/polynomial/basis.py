"""The basis of homogeneous polynomials in compressed symmetric storage.

A homogeneous polynomial of degree k in n variables is a vector with one number per *sorted* index tuple
(i1 ≤ … ≤ ik), in lexicographic order of the tuples: C(n+k−1, k) numbers instead of the n^k of a Kronecker
vector. Everything above works on two tables of this file: the rank of a tuple after one index is inserted
(gradients, products) and the multiplicity of a tuple (symmetric tensor entry times multiplicity = coefficient
of the monomial).

All tables are built by slices of the table one degree below, cached, and read-only.

Translation from and to Kronecker coefficients: C (x ⊗ … ⊗ x), n^k columns for what C(n+k−1, k) monomials need.

Column (i1, …, ik), the first index slowest, multiplies x_i1 … x_ik; all orderings of one tuple are one
monomial. That is the form of PPR, NLbalancing and QQR [corbin2024].
"""

# Not checked strictly: parts of SciPy, CasADi and NumPy have no types.
# pyright: reportUnknownArgumentType=false

from __future__ import annotations

from functools import lru_cache
from math import comb
from typing import Any, cast

import numpy as np

from flexhinf.errors import InvalidInput
from flexhinf.validation import read_only, real_array

_CACHED = 256


def count(n: int, k: int) -> int:
    """Number of monomials of degree exactly `k` in `n` variables, C(n+k−1, k); `count(n, 0)` is 1."""
    return comb(n + k - 1, k)


@lru_cache(_CACHED)
def offsets(n: int, k: int) -> np.ndarray:
    """First rank of the tuples that begin with each index, (n + 1,); the last entry is `count(n, k)`.

    Tuples with all indices ≥ j are exactly the ranks `offsets(n, k)[j]` and above. For k = 0 the first n entries are 0.
    """
    counts = [count(n - j, k - 1) for j in range(n)] if k else [0] * (n - 1) + [1]
    return read_only(np.cumsum([0, *counts]))


@lru_cache(_CACHED)
def factors(n: int, k: int) -> tuple[np.ndarray, np.ndarray]:
    """First index of every tuple of degree k ≥ 1, and the rank of the rest of it among those of degree k − 1."""
    start, first = offsets(n, k - 1), offsets(n, k)
    variable = np.repeat(np.arange(n), np.diff(first))
    others = cast("np.ndarray", np.arange(first[-1]) - (first[:-1] - start[:-1])[variable])
    return read_only(variable), read_only(others)


@lru_cache(_CACHED)
def indices(n: int, k: int) -> np.ndarray:
    """Sorted index tuples of degree `k`, in lexicographic order, int16 (count(n, k), k)."""
    table = np.empty((count(n, k), k), np.int16)
    if k:
        tails, start, first = indices(n, k - 1), offsets(n, k - 1), offsets(n, k)
        for j in range(n):
            block = table[first[j] : first[j + 1]]
            block[:, 0] = j
            block[:, 1:] = tails[start[j] :]
    return read_only(table)


@lru_cache(_CACHED)
def exponents(n: int, k: int) -> np.ndarray:
    """Exponent vector of each monomial of degree `k`, in the order of `indices`, int16 (count(n, k), n)."""
    table, rows = np.zeros((count(n, k), n), np.int16), np.arange(count(n, k))
    for column in indices(n, k).T:
        table[rows, column] += 1
    return read_only(table)


@lru_cache(_CACHED)
def insertion(n: int, k: int) -> np.ndarray:
    """Rank, among the tuples of degree `k`, of the tuple β of degree k−1 (row) with the index j (column) inserted.

    If j comes before the first index i of β the new tuple begins with j and its tail is β; otherwise it still begins
    with i, and j is inserted into the tail, which is the table one degree below. int32 (count(n, k−1), n).
    """
    if k < 1:
        raise ValueError(f"insertion needs degree k >= 1, got {k}")
    table = np.empty((count(n, k - 1), n), np.int32)
    shift = offsets(n, k)[:n] - offsets(n, k - 1)[:n]
    if k == 1:
        table[0] = np.arange(n)
        return read_only(table)
    below, first, start = insertion(n, k - 1), offsets(n, k - 1), offsets(n, k - 2)
    for i in range(n):
        rows = np.arange(int(first[i]), int(first[i + 1]))
        table[rows[0] : rows[-1] + 1, : i + 1] = rows[:, None] + shift[: i + 1]
        table[rows[0] : rows[-1] + 1, i + 1 :] = below[start[i] :, i + 1 :] + shift[i]
    return read_only(table)


@lru_cache(4)
def insertion_columns(n: int, k: int) -> np.ndarray:
    """The columns of `insertion`, each contiguous: int32 (n, count(n, k−1))."""
    return read_only(np.ascontiguousarray(insertion(n, k).T))


@lru_cache(_CACHED)
def removal(n: int, k: int) -> np.ndarray:
    """Rank, among the tuples of degree k−1, of the tuple α of degree `k` without its index at each position.

    Without its first index a tuple is its tail; otherwise the first index stays and the tail loses one. int32 (count(n,
    k), k).
    """
    table = np.zeros((count(n, k), k), np.int32)
    if k > 1:
        below, first, higher, start = removal(n, k - 1), offsets(n, k), offsets(n, k - 1), offsets(n, k - 2)
        for i in range(n):
            block = table[first[i] : first[i + 1]]
            block[:, 0] = np.arange(higher[i], higher[n])
            block[:, 1:] = below[higher[i] :] + (higher[i] - start[i])
    return read_only(table)


@lru_cache(_CACHED)
def multiplicity(n: int, k: int) -> np.ndarray:
    """Number of distinct orderings of each tuple: the multinomial k! / ∏ αᵢ!, float64 (count(n, k),)."""
    tuples = indices(n, k)
    orderings, run = np.ones((2, len(tuples)))
    for j in range(1, k):
        run = np.where(tuples[:, j] == tuples[:, j - 1], run + 1, 1)
        orderings *= (j + 1) / run
    return read_only(np.rint(orderings))


@lru_cache(32)
def _binomials(size: int) -> np.ndarray:
    most = 2**63 - 1  # what is larger is not looked up where the rank itself fits
    return read_only(
        np.array([[min(comb(a, b), most) for b in range(size)] for a in range(size)], dtype=np.int64)
    )


def rank(n: int, tuples: np.ndarray) -> np.ndarray:
    """Rank, int64 (N,), of sorted index tuples (N, k): each row ascending, entries in 0 … n−1."""
    tuples = np.asarray(tuples, dtype=np.int64)
    k = tuples.shape[1]
    table = _binomials(n + k + 1)
    # how many tuples come later, counted at the first differing place
    later = (table[n - 1 - tuples[:, j] + k - j - 1, k - j] for j in range(k))
    return count(n, k) - 1 - sum(later, np.zeros(len(tuples), np.int64))


@lru_cache(64)
def merge(n: int, a: int, b: int) -> np.ndarray:
    """Rank of the union of tuples of degrees `a` and `b`: where a product of monomials goes.

    int32 (count(n, a), count(n, b)).
    """
    table = np.arange(count(n, a), dtype=np.int32)[:, None]
    for degree in range(1, b + 1):
        insert, start = insertion(n, a + degree), offsets(n, degree - 1)
        table = np.concatenate([insert[table[:, start[j] :], j] for j in range(n)], axis=1)
    return read_only(table)


def from_kronecker(coefficients: Any, n: int, k: int) -> np.ndarray:
    """Monomial coefficients (rows, count(n, k)) of C (x ⊗ … ⊗ x), C (rows, n^k), array_like or SciPy sparse.

    C need not be symmetric, orderings are added up.
    """
    matrix: Any = coefficients if hasattr(coefficients, "tocoo") else real_array(coefficients)
    if len(matrix.shape) != 2 or matrix.shape[1] != n**k:
        raise InvalidInput(
            f"The Kronecker coefficients of degree {k} do not fit {n} variables.",
            f"expected shape (rows, {n}^{k} = {n**k}), got {tuple(matrix.shape)}",
            "one column per product x_i1 … x_ik, the first index slowest",
        )
    rows: np.ndarray
    columns: np.ndarray
    if hasattr(matrix, "tocoo"):
        entries: Any = matrix.tocoo()
        rows, columns, numbers = entries.row, entries.col, entries.data
    else:
        rows, columns = np.nonzero(matrix)
        numbers = matrix[rows, columns]
    result = np.zeros((matrix.shape[0], count(n, k)))
    np.add.at(result, (rows, _ranks(columns, n, k)), numbers)
    return result


def to_kronecker(part: np.ndarray, n: int, k: int) -> np.ndarray:
    """The symmetric C (…, n^k) with C (x ⊗ … ⊗ x) equal to a polynomial of monomial coefficients (…, count(n, k))."""
    return (part / multiplicity(n, k))[..., _ranks(np.arange(n**k), n, k)]


def _ranks(columns: np.ndarray, n: int, k: int) -> np.ndarray:
    tuples = np.stack(np.unravel_index(columns, (n,) * k), axis=1) if k else np.zeros((len(columns), 0), int)
    return rank(n, np.sort(tuples, axis=1))
