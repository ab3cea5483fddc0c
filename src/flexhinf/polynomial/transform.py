"""Linear change of variables in a homogeneous polynomial, in compressed symmetric storage.

One index of the symmetric tensor is transformed at a time. In between, the tensor is symmetric in the k−s old
indices and symmetric in the s new ones: a matrix of count(n, k−s) rows and count(n, s) columns. A step opens
one old index by the insertion table, contracts it with the matrix and keeps the results whose new index comes
first in the sorted tuple: dense matrix products on arrays that never exceed count(n, k/2)² numbers.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise

import numpy as np

from flexhinf.polynomial import basis

__all__ = ["change_variables"]

_SMALL = 20_000  # opened tensors up to this size go through one product and one selection
_CHUNK_BYTES = 2_000_000


def change_variables(entries: np.ndarray, n: int, k: int, matrix: np.ndarray) -> np.ndarray:
    """Tensor entries of p(M z) as a polynomial in z, for p homogeneous of degree `k`.

    Parameters
    ----------
    entries : ndarray, shape (count(n, k),)
        Tensor entries of p, real or complex.
    matrix : ndarray, shape (n, n)
        M, real or complex.

    Returns
    -------
    ndarray, shape (count(n, k),)
    """
    dtype = np.result_type(entries, matrix)
    tensor = np.ascontiguousarray(entries, dtype).reshape(-1, 1)
    matrix = np.ascontiguousarray(matrix, dtype)
    for s in range(k):
        opening = basis.insertion(n, k - s)
        if opening.size * tensor.shape[1] <= _SMALL:
            opened = matrix.T @ tensor[opening]
            tensor = opened.reshape(len(opening), -1)[:, _sorted_pairs(n, s)]
        else:
            tensor = _contract_one_index(tensor, opening, n, s, matrix)
    return tensor.reshape(-1)


@lru_cache(64)
def _sorted_pairs(n: int, s: int) -> np.ndarray:
    """Positions, in an (n, count(n, s)) array, of the pairs (j, tail) with j ≤ the first index of tail."""
    start, width = basis.offsets(n, s), basis.count(n, s)
    return np.concatenate([j * width + np.arange(start[j], width) for j in range(n)])


def _contract_one_index(
    tensor: np.ndarray, opening: np.ndarray, n: int, s: int, matrix: np.ndarray
) -> np.ndarray:
    width = basis.count(n, s)
    result = np.empty((len(opening), basis.count(n, s + 1)), tensor.dtype)
    step = max(1, _CHUNK_BYTES // (n * width * tensor.itemsize))
    for begin in range(0, len(opening), step):
        rows = opening[begin : begin + step]
        _contract_rows(tensor[rows], n, s, matrix, result[begin : begin + step])
    return result


def _contract_rows(opened: np.ndarray, n: int, s: int, matrix: np.ndarray, result: np.ndarray) -> None:
    """Contract axis 1 of `opened` (rows, n, count(n, s)); blocks of new indices skip most of the unsorted."""
    if s == 0:
        np.matmul(opened[:, :, 0], matrix, out=result)
        return
    start, first = basis.offsets(n, s), basis.offsets(n, s + 1)
    blocks = min(n, 6)
    edges = [(block * n) // blocks for block in range(blocks + 1)]
    for low, high in pairwise(edges):
        contracted = np.matmul(matrix[:, low:high].T, opened[:, :, start[low] :])
        for j in range(low, high):
            result[:, first[j] : first[j + 1]] = contracted[:, j - low, start[j] - start[low] :]
