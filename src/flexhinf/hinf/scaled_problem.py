"""A problem in scaled coordinates: units by powers of two, so that nothing is rounded, and Eq. (8) in them.

Arms mix 1e4 N·m/rad with radians. With x = D ξ and V = s² W the Hamiltonian matrix of the Riccati equation is
balanced, and so are the coefficients of every higher degree.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexhinf.plant.polynomial_plant import PolynomialPlant
from flexhinf.polynomial.algebra import add_part, monomials, product

#: Monomial coefficients by degree.
Parts = dict[int, np.ndarray]


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
    with np.errstate(invalid="ignore"):  # SciPy reads the factors as a permutation too
        _, (factors, _) = matrix_balance(hamiltonian, permute=False, separate=True)
    exponents = np.log2(factors)
    state = np.exp2(-np.round((exponents[n:] - exponents[:n]) / 2))
    b_norm = np.linalg.norm(b_square / np.outer(state, state))
    c_norm = np.linalg.norm(c_square * np.outer(state, state))
    ratio = c_norm / b_norm if b_norm > 0 and c_norm > 0 else 1.0
    return Scaling(state, float(np.exp2(np.round(np.log2(ratio) / 4))))


@dataclass(frozen=True)
class ScaledProblem:
    """V_x f + q + ½ Σ_c s_c (V_x g_c)² = 0, one column g_c per player's channel.

    The columns are g1/γ with sign +1 and g2 L⁻ᵀ with sign −1, where R2 = L Lᵀ; q = ½ hᵀh. So both quadratic
    terms of Eq. (8) are sums of squares of *scalar* polynomials V_x g_c, as many as there are channels.

    Attributes
    ----------
    n, degree : int
        States, and degree of V.
    f, g, q : dict degree → ndarray
        Monomial coefficients, shapes (n, count), (n, channels, count), (count,).
    signs : ndarray, shape (channels,)
    """

    n: int
    degree: int
    f: Parts
    g: Parts
    q: Parts
    signs: np.ndarray

    @classmethod
    def of(cls, plant: PolynomialPlant, gamma: float, degree: int, scaling: Scaling) -> ScaledProblem:
        """Scale x = D ξ, V = s² W, and join the channels of both players."""
        n, md, m, _ = plant.size
        d, s = scaling.state, scaling.value
        highest = max((*plant.f_parts, *plant.g1_parts, *plant.g2_parts, *plant.h_parts))
        powers = monomials(d[None, :], range(highest + 1))
        disturbed = np.isfinite(gamma)
        lower = np.linalg.cholesky(plant.r2)
        f = {k: part * powers[k] / d[:, None] for k, part in plant.f_parts.items()}
        g: Parts = {}
        for k in sorted({*plant.g1_parts, *plant.g2_parts}):
            width = powers[k].shape[1]
            first = plant.g1_parts.get(k, np.zeros((n, md, width))) / gamma
            second = plant.g2_parts.get(k, np.zeros((n, m, width)))
            second = np.linalg.solve(lower, np.moveaxis(second, 1, 0).reshape(m, -1))
            second = np.moveaxis(second.reshape(m, n, width), 0, 1)
            channels = np.concatenate([first, second], axis=1) if disturbed else second
            g[k] = channels * powers[k] * (s / d)[:, None, None]
        signs = np.r_[np.ones(md if disturbed else 0), -np.ones(m)]
        h = {k: part * powers[k] / s for k, part in plant.h_parts.items()}
        return cls(n, degree, f, g, _half_square(h, n, degree), signs)


def _half_square(h: Parts, n: int, degree: int) -> Parts:
    """½ hᵀh through `degree`."""
    total: Parts = {}
    for a, left in h.items():
        for b, right in h.items():
            if b <= a and a + b <= degree:
                weight = 0.5 if a == b else 1.0
                add_part(total, a + b, weight * product(left.T, right, n, a, b))
    return {k: part for k, part in total.items() if part.any()}
