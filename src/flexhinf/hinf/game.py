"""The differential game of Eq. (8) in scaled coordinates, ready for the recursion over degrees."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexhinf.hinf.scaling import Scaling
from flexhinf.plant.polynomial_plant import PolynomialPlant
from flexhinf.polynomial.algebra import add_part, monomials, product

__all__ = ["ScaledGame"]

Parts = dict[int, np.ndarray]


@dataclass(frozen=True)
class ScaledGame:
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
    def of(cls, plant: PolynomialPlant, gamma: float, degree: int, scaling: Scaling) -> ScaledGame:
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
