"""Kalman filters: the unscented one, the paper's Algorithm 1 in matrix form, and the extended one.

Comments number the steps of Algorithm 1. Its γ of steps 1 and 5 is `SigmaPoints.spread`, Eq. (10).

The Jacobian of the extended filter is exact, that of the integrated map F itself, through symbols, not I + A·period: a
comparison with a filter that drops terms would say little. The matrix ∂F/∂x itself is not needed, only its product with
a square root of the covariance: that is computed, column by column, through every Runge–Kutta step.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from functools import cached_property, partial
from typing import Any, NamedTuple, cast

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from flexhinf.arrays import Elements
from flexhinf.codegen import DIRECT
from flexhinf.codegen.differences import difference
from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.estimation.beliefs import WELL
from flexhinf.estimation.bounds import bounded_places, projected
from flexhinf.estimation.conditions import conditioned, lesser, pivots_kept
from flexhinf.estimation.diagnosis import EPS
from flexhinf.estimation.filter import RecursiveFilter, correction, gained, rooted, seen_of
from flexhinf.estimation.interface import Form
from flexhinf.estimation.square_root import (
    Pairs,
    RootGaussian,
    correction_of_rows,
    reciprocal_condition,
    root_prediction,
)
from flexhinf.plant import Plant, Sensor, turned
from flexhinf.plant.protocols import Belief
from flexhinf.scalars import apply, cholesky, clip, trace
from flexhinf.scalars.run import Run
from flexhinf.validation import read_only, real_number


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
        # What is left of numbers of this size by rounding is zero, as of the cubature filter.
        if abs(weights[0]) <= 4.0 * EPS * (1.0 + n / total + alpha**2 + abs(beta)):
            weights[0] = 0.0
        self.covariance_weights = read_only(weights)
        if weights.min() < 0.0:
            warnings.warn(
                f"The central covariance weight is negative ({weights[0]:.4g}), so only the covariance form is left, "
                "and the covariance may become indefinite. With alpha=1, beta=2, kappa=0 none is negative.",
                stacklevel=3,
            )

    def __setstate__(self, state: dict[str, object]) -> None:
        vars(self).update(read_only(state))  # copies share their arrays

    def offsets(self, column: Elements) -> tuple[Elements, Elements]:
        """Deviations of two points from the mean, for a column of a square root of P."""
        offset = self.spread * column
        return offset, -offset

    def pair(self, column: Elements, mean: Elements) -> tuple[Elements, Elements]:
        """The two sigma points, mean ± offset."""
        offset, other = self.offsets(column)
        return mean + offset, mean + other


class SampledGaussian(NamedTuple):
    """A belief that carries the propagated sigma points (n, 2n + 1), for `redraw=False`."""

    mean: Elements
    covariance: Elements
    points: Elements
    rcond: Elements = WELL


class UnscentedKalmanFilter(RecursiveFilter):
    """The unscented Kalman filter, the paper's Algorithm 1.

    Parameters
    ----------
    plant, period, process_noise, measurement_noise, mean, covariance, gate, sensors
        As in `flexhinf.estimation.filter.RecursiveFilter`.
    form : {"square_root", "covariance"}, optional
        As there. By default "square_root", or "covariance" where that does not exist: with `redraw=False`, (with a
        warning) with scaling parameters that make a covariance weight negative, and in a subclass that moves points
        itself, by a `moved` or `sub_step` of its own: rows are moved by differences of the plant's flow.
    alpha, beta, kappa : float
        Table 3.
    redraw : bool
        Step 5: new sigma points from the predicted covariance, which includes R^v. Without it the propagated
        points are used for the measurement (and a linear plant no longer gives the Kalman filter).
    bounds : mapping of str to (float, float), optional
        Intervals of states: the sigma points are clipped to them in the time and in the measurement update,
        and the estimate too [kandepu2008]. The paper's "bounded UKF" is not defined there; this is ours. Bound
        parameters and states that are not measured.

    Raises
    ------
    InvalidInput
        As the base class; for scaling parameters that give no points; and for a bound that is not an interval
        of a known state that contains the initial mean.

    Examples
    --------
    >>> import flexhinf as fh
    >>> import numpy as np
    >>> plant = fh.paper_arm().plant()
    >>> ukf = fh.UnscentedKalmanFilter(plant, 1e-3, 1e-6, 1e-6, mean=np.zeros(4), covariance=1e-2)
    >>> ukf.correct([0.1])
    >>> ukf.predict([0.0])
    >>> bool(0.09 < ukf.mean[0] < 0.1)
    True
    """

    _takes_exact = True

    def __init__(
        self,
        plant: Plant,
        period: float,
        process_noise: ArrayLike,
        measurement_noise: ArrayLike | None,
        mean: ArrayLike,
        covariance: ArrayLike,
        alpha: float = 1.0,
        beta: float = 2.0,
        kappa: float = 0.0,
        redraw: bool = True,
        bounds: Mapping[str, tuple[float, float]] | None = None,
        form: Form | None = None,
        gate: float | None = None,
        sensors: Sequence[Sensor] | Sensor | None = None,
    ) -> None:
        super().__init__(
            plant,
            period,
            process_noise,
            measurement_noise,
            mean,
            covariance,
            form or "covariance",
            gate,
            sensors,
            bounds,
        )
        plant = self.plant
        self.sigma = SigmaPoints(plant.n, *map(real_number, (alpha, beta, kappa)))
        self.redraw = bool(redraw)
        refuse_if(
            gate is not None and not self.redraw,
            "Propagated points do not stand for the whole predicted variance, so no gate can judge by them.",
            f"expected redraw=True with a gate, got redraw={redraw!r}, gate={gate!r}",
            "gate=None, or redraw=True",
        )
        kind, base = type(self), RecursiveFilter
        own = [name for name in ("moved", "sub_step") if getattr(kind, name) is not getattr(base, name)]
        unrooted = bool(own) or not self.redraw or self.sigma.covariance_weights[0] < 0.0
        if form is None:
            self.form = "covariance" if unrooted else "square_root"
        refuse_if(
            form == "square_root" and unrooted,
            "This unscented filter has no square-root form.",
            "expected redraw=True, scaling parameters without a negative weight, and no other `moved` or `sub_step` in "
            f"a subclass, got {redraw=}, {alpha=}, {beta=}, {kappa=}, a subclass with {own}",
            'form="covariance", or alpha=1, beta=2, kappa=0',
        )
        self.initial = self._belief = self.initial_at(self.initial.mean)

    def settings(self) -> dict[str, object]:
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
            "gate": self.gate,
        }

    @property
    def estimator_key(self) -> str:
        """Method, period, sub-steps, scaling, bounds and gate: constants of the traced code."""
        sigma = self.sigma
        scaling = (sigma.alpha, sigma.beta, sigma.kappa)
        steps, bounds = f"{self.sub_steps} x {self.stages}", sorted(self.bounds.items())
        exact = " exact" * self._exact
        return f"ukf {self.form} {self.period!r} {steps} {scaling} {self.redraw} {bounds} {self.gate}{exact}"

    def initial_at(self, mean: ArrayLike) -> Belief:
        """The initial belief with another mean (n,), its points too."""
        belief = super().initial_at(mean)
        if self.redraw:
            return belief
        points = self.points(DIRECT, belief.mean, cholesky(belief.covariance))
        return read_only(SampledGaussian(belief.mean, belief.covariance, points))

    @property
    def operations(self) -> int:
        """Roughly, the operations of both updates as one trace: sigma points through F, and covariances."""
        n, points = self.plant.n, 2 * self.plant.n + 1
        return points * (self.stages * self.sub_steps * self.plant.traced_flow.n_instructions() + n * n)

    def time_stages(
        self, run: Run, belief: Belief, u: Elements, p: Elements, process_noise: Elements
    ) -> Belief:
        """Steps 1 to 4: x(k|k) → x(k+1|k)."""
        if self.form == "square_root":
            mean, rows = self.moved_rows(run, belief, u, p)
            root = root_prediction(run, rows, process_noise)
            return belief._replace(mean=mean, root=root, **conditioned(run, belief, np.ones, 1))
        run.section("Algorithm 1, step 1: sigma points X of the estimate x, P = L L^T")
        root = run.cholesky(belief.covariance)
        points = self.points(run, belief.mean, root)  # 1
        run.section("Step 2: the model of the robot moves each of them over a period, X <- F(X, u)")
        moved = _about_first(run, self.wrapped, run.sweep(self.moved, points, u, p))  # 2
        moved = self.inside(run, moved)
        run.section("Step 3: the prediction x <- sum of w X")
        mean = run.combination(moved, self.sigma.mean_weights)  # 3
        run.section("Step 4: its covariance P <- sum of w (X - x) (X - x)^T + R^v")
        deviations = self.deviations(run, moved, mean)
        covariance = run.gram(deviations, self.sigma.covariance_weights, process_noise)  # 4
        more = conditioned(run, belief, pivots_kept, root, belief.covariance)
        more |= {} if self.redraw else {"points": moved}
        return belief._replace(mean=mean, covariance=covariance, **more)

    def innovation_stages(
        self, run: Run, belief: Belief, y: Elements, u: Elements, p: Elements, measurement_noise: Elements
    ) -> tuple[Belief, Elements, Elements]:
        """Steps 5 to 12: x(k|k−1) → (x(k|k), innovation, its covariance).

        Where the output is linear in x, the sums over sigma points (steps 7 to 9) are those over the columns of L,
        P = L Lᵀ, whatever the weights: Σ wᵢ dᵢ dᵢᵀ = P, and the points' mean is x̂. Half as many columns then do.
        """
        if self.linear_output and self.redraw and not self.bounds:
            return self.linear_innovation(run, belief, y, u, p, measurement_noise)
        if self.form == "square_root":
            return self._corrected(run, belief, y, u, p, measurement_noise)
        weights = self.sigma.covariance_weights
        points, deviations, centre, more = self.redrawn(run, belief)  # 5
        outputs = _about_first(run, self.angles, run.columns(self.output, points, u, p))  # 6
        expected = run.combination(outputs, self.sigma.mean_weights)  # 7
        spread, still = self.deviations(run, outputs, expected), np.zeros(len(self.plant.outputs))
        slope = partial(self._slope, run, belief.mean, u, p)
        gate = self.gated(run, belief, lambda: spread, weights, slope, measurement_noise)
        _, innovation, seen, noise, counts = self.admitted(
            run, y, expected, spread, measurement_noise, still, gate
        )
        known = ((centre, deviations), (still, seen), weights, innovation, noise)
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
        if "rcond" in counts and "rcond" in more:
            more["rcond"] = run.call(lesser, counts["rcond"], more["rcond"])
        return belief._replace(mean=mean, covariance=covariance, **(counts | more)), innovation, p_yy

    # With rows of deviations ----------------------------------------------------------------------
    def moved_rows(
        self, run: Run, belief: RootGaussian, u: Elements, p: Elements
    ) -> tuple[Elements, Elements]:
        """x(k+1|k), and rows of its covariance before R^v is added: first what F makes of the belief's n rows, each in
        its place, then those that belong to none of them."""
        stepped = partial(self._stepped, run, u, p)
        mean, moved = run.repeat(self.sub_steps, stepped, belief.mean, self._spread(run, belief).T)
        apart = self.inside(run, _shorter(run, self.wrapped, moved.T), mean)
        if not self.bounds:
            shift, rows = self._halves(run, apart)
            return run.call(np.add, mean, shift), rows
        centre = run.call(self.bounded, mean)  # the central point is clipped like the others
        shift, rows = self._halves(run, run.columns(_seen_from, apart, mean, centre))
        return run.call(self._added_within, centre, shift), rows

    def _corrected(
        self, run: Run, belief: Belief, y: Elements, u: Elements, p: Elements, measurement_noise: Elements
    ) -> tuple[Belief, Elements, Elements]:
        mean, apart = belief.mean, self.inside(run, self._spread(run, belief), belief.mean)
        outputs = _shorter(run, self.angles, run.columns(self._output_difference, apart, mean, u, p))
        shift, rows = self._halves(run, run.columns(_joined, (outputs, apart)))
        expected = run.call(self.output, mean, u, p)
        shift, mean = run.call(_parted, y, shift, mean)
        slope, seen = partial(self._slope, run, belief.mean, u, p), partial(run.columns, _first, rows.T, y)
        gate = self.gated(run, belief, seen, np.ones(len(rows)), slope, measurement_noise)
        flags, innovation, columns, noise, more = self.admitted(
            run, y, expected, rows.T, measurement_noise, shift, gate
        )
        corrected, spread, gains = correction_of_rows(run, mean, columns.T, innovation, noise)
        c = run.columns(seen_of, slope(), flags)
        more = conditioned(
            run, belief, reciprocal_condition, gains, innovation, belief.root, c, noise, known=more
        )
        if self.bounds:
            corrected = corrected._replace(mean=run.call(self.bounded, corrected.mean))
        return belief._replace(**corrected._asdict(), **more), innovation, spread

    def _slope(self, run: Run, mean: Elements, u: Elements, p: Elements) -> Elements:
        """C (p, n)."""
        return run.call(self.measured, mean, u, p)[1]

    def _spread(self, run: Run, belief: Belief) -> Elements:
        """Deviations of the sigma points from the mean, (n, 2n)."""
        return run.stacked(*run.columns(self.sigma.offsets, belief.root)).T

    def _stepped(
        self, run: Run, u: Elements, p: Elements, mean: Elements, rows: Elements
    ) -> tuple[Elements, Elements]:
        """The mean, and deviations (2n, n) from it, after one of the `sub_steps`."""
        means: list[Elements] = []

        def stages(inner: Run, deviation: Elements, mean: Elements, u: Elements, p: Elements) -> Elements:
            pairs: Any = Pairs(inner, self.flow, self._flow_and_difference)
            mean, deviation = self.sub_step(cast(Elements, (mean, deviation)), u, p, pairs)
            means.append(mean)
            return deviation

        moved = run.sweep(stages, rows.T, mean, u, p)
        return means[-1], moved.T

    def _halves(self, run: Run, deviations: Elements) -> tuple[Elements, Elements]:
        """Mean of deviations (k, 2n) by their weights, and rows whose WᵀW is their covariance."""
        n, s = self.plant.n, self.sigma.spread
        rows = deviations.T  # signal by signal, as each has its neighbours beside it
        odd, even = run.columns(partial(_odd_and_even, s), (rows[:n], rows[n:]))
        shift = run.combination(even.T, np.full(n, 1.0 / s))
        even = run.columns(partial(_centred, s), (even, shift.reshape(1, len(shift))))
        centre = run.call(partial(_scaled, math.sqrt(self.sigma.covariance_weights[0])), shift)
        return shift, run.stacked(odd, even, centre)

    def _added_within(self, centre: Elements, shift: Elements) -> Elements:
        return self.bounded(centre + shift)

    @cached_property
    def _differences(self) -> tuple[ca.Function, ca.Function]:
        sizes = (self.plant.n, len(self.plant.inputs), self.plant.parameters.size)
        return difference(trace(self.flow, *sizes)), difference(trace(self.output, *sizes))

    def _flow_and_difference(
        self, x: Elements, deviation: Elements, u: Elements, p: Elements
    ) -> tuple[Elements, Elements]:
        return self.flow(x, u, p), apply(self._differences[0], x, deviation, u, p)[0]

    def _output_difference(self, deviation: Elements, x: Elements, u: Elements, p: Elements) -> Elements:
        return apply(self._differences[1], x, deviation, u, p)[0]

    @property
    def angles(self) -> list[int]:
        """Places of the outputs that are angles."""
        return self.plant.angle_places(self.plant.outputs)

    @property
    def wrapped(self) -> list[int]:
        """Places of the states that are angles and may be wrapped between two samples: those of a map."""
        return self.plant.angle_places(self.plant.states) if self.plant.sampled else []

    def points(self, run: Run, mean: Elements, root: Elements) -> Elements:
        """Sigma points inside the bounds, (n, 2n + 1)."""
        return self.inside(run, run.beside(mean, self.sigma.pair, root, mean))

    def redrawn(self, run: Run, belief: Belief) -> tuple[Elements, Elements, Elements, dict[str, Elements]]:
        """Sigma points for the measurement, their deviations, both (n, 2n + 1), and the mean that those are from; and
        other parts of the corrected belief by name.

        Clipped points represent a narrower prior than the belief: steps 9 to 12 must use its mean and deviations, or
        what is subtracted from P could exceed it.
        """
        mean = belief.mean
        if not self.redraw:
            return belief.points, self.deviations(run, belief.points, mean), mean, {"points": belief.points}
        root = run.cholesky(belief.covariance)
        more = conditioned(run, belief, pivots_kept, root, belief.covariance, goes_on=True)
        points = self.points(run, mean, root)
        if not self.bounds:  # not points − mean: those digits are lost already
            return points, run.beside(run.call(np.zeros_like, mean), self.sigma.offsets, root), mean, more
        centre = run.combination(points, self.sigma.mean_weights)
        return points, self.deviations(run, points, centre), centre, more

    def deviations(self, run: Run, points: Elements, mean: Elements) -> Elements:
        """Points minus a mean, (n, 2n + 1)."""
        return run.columns(_less, (points.T, mean.reshape(1, len(mean)))).T

    def inside(self, run: Run, points: Elements, *about: Elements) -> Elements:
        """Points, or deviations from a mean (n,), clipped to the bounds."""
        return run.columns(self.bounded, points, *about) if self.bounds else points

    def bounded(self, states: Elements, about: Elements | None = None) -> Elements:
        """States (n,) or (n, N), or deviations from a mean (n,), clipped to the bounds."""
        states = np.array(states)
        for name, (low, high) in self.bounds.items():
            row = self.plant.index(name)
            at = 0.0 if about is None else about[row]
            states[row] = clip(states[row], low - at, high - at)
        return states


def _about_first(run: Run, places: Sequence[int], points: Elements) -> Elements:
    """Sigma points (k, 2n + 1) whose angles, at these places, are the turns that lie nearest to the central ones."""
    if not places:
        return points
    return run.columns(partial(turned, places=places), points, points.T[:1].reshape(len(points)))


def _shorter(run: Run, places: Sequence[int], deviations: Elements) -> Elements:
    """Deviations (k, 2n) whose angles, at these places, go the shorter way round."""
    about = np.zeros(len(deviations))
    return run.columns(partial(turned, places=places), deviations, about) if places else deviations


def _odd_and_even(spread: float, up: Elements, down: Elements) -> tuple[Elements, Elements]:
    """Halves of the difference and the sum of a pair's deviations, in parts of the spread."""
    return (0.5 / spread) * (up - down), (0.5 / spread) * (up + down)


def _centred(spread: float, even: Elements, shift: Elements) -> Elements:
    return even - shift / spread


def _seen_from(deviation: Elements, mean: Elements, centre: Elements) -> Elements:
    """A deviation from the mean as one from a centre."""
    return deviation + (mean - centre)


def _scaled(factor: float, row: Elements) -> Elements:
    return (factor * row).reshape(1, len(row))


def _joined(first: Elements, second: Elements) -> Elements:
    """A column of outputs above one of states."""
    return np.concatenate([first, second])


def _parted(y: Elements, shift: Elements, mean: Elements) -> tuple[Elements, Elements]:
    """The shift of the outputs, and the mean of the sigma points."""
    return shift[: len(y)], mean + shift[len(y) :]


def _first(column: Elements, y: Elements) -> Elements:
    return column[: len(y)]


def _less(row: Elements, mean: Elements) -> Elements:
    """Deviations of a state at all sigma points from its mean."""
    return row - mean


class ExtendedKalmanFilter(RecursiveFilter):
    """Kalman filter along the estimate; parameters as in `flexhinf.estimation.filter.RecursiveFilter`.

    Examples
    --------
    >>> import flexhinf as fh
    >>> import numpy as np
    >>> plant = fh.paper_arm().plant()
    >>> ekf = fh.ExtendedKalmanFilter(plant, 1e-3, 1e-6, 1e-6, mean=np.zeros(4), covariance=1e-2)
    >>> ekf.correct([0.1])
    >>> bool(0.09 < ekf.mean[0] < 0.1)
    True
    """

    _takes_exact = True

    def __init__(
        self,
        plant: Plant,
        period: float,
        process_noise: ArrayLike,
        measurement_noise: ArrayLike | None,
        mean: ArrayLike,
        covariance: ArrayLike,
        form: Form = "square_root",
        gate: float | None = None,
        sensors: Sequence[Sensor] | Sensor | None = None,
        bounds: Mapping[str, tuple[float, float]] | None = None,
    ) -> None:
        super().__init__(
            plant, period, process_noise, measurement_noise, mean, covariance, form, gate, sensors, bounds
        )

    def settings(self) -> dict[str, object]:
        """Arguments of the constructor by name."""
        own = {"form": self.form, "gate": self.gate, "bounds": dict(self.bounds)}
        return {**super().settings(), **own}

    @property
    def estimator_key(self) -> str:
        """Method, period, sub-steps, gate and bounds: constants of the traced code."""
        bounds = sorted(self.bounds.items())
        exact = " exact" * self._exact
        return f"ekf {self.form} {self.period!r} {self.sub_steps} x {self.stages} {self.gate} {bounds}{exact}"

    @property
    def operations(self) -> int:
        """Roughly, the operations of both updates as one trace: derivatives along every state through F."""
        n = self.plant.n
        return n * (2 * self.stages * self.sub_steps * self.plant.traced_flow.n_instructions() + n * n)

    @cached_property
    def _tangent(self) -> ca.Function:
        sizes = (self.plant.n, len(self.plant.inputs), self.plant.parameters.size)
        moved = trace(self.sub_step, *sizes, name="sub_step")
        inputs = [ca.SX.sym(name, size) for name, size in zip("xup", sizes)]
        direction = ca.SX.sym("v", self.plant.n)
        along = ca.densify(ca.jtimes(moved.call(inputs)[0], inputs[0], direction))
        return ca.Function("tangent", [inputs[0], direction, *inputs[1:]], [along], {"cse": True})

    def tangent(self, direction: Elements, x: Elements, u: Elements, p: Elements) -> Elements:
        """Derivative of `sub_step` at x along a direction, (n,)."""
        return apply(self._tangent, x, direction, u, p)[0]

    def time_stages(
        self, run: Run, belief: Belief, u: Elements, p: Elements, process_noise: Elements
    ) -> Belief:
        """x(k|k) → x(k+1|k): F(x̂, u) and A P Aᵀ + R^v with A = ∂F/∂x."""
        if self.form == "square_root":
            mean, rows = self.moved_rows(run, belief, u, p)
            root = root_prediction(run, rows, process_noise)
            moved = belief._replace(mean=mean, root=root, **conditioned(run, belief, np.ones, 1))
        else:
            root = run.cholesky(belief.covariance)
            mean, spread = self._moved(run, belief.mean, root, u, p)
            covariance = run.gram(spread, np.ones(self.plant.n), process_noise)
            more = conditioned(run, belief, pivots_kept, root, belief.covariance)
            moved = belief._replace(mean=mean, covariance=covariance, **more)
        return self._within(run, moved)

    def moved_rows(
        self, run: Run, belief: RootGaussian, u: Elements, p: Elements
    ) -> tuple[Elements, Elements]:
        """x(k+1|k), and W Aᵀ, rows of its covariance before R^v is added."""
        mean, spread = self._moved(run, belief.mean, belief.root.T, u, p)
        return mean, spread.T

    def _moved(
        self, run: Run, mean: Elements, spread: Elements, u: Elements, p: Elements
    ) -> tuple[Elements, Elements]:
        """F(x̂, u), and the columns of a spread (n, k) after it."""
        for _ in range(self.sub_steps):
            spread = run.columns(self.tangent, spread, mean, u, p)
            mean = run.call(self.sub_step, mean, u, p)
        return mean, spread

    def innovation_stages(
        self, run: Run, belief: Belief, y: Elements, u: Elements, p: Elements, measurement_noise: Elements
    ) -> tuple[Belief, Elements, Elements]:
        """x(k|k−1) → (x(k|k), innovation, its covariance), with C = ∂H/∂x."""
        corrected, innovation, spread = self.linear_innovation(run, belief, y, u, p, measurement_noise)
        return self._within(run, corrected), innovation, spread

    def _within(self, run: Run, belief: Belief) -> Belief:
        """The belief with its mean within the bounds."""
        if not self.bounds:
            return belief
        carries_root = self.form == "square_root"
        places, ends = bounded_places(self.bounds, self.plant)
        columns = run.call(partial(_of_root if carries_root else _of_covariance, places), belief[1])
        return belief._replace(mean=run.call(partial(projected, places, ends), belief.mean, columns))


def _of_covariance(places: list[int], covariance: Elements) -> Elements:
    return covariance[:, places]


def _of_root(places: list[int], root: Elements) -> Elements:
    return root.T @ root[:, places]
