"""Errors of the model that every pair of an arm stands at once: small gain, one scaling per frequency for all λ.

Let the accelerations that the springs make of the links, M⁻¹ K (θ − q), and those that motors and springs make of the
rotors, J⁻¹ (u − K (θ − q)), be wrong by (1 + Δ₁) and (1 + Δ₂), any linear operators that mix joints and change with
time. Of the pairs these are a_z = λ (w − z) and a_w = κ (f + z − w), with d_z = Δ₁ a_z and d_w = Δ₂ a_w added, where Δ
is turned by V and scaled by K^½. The loop is stable if, at every frequency, one number s > 0 has

    ‖Δ‖ · max over λ of σ̄ [ N₁₁  s N₁₂ ; N₂₁/s  N₂₂ ] < 1,

N(λ) from (d_z, d_w) to (a_z, a_w): the scaling commutes with Δ, which mixes pairs but neither links with motors nor
frequencies that are not the same modulo that of sampling. So it holds for Δ that do not change with time, and for all
poses whose λ are in the range. Between samples d and a are pieces of a period (lifting, [chen1995]); the norms of
their blocks bound σ̄.
"""

from __future__ import annotations

import numpy as np

from flexhinf.modal.pair import PairGains

#: Pieces of a sampling period, pairs, frequencies, and scalings.
PIECES, PAIRS, FREQUENCIES, SCALINGS = 4, 30, 400, 121


def tolerated_error(gains: PairGains, fastest: float = 350.0, latency: int = 0) -> float:
    """Largest ‖Δ₁‖ = ‖Δ₂‖ that small gain covers, for pairs with √λ up to `fastest` (rad/s); see this module.

    The state is known to the law, as of `latency` samples before its input acts and predicted over them by the model.
    Sampled at 30 λ and 400 frequencies, so a computed number and not a proof.
    """
    spectrum = np.exp(1j * np.geomspace(1e-3, np.pi, FREQUENCIES))
    norms = np.array([_norms(gains, link, latency, spectrum) for link in gains.links(PAIRS, fastest)])
    best, product = np.full(FREQUENCIES, np.inf), np.linalg.det(norms) ** 2
    for scaling in np.geomspace(1e-2, 1e2, SCALINGS):
        total = ((norms * np.array([[1.0, scaling], [1.0 / scaling, 1.0]])) ** 2).sum(axis=(2, 3))
        largest = (
            total + np.sqrt(np.maximum(total**2 - 4.0 * product, 0.0))
        ) / 2.0  # the largest singular value²
        best = np.minimum(best, largest.max(axis=0))
    return float(1.0 / np.sqrt(best.max()))


def _norms(gains: PairGains, link: float, latency: int, spectrum: np.ndarray) -> np.ndarray:
    """Norms (N, 2, 2) of the blocks of the lifted N(λ) at N points of the unit circle."""
    pair = gains.pair(link)
    moved, driven = pair.held(gains.period / PIECES)
    driven = driven / np.array([1.0, link, pair.motor])  # d as accelerations
    seen = np.array([[-link, 0.0, link, 0.0, 0.0], [pair.motor, 0.0, -pair.motor, 0.0, 0.0]])
    # The state after each piece, of the state before, the input and the pieces of d.
    state, rows = np.eye(5, 6 + 2 * PIECES), []
    for piece in range(PIECES):
        rows.append(seen @ state)
        rows[-1][1, 5] += pair.motor
        state = moved @ state
        state[:, 5] += driven[:, 0]
        state[:, 6 + 2 * piece : 8 + 2 * piece] += driven[:, 1:]
    model, output = state[:, :6], np.vstack(rows)
    # States of the loop: the pair's, and the inputs that wait, that which acts next first.
    size, feedback = 5 + latency, np.zeros((1, 5 + latency))
    ahead = np.eye(5, size)
    for place in range(latency):
        ahead = model[:, :5] @ ahead
        ahead[:, 5 + place] += model[:, 5]
    feedback[:] = -gains(link)[:5] @ ahead
    acting = np.eye(1, size, 5) if latency else feedback
    a, b = np.zeros((size, size)), np.zeros((size, 2 * PIECES))
    a[:5, :5], b[:5] = model[:, :5], state[:, 6:]
    a[:5] += np.outer(model[:, 5], acting)
    if latency:
        a[5:-1, 6:] = np.eye(latency - 1)
        a[-1:] = feedback
    c = output[:, 5:6] @ acting
    c[:, :5] += output[:, :5]
    inner = np.linalg.solve(
        spectrum[:, None, None] * np.eye(size) - a, np.broadcast_to(b, (len(spectrum), *b.shape))
    )
    blocks = (c @ inner + output[:, 6:]).reshape(-1, PIECES, 2, PIECES, 2)
    return np.linalg.norm(blocks, 2, axis=(1, 3))
