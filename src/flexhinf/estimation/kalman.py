"""The unscented Kalman filter, the paper's Algorithm 1 in matrix form, and the extended one.

Comments number the steps of Algorithm 1. Its γ of steps 1 and 5 is `SigmaPoints.spread`, Eq. (10).

The Jacobian of the extended filter is exact, that of the integrated map F itself, through symbols, not I + A·period: a
comparison with a filter that drops terms would say little. The matrix ∂F/∂x itself is not needed, only its product with
a square root of the covariance: that is computed, column by column, through every Runge–Kutta step.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from flexhinf.codegen import DIRECT
from flexhinf.errors import InvalidInput
from flexhinf.estimation.filter import RecursiveFilter, correction, gained, rooted
from flexhinf.plant import Gaussian, Plant
from flexhinf.scalars import apply, cholesky, clip, trace
from flexhinf.scalars.trace import linear
from flexhinf.validation import read_only, real_array, real_number, value_text


class SigmaPoints:
    """The scaled unscented transform of n variables, which has 2n + 1 points.

    `alpha`, `beta`, `kappa`: Table 3. λ = α²(n + κ) − n. `spread`: √(n + λ), the paper's γ of Eq. (10); γ is also the
    attenuation level. `mean_weights`, `covariance_weights`: Wᵐ and Wᶜ, (2n + 1,). Raises InvalidInput: if the spread is
    not a positive number.
    """

    def __init__(self, n: int, alpha: float = 1.0, beta: float = 2.0, kappa: float = 0.0) -> None:
        if not (alpha > 0.0 and n + kappa > 0.0 and math.isfinite(beta + alpha + kappa)):
            raise InvalidInput(
                "These scaling parameters give no sigma points.",
                f"expected finite numbers with alpha > 0 and kappa > {-n}, got {alpha=}, {beta=}, {kappa=}",
                "the paper's alpha=1, beta=2, kappa=0",
            )
        self.n, self.alpha, self.beta, self.kappa = n, alpha, beta, kappa
        self.spread = alpha * math.sqrt(n + kappa)
        total = self.spread**2
        self.mean_weights = read_only(np.array([(total - n) / total] + [0.5 / total] * (2 * n)))
        weights = self.mean_weights.copy()
        weights[0] += 1.0 - alpha**2 + beta
        self.covariance_weights = read_only(weights)
        if weights.min() < 0.0:
            warnings.warn(
                f"The central covariance weight is negative ({weights[0]:.4g}): the estimated covariance may become "
                "indefinite. With alpha=1, beta=2, kappa=0 none is negative.",
                stacklevel=3,
            )

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(read_only(state))  # copies share their arrays

    def offsets(self, column: Any) -> tuple[Any, Any]:
        """Deviations of two points from the mean, for a column of a square root of P."""
        offset = self.spread * column
        return offset, -offset

    def pair(self, column: Any, mean: Any) -> tuple[Any, Any]:
        """The two sigma points, mean ± offset."""
        offset, other = self.offsets(column)
        return mean + offset, mean + other


class SampledGaussian(NamedTuple):
    """A belief that carries the propagated sigma points (n, 2n + 1), for `redraw=False`."""

    mean: Any
    covariance: Any
    points: Any


class UnscentedKalmanFilter(RecursiveFilter):
    """The unscented Kalman filter, the paper's Algorithm 1.

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
        self.sigma = SigmaPoints(plant.n, *map(real_number, (alpha, beta, kappa)))
        self.redraw = bool(redraw)
        self.bounds = self._checked_bounds(bounds or {})
        self.initial = self._belief = self.initial_at(self.initial.mean)

    def settings(self) -> dict[str, Any]:
        """Arguments of the constructor by name."""
        sigma = self.sigma
        own = {"alpha": sigma.alpha, "beta": sigma.beta, "kappa": sigma.kappa}
        return {**super().settings(), **own, "redraw": self.redraw, "bounds": dict(self.bounds)}

    @property
    def estimator_key(self) -> str:
        """Method, period, sub-steps, scaling and bounds: constants of the traced code."""
        sigma = self.sigma
        scaling = (sigma.alpha, sigma.beta, sigma.kappa)
        steps, bounds = f"{self.sub_steps} x {self.stages}", sorted(self.bounds.items())
        return f"ukf {self.period!r} {steps} {scaling} {self.redraw} {bounds}"

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
        points = self.points(DIRECT, belief.mean, cholesky(belief.covariance))
        return read_only(SampledGaussian(belief.mean, belief.covariance, points))

    @property
    def operations(self) -> int:
        """Roughly, the operations of both updates as one trace: sigma points through F, and covariances."""
        n, points = self.plant.n, 2 * self.plant.n + 1
        return points * (self.stages * self.sub_steps * self.plant.traced_flow.n_instructions() + n * n)

    def time_stages(self, run: Any, belief: Any, u: Any, p: Any, process_noise: Any) -> Any:
        """Steps 1 to 4: x(k|k) → x(k+1|k)."""
        points = self.points(run, belief.mean, run.cholesky(belief.covariance))  # 1
        moved = self.inside(run, run.sweep(self.moved, points, u, p))  # 2
        mean = run.combination(moved, self.sigma.mean_weights)  # 3
        deviations = self.deviations(run, moved, mean)
        covariance = run.gram(deviations, self.sigma.covariance_weights, process_noise)  # 4
        return Gaussian(mean, covariance) if self.redraw else SampledGaussian(mean, covariance, moved)

    def innovation_stages(
        self, run: Any, belief: Any, y: Any, u: Any, p: Any, measurement_noise: Any
    ) -> tuple[Any, Any, Any]:
        """Steps 5 to 12: x(k|k−1) → (x(k|k), innovation, its covariance).

        Where the output is linear in x, the sums over sigma points (steps 7 to 9) are those over the columns of L,
        P = L Lᵀ, whatever the weights: Σ wᵢ dᵢ dᵢᵀ = P, and the points' mean is x̂. Half as many columns then do.
        """
        if self.linear_output and self.redraw and not self.bounds:
            return self.linear_innovation(run, belief, y, u, p, measurement_noise)
        weights = self.sigma.covariance_weights
        points, deviations, centre = self.redrawn(run, belief)  # 5
        outputs = run.columns(self.output, points, u, p)  # 6
        expected = run.combination(outputs, self.sigma.mean_weights)  # 7
        spread = self.deviations(run, outputs, expected)
        known = ((centre, deviations), (expected, spread), weights, y, measurement_noise)
        if self.redraw:
            corrected, innovation, p_yy = correction(run, *known)
            mean, covariance = corrected
        else:  # the points do not stand for the whole of P, which has R^v beside them: step 12 as it is printed
            mean, gain, factor, innovation, p_yy = gained(run, *known)
            root = run.columns(rooted, gain, factor)
            covariance = run.gram(root.T, -np.ones(len(self.plant.outputs)), belief.covariance)
        if self.bounds:
            mean = run.call(self.bounded, mean)
        corrected = Gaussian(mean, covariance) if self.redraw else SampledGaussian(mean, covariance, points)
        return corrected, innovation, p_yy

    @cached_property
    def linear_output(self) -> bool:
        """Whether H is linear in x, whatever the input and the parameters."""
        sizes = (self.plant.n, len(self.plant.inputs), self.plant.parameters.size)
        return linear(trace(self.output, *sizes))

    def points(self, run: Any, mean: Any, root: Any) -> Any:
        """Sigma points inside the bounds, (n, 2n + 1)."""
        return self.inside(run, run.beside(mean, self.sigma.pair, root, mean))

    def redrawn(self, run: Any, belief: Any) -> tuple[Any, Any, Any]:
        """Sigma points for the measurement, their deviations, both (n, 2n + 1), and the mean that those are from.

        Clipped points represent a narrower prior than the belief: steps 9 to 12 must use its mean and deviations, or
        what is subtracted from P could exceed it.
        """
        mean = belief.mean
        if not self.redraw:
            return belief.points, self.deviations(run, belief.points, mean), mean
        root = run.cholesky(belief.covariance)
        points = self.points(run, mean, root)
        if not self.bounds:  # not points − mean: those digits are lost already
            still = run.call(np.zeros_like, mean)
            return points, run.beside(still, self.sigma.offsets, root), mean
        centre = run.combination(points, self.sigma.mean_weights)
        return points, self.deviations(run, points, centre), centre

    def deviations(self, run: Any, points: Any, mean: Any) -> Any:
        """Points minus a mean, (n, 2n + 1)."""
        return run.columns(less, (points.T, mean.reshape(1, len(mean)))).T

    def inside(self, run: Any, points: Any) -> Any:
        """Points clipped to the bounds."""
        return run.columns(self.bounded, points) if self.bounds else points

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
                low, high = real_array(interval).tolist()
            except (TypeError, ValueError):
                low = high = np.nan
            if not low < high:
                raise InvalidInput(
                    f"The bounds of {name!r} are not an interval.",
                    f"expected (low, high) with low < high, got {value_text(interval)}",
                    f"bounds={{{name!r}: (-1.0, 1.0)}}",
                )
            checked[name] = (low, high)
        return checked


def less(row: Any, mean: Any) -> Any:
    """Deviations of numbers from their mean."""
    return row - mean


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
