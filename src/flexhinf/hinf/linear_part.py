"""The linear part of a game: A, g1, g2 R2^(−½), ∂h/∂x at the operating point."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexhinf.hinf.conditions import check_standing_assumptions
from flexhinf.hinf.riccati import RiccatiSolution, solve_riccati
from flexhinf.hinf.scaling import Scaling, balance
from flexhinf.plant.polynomial_plant import PolynomialPlant

__all__ = ["LinearPart"]


@dataclass(frozen=True)
class LinearPart:
    """ẋ = A x + B1 d + B2 v, z = (C x, v): the input is in units of its own penalty, v = lu.

    Attributes
    ----------
    a, b1, b2, c : ndarray, shapes (n, n), (n, md), (n, m), (s, n)
    state_names : tuple of str
    """

    a: np.ndarray
    b1: np.ndarray
    b2: np.ndarray
    c: np.ndarray
    state_names: tuple[str, ...]

    @classmethod
    def of(cls, plant: PolynomialPlant) -> LinearPart:
        """Degree-1 part of the expansion."""
        b2 = np.linalg.solve(np.linalg.cholesky(plant.r2), plant.g2_parts[0][:, :, 0].T).T
        return cls(plant.f_parts[1], plant.g1_parts[0][:, :, 0], b2, plant.h_parts[1], plant.state_names)

    def scaled(self, gamma: float) -> tuple[Scaling, LinearPart]:
        """Balanced for this level: g1 counts with its weight 1/γ."""
        scaling = balance(self.a, np.hstack([self.b1 / gamma, self.b2]), self.c)
        a, b, c = scaling.linear(self.a, np.hstack([self.b1, self.b2]), self.c)
        md = self.b1.shape[1]
        return scaling, LinearPart(a, b[:, :md], b[:, md:], c, self.state_names)

    def check(self) -> None:
        """Stabilisable from the input, detectable in the penalty; see `check_standing_assumptions`."""
        _, balanced = self.scaled(np.inf)
        check_standing_assumptions(balanced.a, balanced.b2, balanced.c, self.state_names)

    def riccati(self, gamma: float, polish: bool = True) -> RiccatiSolution | None:
        """Stabilising P ≥ 0 at this level, or None. Expects balanced coordinates."""
        b1, b2, c = (self.b1 / gamma, self.b2, self.c)
        if polish:  # the polished residual is formed in extended precision
            b1, b2, c = (matrix.astype(np.longdouble) for matrix in (b1, b2, c))
        return solve_riccati(self.a, b1 @ b1.T - b2 @ b2.T, c.T @ c, polish)
