"""The unscented Kalman filter: the paper's Algorithm 1, in matrix form.

Comments number the steps of Algorithm 1. Its γ of steps 1 and 5 is `SigmaPoints.spread`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from flexhinf.errors import InvalidInput
from flexhinf.estimation.filter import RecursiveFilter
from flexhinf.estimation.sigma_points import SigmaPoints
from flexhinf.plant import Gaussian, Plant
from flexhinf.scalars import cholesky, clip, gram, solve_lower, solve_lower_transposed

__all__ = ["UnscentedKalmanFilter"]


class SampledGaussian(NamedTuple):
    """A belief that carries the propagated sigma points (n, 2n + 1), for `redraw=False`."""

    mean: Any
    covariance: Any
    points: Any


class UnscentedKalmanFilter(RecursiveFilter):
    """Algorithm 1.

    Parameters
    ----------
    plant, period, process_noise, measurement_noise, mean, covariance
        As in `flexhinf.estimation.filter.RecursiveFilter`.
    alpha, beta, kappa : float
        Table 3.
    redraw : bool
        Step 5: new sigma points from the predicted covariance, which includes R^v. Without it the propagated points
        are used for the measurement (and a linear plant no longer gives the Kalman filter).
    bounds : mapping of str to (float, float), optional
        Intervals of states: the sigma points are clipped to them in the time and in the measurement update, and the
        estimate too. The paper's "bounded UKF" is not defined there; this is ours.

    Raises
    ------
    InvalidInput
        As the base class; and for a bound that is not an interval of a known state that contains the initial mean.
    """

    def __init__(
        self,
        plant: Plant,
        period: float,
        process_noise: Any,
        measurement_noise: Any,
        mean: Any,
        covariance: Any,
        alpha: float = 1.0,
        beta: float = 2.0,
        kappa: float = 0.0,
        redraw: bool = True,
        bounds: Mapping[str, tuple[float, float]] | None = None,
    ) -> None:
        super().__init__(plant, period, process_noise, measurement_noise, mean, covariance)
        self.sigma = SigmaPoints(plant.n, float(alpha), float(beta), float(kappa))
        self.redraw = bool(redraw)
        self.bounds = self._checked_bounds(bounds or {})
        if not self.redraw:
            points = self.draw(self.initial)
            self.initial = self._belief = SampledGaussian(*self.initial, points)

    @property
    def estimator_key(self) -> str:
        sigma = self.sigma
        scaling = (sigma.alpha, sigma.beta, sigma.kappa)
        return f"ukf {self.period!r} {self.sub_steps} {scaling} {self.redraw} {sorted(self.bounds.items())}"

    def time_update(self, belief: Any, u: Any, p: Any, process_noise: Any) -> Any:
        weights = self.sigma
        points = self.draw(belief)  # 1
        moved = np.stack([self.transition(x, u, p) for x in points.T], axis=1)  # 2
        moved = self.bounded(moved)
        mean = moved @ weights.mean_weights  # 3
        deviations = moved - mean[:, None]
        covariance = gram(deviations, weights.covariance_weights) + process_noise  # 4
        return Gaussian(mean, covariance) if self.redraw else SampledGaussian(mean, covariance, moved)

    def innovate(self, belief: Any, y: Any, u: Any, p: Any, measurement_noise: Any) -> tuple[Any, Any, Any]:
        weights = self.sigma
        points = self.draw(belief) if self.redraw else belief.points  # 5
        outputs = np.stack([np.atleast_1d(self.plant.output(x, u, p)) for x in points.T], axis=1)  # 6
        expected = outputs @ weights.mean_weights  # 7
        spread = outputs - expected[:, None]
        p_yy = gram(spread, weights.covariance_weights) + measurement_noise  # 8
        p_xy = gram(points - np.asarray(belief.mean)[:, None], weights.covariance_weights, spread)  # 9
        factor = cholesky(p_yy)
        gain = solve_lower_transposed(factor, solve_lower(factor, p_xy.T)).T  # 10
        innovation = y - expected
        mean = self.bounded(belief.mean + gain @ innovation)  # 11
        covariance = belief.covariance - gram(gain @ factor, np.ones(len(innovation)))  # 12: K P_yy Kᵀ
        corrected = Gaussian(mean, covariance)
        return (corrected if self.redraw else SampledGaussian(*corrected, points)), innovation, p_yy

    def draw(self, belief: Any) -> Any:
        """Sigma points of a belief, inside the bounds, (n, 2n + 1)."""
        return self.bounded(self.sigma.draw(belief.mean, belief.covariance))

    def bounded(self, states: Any) -> Any:
        """States (n,) or (n, N) clipped to the bounds."""
        if not self.bounds:
            return states
        states = np.array(states)
        for name, (low, high) in self.bounds.items():
            row = self.plant.index(name)
            states[row] = clip(states[row], low, high)
        return states

    def _checked_bounds(self, bounds: Mapping[str, tuple[float, float]]) -> dict[str, tuple[float, float]]:
        checked = {}
        for name, interval in bounds.items():
            row = self.plant.index(name)
            low, high = (float(edge) for edge in interval)
            if not low < high or not low <= self.initial.mean[row] <= high:
                raise InvalidInput(
                    f"The bounds of {name!r} are not an interval around the initial mean.",
                    f"expected low < high with low <= {self.initial.mean[row]:.6g} <= high, got ({low:.6g}, {high:.6g})",
                    "wider bounds, or another initial mean",
                )
            checked[name] = (low, high)
        return checked
