"""The dissipation inequality of the linear part at the corners of the tolerances.

A law of `solve_hji` with the storage V = ½ xᵀ P x to second order and the gain u = K x keeps

    V̇ ≤ ½ γ²|d|² − ½ |z|²   for all x and d   ⟺   Q = P A_K + A_Kᵀ P + CᵀC + Kᵀ R2 K + γ⁻² P B1 B1ᵀ P ≤ 0,

A_K = A + B2 K with the matrices of the true robot at its own equilibrium (complete the square in d). For the robot
that the law was made for, Q = 0 or below. At a corner of the tolerances it is one eigenvalue problem: no linear matrix
inequality has to be solved, as P and K are given. A synthesis that covers each tolerance alone need not cover products
of them, such as m·g·l or k_t/R; here all of them act.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from flexhinf.analysis.population import Population, corner_population
from flexhinf.analysis.tolerance_corners import ALL_OF, SAMPLED
from flexhinf.errors import InvalidInput
from flexhinf.hinf import HJISolution
from flexhinf.plant import GeneralisedPlant

#: Eigenvalues of Q below this share of its terms are rounding: Q = 0 for the robot of a nominal synthesis.
ROUNDING = 1e-8


@dataclass(frozen=True, eq=False)
class DissipationCorners:
    """By how much the inequality fails at the corners.

    Attributes
    ----------
    population : Population
        The corners, and the nominal plant last.
    complete : bool
        Whether all corners are among them; otherwise they are sampled.
    excess : (N + 1,) array
        Largest eigenvalue of D⁻¹ Q D⁻¹ for each plant, 1/s, with D = diag(P)^½: positive where V̇ may exceed
        ½ γ²|d|² − ½ |z|², by up to ½ excess Σ P_ii x_i²; what is rounding is zero.
    gamma : float
        γ of the inequality.
    """

    population: Population
    complete: bool
    excess: np.ndarray
    gamma: float

    def __repr__(self) -> str:
        return f"DissipationCorners({self.failing} of {self.count} corners fail at gamma = {self.gamma:.6g})"

    @property
    def count(self) -> int:
        """Number of corners."""
        return len(self.population) - 1

    @property
    def failing(self) -> int:
        """Corners at which the inequality does not hold."""
        return int((self.excess[:-1] > 0.0).sum())

    @property
    def worst(self) -> int:
        """The corner with the largest excess."""
        return int(np.argmax(self.excess[:-1]))

    def describe(self, k: int | None = None) -> str:
        """A corner, the worst one by default, by its changes in per cent."""
        return self.population.describe(self.worst if k is None else k)


@dataclass(frozen=True, eq=False)
class LinearCorners:
    """A problem's plant linearised at the corners of the tolerances, each at its own equilibrium.

    Attributes
    ----------
    problem : GeneralisedPlant
        Its d and z are meant.
    population : Population
        The corners, and the nominal plant last.
    complete : bool
        Whether all corners are among them; otherwise they are sampled.
    a, b1, b2 : (N, n, n), (N, n, k) and (N, n, m) arrays
        ẋ = A x + B1 d + B2 u, integrals included.
    """

    problem: GeneralisedPlant
    population: Population
    complete: bool
    a: np.ndarray
    b1: np.ndarray
    b2: np.ndarray

    @staticmethod
    def of(
        problem: GeneralisedPlant,
        at: Callable[[Sequence[float]], Mapping[str, Any]],
        uncertain: int | Sequence[Any],
        equilibrium: Callable[[Mapping[str, Any]], tuple[np.ndarray, np.ndarray]],
        seed: int = 0,
    ) -> LinearCorners:
        """All corners of up to 12 uncertain numbers, samples of the corners of more; see `dissipation_corners`."""
        number = uncertain if isinstance(uncertain, int) else len(uncertain)
        complete, plant = number <= ALL_OF, problem.plant
        population = corner_population(at, number, 2**number if complete else SAMPLED[0], seed, singles=False)
        plant.traced_jacobians  # noqa: B018  traced once, shared by all
        expansion, count = problem.expand(1), len(population)
        nominal = (expansion.f_parts[1], expansion.g1_parts[0][:, :, 0], expansion.g2_parts[0][:, :, 0])
        a, b1, b2 = (np.tile(matrix, (count, 1, 1)) for matrix in nominal)
        names = tuple(problem.disturbance_names)
        torques = [k for k, name in enumerate(names) if name in plant.disturbances]
        places = [tuple(plant.disturbances).index(names[k]) for k in torques]
        n = plant.n
        for k, values in enumerate(population.values):
            known = plant.parameters.known(values)
            state, inputs, disturbed, _ = plant.with_parameters(**known).linearise(*equilibrium(known))
            a[k, :n, :n], b2[k, :n] = state, inputs
            b1[k, :n][:, torques] = disturbed[:, places]
        return LinearCorners(problem, population, complete, a, b1, b2)

    def dissipation(self, storage: np.ndarray, gain: np.ndarray, gamma: float) -> DissipationCorners:
        """The inequality with V = ½ xᵀ P x (n, n), u = K x (m, n) and γ at every corner."""
        c, r2 = self.problem.expand(1).h_parts[1], self.problem.r2
        scale = 1.0 / np.sqrt(np.diag(storage))
        moved, driven = storage @ (self.a + self.b2 @ gain), storage @ self.b1
        terms = (
            moved + np.swapaxes(moved, 1, 2),
            np.broadcast_to(c.T @ c + gain.T @ r2 @ gain, self.a.shape),
            driven @ np.swapaxes(driven, 1, 2) / gamma**2,
        )
        scaled = [scale[:, None] * term * scale for term in terms]
        size = sum(np.linalg.norm(term, 2, axis=(1, 2)) for term in scaled)
        excess = np.linalg.eigvalsh(np.sum(scaled, axis=0))[:, -1]
        return DissipationCorners(
            self.population, self.complete, np.where(excess > ROUNDING * size, excess, 0.0), float(gamma)
        )


def dissipation_corners(
    solution: HJISolution,
    problem: GeneralisedPlant,
    at: Callable[[Sequence[float]], Mapping[str, Any]],
    uncertain: int | Sequence[Any],
    equilibrium: Callable[[Mapping[str, Any]], tuple[np.ndarray, np.ndarray]],
    *,
    gamma: float | None = None,
    seed: int = 0,
) -> DissipationCorners:
    """Check the linear part of the inequality at all corners of up to 12 uncertain numbers, at sampled ones of more.

    Parameters
    ----------
    solution : HJISolution
        P, K and γ; it may come of another problem of the same states, with channels for the tolerances.
    problem : GeneralisedPlant
        Its d and z are meant, and its plant is changed.
    at : callable
        Signs (one per uncertain number) → parameters of a plant: `Robot.corner`.
    uncertain : int or sequence
        The uncertain numbers that the plant has, or how many there are.
    equilibrium : callable
        Parameters → (x, u) where the plant with these parameters is held at the goal:
        ``lambda values: robot.operating_point(goal, parameters=values)``.
    gamma : float, optional
        Instead of the solution's.
    seed : int
        Of the samples; without effect where all corners are computed.

    Raises
    ------
    InvalidInput
        If the solution has other states than the problem.
    """
    if tuple(solution.state_names) != tuple(problem.state_names):
        raise InvalidInput(
            "The solution was not made for the problem's states.",
            f"expected {list(problem.state_names)}, got {list(solution.state_names)}",
            "the problem whose d and z are meant, with the same integrals",
        )
    found = LinearCorners.of(problem, at, uncertain, equilibrium, seed)
    return found.dissipation(solution.P, solution.gain, solution.gamma if gamma is None else gamma)
