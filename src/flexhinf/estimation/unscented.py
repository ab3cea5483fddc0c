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
        Step 5: new sigma points from the predicted covariance, which includes R^v. Without it the propagated
        points are used for the measurement (and a linear plant no longer gives the Kalman filter).
    bounds : mapping of str to (float, float), optional
        Intervals of states: the sigma points are clipped to them in the time and in the measurement update,
        and the estimate too. The paper's "bounded UKF" is not defined there; this is ours.

    Raises
    ------
    InvalidInput
        As the base class; for scaling parameters that give no points; and for a bound that is not an interval
        of a known state that contains the initial mean.
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
        self.initial = self._belief = self.initial_at(self.initial.mean)

    @property
    def estimator_key(self) -> str:
        """Method, period, sub-steps, scaling and bounds: constants of the traced code."""
        sigma = self.sigma
        scaling = (sigma.alpha, sigma.beta, sigma.kappa)
        return f"ukf {self.period!r} {self.sub_steps} {scaling} {self.redraw} {sorted(self.bounds.items())}"

    def initial_at(self, mean: Any) -> Any:
        """The initial belief with another mean (n,), which must be inside the bounds; its points too."""
        belief = super().initial_at(mean)
        for name, (low, high) in self.bounds.items():
            if not low <= belief.mean[self.plant.index(name)] <= high:
                raise InvalidInput(
                    f"The mean is outside the bounds of {name!r}.",
                    f"expected {low:.6g} to {high:.6g}, got {belief.mean[self.plant.index(name)]:.6g}",
                    "wider bounds, or another mean",
                )
        if self.redraw:
            return belief
        return SampledGaussian(belief.mean, belief.covariance, self.draw(belief)[0])

    def time_update(self, belief: Any, u: Any, p: Any, process_noise: Any) -> Any:
        """Steps 1 to 4: x(k|k) → x(k+1|k)."""
        weights = self.sigma
        points, _ = self.draw(belief)  # 1
        moved = np.stack([self.transition(x, u, p) for x in points.T], axis=1)  # 2
        moved = self.bounded(moved)
        mean = moved @ weights.mean_weights  # 3
        deviations = moved - mean[:, None]
        covariance = gram(deviations, weights.covariance_weights) + process_noise  # 4
        return Gaussian(mean, covariance) if self.redraw else SampledGaussian(mean, covariance, moved)

    def innovate(self, belief: Any, y: Any, u: Any, p: Any, measurement_noise: Any) -> tuple[Any, Any, Any]:
        """Steps 5 to 12: x(k|k−1) → (x(k|k), innovation, its covariance)."""
        weights = self.sigma
        points, deviations = self.draw(belief) if self.redraw else kept(belief)  # 5
        outputs = np.stack([np.atleast_1d(self.plant.output(x, u, p)) for x in points.T], axis=1)  # 6
        expected = outputs @ weights.mean_weights  # 7
        spread = outputs - expected[:, None]
        p_yy = gram(spread, weights.covariance_weights) + measurement_noise  # 8
        p_xy = gram(deviations, weights.covariance_weights, spread)  # 9
        factor = cholesky(p_yy)
        gain = solve_lower_transposed(factor, solve_lower(factor, p_xy.T)).T  # 10
        innovation = y - expected
        mean = self.bounded(belief.mean + gain @ innovation)  # 11
        covariance = belief.covariance - gram(gain @ factor, np.ones(len(innovation)))  # 12: K P_yy Kᵀ
        corrected = Gaussian(mean, covariance)
        return (
            corrected if self.redraw else SampledGaussian(mean, covariance, points),
            innovation,
            p_yy,
        )

    def draw(self, belief: Any) -> tuple[Any, Any]:
        """Sigma points inside the bounds, and their deviations from the mean, both (n, 2n + 1)."""
        offsets = self.sigma.offsets(belief.covariance)
        points = np.asarray(belief.mean)[:, None] + offsets
        if not self.bounds:
            return points, offsets  # not points − mean: those digits are lost already
        points = self.bounded(points)
        return points, points - np.asarray(belief.mean)[:, None]

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
            self.plant.index(name)
            try:
                low, high = np.asarray(interval, dtype=float).tolist()
            except (TypeError, ValueError):
                low = high = np.nan
            if not low < high:
                raise InvalidInput(
                    f"The bounds of {name!r} are not an interval.",
                    f"expected (low, high) with low < high, got {interval!r}",
                    f"bounds={{{name!r}: (-1.0, 1.0)}}",
                )
            checked[name] = (low, high)
        return checked


def kept(belief: SampledGaussian) -> tuple[Any, Any]:
    """The propagated points of a belief, and their deviations from its mean."""
    return belief.points, belief.points - np.asarray(belief.mean)[:, None]
