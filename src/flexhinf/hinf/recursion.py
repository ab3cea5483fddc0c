"""The recursion over degrees: V_2 from Riccati, every higher V_k from one homological equation.

Insert V = V_2 + V_3 + … into V_x f + q + ½ Σ_c s_c w_c² = 0 with w = V_x g (one polynomial per channel). At
degree k the unknown V_k appears twice, in V_k,x A x and in w_1 · V_k,x g(0): together V_k,x A_cl x with the
closed loop A_cl = A + M P. Everything else is known from lower degrees:

    V_k,x A_cl x + Σ_{i<k} V_i,x f_{k+1−i} + q_k + ½ Σ_{a+b=k} s · w_a w_b = 0,

where w_{k−1} is taken without V_k,x g(0).

Degrees whose known part is empty vanish exactly: an odd plant has no V_3, V_5, …

States in which V is bounded, however close γ is to γ*.

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

from collections.abc import Callable
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np

from flexhinf.hinf.linear_part import Parts, ScaledProblem
from flexhinf.hinf.riccati import RiccatiSolution
from flexhinf.polynomial import basis
from flexhinf.polynomial.algebra import add_part, gradient, matrix_product, product
from flexhinf.polynomial.homological import HomologicalEquation
from flexhinf.polynomial.transform import change_variables


@dataclass(frozen=True)
class BoundedStates:
    """x = `to_x` y and y = `to_y` x, both (n, n) in extended precision."""

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


@dataclass(frozen=True)
class DegreeRecord:
    """How one degree of V was found.

    `method`: "Riccati", "eigenbasis", "eigenbasis, refined", "Schur", or "zero by parity". `residual`: Of Eq. (8) at
    this degree with the V that is returned, relative to the largest of its terms there. `seconds`: Wall time. `error`:
    Estimate of the largest error of a coefficient, relative to the largest coefficient of this degree; nan where none
    was made.
    """

    degree: int
    method: str
    residual: float
    seconds: float
    error: float = float("nan")


def solve_degrees(
    problem: ScaledProblem, riccati: RiccatiSolution, seconds: float, advance: Callable[[int], None]
) -> tuple[Parts, tuple[DegreeRecord, ...], float]:
    """All degrees of V in scaled coordinates.

    `riccati`: Of the scaled linear part. `seconds`: What the Riccati equation took, for the record. `advance`: Told
    each degree once it is done. Returns `value`, dict degree → (count(n, degree),): Tensor entries, of degree 2 in the
    precision of P; vanishing degrees are missing. Returns `records`, Their residuals are those of the linear equation
    of each degree, relative to A_cl, V_k and right-hand side. Returns `condition`, Condition number of the closed
    loop's eigenvectors.
    """
    n, p = problem.n, riccati.p.astype(float)
    equation = HomologicalEquation(riccati.closed_loop)
    value: Parts = {2: p[np.triu_indices(n)] / 2}
    records = [DegreeRecord(2, "Riccati", riccati.residual, seconds)]
    gradients: Parts = {2: gradient(value[2], n, 2)}
    rows: Parts = {
        1: matrix_product(gradients[2], problem.g[0][:, :, 0])
    }  # w, shape (count(n, degree), channels)
    for k in range(3, problem.degree + 1):
        begin = perf_counter()
        known_rows = _channel_rows(problem, gradients, k)
        if known_rows is not None:
            rows[k - 1] = known_rows
        known = _known_part(problem, gradients, rows, k)
        if known is None:
            records.append(DegreeRecord(k, "zero by parity", 0.0, perf_counter() - begin))
        else:
            solution = equation.solve(known / basis.multiplicity(n, k), k)
            value[k] = solution.entries
            if k < problem.degree:
                gradients[k] = gradient(value[k], n, k)
                add_part(rows, k - 1, matrix_product(gradients[k], problem.g[0][:, :, 0]))
            records.append(DegreeRecord(k, solution.method, solution.residual, perf_counter() - begin))
        advance(k)
    value[2] = riccati.p[np.triu_indices(n)] / 2
    return value, tuple(records), equation.condition if problem.degree > 2 else float("nan")


def _channel_rows(problem: ScaledProblem, gradients: Parts, k: int) -> np.ndarray | None:
    """w_{k−1} without V_k,x g(0): Σ_{i<k} V_i,x g_{k−i}; None if there is nothing."""
    total = None
    for i, slope in gradients.items():
        fields = problem.g.get(k - i)
        if k - i < 1 or fields is None:
            continue
        if total is None:
            total = np.zeros((basis.count(problem.n, k - 1), len(problem.signs)))
        for channel in np.flatnonzero(fields.any(axis=(0, 2))):
            total[:, channel] += product(slope, fields[:, channel], problem.n, i - 1, k - i)
    return total


def _known_part(problem: ScaledProblem, gradients: Parts, rows: Parts, k: int) -> np.ndarray | None:
    """Monomial coefficients of all that is known at degree k; None if there is nothing."""
    n = problem.n
    terms = [problem.q[k]] if k in problem.q else []
    for i, slope in gradients.items():
        if k + 1 - i >= 2 and k + 1 - i in problem.f:
            terms.append(product(slope, problem.f[k + 1 - i], n, i - 1, k + 1 - i))
    for a, left in rows.items():
        b = k - a
        if b <= a and b in rows:
            weights = problem.signs * (0.5 if a == b else 1.0)
            terms.append(product(left, (rows[b] * weights).T, n, a, b))
    return sum(terms[1:], start=terms[0]) if terms else None
