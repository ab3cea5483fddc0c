"""Errors of the model that every pair tolerates, all at the same time: small gain, one scaling per frequency for all λ.

Let the accelerations that the springs make of the links, M⁻¹ K (θ − q), and those that motors and springs make of the
rotors, J⁻¹ (u − K (θ − q)), be wrong by (1 + Δ₁) and (1 + Δ₂), any linear operators that mix joints and change with
time. Of the pairs these are a_z = λ (w − z) and a_w = κ (f + z − w), with d_z = Δ₁ a_z and d_w = Δ₂ a_w added, where Δ
is turned by V and scaled by K^½. The loop is stable if, at every frequency, one number s > 0 has

    ‖Δ‖ · max over λ of σ̄ [ N₁₁  s N₁₂ ; N₂₁/s  N₂₂ ] < 1,

N(λ) from (d_z, d_w) to (a_z, a_w): the scaling commutes with Δ, which may mix pairs, but not links with motors, and
only those frequencies that sampling makes equal. So it holds for Δ that do not change with time, and for all
poses whose λ are in the range. Between samples d and a are pieces of a period (lifting, [chen1995]); the norms of
their blocks bound σ̄. With one s for all frequencies Δ may be any operator; `flexhinf.modal.stability` proves it.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.polynomial import chebyshev

from flexhinf.modal.pair import PairGains

#: Pieces of a sampling period, pairs, frequencies, and scalings.
PIECES, PAIRS, FREQUENCIES, SCALINGS = 4, 30, 400, 121


class Tolerance(NamedTuple):
    """Sizes ‖Δ‖ of errors that are covered: of any, with one scaling s for all frequencies, and of errors that do not
    change with time, with an s of each frequency."""

    error: float
    constant: float
    scaling: float


def tolerated_error(gains: PairGains, fastest: float = 350.0, latency: int = 0, filter: Any = None) -> float:
    """Largest ‖Δ₁‖ = ‖Δ₂‖, of errors that do not change with time; arguments as for `error_tolerance`."""
    return error_tolerance(gains, fastest, latency, filter).constant


def error_tolerance(
    gains: PairGains, fastest: float = 350.0, latency: int = 0, filter: Any = None, count: int = PAIRS
) -> Tolerance:
    """Largest ‖Δ₁‖ = ‖Δ₂‖ that small gain covers, for pairs with √λ up to `fastest` (rad/s); see this module.

    The law reads the state that a ModalFilter estimates, or the true one, as of `latency` samples before its input
    acts and predicted over them by the model. Sampled at `count` λ and 400 frequencies, so a computed number and not a
    proof.
    """
    spectrum, scalings = (
        np.exp(1j * np.geomspace(1e-3, np.pi, FREQUENCIES)),
        np.geomspace(1e-2, 1e2, SCALINGS),
    )
    links = map(float, gains.links(count, fastest))
    norms = np.array([_norms(gains, link, latency, spectrum, filter) for link in links])
    squares, product = [], np.linalg.det(norms) ** 2
    for scaling in scalings:
        total = ((norms * np.array([[1.0, scaling], [1.0 / scaling, 1.0]])) ** 2).sum(axis=(2, 3))
        largest = total + np.sqrt(np.maximum(total**2 - 4.0 * product, 0.0))
        squares.append(largest.max(axis=0) / 2.0)  # the largest singular value²
    over, best = np.max(squares, axis=1), np.min(squares, axis=0)
    return Tolerance(float(over.min() ** -0.5), float(best.max() ** -0.5), float(scalings[over.argmin()]))


def sampled_pair(
    moved: Any, gain: Any, period: float, latency: int, observer: tuple[Any, np.ndarray] | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """The sampled loop of a pair, as rows of its states: x = (z, z′, w, w′) and the input, which act over a period,
    (5, n); and the controller's memory after it, (n − 4, n).

    `moved` (4, 5) is the model's x after a period, of x and the input, `gain` (5,) that of x and the integral, and
    `observer` the filter's ℓ(λ) (4, k) and H (k, 4). All are numbers, or series in λ. The memory is the filter's
    prediction, the integral and the last position (trapezoidal rule), and the inputs that wait, that which acts next
    first; states are x, then the memory.
    """
    unit = np.eye(6 + latency + (0 if observer is None else 4))
    estimate, position, others = unit[:4], unit[0], unit[-2 - latency :]
    if observer is not None:
        correction, seen = observer
        estimate = unit[4:8] + correction @ seen @ (unit[:4] - unit[4:8])
        position = unit[0] if [1.0, 0.0, 0.0, 0.0] in seen.tolist() else estimate[0]
    integral, ahead = others[0] + 0.5 * period * (others[1] + position), estimate
    for waiting in others[2:]:
        ahead = moved @ np.vstack([ahead, waiting])
    queue = np.vstack([others[2:], -gain @ np.vstack([ahead, integral])])
    prediction = unit[:0] if observer is None else moved @ np.vstack([estimate, queue[0]])
    return np.vstack([unit[:4], queue[0]]), np.vstack([prediction, integral, position, queue[1:]])


def _norms(gains: PairGains, link: float, latency: int, spectrum: np.ndarray, filter: Any) -> np.ndarray:
    """Norms (N, 2, 2) of the blocks of the lifted N(λ) at N points of the unit circle."""
    pair = gains.pair(link)
    moved, driven = (part[:4] for part in pair.held(gains.period / PIECES))
    driven = driven / np.array([1.0, link, pair.motor])  # d as accelerations
    seen = np.array([[-link, 0.0, link, 0.0, 0.0], [pair.motor, 0.0, -pair.motor, 0.0, pair.motor]])
    # The state after each piece, of the state before, the input and the pieces of d.
    state, rows, unit = np.eye(4, 5 + 2 * PIECES), [], np.eye(1, 5 + 2 * PIECES, 4)
    for piece in range(PIECES):
        rows.append(seen @ np.vstack([state, unit]))
        state = moved[:, :4] @ state
        state[:, 4] += driven[:, 0]
        state[:, 5 + 2 * piece : 7 + 2 * piece] += driven[:, 1:]
    output = np.vstack(rows)
    observer = None
    if filter is not None:
        sensors, table, (low, high) = filter.pair
        place = np.clip((2.0 * np.log(link) - (low + high)) / (high - low), -1.0, 1.0)
        observer = chebyshev.chebval(place, table).reshape(4, -1), sensors
    acting, memory = sampled_pair(state[:, :5], gains(link)[:5], gains.period, latency, observer)
    a, b = np.vstack([state[:, :5] @ acting, memory]), np.zeros((acting.shape[1], 2 * PIECES))
    b[:4] = state[:, 5:]
    inner = np.linalg.solve(
        spectrum[:, None, None] * np.eye(len(a)) - a, np.broadcast_to(b, (len(spectrum), *b.shape))
    )
    blocks = (output[:, :5] @ acting @ inner + output[:, 5:]).reshape(-1, PIECES, 2, PIECES, 2)
    return np.linalg.norm(blocks, 2, axis=(1, 3))
