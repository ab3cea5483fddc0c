"""Coordinates in which a linear flow is diagonal or triangular: a real matrix times complex pairs."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from flexhinf.polynomial.rotation import rotate_pairs
from flexhinf.polynomial.transform import Workspace, change_variables

__all__ = ["Coordinates", "eigen_coordinates", "schur_coordinates"]

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
