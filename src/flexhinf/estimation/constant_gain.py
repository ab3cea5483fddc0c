"""The stationary Kalman filter, and an estimator with its gain: gain and covariance no longer change.

The gain is usually that of the Kalman filter for the estimator's own model F at one operating point
(`stationary_gain`). The extended filter's gain tends to it, and the unscented filter's does as far
as F and H are straight over the spread of its points.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from flexhinf.errors import InvalidInput, NumericalFailure
from flexhinf.estimation.filter import RecursiveFilter
from flexhinf.plant import Estimator
from flexhinf.scalars import jacobian
from flexhinf.untrusted import real_array


class ConstantGainBelief(NamedTuple):
    """A mean (n,) and the gain (n, p) that corrects it."""

    mean: Any
    gain: Any


class ConstantGainFilter(Estimator):
    """x̂ = x̂⁻ + L (y − h(x̂⁻)), x̂⁻ = F(x̂, u), with the gain L carried along in the belief.

    Parameters
    ----------
    filter : RecursiveFilter
        Whose model, discretisation and noises are meant.
    gain : (n, p) array

    Raises
    ------
    InvalidInput
        If the gain is not (n, p) finite numbers.
    """

    def __init__(self, filter: RecursiveFilter, gain: np.ndarray) -> None:
        self.filter, self.plant, self.period = filter, filter.plant, filter.period
        self.process_noise, self.measurement_noise = filter.process_noise, filter.measurement_noise
        gain, shape = real_array(gain), (filter.plant.n, len(filter.plant.outputs))
        if gain.shape != shape or not np.all(np.isfinite(gain)):
            raise InvalidInput(
                "The gain does not fit the plant.",
                f"expected {shape} finite numbers, got shape {gain.shape}",
                "stationary_gain(linear_model(filter, x, u), process_noise, measurement_noise)",
            )
        self.initial: Any = ConstantGainBelief(np.array(filter.initial.mean), gain)

    def settings(self) -> dict[str, Any]:
        """Arguments of the constructor by name."""
        return {"filter": self.filter, "gain": self.initial.gain}

    @property
    def estimator_key(self) -> str:
        """What distinguishes its code from another's."""
        return f"constant gain {self.period!r} {self.filter.sub_steps} x {self.filter.stages}"

    def initial_at(self, mean: np.ndarray) -> Any:
        """The initial belief with another mean (n,)."""
        return ConstantGainBelief(self.filter.initial_at(mean).mean, self.initial.gain)

    def time_update(self, belief: Any, u: Any, p: Any, process_noise: Any) -> Any:
        """x̂(k|k) → x̂(k+1|k), pure, on any element."""
        return ConstantGainBelief(self.filter.transition(belief.mean, u, p), belief.gain)

    def measurement_update(self, belief: Any, y: Any, u: Any, p: Any, measurement_noise: Any) -> Any:
        """x̂(k|k−1) → x̂(k|k), pure, on any element."""
        innovation = y - self.filter.output(belief.mean, u, self.plant.parameters.flat(p))
        return ConstantGainBelief(belief.mean + belief.gain @ innovation, belief.gain)


if TYPE_CHECKING:
    from flexhinf.estimation.filter import RecursiveFilter


#: Doublings of the Riccati recursion at most: 2⁴⁰ samples.
DOUBLINGS = 40


def linear_model(filter: RecursiveFilter, x: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(∂F/∂x, ∂h/∂x), (n, n) and (p, n), of the filter's own sampled model at x (n,) and u (m,)."""
    table = filter.plant.parameters
    moved = jacobian(lambda s, v, w: filter.transition(s, v, table.named(w)), len(x), len(u), table.size)
    return moved(x, u, table.vector())[1], filter.plant.linearise(x, u)[3]


def stationary_gain(
    model: tuple[np.ndarray, np.ndarray], process_noise: np.ndarray, measurement_noise: np.ndarray
) -> np.ndarray:
    """The Kalman gain (n, p) of a linear model (F, H) after very many samples; see `stationary_covariance`."""
    c, r = model[1], measurement_noise
    covariance = stationary_covariance(model, process_noise, r)
    return np.linalg.solve(c @ covariance @ c.T + r, c @ covariance).T


def stationary_covariance(
    model: tuple[np.ndarray, np.ndarray], process_noise: np.ndarray, measurement_noise: np.ndarray
) -> np.ndarray:
    """The covariance (n, n) of a prediction of a linear model (F, H) after very many samples.

    The Riccati recursion is doubled [anderson1979]: each turn goes as far as all turns before it together, so
    R^v = 0 and a model that is only just detectable need no special case.

    Parameters
    ----------
    model : ((n, n), (p, n)) arrays
        F and H of one sample.
    process_noise, measurement_noise : (n, n) and (p, p) arrays
        R^v per sample and R^n, the latter positive definite.

    Raises
    ------
    NumericalFailure
        If the numbers are too far apart for the recursion: R^v and R^n, or a model that grows by decades in a sample.
    """
    (a, c), r = model, measurement_noise
    n, unit = len(a), np.eye(len(a))
    forward, information, covariance = a.T, c.T @ np.linalg.solve(r, c), np.array(process_noise)
    for _ in range(DOUBLINGS):
        try:
            shared = np.linalg.solve(unit + information @ covariance, np.hstack([forward, information]))
        except np.linalg.LinAlgError as error:
            raise NumericalFailure(
                "The stationary covariance cannot be computed in these numbers.",
                f"got R^v up to {np.abs(process_noise).max():.3g}, R^n up to {np.abs(r).max():.3g} and a model up to "
                f"{np.abs(a).max():.3g} per sample",
                "covariances of more similar size, or poles=",
            ) from error
        growth = forward.T @ covariance @ shared[:, :n]
        information = information + forward @ shared[:, n:] @ forward.T
        forward = forward @ shared[:, :n]
        covariance = covariance + (growth + growth.T) / 2.0
        information = (information + information.T) / 2.0
        if np.abs(growth).max() <= 1e-15 * np.abs(covariance).max():
            break
    return covariance
