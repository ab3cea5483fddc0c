"""The peer: the closed loop of the paper's arm for many plants with numba, one plant after the other on each thread."""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np
from numba import njit, prange

__all__ = ["simulate", "versions"]

N = 4


@njit(inline="always", error_model="numpy")
def advance(x, u, p, h, out):
    """One Runge–Kutta step of the plant (p: gravity, stiffness over both inertias, input gain, damping)."""
    x0, x1, x2, x3 = x[0], x[1], x[2], x[3]
    spring = x0 - x2
    a1, b1 = -p[0] * math.sin(x0) - p[1] * spring, p[2] * spring + p[3] * u - p[4] * x3
    y0, v0, y2, v2 = x0 + 0.5 * h * x1, x1 + 0.5 * h * a1, x2 + 0.5 * h * x3, x3 + 0.5 * h * b1
    spring = y0 - y2
    a2, b2 = -p[0] * math.sin(y0) - p[1] * spring, p[2] * spring + p[3] * u - p[4] * v2
    z0, w0, z2, w2 = x0 + 0.5 * h * v0, x1 + 0.5 * h * a2, x2 + 0.5 * h * v2, x3 + 0.5 * h * b2
    spring = z0 - z2
    a3, b3 = -p[0] * math.sin(z0) - p[1] * spring, p[2] * spring + p[3] * u - p[4] * w2
    s0, r0, s2, r2 = x0 + h * w0, x1 + h * a3, x2 + h * w2, x3 + h * b3
    spring = s0 - s2
    a4, b4 = -p[0] * math.sin(s0) - p[1] * spring, p[2] * spring + p[3] * u - p[4] * r2
    out[0] = x0 + h / 6.0 * (x1 + 2.0 * (v0 + w0) + r0)
    out[1] = x1 + h / 6.0 * (a1 + 2.0 * (a2 + a3) + a4)
    out[2] = x2 + h / 6.0 * (x3 + 2.0 * (v2 + w2) + r2)
    out[3] = x3 + h / 6.0 * (b1 + 2.0 * (b2 + b3) + b4)


@njit(error_model="numpy")
def draw_points(x, P, L, X):
    """Sigma points x, x ± 2 L (α = 1, κ = 0 and four states)."""
    for j in range(N):
        s = P[j, j]
        for k in range(j):
            s -= L[j, k] * L[j, k]
        L[j, j] = math.sqrt(s)
        inverse = 1.0 / L[j, j]
        for i in range(j + 1, N):
            s = P[i, j]
            for k in range(j):
                s -= L[i, k] * L[j, k]
            L[i, j] = s * inverse
    for i in range(N):
        X[0, i] = x[i]
        for j in range(N):
            offset = 2.0 * L[i, j] if i >= j else 0.0
            X[1 + j, i], X[5 + j, i] = x[i] + offset, x[i] - offset


@njit(error_model="numpy")
def correct(x, P, y, r, L, X, gain):
    """The measurement update with redrawn points; the central covariance weight is 2, the others 1/8."""
    draw_points(x, P, L, X)
    expected = 0.0
    for s in range(1, 9):
        expected += X[s, 0]
    expected *= 0.125
    spread = 2.0 * (X[0, 0] - expected) ** 2
    for s in range(1, 9):
        spread += 0.125 * (X[s, 0] - expected) ** 2
    spread += r
    for i in range(N):
        total = 2.0 * (X[0, 0] - expected) * (X[0, i] - x[i])
        for s in range(1, 9):
            total += 0.125 * (X[s, 0] - expected) * (X[s, i] - x[i])
        gain[i] = total / spread
    for i in range(N):
        x[i] += gain[i] * (y - expected)
        for j in range(i + 1):
            P[i, j] -= gain[i] * gain[j] * spread


@njit(error_model="numpy")
def predict(x, P, u, p, h, q, L, X):
    """The time update."""
    draw_points(x, P, L, X)
    for s in range(9):
        advance(X[s], u, p, h, X[s])
    for i in range(N):
        total = 0.0
        for s in range(1, 9):
            total += X[s, i]
        x[i] = 0.125 * total
    for s in range(9):
        for i in range(N):
            X[s, i] -= x[i]
    for i in range(N):
        for j in range(i + 1):
            total = 2.0 * X[0, i] * X[0, j]
            for s in range(1, 9):
                total += 0.125 * X[s, i] * X[s, j]
            P[i, j] = total
        P[i, i] += q


@njit(error_model="numpy")
def law(w, first, third):
    """The cubic law: five linear terms and 35 cubic ones."""
    u, n = 0.0, 0
    for i in range(5):
        u += first[i] * w[i]
        for j in range(i, 5):
            product = w[i] * w[j]
            for k in range(j, 5):
                u += third[n] * product * w[k]
                n += 1
    return u


@njit(parallel=True, error_model="numpy")
def campaign(plants, model, first, third, period, q, r, goal, noise, given, steps, found):
    """Largest position, largest input, and Σ error² of each plant."""
    for b in prange(len(plants)):
        x, estimate, P = np.zeros(N), np.zeros(N), 1e-4 * np.eye(N)
        L, X, gain, w = np.zeros((N, N)), np.zeros((9, N)), np.zeros(N), np.zeros(5)
        integral, previous, highest, peak, total = 0.0, 0.0, -math.inf, 0.0, 0.0
        for k in range(steps):
            v = given[k] if len(given) else noise * np.random.normal()  # noqa: NPY002 - what numba has
            y = x[0] + v
            correct(estimate, P, y, r, L, X, gain)
            if k:
                integral += period * (0.5 * (previous + y) - goal)
            previous = y
            w[:N] = estimate
            w[N] = integral
            u = law(w, first, third)
            highest, peak = max(highest, x[0]), max(peak, abs(u))
            total += (x[0] - goal) ** 2
            predict(estimate, P, u, model, period, q, L, X)
            advance(x, u, plants[b], period, x)
        found[b, 0], found[b, 1], found[b, 2] = highest, peak, total


def simulate(task: dict[str, Any], plants: np.ndarray, steps: int, given: np.ndarray) -> np.ndarray:
    """Results (N, 3) of a task, see `benchmarks.campaign.peer`."""
    numba.set_num_threads(min(task["threads"], numba.config.NUMBA_NUM_THREADS))
    found = np.zeros((len(plants), 3))
    constants = (task["period"], task["q"], task["r"], task["goal"], task["noise"])
    model, first, third = (np.array(task[name]) for name in ("model", "first", "third"))
    campaign(plants, model, first, third, *constants, given, steps, found)
    return found


def versions() -> dict[str, str]:
    """For the record."""
    return {"numba": numba.__version__, "numpy": np.__version__}
