"""Units for the computation: states and value scaled by powers of two, so that nothing is rounded.

Arms mix 1e4 N·m/rad with radians. With x = D ξ and V = s² W the Hamiltonian matrix of the Riccati equation is
balanced, and so are the coefficients of every higher degree.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

__all__ = ["Scaling", "balance"]


@dataclass(frozen=True)
class Scaling:
    """x = `state` * ξ (elementwise) and V = `value`² W.

    Attributes
    ----------
    state : ndarray, shape (n,)
        Powers of two.
    value : float
        A power of two: g1 and g2 are multiplied by it, h divided by it.
    """

    state: np.ndarray
    value: float

    def linear(
        self, a: np.ndarray, b: np.ndarray, c: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Scaled A, input matrix and output matrix."""
        d = self.state
        return a * (d / d[:, None]), b * (self.value / d)[:, None], c * (d / self.value)

    def unscale_hessian(self, p: np.ndarray) -> np.ndarray:
        """P of V = ½ xᵀPx from the scaled one."""
        return p * (self.value**2 / np.outer(self.state, self.state))


def balance(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> Scaling:
    """Scaling that balances the Hamiltonian matrix [[A, BBᵀ], [CᵀC, Aᵀ]].

    The diagonal similarity is kept symplectic up to one factor: diag(D⁻¹, D) on state and costate, and the
    factor evens out the two off-diagonal blocks.

    Parameters
    ----------
    a, b, c : ndarray, shapes (n, n), (n, inputs), (outputs, n)
    """
    from scipy.linalg import matrix_balance

    n = len(a)
    b_square, c_square, size = np.abs(b @ b.T), np.abs(c.T @ c), np.abs(a)
    hamiltonian = np.block([[size, b_square], [c_square, size.T]])
    np.fill_diagonal(hamiltonian, 0.0)
    _, (factors, _) = matrix_balance(hamiltonian, permute=False, separate=True)
    exponents = np.log2(factors)
    state = np.exp2(-np.round((exponents[n:] - exponents[:n]) / 2))
    b_norm = np.linalg.norm(b_square / np.outer(state, state))
    c_norm = np.linalg.norm(c_square * np.outer(state, state))
    ratio = c_norm / b_norm if b_norm > 0 and c_norm > 0 else 1.0
    return Scaling(state, float(np.exp2(np.round(np.log2(ratio) / 4))))
