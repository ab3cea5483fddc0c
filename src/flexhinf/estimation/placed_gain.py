"""The gain of an observer from the poles that its error shall have, and whether every error decays."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np

from flexhinf.errors import InvalidInput, NotDetectable, NumericalFailure
from flexhinf.untrusted import value_text

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

    Parameters
    ----------
    drift, measured, transition : (n, n), (p, n) and (n, n) arrays
        A, H, and Φ = exp(A T).
    period : float
        T, s.
    poles : (n,) complex array
        s, 1/s: negative real parts, complex ones in conjugate pairs.
    states : sequence of str
        Names, for errors.

    Raises
    ------
    InvalidInput
        For another number of poles; poles that do not decay, are not in pairs or turn by more than half a turn per
        sample; more equal ones than there are independent measurements.
    NotDetectable
        If (A, H) is not observable.
    NumericalFailure
        If the poles that are reached are not those that were wanted.
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
            found: Any = place_poles(slope.T, (rows @ transition).T, rates)
    except ValueError as error:
        raise InvalidInput(
            "The poles of the observer cannot be placed.",
            f"expected each pole at most once per independent measurement, got {wanted.tolist()}: {error}",
            "distinct poles, a few per cent apart",
        ) from error
    gain = period * found.gain_matrix.T @ mixed.T / size
    reached = np.linalg.eigvals(slope - gain @ measured @ transition / period)
    distance = max(np.abs(reached - rate).min() for rate in rates)
    if distance > PLACED * np.abs(rates).max():
        raise NumericalFailure(
            "The poles of the observer are not reached.",
            f"wanted {rates.tolist()} 1/s as (z − 1)/T, got {reached.tolist()}",
            "poles further apart, or closer to the plant's own",
        )
    return gain


def check_detectable(drift: np.ndarray, measured: np.ndarray, states: Sequence[str]) -> None:
    """Refuse a plant with a mode that neither decays nor shows: no gain makes that error go away.

    Raises
    ------
    NotDetectable
        With the mode and the state it is mainly in.
    """
    hidden = unobservable(drift, measured)
    modes = np.linalg.eigvals(hidden.T @ drift @ hidden)
    rounding = 4.0 * np.finfo(float).eps * len(drift) * np.linalg.norm(drift)
    if np.any(modes.real >= -rounding):
        raise _not_seen(drift, hidden, states, "an error in it does not decay")


def check_decay(error: np.ndarray) -> None:
    """Refuse (1 − L H) Φ, (n, n), if an error stays: what the gain is when there is no noise to learn from.

    Raises
    ------
    InvalidInput
    """
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
        leaving = moved - basis @ (basis.T @ moved)
        _, singular, directions = np.linalg.svd(leaving)
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
