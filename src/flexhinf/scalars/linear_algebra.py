"""Small dense linear algebra on any element (``np.linalg`` takes floats only).

Loops over indices, so meant for matrices of the size of a state vector. The results on floats are plain
floats; a matrix that is not positive semidefinite gives NaN, which the callers turn into an error or a
status: a kernel cannot raise.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from flexhinf.scalars.piecewise import where

#: A pivot this small, times n, relative to what it is made of is zero: the matrix is singular to rounding.
PIVOT_TOLERANCE = 1e-14


def _empty_like(*arrays: Any) -> np.ndarray:
    dtype = object if any(np.asarray(a).dtype == object for a in arrays) else float
    return np.zeros(np.shape(arrays[0]), dtype=dtype)


def gram(columns: np.ndarray, weights: Any, other: np.ndarray | None = None) -> np.ndarray:
    """Σ wᵢ aᵢ bᵢᵀ over columns; exactly symmetric when `other` is not given.

    Parameters
    ----------
    columns, other : ndarray, (n, s), (m, s)
        Columns aᵢ and bᵢ (bᵢ = aᵢ by default).
    weights : ndarray, (s,)
    """
    weighted = columns * weights
    if other is not None:
        return weighted @ other.T
    n = len(columns)
    result = np.zeros((n, n), dtype=weighted.dtype)
    for i in range(n):
        for j in range(i + 1):
            result[i, j] = result[j, i] = weighted[i] @ columns[j]
    return result


def cholesky(matrix: np.ndarray) -> np.ndarray:
    """Lower L with L Lᵀ = matrix, for a positive semidefinite matrix (n, n).

    A pivot that is zero to rounding gives a zero column, so exactly known states (P = 0) are allowed; a
    negative one gives NaN.

    A pivot is what elimination leaves of a_jj: vᵀ A v with v = (−w, 1), w = A_j⁻¹ a_j. Rounding moves it by some units
    of the last place of Σᵢ vᵢ² aᵢᵢ, which may be many times a_jj where the entries before it are nearly singular. That
    sum is carried along: it grows by (l_ij / l_jj)² of its value at j with each column j. A pivot below zero is
    compared with it, one above zero with a_jj.
    """
    n = len(matrix)
    factor = _empty_like(matrix)
    moved = [abs(matrix[j, j]) for j in range(n)]
    for j in range(n):
        pivot = matrix[j, j] - factor[j, :j] @ factor[j, :j]
        small = pivot <= abs(matrix[j, j]) * (PIVOT_TOLERANCE * n)
        singular = small & (pivot >= moved[j] * (-PIVOT_TOLERANCE * n))
        with np.errstate(divide="ignore", invalid="ignore"):
            root = np.sqrt(pivot)
            inverse = where(singular, 0.0, 1.0 / root)
        factor[j, j] = where(singular, 0.0, root)
        for i in range(j + 1, n):
            factor[i, j] = (matrix[i, j] - factor[i, :j] @ factor[j, :j]) * inverse
            ratio = factor[i, j] * inverse
            moved[i] = moved[i] + ratio * ratio * moved[j]
    return factor


def solve_lower(factor: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solve L X = B for lower-triangular L (n, n) and B (n,) or (n, k)."""
    solution = _empty_like(right, factor)
    for i in range(len(factor)):
        solution[i] = (right[i] - factor[i, :i] @ solution[:i]) / factor[i, i]
    return solution


def solve_lower_transposed(factor: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solve Lᵀ X = B for lower-triangular L (n, n) and B (n,) or (n, k)."""
    solution = _empty_like(right, factor)
    for i in reversed(range(len(factor))):
        solution[i] = (right[i] - factor[i + 1 :, i] @ solution[i + 1 :]) / factor[i, i]
    return solution
