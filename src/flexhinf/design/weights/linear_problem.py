"""The linear H∞ gain of a penalty: what a search candidates many times."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexhinf.design.weights.linear_family import LinearFamily
from flexhinf.hinf import linear_law
from flexhinf.hinf.gamma import linear_smallest_gamma
from flexhinf.hinf.linear_part import LinearPart
from flexhinf.plant import PolynomialPlant

__all__ = ["LinearDesign", "LinearProblem"]

#: Relative width at which the bisection for γ* ends during a search.
ROUGH = 1e-3


@dataclass(frozen=True, eq=False)
class LinearDesign:
    """A gain and its levels.

    Attributes
    ----------
    gain : (m, n)
        u − u* = K x.
    p : (n, n)
        V = ½ xᵀ P x.
    gamma, gamma_star : float
        Of the design, and the smallest feasible one (to `ROUGH`).
    """

    gain: np.ndarray
    p: np.ndarray
    gamma: float
    gamma_star: float


@dataclass(frozen=True, eq=False)
class LinearProblem:
    """The linear problem of the nominal robot: ẋ = A x + B1 d + B2 u, z = (C x, R2^½ u).

    Attributes
    ----------
    a, b1, b2, c, r2 : ndarray
    """

    a: np.ndarray
    b1: np.ndarray
    b2: np.ndarray
    c: np.ndarray
    r2: np.ndarray

    @staticmethod
    def of(
        family: LinearFamily, rows: np.ndarray, command: bool, torques: np.ndarray | None = None
    ) -> LinearProblem:
        """With h(x) = C x, R2 = I, and disturbances by the command and by torques.

        Parameters
        ----------
        family : LinearFamily
        rows : (s, n)
            C.
        command : bool
            Whether the command is a disturbance, through ė = q − d.
        torques : (2 joints, k) or None
            Which torques at links and motors disturb.
        """
        a, b2 = family.nominal
        n, joints = len(a), len(family.joints)
        enter = np.zeros((n, joints))
        enter[n - joints :] = -np.eye(joints)
        parts = ([enter] if command else []) + ([] if torques is None else [family.torques @ torques])
        return LinearProblem(a, np.hstack(parts), b2, rows, np.eye(b2.shape[1]))

    def linear_part(self) -> LinearPart:
        """As the synthesis has it, the input in units of its price."""
        root = np.linalg.cholesky(self.r2)
        names = tuple(f"x{k + 1}" for k in range(len(self.a)))
        return LinearPart(self.a, self.b1, np.linalg.solve(root, self.b2.T).T, self.c, names)

    def gamma_star(self) -> float:
        """Smallest feasible level, to `ROUGH`."""
        return linear_smallest_gamma(self.linear_part(), ROUGH)

    def design(self, gamma: float, gamma_star: float) -> LinearDesign:
        """The gain −R2⁻¹ B2ᵀ P at a level."""
        third = {0: self.b1[:, :, None]}
        plant = PolynomialPlant.from_parts(
            len(self.a), {1: self.a}, third, {0: self.b2[:, :, None]}, {1: self.c}, self.r2
        )
        p = linear_law(plant, gamma).P
        return LinearDesign(-np.linalg.solve(self.r2, self.b2.T @ p), p, gamma, gamma_star)

    def attained(self, gain: np.ndarray) -> float:
        """H∞ norm from d to z of the loop of a stabilising gain: the level that it attains, to `ROUGH`."""
        closed = np.vstack([self.c, np.linalg.cholesky(self.r2).T @ gain])
        nothing = np.zeros((len(self.a), 1))
        part = self.linear_part()
        return linear_smallest_gamma(
            LinearPart(self.a + self.b2 @ gain, self.b1, nothing, closed, part.state_names), ROUGH
        )
