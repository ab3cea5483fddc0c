"""The stationary filter, whose gain and covariance no longer change.

Its gain is usually that of the Kalman filter for the estimator's own model F at one operating point
(`stationary_gain`). The extended filter's gain tends to it, and the unscented filter's does as far as F and H are
straight over the spread of its points. Or the gain is that of an observer with the poles that its error shall have
(`placed_gain`).
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from flexhinf.errors import InvalidInput, NotDetectable, NumericalFailure
from flexhinf.estimation.filter import RecursiveFilter
from flexhinf.plant import Estimator
from flexhinf.scalars import jacobian
from flexhinf.validation import checked_array, value_text


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
    return moved(x, u, table.vector())[1], filter.plant.slopes(x, u)[3]


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
