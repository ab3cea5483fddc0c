"""Errors of the model that all pairs tolerate together: small gain with one scaling for all λ.

The springs accelerate the links by M⁻¹ K (θ − q), motors and springs the rotors by J⁻¹ (u − K (θ − q)). Let the true
accelerations be (1 + Δ₁) and (1 + Δ₂) times these, with linear operators Δ that may mix joints. For the pairs the
accelerations are a_z = λ (w − z) and a_w = κ (f + z − w), and d_z = Δ₁ a_z and d_w = Δ₂ a_w are added; this Δ is turned
by V and scaled by K^½. Let N(λ) be the closed loop of a pair from (d_z, d_w) to (a_z, a_w). By the small gain
theorem the arm is stable if at every frequency there is a number s > 0 with

    ‖Δ‖ · max over λ of σ̄ [ N₁₁  s N₁₂ ; N₂₁/s  N₂₂ ] < 1.

The scaling by s commutes with a Δ that mixes pairs, but neither links with motors nor frequencies, other than those
that sampling makes equal: one that does not change with time. With one s for all frequencies, Δ may change with time.
The statement holds for small motions about rest, at all poses whose λ are in the range, with motors alike, springs
without damping, no dry friction, and gravity without slope. Between samples, d and a are lifted to pieces of a period
[chen1995]; the norms of their blocks bound σ̄. Errors of mass are static, and far larger ones are proved to be
tolerated: `flexhinf.modal.popov`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple, cast

import numpy as np
from numpy.polynomial import chebyshev

from flexhinf.arrays import Elements
from flexhinf.modal.pair import PairGains

if TYPE_CHECKING:
    from flexhinf.estimation.modal import ModalFilter

#: Numbers of pieces of a sampling period, of pairs, of frequencies and of scalings.
PIECES, PAIRS, FREQUENCIES, SCALINGS = 4, 30, 400, 121


class Tolerance(NamedTuple):
    """Largest ‖Δ₁‖ = ‖Δ₂‖ that small gain covers, as shares of the accelerations."""

    error: float  # of any errors, with one scaling for all frequencies
    constant: float  # of errors that do not change with time, with a scaling for each frequency
    scaling: float  # s of `error`


def tolerated_error(
    gains: PairGains, fastest: float = 350.0, latency: int = 0, filter: ModalFilter | None = None
) -> float:
    """Largest ‖Δ₁‖ = ‖Δ₂‖ of errors that do not change with time; arguments as for `error_tolerance`."""
    return error_tolerance(gains, fastest, latency, filter).constant


def error_tolerance(
    gains: PairGains,
    fastest: float = 350.0,
    latency: int = 0,
    filter: ModalFilter | None = None,
    count: int = PAIRS,
) -> Tolerance:
    """Which errors small gain covers, by the inequality of this module; computed at some λ and frequencies, not proved.

    Parameters
    ----------
    gains : PairGains
        The law of the pairs.
    fastest : float
        Largest √λ, rad/s.
    latency : int
        Samples between a measurement and its input; the model predicts the state over them.
    filter : ModalFilter, optional
        The estimator. Without one the law reads the true state.
    count : int
        Number of λ. There are 400 frequencies.
    """
    spectrum = np.exp(1j * np.geomspace(1e-3, np.pi, FREQUENCIES))
    scalings = np.geomspace(1e-2, 1e2, SCALINGS)
    links = map(float, gains.links(count, fastest))
    norms = np.array([_norms(gains, link, latency, spectrum, filter) for link in links])
    squares, product = list[np.ndarray](), np.linalg.det(norms) ** 2
    for scaling in scalings:
        total = ((norms * np.array([[1.0, scaling], [1.0 / scaling, 1.0]])) ** 2).sum(axis=(2, 3))
        largest = total + np.sqrt(np.maximum(total**2 - 4.0 * product, 0.0))
        squares.append(largest.max(axis=0) / 2.0)  # the largest singular value²
    over, best = np.max(squares, axis=1), np.min(squares, axis=0)
    return Tolerance(float(over.min() ** -0.5), float(best.max() ** -0.5), float(scalings[over.argmin()]))


def sampled_pair(
    moved: Elements,
    gain: Elements,
    period: float,
    latency: int,
    observer: tuple[Elements, np.ndarray] | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """The sampled loop of a pair as two matrices that multiply its n states, which are x = (z, z′, w, w′) and the
    controller's memory.

    The memory is the filter's prediction (4,), the integral (trapezoidal rule), the last position, and the inputs that
    have not acted yet, the next one first. All numbers may be series in λ.

    Parameters
    ----------
    moved : (4, 5)
        The model's x after a period, by x and the input.
    gain : (5,)
        That of x and of the integral.
    period : float
        s.
    latency : int
        Samples.
    observer : (4, k) and (k, 4), optional
        Gain ℓ(λ) of the filter and its output matrix H; the state is known without.

    Returns
    -------
    acting : (5, n)
        x, and the input that acts over the period.
    memory : (n − 4, n)
        The memory after it.
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


def _norms(
    gains: PairGains, link: float, latency: int, spectrum: np.ndarray, filter: ModalFilter | None
) -> np.ndarray:
    """Norms (N, 2, 2) of the blocks of the lifted N(λ) at N points of the unit circle."""
    pair = gains.pair(link)
    moved, driven = (part[:4] for part in pair.held(gains.period / PIECES))
    driven = driven / np.array([1.0, link, pair.input])  # d as accelerations
    on_motor = [pair.motor, 0.0, -pair.motor - pair.holding, 0.0, pair.input]
    seen = np.array([[-link, 0.0, link, 0.0, 0.0], on_motor])
    # The state after each piece, of the state before, the input and the pieces of d.
    state, unit = np.eye(4, 5 + 2 * PIECES), np.eye(1, 5 + 2 * PIECES, 4)
    rows: list[np.ndarray] = []
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
        gain = np.asarray(cast(Any, chebyshev).chebval(place, table))
        observer = gain.reshape(4, -1), sensors
    acting, memory = sampled_pair(state[:, :5], gains(link)[:5], gains.period, latency, observer)
    a, b = np.vstack([state[:, :5] @ acting, memory]), np.zeros((acting.shape[1], 2 * PIECES))
    b[:4] = state[:, 5:]
    inner = np.linalg.solve(
        spectrum[:, None, None] * np.eye(len(a)) - a, np.broadcast_to(b, (len(spectrum), *b.shape))
    )
    blocks = (output[:, :5] @ acting @ inner + output[:, 5:]).reshape(-1, PIECES, 2, PIECES, 2)
    return np.linalg.norm(blocks, 2, axis=(1, 3))
