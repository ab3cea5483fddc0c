"""The homological equation V_x(x) A x + r(x) = 0 for homogeneous V and r of degree k, A stable.

In eigenvector coordinates, x = T z, the equation is a division by λ_{i1} + … + λ_{ik}. Its error grows like
cond(T)^k; one step of refinement repairs that while cond(T)^k ε ≪ 1, and nothing does past it. In complex
Schur coordinates the equation is triangular and solved by substitution (`substitute`): backward stable
for any A, defective ones included, at a few times the cost. The residual of what is returned is always
measured.

In the triangular equation V_z(z) T z = r(z), z_j ∂V/∂z_i with j > i moves an index i of a tuple up to j, so the sum
of the indices orders the equations: all tuples of one sum depend only on those of smaller sums and are solved together.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import Any

import numpy as np

from flexhinf.polynomial import basis
from flexhinf.polynomial.algebra import matrix_product
from flexhinf.polynomial.transform import Coordinates, eigen_coordinates, schur_coordinates

HOPELESS = 1e-1  # cond(T)^k ε beyond which the eigenvector route is not tried
_SMALL = 2_000  # coefficients up to which a refinement step costs nothing to speak of
_ROWS = 8_192  # gradients formed at a time for a residual
_REFINE = 1e-14  # residual above which a large solution is refined
_ACCEPT = 3e-14  # residual above which the eigenvector route is given up


@dataclass(frozen=True)
class HomologicalSolution:
    """Solution of one degree: tensor entries (count(n, k),) of V_k.

    The method is "eigenbasis", "eigenbasis, refined" or "Schur"; the residual ‖V_x A x + r‖ / (‖A‖ ‖V‖ + ‖r‖) has norms
    of the tensor entries.
    """

    entries: np.ndarray
    method: str
    residual: float


@dataclass(frozen=True)
class HomologicalEquation:
    """The equation for one matrix A, shape (n, n), eigenvalues in the open left half plane."""

    matrix: np.ndarray

    @cached_property
    def eigenbasis(self) -> Coordinates:
        """Eigenvector coordinates of A."""
        return eigen_coordinates(self.matrix)

    @cached_property
    def schur_basis(self) -> Coordinates:
        """Schur coordinates of A."""
        return schur_coordinates(self.matrix)

    @cached_property
    def condition(self) -> float:
        """cond(T) of the eigenvectors, in the 2-norm; infinite for a defective matrix."""
        return self.eigenbasis.condition

    def solve(self, known: np.ndarray, k: int) -> HomologicalSolution:
        """V of degree `k`, from the tensor entries (count(n, k),) of r."""
        if self.condition**k * np.finfo(float).eps < HOPELESS:
            solution = self._by_eigenbasis(known, k)
            if solution.residual <= _ACCEPT:
                return solution
        return self._by_schur(known, k)

    def residual(self, entries: np.ndarray, known: np.ndarray, k: int) -> np.ndarray:
        """Tensor entries of V_x A x + r."""
        n = len(self.matrix)
        table, weights = basis.insertion(n, k), k * basis.multiplicity(n, k - 1)
        total = np.zeros(basis.count(n, k))
        for begin in range(0, len(table), _ROWS):
            rows = table[begin : begin + _ROWS]
            slopes = entries[rows] * weights[begin : begin + _ROWS, None]
            np.add.at(total, rows.ravel(), matrix_product(slopes, self.matrix).ravel())
        return total / basis.multiplicity(n, k) + known

    def _relative(self, residual: np.ndarray, entries: np.ndarray, known: np.ndarray) -> float:
        scale = self._norm * np.linalg.norm(entries) + np.linalg.norm(known)
        return float(np.linalg.norm(residual) / scale) if scale > 0 else 0.0

    @cached_property
    def _norm(self) -> float:
        return float(np.linalg.norm(self.matrix, 2))

    def _by_eigenbasis(self, known: np.ndarray, k: int) -> HomologicalSolution:
        def divide(right: np.ndarray) -> np.ndarray:
            quotient = self.eigenbasis.enter(right, k)
            quotient /= -diagonal_sums(self.eigenbasis.flow, k)
            return self.eigenbasis.leave(quotient, k)

        return self._refined(divide, known, k, "eigenbasis", "eigenbasis, refined", _REFINE)

    def _by_schur(self, known: np.ndarray, k: int) -> HomologicalSolution:
        def substituted(right: np.ndarray) -> np.ndarray:
            rotated = self.schur_basis.enter(right, k)
            return self.schur_basis.leave(substitute(self.schur_basis.flow, -rotated, k), k)

        return self._refined(substituted, known, k, "Schur", "Schur", np.inf)

    def _refined(
        self, inverse: Any, known: np.ndarray, k: int, method: str, refined: str, enough: float
    ) -> HomologicalSolution:
        """The better one of a solution and the same refined once; a large one with a residual of `enough` as it is."""
        entries = inverse(known)
        residual = self.residual(entries, known, k)
        relative = self._relative(residual, entries, known)
        first = HomologicalSolution(entries, method, relative)
        if (relative <= enough and len(known) > _SMALL) or not np.isfinite(relative):
            return first
        entries = entries + inverse(residual)
        after = self._relative(self.residual(entries, known, k), entries, known)
        return HomologicalSolution(entries, refined, after) if after < relative else first


_CHUNK = 100_000


def substitute(triangular: np.ndarray, known: np.ndarray, k: int) -> np.ndarray:
    """Tensor entries (count(n, k),) of V with V_z T z = r, T (n, n) upper triangular, from those of r.

    No sum of k diagonal entries vanishes. In tensor entries, k times the symmetrised equation reads
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
