"""The stationary filter, whose gain and covariance no longer change.

Its gain is usually that of the Kalman filter for the estimator's own model F at one operating point
(`stationary_gain`). The extended filter's gain tends to it, and the unscented filter's does as far as F and H are
straight over the spread of its points. Or the gain is that of an observer with the poles that its error shall have
(`placed_gain`).
"""

# SciPy has no types.
# pyright: reportMissingTypeStubs=false, reportUnknownVariableType=false

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from flexhinf.arrays import Elements
from flexhinf.errors import InvalidInput, NotDetectable, NumericalFailure, refuse_if
from flexhinf.estimation.bounds import bounded_places, projected
from flexhinf.estimation.covariances import is_singular
from flexhinf.estimation.filter import RecursiveFilter, beyond
from flexhinf.plant import Estimator
from flexhinf.plant.parameters import Parameters
from flexhinf.plant.protocols import Belief
from flexhinf.scalars import jacobian, masked
from flexhinf.validation import checked_array, read_only, value_text


class ConstantGainBelief(NamedTuple):
    """A mean (n,) and the gain (n, p) that corrects it."""

    mean: Elements
    gain: Elements


class GatedGainBelief(NamedTuple):
    """As `ConstantGainBelief`, with the variances (p,) of innovations, and how often each was rejected (p,)."""

    mean: Elements
    gain: Elements
    variances: Elements
    rejected: Elements


class BoundedGainBelief(NamedTuple):
    """As `ConstantGainBelief`, with the columns (n, k) of P at the states with bounds: of a prediction, and of what a
    measurement has corrected."""

    mean: Elements
    gain: Elements
    predicted: Elements
    corrected: Elements


class GatedBoundedGainBelief(NamedTuple):
    """Both of them."""

    mean: Elements
    gain: Elements
    predicted: Elements
    corrected: Elements
    variances: Elements
    rejected: Elements


class ConstantGainFilter(Estimator):
    """x̂ = x̂⁻ + L (y − h(x̂⁻)), x̂⁻ = F(x̂, u), with the gain L carried along in the belief.

    A gate and bounds are those of the filter. What they need of a covariance is the one that errors have after very
    many samples with this gain and the filter's noises, by its model about one state, see `stationary_error`.

    `filter`: The filter with model, discretisation and noises. `gain`: (n, p). `about`: (n,), the state of that
    covariance, the initial mean by default. Raises InvalidInput: if the gain is not (n, p) finite numbers; if there is
    a gate or a bound, and errors with this gain do not decay; for `about` where nothing needs it.
    """

    def __init__(self, filter: RecursiveFilter, gain: np.ndarray, about: ArrayLike | None = None) -> None:
        self._adopt(filter)
        gated, bounded = filter.gate is not None, bool(filter.bounds)
        refuse_if(
            about is not None and not (gated or bounded),
            "A state is given about which nothing is computed.",
            f"expected about=None for a filter without gate and bounds, got {value_text(about)}",
            "the filter with gate=0.999",
        )
        self._about = None if about is None else np.array(filter.initial_at(about).mean)
        shape = (filter.plant.n, len(filter.plant.outputs))
        gain = checked_array(
            "The gain does not fit the plant.",
            gain,
            shape,
            f"{shape} finite numbers",
            "stationary_gain of linear_model(filter, x, u)",
        )
        mean, more = np.array(filter.initial.mean), list[np.ndarray]()
        if gated or bounded:
            point = mean if self._about is None else self._about
            predicted, corrected, spread = stationary_error(filter, gain, point)
            places = self._bounded[0]
            more += [predicted[:, places], corrected[:, places]] if bounded else []
            more += [np.diag(spread), np.zeros(len(spread))] if gated else []
        self.initial = read_only(GAIN_BELIEFS[gated, bounded](mean, gain, *more))

    def _adopt(self, filter: RecursiveFilter) -> None:
        self.filter, self.plant, self.period = filter, filter.plant, filter.period
        self.process_noise, self.measurement_noise = filter.process_noise, filter.measurement_noise

    def settings(self) -> dict[str, object]:
        """Arguments of the constructor by name."""
        about = {} if self._about is None else {"about": self._about}
        return {"filter": self.filter, "gain": np.array(self.initial.gain), **about}

    @property
    def estimator_key(self) -> str:
        """Key of the traced code."""
        return (
            f"constant gain {self.period!r} {self.filter.sub_steps} x {self.filter.stages}{self._limits_key}"
        )

    @property
    def _limits_key(self) -> str:
        bounds, gate = sorted(self.filter.bounds.items()), self.filter.gate
        return f" {gate} {bounds}" if bounds or gate is not None else ""

    def initial_at(self, mean: ArrayLike) -> Belief:
        """The initial belief with another mean (n,)."""
        return self.initial._replace(mean=self.filter.initial_at(mean).mean)

    def time_update(self, belief: Belief, u: Elements, p: Parameters, process_noise: Elements) -> Belief:
        """x̂(k|k) → x̂(k+1|k), pure, on any element."""
        mean = self.filter.transition(belief.mean, u, p)
        if self.filter.bounds:
            mean = projected(*self._bounded, mean, belief.predicted)
        return belief._replace(mean=mean)

    def measurement_update(
        self, belief: Belief, y: Elements, u: Elements, p: Parameters, measurement_noise: Elements
    ) -> Belief:
        """x̂(k|k−1) → x̂(k|k), pure, on any element."""
        innovation, more = y - self.filter.output(belief.mean, u, self.plant.parameters.flat(p)), {}
        if self.filter.gate is not None:
            innovation, counts = self._passed(innovation, belief.variances, belief.rejected)
            more = {"rejected": counts}
        mean = belief.mean + belief.gain @ innovation
        if self.filter.bounds:
            mean = projected(*self._bounded, mean, belief.corrected)
        return belief._replace(mean=mean, **more)

    @property
    def _bounded(self) -> tuple[list[int], list[tuple[float, float]]]:
        """Places of the states with bounds, and their intervals."""
        return bounded_places(self.filter.bounds, self.plant)

    def _passed(
        self, innovation: Elements, variances: Elements, rejected: Elements
    ) -> tuple[Elements, Elements]:
        """The innovation (p,), zero where the gate rejects it, and the counts (p,)."""
        outliers = beyond(innovation * innovation, variances * self.filter.limit)
        return masked(1.0 - outliers, innovation), rejected + outliers


#: Beliefs by whether there is a gate, and whether there are bounds.
GAIN_BELIEFS: dict[tuple[bool, bool], type] = {
    (False, False): ConstantGainBelief,
    (True, False): GatedGainBelief,
    (False, True): BoundedGainBelief,
    (True, True): GatedBoundedGainBelief,
}


#: Doublings of the Riccati recursion at most: 2⁴⁰ samples.
DOUBLINGS = 40


#: Doublings of a sum over samples at most; the slowest error that is allowed takes 46.
SUM_DOUBLINGS = 64


def stein(matrix: np.ndarray, added: np.ndarray) -> np.ndarray:
    """X = M X Mᵀ + W for |eigenvalues| of M below one: Σ Mᵏ W (Mᵏ)ᵀ, doubled [anderson1979]."""
    total = growth = added
    power = matrix
    for _ in range(SUM_DOUBLINGS):
        growth = power @ total @ power.T
        total, power = total + (growth + growth.T) / 2.0, power @ power
        if np.abs(growth).max() <= np.finfo(float).eps * np.abs(total).max():
            return total
    raise NumericalFailure(
        "The sum over all samples does not converge.",
        f"got terms of {np.abs(growth).max():.3g} after 2^{SUM_DOUBLINGS} samples",
        "a gain with faster errors: more process noise, or poles=",
    )


def linear_model(filter: RecursiveFilter, x: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(∂F/∂x, ∂h/∂x), (n, n) and (p, n), of the filter's own sampled model at x (n,) and u (m,)."""
    table = filter.plant.parameters

    def step(s: np.ndarray, v: np.ndarray, w: np.ndarray) -> np.ndarray:
        return filter.transition(s, v, table.named(w))

    moved = jacobian(step, len(x), len(u), table.size)
    return moved(x, u, table.vector())[1], filter.plant.slopes(x, u)[3]


def stationary_error(
    filter: RecursiveFilter, gain: np.ndarray, x: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """P⁻ (n, n) and P (n, n), of errors before and after a correction, and the covariance (p, p) of innovations, after
    very many samples with a constant gain L (n, p), by the filter's model F, H and noises about a state x (n,), u = 0:

        P = (1 − L H) P⁻ (1 − L H)ᵀ + L R^n Lᵀ,        P⁻ = F P Fᵀ + R^v        [anderson1979].

    Raises InvalidInput: if these errors do not decay.
    """
    a, c = linear_model(filter, x, np.zeros(len(filter.plant.inputs)))
    left, q, r = np.eye(len(a)) - gain @ c, filter.process_noise, filter.measurement_noise
    check_decay(left @ a)
    added = left @ q @ left.T + gain @ r @ gain.T
    corrected = stein(left @ a, (added + added.T) / 2.0)
    predicted = a @ corrected @ a.T + q
    predicted = (predicted + predicted.T) / 2.0
    return predicted, corrected, c @ predicted @ c.T + r


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
    if is_singular(r):
        raise NumericalFailure(
            "There is no stationary gain without measurement noise in every direction.",
            f"expected a positive definite R^n, got {value_text(r)}",
            "a variance > 0 for each measured signal",
        )
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
    poles: ArrayLike,
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
    gain: np.ndarray = period * placed.gain_matrix.T @ mixed.T / size
    reached: np.ndarray = np.linalg.eigvals(slope - gain @ measured @ transition / period)
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

    scaled: Any = matrix_balance(drift, permute=False, separate=True)
    balanced, (scale, _) = scaled
    balanced = balanced / (np.linalg.norm(balanced, 2) or 1.0)
    rows = measured * scale
    rows = rows / np.maximum(np.linalg.norm(rows, axis=1, keepdims=True), np.finfo(float).tiny)
    basis = np.asarray(null_space(rows, rcond=UNSEEN), dtype=float)
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


def _checked(poles: ArrayLike, states: Sequence[str], period: float) -> np.ndarray:
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
