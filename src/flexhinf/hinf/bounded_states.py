"""States in which V is bounded, however close γ is to γ*.

P may grow without bound as γ falls to γ*, in one direction v after the other: vᵀPv ~ 1/δ with δ = γ/γ* − 1. The
coefficients of V_k in that direction then grow like δ^(3−2k), what is known of V_k is a sum of terms that cancel to a
fraction δ^k of their size, and the recursion in x, whose linear solves are each backward stable, loses every digit.

The Hamiltonian matrix and its stable subspace, the graph of P, are well behaved there: with an orthonormal basis
(U1; U2) of it, P = U2 U1⁻¹, it is U1 alone that becomes singular, with singular values 1/√(1 + λ²) for the
eigenvalues λ of P. So the problem is written in the states y of

    x = T y,    T = Q S,    P = Q diag(λ) Qᵀ,    S = diag(1/√(1 + λ²)) rounded to powers of two,

where TᵀPT, and with it the closed loop, its eigenvectors and V, are of ordinary size. T need not be exact, only its
inverse must be: that, and the linear part in y, are formed in extended precision (where the machine has it). What is
left is the conditioning of the problem itself.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from flexhinf.hinf.scaled_problem import Parts, ScaledProblem
from flexhinf.polynomial import basis
from flexhinf.polynomial.transform import change_variables


@dataclass(frozen=True)
class BoundedStates:
    """x = `to_x` y and y = `to_y` x, in extended precision.

    Attributes
    ----------
    to_x, to_y : ndarray of longdouble, shape (n, n)
    """

    to_x: np.ndarray
    to_y: np.ndarray

    @classmethod
    def of(cls, eigenvalues: np.ndarray, q: np.ndarray, stretch: np.ndarray | None = None) -> BoundedStates:
        """For P = Q diag(λ) Qᵀ, known roughly; `stretch` (n,), near 1, gives other states of the same kind."""
        scale = np.exp2(-np.round(np.log2(np.hypot(1.0, eigenvalues))))
        scale = (scale if stretch is None else scale * stretch).astype(np.longdouble)
        q = q.astype(np.longdouble)
        inverse = q.T @ (
            2 * np.eye(len(q), dtype=np.longdouble) - q @ q.T
        )  # a Newton step, which squares 1e-15
        return cls(q * scale, inverse / scale[:, None])

    def hessian(self, p: np.ndarray) -> np.ndarray:
        """P of ½ xᵀPx in y."""
        return self.to_x.T @ p @ self.to_x

    def problem(self, problem: ScaledProblem) -> ScaledProblem:
        """Eq. (8) in y: ẏ = T⁻¹ f(T y) + T⁻¹ g(T y) · (d, u), with q(T y)."""
        f = {k: self._fields(part, k) for k, part in problem.f.items()}
        g = {k: self._fields(part, k) for k, part in problem.g.items()}
        q = {k: self._substituted(part, k) for k, part in problem.q.items()}
        return replace(problem, f=f, g=g, q=q)

    def value(self, value: Parts) -> Parts:
        """Tensor entries in x of a V given in y; degree 2 in the precision it comes in."""
        n, back = len(self.to_x), self.to_y.astype(float)
        parts = {k: change_variables(part, n, k, back) for k, part in value.items() if k > 2}
        p = np.zeros((n, n), value[2].dtype)
        p[np.triu_indices(n)] = value[2]
        p = self.to_y.T @ (p + np.triu(p, 1).T) @ self.to_y
        return {2: p[np.triu_indices(n)], **parts}

    def _fields(self, part: np.ndarray, k: int) -> np.ndarray:
        """T⁻¹ p(T y) for fields p: monomial coefficients (n, …, count(n, k))."""
        matrix = self.to_y if k <= 1 else self.to_y.astype(float)
        return np.tensordot(matrix, self._substituted(part, k), axes=1).astype(float)

    def _substituted(self, part: np.ndarray, k: int) -> np.ndarray:
        """Monomial coefficients (…, count(n, k)) of p(T y)."""
        if k <= 1:
            return part @ self.to_x if k else part
        n, weights, matrix = len(self.to_x), basis.multiplicity(len(self.to_x), k), self.to_x.astype(float)
        rows = part.reshape(-1, part.shape[-1])
        result = np.zeros(rows.shape)
        for i in np.flatnonzero(rows.any(axis=1)):
            result[i] = change_variables(rows[i] / weights, n, k, matrix) * weights
        return result.reshape(part.shape)
