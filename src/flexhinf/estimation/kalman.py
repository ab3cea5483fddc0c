"""Kalman filters: the unscented one, the paper's Algorithm 1 in matrix form, the extended and the stationary one.

Comments number the steps of Algorithm 1. Its γ of steps 1 and 5 is `SigmaPoints.spread`, Eq. (10).

The Jacobian of the extended filter is exact, that of the integrated map F itself, through symbols, not I + A·period: a
comparison with a filter that drops terms would say little. The matrix ∂F/∂x itself is not needed, only its product with
a square root of the covariance: that is computed, column by column, through every Runge–Kutta step.

*The stationary filter*, whose gain and covariance no longer change: its gain is usually that of the Kalman filter for
the estimator's own model F at one operating point (`stationary_gain`). The extended filter's gain tends to it, and the
unscented filter's does as far as F and H are straight over the spread of its points. Or the gain is that of an observer
with the poles that its error shall have (`placed_gain`).
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from flexhinf.codegen import DIRECT
from flexhinf.errors import InvalidInput, NotDetectable, NumericalFailure
from flexhinf.estimation.filter import RecursiveFilter, correction, gained, rooted
from flexhinf.plant import Estimator, Gaussian, Plant
from flexhinf.scalars import apply, cholesky, clip, jacobian, trace
from flexhinf.scalars.trace import linear
from flexhinf.validation import checked_array, checked_kind, read_only, real_array, real_number, value_text


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
        }

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
            covariance = run.gram(
                run.columns(rooted, gain, factor).T, -np.ones(len(self.plant.outputs)), belief.covariance
            )
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
            return points, run.beside(run.call(np.zeros_like, mean), self.sigma.offsets, root), mean
        centre = run.combination(points, self.sigma.mean_weights)
        return points, self.deviations(run, points, centre), centre

    def deviations(self, run: Any, points: Any, mean: Any) -> Any:
        """Points minus a mean, (n, 2n + 1)."""
        return run.columns(_less, (points.T, mean.reshape(1, len(mean)))).T

    def inside(self, run: Any, points: Any) -> Any:
        """Points clipped to the bounds."""
        return run.columns(self.bounded, points) if self.bounds else points

    def bounded(self, states: Any) -> Any:
        """States (n,) or (n, N) clipped to the bounds."""
        states = np.array(states)
        for name, (low, high) in self.bounds.items():
            row = self.plant.index(name)
            states[row] = clip(states[row], low, high)
        return states


def _less(row: Any, mean: Any) -> Any:
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

    innovation_stages = RecursiveFilter.linear_innovation  # with C = ∂H/∂x


class ConstantGainBelief(NamedTuple):
    """A mean (n,) and the gain (n, p) that corrects it."""

    mean: Any
    gain: Any


class ConstantGainFilter(Estimator):
    """x̂ = x̂⁻ + L (y − h(x̂⁻)), x̂⁻ = F(x̂, u), with the gain L carried along in the belief.

    `filter`: The filter with model, discretisation and noises. `gain`: (n, p). Raises InvalidInput: if the gain is not
    (n, p) finite numbers.
    """

    def __init__(self, filter: RecursiveFilter, gain: np.ndarray) -> None:
        self.filter, self.plant, self.period = filter, filter.plant, filter.period
        self.process_noise, self.measurement_noise = filter.process_noise, filter.measurement_noise
        shape = (filter.plant.n, len(filter.plant.outputs))
        gain = checked_array(
            "The gain does not fit the plant.",
            gain,
            shape,
            f"{shape} finite numbers",
            "stationary_gain of linear_model(filter, x, u)",
        )
        self.initial: Any = ConstantGainBelief(np.array(filter.initial.mean), gain)

    def settings(self) -> dict[str, Any]:
        """Arguments of the constructor by name."""
        return {"filter": self.filter, "gain": self.initial.gain}

    @property
    def estimator_key(self) -> str:
        """Key of the traced code."""
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

    `model`: ((n, n), (p, n)) arrays, F and H of one sample. `process_noise`, `measurement_noise`: (n, n) and (p, p)
    arrays, R^v per sample and R^n, the latter positive definite. Raises NumericalFailure: if the numbers are too far
    apart for the recursion: R^v and R^n, or a model that grows by decades in a sample.
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


#: Relative size of a singular value that counts as zero: what the measurement does not show.
UNSEEN = 1e-10

#: A mode that decays by less than this in a sample does not decay.
UNDAMPED = 1e-12

#: Largest difference of poles that were placed from those that were wanted, relative to the fastest one.
PLACED = 1e-6


def placed_gain(
    drift: np.ndarray,
    measured: np.ndarray,
    transition: np.ndarray,
    period: float,
    poles: Any,
    states: Sequence[str],
) -> np.ndarray:
    """L (n, p) that gives (1 − L H) Φ the eigenvalues exp(s T) for the wanted s [tits1996].

    `drift`, `measured`, `transition`: (n, n), (p, n) and (n, n) arrays, A, H, and Φ = exp(A T). `period`: T, s.
    `poles`: (n,) complex, s, 1/s: negative real parts, complex ones in conjugate pairs. `states`: Names, for errors.
    Raises InvalidInput: for another number of poles; poles that do not decay, are not in pairs or turn by more than
    half a turn per sample; more equal ones than there are independent measurements. Raises NotDetectable: if (A, H) is
    not observable. Raises NumericalFailure: if the poles that are reached are not those that were wanted.
    """
    from scipy.signal import place_poles

    wanted = _checked(poles, states, period)
    hidden = unobservable(drift, measured)
    if hidden.size:
        raise _not_seen(drift, hidden, states, "its poles cannot be chosen")
    # As (z − 1)/T: the eigenvalues of a fast sampled system all lie next to one.
    rates, slope = np.expm1(wanted * period) / period, (transition - np.eye(len(drift))) / period
    size = np.linalg.norm(measured, axis=1)
    size = np.where(size > 0.0, size, 1.0)
    mixed, singular, rows = np.linalg.svd(measured / size[:, None], full_matrices=False)
    rank = int(np.sum(singular > UNSEEN))  # of sensors that say the same, their mean
    rows, mixed = singular[:rank, None] * rows[:rank], mixed[:, :rank]
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # of slow convergence: the result is judged below
            placed: Any = place_poles(slope.T, (rows @ transition).T, rates)
    except ValueError as error:
        raise InvalidInput(
            "The poles of the observer cannot be placed.",
            f"expected each pole at most once per independent measurement, got {wanted.tolist()}: {error}",
            "distinct poles, a few per cent apart",
        ) from error
    gain = period * placed.gain_matrix.T @ mixed.T / size
    reached = np.linalg.eigvals(slope - gain @ measured @ transition / period)
    if max(np.abs(reached - rate).min() for rate in rates) > PLACED * np.abs(rates).max():
        raise NumericalFailure(
            "The poles of the observer are not reached.",
            f"wanted {rates.tolist()} 1/s as (z − 1)/T, got {reached.tolist()}",
            "poles further apart, or closer to the plant's own",
        )
    return gain


def check_detectable(drift: np.ndarray, measured: np.ndarray, states: Sequence[str]) -> None:
    """Refuse a plant with a mode that neither decays nor shows: no gain makes that error go away.

    Raises NotDetectable: with the mode and the state it is mainly in.
    """
    hidden = unobservable(drift, measured)
    modes = np.linalg.eigvals(hidden.T @ drift @ hidden)
    if np.any(modes.real >= -4.0 * np.finfo(float).eps * len(drift) * np.linalg.norm(drift)):
        raise _not_seen(drift, hidden, states, "an error in it does not decay")


def check_decay(error: np.ndarray) -> None:
    """Refuse (1 − L H) Φ, (n, n), if its error does not decay, as without process noise."""
    radius = float(np.abs(np.linalg.eigvals(error)).max())
    if radius >= 1.0 - UNDAMPED:
        raise InvalidInput(
            "The error of the observer does not decay.",
            f"expected |eigenvalues| of (1 − L H) Φ below 1, got {radius:.12g}",
            "process noise on every state, or poles=",
        )


def unobservable(drift: np.ndarray, measured: np.ndarray) -> np.ndarray:
    """Orthogonal basis (n, k) of the motions ẋ = A x that never show in H x.

    The directions that H does not see, less those that A carries out of them, until none is left to take away: this
    needs no eigenvalues, which are ill defined for the chains of integrators that robots are.
    """
    from scipy.linalg import matrix_balance, null_space

    balanced, (scale, _) = matrix_balance(drift, permute=False, separate=True)
    balanced = balanced / (np.linalg.norm(balanced, 2) or 1.0)
    rows = measured * scale
    rows = rows / np.maximum(np.linalg.norm(rows, axis=1, keepdims=True), np.finfo(float).tiny)
    basis = null_space(rows, rcond=UNSEEN)
    while basis.size:
        moved = balanced @ basis
        _, singular, directions = np.linalg.svd(moved - basis @ (basis.T @ moved))
        kept = basis @ directions[np.count_nonzero(singular > UNSEEN) :].T
        if kept.shape == basis.shape:
            return np.linalg.qr(scale[:, None] * basis)[0]
        basis = kept
    return basis


def _not_seen(drift: np.ndarray, hidden: np.ndarray, states: Sequence[str], so: str) -> NotDetectable:
    modes = np.linalg.eigvals(hidden.T @ drift @ hidden)
    mainly = states[int(np.argmax(np.abs(hidden).max(axis=1)))]
    return NotDetectable(
        f"What is measured does not show every mode of the observer's plant: {so}.",
        f"expected an observable pair (A, H), got hidden modes at {np.round(modes, 6).tolist()} 1/s, mainly in "
        f"{mainly!r}",
        f"measure {mainly} in addition, or what depends on it",
    )


def _checked(poles: Any, states: Sequence[str], period: float) -> np.ndarray:
    try:
        wanted: Any = np.asarray(poles, dtype=complex)
    except (TypeError, ValueError):
        wanted = np.zeros(0, dtype=complex)
    example = [-10.0 - 2.0 * k for k in range(len(states))]
    if wanted.shape != (len(states),) or not np.all(np.isfinite(wanted)):
        raise InvalidInput(
            "The poles of the observer do not fit its plant.",
            f"expected {len(states)} finite poles, one per state of {list(states)}, got {value_text(poles)}",
            f"poles={example}, in 1/s",
        )
    unpaired = [s for s in wanted if np.sum(wanted == s) != np.sum(wanted == np.conj(s))]
    fast = np.pi / period
    if unpaired or wanted.real.max() >= 0.0 or np.abs(wanted.imag).max() >= fast:
        raise InvalidInput(
            "These are not the poles of an error that decays from sample to sample.",
            f"expected negative real parts, complex poles in conjugate pairs and frequencies below {fast:.6g} rad/s, "
            f"got {wanted.tolist()}",
            f"poles={example}, in 1/s",
        )
    return wanted
