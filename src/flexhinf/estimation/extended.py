"""The extended Kalman filter with exact Jacobians of the sampled plant.

The Jacobian is that of the integrated map F itself, through symbols, not I + A·period: a comparison with a
filter that drops terms would say little. Nothing needs the matrix ∂F/∂x, only what it does to a square root of
the covariance: that is carried along, column by column, through every Runge–Kutta step.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np

from flexhinf.estimation.filter import RecursiveFilter
from flexhinf.plant import Gaussian
from flexhinf.scalars import apply, trace


class ExtendedKalmanFilter(RecursiveFilter):
    """Kalman filter along the estimate; parameters as in `flexhinf.estimation.filter.RecursiveFilter`."""

    @property
    def estimator_key(self) -> str:
        """Method, period and sub-steps: constants of the traced code."""
        return f"ekf {self.period!r} {self.sub_steps} x {self.stages}"

    @property
    def operations(self) -> int:
        """Roughly, the operations of both updates as one trace: derivatives along every state through F."""
        n = self.plant.n
        return n * (2 * self.stages * self.sub_steps * self.plant.traced_flow.n_instructions() + n * n)

    @cached_property
    def _tangent(self) -> Any:
        """(x, v, u, p) → ∂sub_step/∂x · v as a CasADi function."""
        import casadi as ca

        sizes = (self.plant.n, len(self.plant.inputs), self.plant.parameters.size)
        moved = trace(self.sub_step, *sizes, name="sub_step")
        inputs = [ca.SX.sym(name, size) for name, size in zip("xup", sizes)]
        direction = ca.SX.sym("v", self.plant.n)
        along = ca.densify(ca.jtimes(moved.call(inputs)[0], inputs[0], direction))
        return ca.Function("tangent", [inputs[0], direction, *inputs[1:]], [along], {"cse": True})

    def tangent(self, direction: Any, x: Any, u: Any, p: Any) -> Any:
        """Derivative of `sub_step` at x along a direction, (n,)."""
        return apply(self._tangent, x, direction, u, p)[0]

    def time_stages(self, run: Any, belief: Any, u: Any, p: Any, process_noise: Any) -> Gaussian:
        """x(k|k) → x(k+1|k): F(x̂, u) and A P Aᵀ + R^v with A = ∂F/∂x."""
        mean, spread = belief.mean, run.cholesky(belief.covariance)
        for _ in range(self.sub_steps):
            spread = run.columns(self.tangent, spread, mean, u, p)
            mean = run.call(self.sub_step, mean, u, p)
        return Gaussian(mean, run.gram(spread, np.ones(self.plant.n), process_noise))

    def innovation_stages(
        self, run: Any, belief: Any, y: Any, u: Any, p: Any, measurement_noise: Any
    ) -> tuple[Any, Any, Any]:
        """x(k|k−1) → (x(k|k), innovation, its covariance), with C = ∂H/∂x."""
        return self.linear_innovation(run, belief, y, u, p, measurement_noise)
