"""The extended Kalman filter with exact Jacobians of the sampled plant.

The Jacobian is that of the integrated map F itself, through symbols, not I + A·period: a comparison with a
filter that drops terms would say little.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from flexhinf.estimation.filter import RecursiveFilter
from flexhinf.plant import Gaussian, Plant
from flexhinf.scalars import cholesky, gram, jacobian, solve_lower, solve_lower_transposed

__all__ = ["ExtendedKalmanFilter"]


class ExtendedKalmanFilter(RecursiveFilter):
    """Kalman filter along the estimate; parameters as in `flexhinf.estimation.filter.RecursiveFilter`."""

    def __init__(
        self,
        plant: Plant,
        period: float,
        process_noise: Any,
        measurement_noise: Any,
        mean: Any,
        covariance: Any,
    ) -> None:
        super().__init__(plant, period, process_noise, measurement_noise, mean, covariance)
        table, sizes = plant.parameters, (plant.n, len(plant.inputs), plant.parameters.size)
        self._moved = jacobian(
            lambda x, u, p: self.transition(x, u, table.named(p)), *sizes, name="transition"
        )
        self._measured = jacobian(
            lambda x, u, p: np.atleast_1d(plant.output(x, u, table.named(p))), *sizes, name="measurement"
        )

    @property
    def estimator_key(self) -> str:
        """Method, period and sub-steps: constants of the traced code."""
        return f"ekf {self.period!r} {self.sub_steps}"

    def time_update(self, belief: Any, u: Any, p: Any, process_noise: Any) -> Gaussian:
        """x(k|k) → x(k+1|k): F(x̂, u) and A P Aᵀ + R^v with A = ∂F/∂x."""
        mean, a = self._moved(belief.mean, u, self.plant.parameters.flat(p))
        spread = a @ cholesky(belief.covariance)  # a square root, so that P stays symmetric and is checked
        return Gaussian(mean, gram(spread, np.ones(len(a))) + process_noise)

    def innovate(self, belief: Any, y: Any, u: Any, p: Any, measurement_noise: Any) -> tuple[Any, Any, Any]:
        """x(k|k−1) → (x(k|k), innovation, its covariance), with C = ∂H/∂x."""
        expected, c = self._measured(belief.mean, u, self.plant.parameters.flat(p))
        p_xy = belief.covariance @ c.T
        p_yy = c @ p_xy + measurement_noise
        factor = cholesky(p_yy)
        gain = solve_lower_transposed(factor, solve_lower(factor, p_xy.T)).T
        innovation = y - expected
        covariance = belief.covariance - gram(gain @ factor, np.ones(len(innovation)))
        return Gaussian(belief.mean + gain @ innovation, covariance), innovation, p_yy
