"""The stationary Kalman filter: the gain and covariance that no longer change."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from flexhinf.errors import NumericalFailure
from flexhinf.scalars import jacobian

if TYPE_CHECKING:
    from flexhinf.estimation.filter import RecursiveFilter

__all__ = ["linear_model", "stationary_covariance", "stationary_gain"]

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
