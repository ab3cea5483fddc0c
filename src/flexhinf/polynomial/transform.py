"""Linear change of variables in a homogeneous polynomial, in compressed symmetric storage.

One index of the symmetric tensor is transformed at a time. In between, the tensor is symmetric in the k−s old
indices and symmetric in the s new ones: a matrix of count(n, k−s) rows and count(n, s) columns. A step opens
one old index by the insertion table, contracts it with the matrix and keeps the results whose new index comes
first in the sorted tuple: dense matrix products on arrays that never exceed count(n, k/2)² numbers.

Coordinates in which a linear flow is diagonal or triangular: a real matrix times complex pairs.

Eigenvectors of a real matrix come in conjugate pairs v = p ± iq. Going to the real columns p, q first and
mixing each pair afterwards keeps the expensive, dense part of the change of variables in real arithmetic.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import pairwise
from typing import Any

import numpy as np

from flexhinf.polynomial import basis
from flexhinf.polynomial.algebra import matrix_product, run_all, tile_products

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
    """Tensor entries (count(n, k),) of p(M z) as a polynomial in z, of those of p, homogeneous of degree `k`.

    Entries and M (n, n) are real or complex. A workspace is used again by later calls, one at a time.
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
    start, first = basis.offsets(n, s), basis.offsets(n, s + 1)

    def contract(top: int, left: int) -> None:
        """Contract axis 1 of a tile (rows, n, tails from `left` on) and keep what is sorted."""
        opened, kept = tensor[:, left : left + columns][opening[top : top + rows]], result[top : top + rows]
        if s == 0:
            np.matmul(opened[:, :, 0], matrix, out=kept)
            return
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
                    kept[:, place + tail : place + right] = contracted[:, j - low, tail - begin :]

    tiles = ((top, left) for top in range(0, len(opening), rows) for left in range(0, width, columns))
    run_all(contract, tiles, large=opening.size * width > _LARGE)
    return result


_NEGLIGIBLE = 5_000  # coefficients up to which one complex change of variables is cheaper than real and pairs
_PAIR = np.array([[1, 1], [1j, -1j]]) / np.sqrt(2)


@dataclass(frozen=True)
class Coordinates:
    """x = M G z with real M, and G unitary in 2×2 blocks (`rotations`, by their first variable).

    `flow` is the matrix in these coordinates, (M G)⁻¹ A (M G): diagonal or upper triangular, complex; `real` and
    `inverse` are M and M⁻¹.
    """

    flow: np.ndarray
    real: np.ndarray
    inverse: np.ndarray
    rotations: dict[int, np.ndarray]
    workspace: Workspace = field(default_factory=Workspace, repr=False)

    @property
    def condition(self) -> float:
        """cond(M G) in the 2-norm; infinite if there is no inverse."""
        if not np.isfinite(self.inverse).all():
            return np.inf
        return float(np.linalg.norm(self.real, 2) * np.linalg.norm(self.inverse, 2))

    def enter(self, entries: np.ndarray, k: int) -> np.ndarray:
        """Tensor entries in z of a polynomial given in x."""
        n = len(self.real)
        if len(entries) <= _NEGLIGIBLE:
            return change_variables(entries, n, k, self.real @ self._pairs())
        return rotate_pairs(change_variables(entries, n, k, self.real, self.workspace), n, k, self.rotations)

    def leave(self, entries: np.ndarray, k: int) -> np.ndarray:
        """Tensor entries in x of a polynomial given in z, real in x."""
        n = len(self.real)
        if len(entries) <= _NEGLIGIBLE:
            return np.real(change_variables(entries, n, k, self._pairs().conj().T @ self.inverse))
        back = {first: np.ascontiguousarray(block.conj().T) for first, block in self.rotations.items()}
        rotated = np.real(rotate_pairs(entries, n, k, back))
        return change_variables(rotated, n, k, self.inverse, self.workspace)

    def _pairs(self) -> np.ndarray:
        pairs = np.eye(len(self.real), dtype=complex)
        for first, block in self.rotations.items():
            pairs[first : first + 2, first : first + 2] = block
        return pairs


def eigen_coordinates(matrix: np.ndarray) -> Coordinates:
    """Eigenvectors of a real matrix, conjugate pairs first."""
    eigenvalues, vectors = np.linalg.eig(matrix)
    pairs, lone = np.flatnonzero(np.imag(eigenvalues) > 0), np.flatnonzero(np.imag(eigenvalues) == 0)
    joined = np.stack([np.real(vectors[:, pairs]), np.imag(vectors[:, pairs])], axis=2) * np.sqrt(2)
    real = np.hstack([joined.reshape(len(matrix), -1), np.real(vectors[:, lone])])
    values = np.stack([eigenvalues[pairs], eigenvalues[pairs].conj()], axis=1).ravel()
    try:
        inverse = np.linalg.inv(real)
    except np.linalg.LinAlgError:
        inverse = np.full_like(real, np.inf)
    flow = np.diag(np.concatenate([values, eigenvalues[lone]]))
    return Coordinates(flow, real, inverse, {2 * i: _PAIR for i in range(len(pairs))})


def schur_coordinates(matrix: np.ndarray) -> Coordinates:
    """Real Schur form, its 2×2 blocks made triangular by complex rotations."""
    from scipy.linalg import schur

    form: tuple[Any, ...] = schur(matrix, output="real")
    triangular, orthogonal = form
    rotations = {}  # unitary, the first column an eigenvector of the block
    for i in np.flatnonzero(np.diag(triangular, -1)).tolist():
        _, vectors = np.linalg.eig(triangular[i : i + 2, i : i + 2].astype(complex))
        a, b = vectors[:, 0]
        rotations[i] = np.array([[a, -np.conj(b)], [b, np.conj(a)]])
    result = Coordinates(triangular, orthogonal, orthogonal.T, rotations)
    pairs = result._pairs()
    return Coordinates(np.triu(pairs.conj().T @ triangular @ pairs), orthogonal, orthogonal.T, rotations)


def rotate_pairs(entries: np.ndarray, n: int, k: int, rotations: Mapping[int, np.ndarray]) -> np.ndarray:
    """Tensor entries (count(n, k),), complex, of p(G z), where G is the identity but for 2×2 blocks on the diagonal.

    A block at i acts on variables i and i+1.
    """
    result = entries.astype(complex)
    for first, rotation in rotations.items():
        for m in range(1, k + 1):
            group = _pair_tuples(n, k, first, m)
            result[group] = matrix_product(result[group], _power(rotation.tobytes(), m))
    return result


@lru_cache(4096)
def _pair_tuples(n: int, k: int, first: int, m: int) -> np.ndarray:
    """Ranks of the tuples that hold the pair's variables exactly m times, int32 (tuples of the other indices, m + 1).

    Column b: the second variable b times, the first m − b times.
    """
    others = basis.indices(n, k - m)
    rest = np.flatnonzero(~((others == first) | (others == first + 1)).any(axis=1)).astype(np.int32)
    columns = []
    for b in range(m + 1):
        ranks = rest
        for step in range(m):
            ranks = basis.insertion(n, k - m + step + 1)[ranks, first + (step < b)]
        columns.append(ranks)
    return np.stack(columns, axis=1)


@lru_cache(512)
def _power(rotation: bytes, m: int) -> np.ndarray:
    """What a 2×2 matrix does to the m+1 tensor entries of degree m in two variables; shape (old, new)."""
    matrix = np.frombuffer(rotation, complex).reshape(2, 2)
    return np.stack([change_variables(unit, 2, m, matrix) for unit in np.eye(m + 1)])
