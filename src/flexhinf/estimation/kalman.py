"""Kalman filters: the unscented one, the paper's Algorithm 1 in matrix form, and the extended one.

Comments number the steps of Algorithm 1. Its γ of steps 1 and 5 is `SigmaPoints.spread`, Eq. (10).

The Jacobian of the extended filter is exact, that of the integrated map F itself, through symbols, not I + A·period: a
comparison with a filter that drops terms would say little. The matrix ∂F/∂x itself is not needed, only its product with
a square root of the covariance: that is computed, column by column, through every Runge–Kutta step.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping
from functools import cached_property, partial
from typing import Any, NamedTuple

import numpy as np

from flexhinf.codegen import DIRECT
from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.estimation.filter import Form, RecursiveFilter, correction, gained, rooted
from flexhinf.estimation.square_root import Pairs, RootGaussian, correction_of_rows, root_prediction
from flexhinf.plant import Gaussian, Plant
from flexhinf.scalars import apply, cholesky, clip, trace
from flexhinf.scalars.differences import difference
from flexhinf.validation import checked_kind, read_only, real_array, real_number, value_text


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
        form: Form = "covariance",
    ) -> None:
        super().__init__(plant, period, process_noise, measurement_noise, mean, covariance, form)
        self.sigma = SigmaPoints(plant.n, *map(real_number, (alpha, beta, kappa)))
        self.redraw = bool(redraw)
        if form == "square_root":
            refuse_if(
                not self.redraw or self.sigma.covariance_weights[0] < 0.0,
                "This unscented filter has no square-root form.",
                f"expected redraw=True and scaling parameters without a negative weight, got {redraw=}, {alpha=}, "
                f"{beta=}, {kappa=}",
                'form="covariance", or alpha=1, beta=2, kappa=0',
            )
        what, advice = "The bounds of the estimates are no mapping.", "bounds={'stiffness': (0.5, 2.0)}"
        checked_kind(what, {} if bounds is None else bounds, Mapping, "(low, high) by name", advice)
        self.bounds: dict[str, tuple[float, float]] = {}
        for name, interval in (bounds or {}).items():
            plant.index(name)
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
            self.bounds[name] = (low, high)
        self.initial = self._belief = self.initial_at(self.initial.mean)

    def settings(self) -> dict[str, Any]:
        """Arguments of the constructor by name."""
        sigma = self.sigma
        return {
            **super().settings(),
            "alpha": sigma.alpha,
            "beta": sigma.beta,
            "kappa": sigma.kappa,
            "redraw": self.redraw,
            "bounds": dict(self.bounds),
            "form": self.form,
        }

    @property
    def estimator_key(self) -> str:
        """Method, period, sub-steps, scaling and bounds: constants of the traced code."""
        sigma = self.sigma
        scaling = (sigma.alpha, sigma.beta, sigma.kappa)
        steps, bounds = f"{self.sub_steps} x {self.stages}", sorted(self.bounds.items())
        return f"ukf {self.form} {self.period!r} {steps} {scaling} {self.redraw} {bounds}"

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
        if self.form == "square_root":
            return self._predicted(run, belief, u, p, process_noise)
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
        if self.form == "square_root":
            return self._corrected(run, belief, y, u, p, measurement_noise)
        weights = self.sigma.covariance_weights
        points, deviations, centre = self.redrawn(run, belief)  # 5
        outputs = run.columns(self.output, points, u, p)  # 6
        expected = run.combination(outputs, self.sigma.mean_weights)  # 7
        spread, still = self.deviations(run, outputs, expected), np.zeros(len(self.plant.outputs))
        innovation, spread, noise = self.admitted(run, y, expected, spread, measurement_noise, still)
        known = ((centre, deviations), (still, spread), weights, innovation, noise)
        if self.redraw:
            corrected, innovation, p_yy = correction(run, *known)
            mean, covariance = corrected
        else:  # the points do not stand for the whole of P, which has R^v beside them: step 12 as it is printed
            mean, gain, factor, innovation, p_yy = gained(run, *known)
            covariance = run.gram(
                run.columns(rooted, gain, factor).T, -np.ones(len(self.plant.outputs)), belief.covariance
            )
        if self.bounds:
            mean = run.call(self.bounded, mean)
        corrected = Gaussian(mean, covariance) if self.redraw else SampledGaussian(mean, covariance, points)
        return corrected, innovation, p_yy

    # With rows of deviations ----------------------------------------------------------------------
    def _predicted(self, run: Any, belief: Any, u: Any, p: Any, process_noise: Any) -> RootGaussian:
        stepped = partial(self._stepped, run, u, p)
        mean, moved = run.repeat(self.sub_steps, stepped, belief.mean, self._spread(run, belief).T)
        shift, rows = self._halves(run, self.inside(run, moved.T, mean))
        return RootGaussian(run.call(np.add, mean, shift), root_prediction(run, rows, process_noise))

    def _corrected(self, run: Any, belief: Any, y: Any, u: Any, p: Any, measurement_noise: Any) -> Any:
        mean, apart = belief.mean, self.inside(run, self._spread(run, belief), belief.mean)
        outputs = run.columns(self._output_difference, apart, mean, u, p)
        shift, rows = self._halves(run, run.columns(_joined, (outputs, apart)))
        expected = run.call(self.output, mean, u, p)
        shift, mean = run.call(_parted, y, shift, mean)
        innovation, columns, noise = self.admitted(run, y, expected, rows.T, measurement_noise, shift)
        corrected, spread = correction_of_rows(run, mean, columns.T, innovation, noise)
        if self.bounds:
            corrected = corrected._replace(mean=run.call(self.bounded, corrected.mean))
        return corrected, innovation, spread

    def _spread(self, run: Any, belief: Any) -> Any:
        """Deviations of the sigma points from the mean, (n, 2n)."""
        up, down = run.columns(self.sigma.offsets, belief.root.T)
        return run.stacked(up.T, down.T).T

    def _stepped(self, run: Any, u: Any, p: Any, mean: Any, rows: Any) -> tuple[Any, Any]:
        """The mean, and deviations (2n, n) from it, after one of the `sub_steps`."""
        means: list[Any] = []

        def stages(inner: Any, deviation: Any, mean: Any, u: Any, p: Any) -> Any:
            pairs: Any = Pairs(inner, self.flow, self._flow_difference)
            mean, deviation = self.sub_step((mean, deviation), u, p, pairs)
            means.append(mean)
            return deviation

        moved = run.sweep(stages, rows.T, mean, u, p)
        return means[-1], moved.T

    def _halves(self, run: Any, deviations: Any) -> tuple[Any, Any]:
        """Mean of deviations (k, 2n) by their weights, and rows whose WᵀW is their covariance."""
        n, s = self.plant.n, self.sigma.spread
        up, down = deviations.T[:n].T, deviations.T[n:].T
        odd, even = run.columns(partial(_odd_and_even, s), (up, down))
        shift = run.combination(even, np.full(n, 1.0 / s))
        even = run.columns(partial(_centred, s), even, shift)
        centre = run.call(partial(_scaled, math.sqrt(self.sigma.covariance_weights[0])), shift)
        return shift, run.stacked(odd.T, even.T, centre)

    @cached_property
    def _differences(self) -> tuple[Any, Any]:
        sizes = (self.plant.n, len(self.plant.inputs), self.plant.parameters.size)
        return tuple(difference(trace(function, *sizes)) for function in (self.flow, self.output))  # type: ignore[return-value]

    def _flow_difference(self, x: Any, deviation: Any, u: Any, p: Any) -> Any:
        return apply(self._differences[0], x, deviation, u, p)[0]

    def _output_difference(self, deviation: Any, x: Any, u: Any, p: Any) -> Any:
        return apply(self._differences[1], x, deviation, u, p)[0]

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
            return points, run.beside(run.call(np.zeros_like, mean), self.sigma.offsets, root), mean
        centre = run.combination(points, self.sigma.mean_weights)
        return points, self.deviations(run, points, centre), centre

    def deviations(self, run: Any, points: Any, mean: Any) -> Any:
        """Points minus a mean, (n, 2n + 1)."""
        return run.columns(_less, (points.T, mean.reshape(1, len(mean)))).T

    def inside(self, run: Any, points: Any, *about: Any) -> Any:
        """Points, or deviations from a mean (n,), clipped to the bounds."""
        return run.columns(self.bounded, points, *about) if self.bounds else points

    def bounded(self, states: Any, about: Any = None) -> Any:
        """States (n,) or (n, N), or deviations from a mean (n,), clipped to the bounds."""
        states = np.array(states)
        for name, (low, high) in self.bounds.items():
            row = self.plant.index(name)
            at = 0.0 if about is None else about[row]
            states[row] = clip(states[row], low - at, high - at)
        return states


def _odd_and_even(spread: float, up: Any, down: Any) -> tuple[Any, Any]:
    """Halves of the difference and the sum of a pair's deviations, in parts of the spread."""
    return (0.5 / spread) * (up - down), (0.5 / spread) * (up + down)


def _centred(spread: float, even: Any, shift: Any) -> Any:
    return even - shift / spread


def _scaled(factor: float, row: Any) -> Any:
    return (factor * row).reshape(1, len(row))


def _joined(first: Any, second: Any) -> Any:
    return np.concatenate([first, second])


def _parted(y: Any, shift: Any, mean: Any) -> tuple[Any, Any]:
    """The shift of the outputs, and the mean of the sigma points."""
    return shift[: len(y)], mean + shift[len(y) :]


def _less(row: Any, mean: Any) -> Any:
    return row - mean


class ExtendedKalmanFilter(RecursiveFilter):
    """Kalman filter along the estimate; parameters as in `flexhinf.estimation.filter.RecursiveFilter`."""

    def settings(self) -> dict[str, Any]:
        """Arguments of the constructor by name."""
        return {**super().settings(), "form": self.form}

    @property
    def estimator_key(self) -> str:
        """Method, period and sub-steps: constants of the traced code."""
        return f"ekf {self.form} {self.period!r} {self.sub_steps} x {self.stages}"

    @property
    def operations(self) -> int:
        """Roughly, the operations of both updates as one trace: derivatives along every state through F."""
        n = self.plant.n
        return n * (2 * self.stages * self.sub_steps * self.plant.traced_flow.n_instructions() + n * n)

    @cached_property
    def _tangent(self) -> Any:
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

    def time_stages(self, run: Any, belief: Any, u: Any, p: Any, process_noise: Any) -> Any:
        """x(k|k) → x(k+1|k): F(x̂, u) and A P Aᵀ + R^v with A = ∂F/∂x."""
        carries_root = self.form == "square_root"
        mean, spread = belief.mean, belief.root.T if carries_root else run.cholesky(belief.covariance)
        for _ in range(self.sub_steps):
            spread = run.columns(self.tangent, spread, mean, u, p)
            mean = run.call(self.sub_step, mean, u, p)
        if carries_root:
            return RootGaussian(mean, root_prediction(run, spread.T, process_noise))
        return Gaussian(mean, run.gram(spread, np.ones(self.plant.n), process_noise))

    innovation_stages = RecursiveFilter.linear_innovation  # with C = ∂H/∂x
