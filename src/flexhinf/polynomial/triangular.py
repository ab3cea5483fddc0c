"""Substitution for V_z(z) T z = r(z) with T upper triangular: Schur coordinates of the homological equation.

z_j ∂V/∂z_i with j > i moves an index i of a tuple up to j, so the sum of the indices orders the equations:
all tuples of one sum depend only on tuples of smaller sums and are solved together.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise

import numpy as np

from flexhinf.polynomial import basis

__all__ = ["diagonal_sums", "substitute"]

_CHUNK = 100_000


def substitute(triangular: np.ndarray, known: np.ndarray, k: int) -> np.ndarray:
    """Tensor entries of V with V_z T z = r.

    Parameters
    ----------
    triangular : ndarray, shape (n, n)
        T, upper triangular; no sum of k diagonal entries vanishes.
    known : ndarray, shape (count(n, k),)
        Tensor entries of r.

    Returns
    -------
    ndarray, shape (count(n, k),)

    Notes
    -----
    In tensor entries, k times the symmetrised equation reads
    Σ_m ( T[i_m, i_m] v[i] + Σ_{j < i_m} v[i with i_m replaced by j] T[j, i_m] ) = r[i].
    """
    n = len(triangular)
    tuples, table, removal = basis.indices(n, k), basis.insertion(n, k), basis.removal(n, k)
    order, cuts = _levels(n, k)
    above = np.ascontiguousarray(np.triu(triangular, 1).T)
    pivots = diagonal_sums(triangular, k)
    solution = np.zeros(len(tuples), np.result_type(triangular, known))
    for low, high in pairwise(cuts):
        for begin in range(low, high, _CHUNK):
            level = order[begin : min(begin + _CHUNK, high)]
            moved = known[level].astype(solution.dtype)
            for position in range(k):
                replaced = solution[table[removal[level, position]]]
                moved -= np.einsum("aj,aj->a", replaced, above[tuples[level, position]])
            solution[level] = moved / pivots[level]
    return solution


def diagonal_sums(matrix: np.ndarray, k: int) -> np.ndarray:
    """Sum of the `k` diagonal entries each tuple points at, shape (count(n, k),)."""
    diagonal, tuples = np.diag(matrix), basis.indices(len(matrix), k)
    total = np.zeros(len(tuples), matrix.dtype)
    for position in range(k):
        total += diagonal[tuples[:, position]]
    return total


@lru_cache(32)
def _levels(n: int, k: int) -> tuple[np.ndarray, np.ndarray]:
    """Tuples ordered by the sum of their indices, and where each sum begins."""
    sums = basis.indices(n, k).sum(axis=1, dtype=np.int32)
    order = np.argsort(sums, kind="stable").astype(np.int32)
    return order, np.searchsorted(sums[order], np.arange(k * (n - 1) + 2))
