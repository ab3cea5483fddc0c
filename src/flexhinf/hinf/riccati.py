"""The quadratic part of Eq. (8): a Riccati equation with an indefinite quadratic term.

    AᵀP + PA + Q + P M P = 0,   M = g1 g1ᵀ/γ² − g2 R2⁻¹ g2ᵀ,   A + M P stable,   P ≥ 0.

The stable invariant subspace of the Hamiltonian matrix (ordered real Schur form) gives P to about 1e-10,
which would cap every higher degree; Newton steps, one Lyapunov equation each, bring it to rounding.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

_AXIS = 1e-13  # eigenvalues this close to the imaginary axis, relative to the norm times n, lie on it
_ISOTROPY = 1e-6  # asymmetry of U1ᵀU2 beyond which the subspace mixes a mode with its mirror image
_NEGATIVE = 1e-9  # most negative eigenvalue of P, relative to the largest, that still counts as zero
_LARGEST = 1e40  # bound on the norm of P, relative to the norm of the Hamiltonian matrix
_NEWTON_STEPS = 6
_ROUNDING = 4 * float(np.finfo(np.longdouble).eps)  # relative residual that no step improves


@dataclass(frozen=True)
class RiccatiSolution:
    """A stabilising solution P ≥ 0.

    `p`: (n, n), in extended precision (where the machine has it) once it is polished. `closed_loop`: (n, n), A + M P,
    both the law and the worst disturbance applied. `residual`: Norm of the left-hand side relative to the largest of
    its terms. `form`: Real Schur form of the closed loop before the last Newton step: close enough for a sensitivity.
    """

    p: np.ndarray
    closed_loop: np.ndarray
    residual: float
    form: tuple[np.ndarray, np.ndarray] | None = None


def solve_riccati(a: np.ndarray, m: np.ndarray, q: np.ndarray) -> RiccatiSolution | None:
    """Stabilising P ≥ 0 to about 1e-10, or None where there is none; `polish` makes it exact.

    `a`, `m`, `q`: (n, n), in balanced coordinates. `m` is symmetric and indefinite, `q` symmetric positive
    semidefinite.

    Feasibility is lost in two ways as γ falls: eigenvalues of the Hamiltonian matrix reach the imaginary
    axis, or the stable subspace loses its graph form (P grows without bound and comes back negative). Both
    are looked at.
    """
    from scipy.linalg import schur

    n = len(a)
    hamiltonian = np.block([[a, m], [-q, -a.T]]).astype(float)
    size = float(np.linalg.norm(hamiltonian))
    if not np.isfinite(size):
        return None
    try:
        ordered: tuple[Any, ...] = schur(hamiltonian, sort="lhp", check_finite=False)
    except np.linalg.LinAlgError:  # an eigenvalue crossed the axis while the form was being ordered
        return None
    triangular, vectors, stable = ordered
    if stable != n or _distance_to_axis(triangular) <= _AXIS * n * size:
        return None
    upper, lower = vectors[:n, :n], vectors[n:, :n]
    cross = upper.T @ lower
    if np.linalg.norm(cross - cross.T) > _ISOTROPY * max(float(np.linalg.norm(cross)), 1e-10):
        return None
    try:
        p = np.linalg.solve(upper.T, lower.T).T
    except np.linalg.LinAlgError:
        return None
    p = (p + p.T) / 2
    eigenvalues = np.linalg.eigvalsh(p) if np.isfinite(p).all() else np.array([-np.inf])
    if eigenvalues[0] < -_NEGATIVE * abs(eigenvalues[-1]) or eigenvalues[-1] > _LARGEST * size:
        return None
    return RiccatiSolution(p, (a + m @ p).astype(float), np.nan)


def _distance_to_axis(triangular: np.ndarray) -> float:
    """Smallest |Re λ| of a real Schur form: the standard 2×2 blocks carry the real part on their diagonal."""
    return float(np.abs(np.diag(triangular)).min())


def polish(a: np.ndarray, m: np.ndarray, q: np.ndarray, p: np.ndarray) -> RiccatiSolution | None:
    """Newton steps while the residual falls; the best iterate is kept. None where it does not stabilise.

    P M P cancels where P is large, so P, residual and closed loop are formed in extended precision (where the
    machine has it); the steps themselves need no more than double.

    `a`, `m`, `q`: (n, n), as for `solve_riccati`. `p`: (n, n), A first approximation.
    """
    a, m, q, p = (matrix.astype(np.longdouble) for matrix in (a, m, q, p))
    p, form = (p + p.T) / 2, None  # no step would take an antisymmetric part away
    left, scale = _riccati_residual(a, m, q, p)
    for _ in range(_NEWTON_STEPS):
        form = _schur((a + m @ p).astype(float))
        step = _lyapunov_step(form, left.astype(float))
        if step is None:
            break
        candidate = p + step
        next_left, next_scale = _riccati_residual(a, m, q, candidate)
        if not _size(next_left) < _size(left):
            break
        gained = _size(next_left) < 0.25 * _size(left)
        p, left, scale = candidate, next_left, next_scale
        if not gained or _size(left) <= _ROUNDING * scale:
            break
    closed_loop = (a + m @ p).astype(float)
    if np.linalg.eigvals(closed_loop).real.max() >= 0:
        return None
    return RiccatiSolution(p, closed_loop, _size(left) / scale, form)


def sensitivity(riccati: RiccatiSolution, change: np.ndarray) -> np.ndarray:
    """ΔP for a small change ΔM of M: A_clᵀ ΔP + ΔP A_cl = −P ΔM P, shape (n, n).

    `change`: (n, n), ΔM, symmetric.
    """
    p = riccati.p.astype(float)
    form = riccati.form or _schur(riccati.closed_loop)
    step = _lyapunov_step(form, p @ change.astype(float) @ p)
    return np.full(p.shape, np.inf) if step is None else step


def _size(matrix: np.ndarray) -> float:
    return float(np.sqrt((matrix * matrix).sum()))


def _schur(closed: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    from scipy.linalg import schur

    form: tuple[Any, ...] = schur(closed, check_finite=False)
    return form[0], form[1]


def _lyapunov_step(form: tuple[np.ndarray, np.ndarray], left: np.ndarray) -> np.ndarray | None:
    """Δ with closedᵀ Δ + Δ closed = −left; None where the equation is singular to working precision."""
    from scipy.linalg.lapack import get_lapack_funcs

    triangular, vectors = form
    (trsyl,) = get_lapack_funcs(("trsyl",), (triangular,))
    rotated, scale, info = trsyl(triangular, triangular, -vectors.T @ left @ vectors, trana="T")
    if info != 0 or scale == 0:
        return None
    step = vectors @ (rotated / scale) @ vectors.T
    return (step + step.T) / 2


def _riccati_residual(a: np.ndarray, m: np.ndarray, q: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, float]:
    linear, quadratic = p @ a, p @ m @ p
    left = linear + linear.T + q + (quadratic + quadratic.T) / 2
    return left, max(_size(term) for term in (linear, q, quadratic)) or 1.0
