"""An estimator at rest: its gain no longer changes.

The gain is that of the Kalman filter for the estimator's own model F at the goal. The extended filter's gain
tends to it, and the unscented filter's does as far as F and H are straight over the spread of its points.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from flexhinf.estimation import RecursiveFilter
from flexhinf.scalars import jacobian

__all__ = ["SteadyBelief", "SteadyFilter", "stationary_gain"]

#: Doublings of the Riccati recursion at most: 2⁴⁰ samples.
DOUBLINGS = 40


class SteadyBelief(NamedTuple):
    """A mean (n,) and the gain (n, p) that corrects it."""

    mean: Any
    gain: Any


class SteadyFilter:
    """x̂ = x̂⁻ + L (y − h(x̂⁻)), x̂⁻ = F(x̂, u), with the gain L carried along in the belief.

    Parameters
    ----------
    filter : RecursiveFilter
        Whose model, discretisation and noises are meant.
    gain : (n, p) array
    """

    def __init__(self, filter: RecursiveFilter, gain: np.ndarray) -> None:
        self.filter, self.plant, self.period = filter, filter.plant, filter.period
        self.process_noise, self.measurement_noise = filter.process_noise, filter.measurement_noise
        self.initial: Any = SteadyBelief(np.array(filter.initial.mean), gain)

    @property
    def estimator_key(self) -> str:
        """What distinguishes its code from another's."""
        return f"steady {self.period!r} {self.filter.sub_steps}"

    def initial_at(self, mean: np.ndarray) -> Any:
        """The initial belief with another mean (n,)."""
        return SteadyBelief(np.array(mean, dtype=float), self.initial.gain)

    def time_update(self, belief: Any, u: Any, p: Any, process_noise: Any) -> Any:
        """x̂(k|k) → x̂(k+1|k), pure, on any element."""
        return SteadyBelief(self.filter.transition(belief.mean, u, p), belief.gain)

    def measurement_update(self, belief: Any, y: Any, u: Any, p: Any, measurement_noise: Any) -> Any:
        """x̂(k|k−1) → x̂(k|k), pure, on any element."""
        innovation = y - np.atleast_1d(self.plant.output(belief.mean, u, p))
        return SteadyBelief(belief.mean + belief.gain @ innovation, belief.gain)


def linear_model(filter: RecursiveFilter, x: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(∂F/∂x, ∂h/∂x) of the filter's own sampled model at (x, u)."""
    table = filter.plant.parameters
    moved = jacobian(lambda s, v, w: filter.transition(s, v, table.named(w)), len(x), len(u), table.size)
    return moved(x, u, table.vector())[1], filter.plant.linearise(x, u)[3]


def stationary_gain(
    model: tuple[np.ndarray, np.ndarray], process_noise: np.ndarray, measurement_noise: np.ndarray
) -> np.ndarray:
    """The Kalman gain (n, p) of a linear model (F, H) after very many samples.

    The Riccati recursion is doubled [anderson1979]: each turn goes as far as all turns before it together, so
    R^v = 0 and a model that is only just detectable need no special case.
    """
    (a, c), r = model, measurement_noise
    n, unit = len(a), np.eye(len(a))
    forward, information, covariance = a.T, c.T @ np.linalg.solve(r, c), np.array(process_noise)
    for _ in range(DOUBLINGS):
        shared = np.linalg.solve(unit + information @ covariance, np.hstack([forward, information]))
        growth = forward.T @ covariance @ shared[:, :n]
        information = information + forward @ shared[:, n:] @ forward.T
        forward = forward @ shared[:, :n]
        covariance = covariance + (growth + growth.T) / 2.0
        information = (information + information.T) / 2.0
        if np.abs(growth).max() <= 1e-15 * np.abs(covariance).max():
            break
    return np.linalg.solve(c @ covariance @ c.T + r, c @ covariance).T
