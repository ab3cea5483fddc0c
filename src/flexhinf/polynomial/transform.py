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
from flexhinf.polynomial.threads import run_all, tile_products

_SMALL = 20_000  # opened tensors up to this size go through one product and one selection
_TILE_BYTES = 2_000_000
_LARGE = 2_000_000  # opened tensors from this size on are worth a second thread


class Workspace:
    """Two buffers that the steps write to in turn, kept from one change of variables to the next.

    Memory that is fresh from the system costs several times the arithmetic done on it.
    """

    def __init__(self) -> None:
        self._buffers = [np.empty(0), np.empty(0)]

    def take(self, turn: int, rows: int, columns: int, dtype: np.dtype) -> np.ndarray:
        """An array whose content is arbitrary; it lives until the next call with the same parity of `turn`."""
        size = rows * columns * dtype.itemsize // 8
        if self._buffers[turn % 2].size < size:
            self._buffers[turn % 2] = np.empty(0)  # give back before asking for more
            self._buffers[turn % 2] = np.empty(size)
        return self._buffers[turn % 2][:size].view(dtype).reshape(rows, columns)


def change_variables(
    entries: np.ndarray, n: int, k: int, matrix: np.ndarray, workspace: Workspace | None = None
) -> np.ndarray:
    """Tensor entries of p(M z) as a polynomial in z, for p homogeneous of degree `k`.

    Parameters
    ----------
    entries : ndarray, shape (count(n, k),)
        Tensor entries of p, real or complex.
    matrix : ndarray, shape (n, n)
        M, real or complex.
    workspace : Workspace, optional
        To be used again by later calls, one at a time.

    Returns
    -------
    ndarray, shape (count(n, k),)
    """
    dtype = np.result_type(entries, matrix)
    tensor = np.ascontiguousarray(entries, dtype).reshape(-1, 1)
    matrix = np.ascontiguousarray(matrix, dtype)
    for s in range(k):
        opening = basis.insertion(n, k - s)
        width = tensor.shape[1]
        if opening.size * width <= _SMALL and n * n * width <= tile_products(dtype):
            opened = matrix.T @ tensor[opening]
            tensor = opened.reshape(len(opening), -1)[:, _sorted_pairs(n, s)]
        else:
            shape = len(opening), basis.count(n, s + 1)
            result = workspace.take(s, *shape, dtype) if workspace else np.empty(shape, dtype)
            tensor = _contract_one_index(tensor, opening, n, s, matrix, result)
    return tensor.reshape(-1).copy() if workspace else tensor.reshape(-1)


@lru_cache(64)
def _sorted_pairs(n: int, s: int) -> np.ndarray:
    """Positions, in an (n, count(n, s)) array, of the pairs (j, tail) with j ≤ the first index of tail."""
    start, width = basis.offsets(n, s), basis.count(n, s)
    return np.concatenate([j * width + np.arange(start[j], width) for j in range(n)])


def _contract_one_index(
    tensor: np.ndarray, opening: np.ndarray, n: int, s: int, matrix: np.ndarray, result: np.ndarray
) -> np.ndarray:
    width = basis.count(n, s)
    blocks = 1 if s == 0 else min(n, 4)  # of new indices: more skip more of the unsorted tuples
    products = tile_products(result.dtype)  # stays in cache, too
    columns = min(width, max(1, products * blocks // n**2))
    rows = max(1, _TILE_BYTES // (n * columns * tensor.itemsize) if s else products // n**2)
    edges = [(block * n) // blocks for block in range(blocks + 1)]

    def contract(top: int, left: int) -> None:
        chosen = opening[top : top + rows]
        opened = tensor[:, left : left + columns][chosen]
        _contract_tile(opened, left, n, s, matrix, edges, result[top : top + rows])

    tiles = ((top, left) for top in range(0, len(opening), rows) for left in range(0, width, columns))
    run_all(contract, tiles, large=opening.size * width > _LARGE)
    return result


def _contract_tile(
    opened: np.ndarray, left: int, n: int, s: int, matrix: np.ndarray, edges: list[int], result: np.ndarray
) -> None:
    """Contract axis 1 of `opened` (rows, n, tails from `left` on) and keep what is sorted."""
    if s == 0:
        np.matmul(opened[:, :, 0], matrix, out=result)
        return
    start, first = basis.offsets(n, s), basis.offsets(n, s + 1)
    right = left + opened.shape[2]
    for low, high in pairwise(edges):
        begin = max(start[low], left)
        if begin >= right:
            return
        contracted = np.matmul(matrix[:, low:high].T, opened[:, :, begin - left :])
        for j in range(low, high):
            tail = max(start[j], left)
            if tail < right:
                place = first[j] - start[j]
                result[:, place + tail : place + right] = contracted[:, j - low, tail - begin :]
