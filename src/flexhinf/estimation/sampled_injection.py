"""ẋ = A x + φ(t) from sample to sample: exact in A, with φ a straight line in between."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

__all__ = ["Held", "first_order_hold"]


class Held(NamedTuple):
    """Φ = exp(A T), Γ = ∫₀ᵀ exp(A s) ds and Γ₁ = ∫₀ᵀ exp(A (T − s)) s/T ds, all (n, n)."""

    transition: np.ndarray
    hold: np.ndarray
    ramp: np.ndarray


def first_order_hold(drift: np.ndarray, period: float) -> Held:
    """x(T) = Φ x(0) + Γ φ(0) + Γ₁ (φ(T) − φ(0)) for ẋ = A x + φ, φ a straight line over the period.

    All three are blocks of one exponential [vanloan1978]. Where φ is not straight, what is left out is at most
    T³/12 |φ̈| in one period, to leading order.

    Parameters
    ----------
    drift : (n, n) array
        A, 1/s.
    period : float
        T, s.
    """
    from scipy.linalg import expm

    n = len(drift)
    chain = np.zeros((3 * n, 3 * n))
    chain[:n, :n] = drift * period
    chain[:n, n : 2 * n] = chain[n : 2 * n, 2 * n :] = np.eye(n)
    blocks = expm(chain)[:n]
    return Held(blocks[:, :n], period * blocks[:, n : 2 * n], period * blocks[:, 2 * n :])
