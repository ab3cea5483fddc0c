"""Coordinates in which a linear flow is diagonal or triangular: a real matrix times complex pairs.

Eigenvectors of a real matrix come in conjugate pairs v = p ± iq. Going to the real columns p, q first and
mixing each pair afterwards keeps the expensive, dense part of the change of variables in real arithmetic.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np

from flexhinf.polynomial import basis
from flexhinf.polynomial.threads import matrix_product
from flexhinf.polynomial.transform import Workspace, change_variables

_SMALL = (
    5_000  # coefficients up to which one complex change of variables is cheaper than a real one and pairs
)
_PAIR = np.array([[1, 1], [1j, -1j]]) / np.sqrt(2)


@dataclass(frozen=True)
class Coordinates:
    """x = M G z with real M, and G unitary in 2×2 blocks.

    Attributes
    ----------
    flow : ndarray, shape (n, n)
        The matrix in these coordinates, (M G)⁻¹ A (M G): diagonal or upper triangular, complex.
    real, inverse : ndarray, shape (n, n)
        M and M⁻¹.
    rotations : dict first variable → ndarray, shape (2, 2)
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
        if len(entries) <= _SMALL:
            return change_variables(entries, n, k, self.real @ self._pairs())
        return rotate_pairs(change_variables(entries, n, k, self.real, self.workspace), n, k, self.rotations)

    def leave(self, entries: np.ndarray, k: int) -> np.ndarray:
        """Tensor entries in x of a polynomial given in z, real in x."""
        n = len(self.real)
        if len(entries) <= _SMALL:
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
    rotations = {
        int(i): _triangulating(triangular[i : i + 2, i : i + 2])
        for i in np.flatnonzero(np.diag(triangular, -1))
    }
    result = Coordinates(triangular, orthogonal, orthogonal.T, rotations)
    pairs = result._pairs()
    return Coordinates(np.triu(pairs.conj().T @ triangular @ pairs), orthogonal, orthogonal.T, rotations)


def _triangulating(block: np.ndarray) -> np.ndarray:
    """Unitary 2×2 matrix whose first column is an eigenvector of the block."""
    _, vectors = np.linalg.eig(block.astype(complex))
    a, b = vectors[:, 0]
    return np.array([[a, -np.conj(b)], [b, np.conj(a)]])


def rotate_pairs(entries: np.ndarray, n: int, k: int, rotations: Mapping[int, np.ndarray]) -> np.ndarray:
    """Tensor entries of p(G z), where G is the identity but for 2×2 blocks on the diagonal.

    Parameters
    ----------
    entries : ndarray, shape (count(n, k),)
    rotations : mapping first variable → ndarray, shape (2, 2)
        The blocks; a block at i acts on variables i and i+1.

    Returns
    -------
    ndarray of complex, shape (count(n, k),)
    """
    result = entries.astype(complex)
    for first, rotation in rotations.items():
        for m in range(1, k + 1):
            group = _pair_tuples(n, k, first, m)
            result[group] = matrix_product(result[group], _power(rotation.tobytes(), m))
    return result


@lru_cache(4096)
def _pair_tuples(n: int, k: int, first: int, m: int) -> np.ndarray:
    """Ranks of the tuples that hold the pair's variables exactly m times.

    Returns
    -------
    ndarray of int32, shape (tuples of the other k − m indices, m + 1)
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
