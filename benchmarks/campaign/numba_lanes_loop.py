"""The stronger peer: numba with plants side by side, every operation in a loop over `W` of them that LLVM vectorises.

It is what somebody would write who knows numba and vector registers, and wants this one loop as fast as it gets: arrays
of plants, all indices but the plant's unrolled by hand, a polynomial for the sine, and fast-math. Its bits depend on
`W`, and its noise is a stream of each thread, so no plant of it can be run again alone.
"""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np
from numba import njit, prange

__all__ = ["simulate", "versions"]

#: Plants side by side; with eight LLVM takes the loops apart before it can vectorise them.
W = 16
N = 4


@njit(inline="always", fastmath=True)
def sine(x):
    """Of any angle to 1e-15: folded into half a turn, then an odd polynomial of degree 17."""
    z = x - 6.283185307179586 * np.floor(x * 0.15915494309189535 + 0.5)
    z = min(max(z, -math.pi - z), math.pi - z)
    s = z * z
    p = s * 2.8114572543455206e-15 - 7.6471637318198164e-13
    p = p * s + 1.605904383682161e-10
    p = p * s - 2.505210838544172e-08
    p = p * s + 2.755731922398589e-06
    p = p * s - 1.984126984126984e-04
    p = p * s + 8.333333333333333e-03
    p = p * s - 1.6666666666666666e-01
    return z + z * s * p


@njit(inline="always", fastmath=True)
def advance(x0, x1, x2, x3, u, a, b, c, d, e, h):
    """One Runge–Kutta step of the plant, whose numbers are a … e as in `numba_loop`."""
    spring = x0 - x2
    a1, b1 = -a * sine(x0) - b * spring, c * spring + d * u - e * x3
    y0, v0, y2, v2 = x0 + 0.5 * h * x1, x1 + 0.5 * h * a1, x2 + 0.5 * h * x3, x3 + 0.5 * h * b1
    spring = y0 - y2
    a2, b2 = -a * sine(y0) - b * spring, c * spring + d * u - e * v2
    z0, w0, z2, w2 = x0 + 0.5 * h * v0, x1 + 0.5 * h * a2, x2 + 0.5 * h * v2, x3 + 0.5 * h * b2
    spring = z0 - z2
    a3, b3 = -a * sine(z0) - b * spring, c * spring + d * u - e * w2
    s0, r0, s2, r2 = x0 + h * w0, x1 + h * a3, x2 + h * w2, x3 + h * b3
    spring = s0 - s2
    a4, b4 = -a * sine(s0) - b * spring, c * spring + d * u - e * r2
    g = h / 6.0
    return (
        x0 + g * (x1 + 2.0 * (v0 + w0) + r0), x1 + g * (a1 + 2.0 * (a2 + a3) + a4),
        x2 + g * (x3 + 2.0 * (v2 + w2) + r2), x3 + g * (b1 + 2.0 * (b2 + b3) + b4),
    )  # fmt: skip


@njit(inline="always", fastmath=True, error_model="numpy")
def draw_points(x, P, X):
    """Sigma points (9 × 4, W) of means (4, W) and lower triangles (10, W)."""
    for l in range(W):
        l00 = math.sqrt(P[0, l])
        i = 1.0 / l00
        l10, l20, l30 = P[1, l] * i, P[3, l] * i, P[6, l] * i
        l11 = math.sqrt(P[2, l] - l10 * l10)
        i = 1.0 / l11
        l21, l31 = (P[4, l] - l20 * l10) * i, (P[7, l] - l30 * l10) * i
        l22 = math.sqrt(P[5, l] - l20 * l20 - l21 * l21)
        l32 = (P[8, l] - l30 * l20 - l31 * l21) / l22
        l33 = math.sqrt(P[9, l] - l30 * l30 - l31 * l31 - l32 * l32)
        x0, x1, x2, x3 = x[0, l], x[1, l], x[2, l], x[3, l]
        X[0, l], X[1, l], X[2, l], X[3, l] = x0, x1, x2, x3
        X[4, l], X[5, l], X[6, l], X[7, l] = x0 + 2.0 * l00, x1 + 2.0 * l10, x2 + 2.0 * l20, x3 + 2.0 * l30
        X[8, l], X[9, l], X[10, l], X[11, l] = x0, x1 + 2.0 * l11, x2 + 2.0 * l21, x3 + 2.0 * l31
        X[12, l], X[13, l], X[14, l], X[15, l] = x0, x1, x2 + 2.0 * l22, x3 + 2.0 * l32
        X[16, l], X[17, l], X[18, l], X[19, l] = x0, x1, x2, x3 + 2.0 * l33
        X[20, l], X[21, l], X[22, l], X[23, l] = (
            x0 - 2.0 * l00,
            x1 - 2.0 * l10,
            x2 - 2.0 * l20,
            x3 - 2.0 * l30,
        )
        X[24, l], X[25, l], X[26, l], X[27, l] = x0, x1 - 2.0 * l11, x2 - 2.0 * l21, x3 - 2.0 * l31
        X[28, l], X[29, l], X[30, l], X[31, l] = x0, x1, x2 - 2.0 * l22, x3 - 2.0 * l32
        X[32, l], X[33, l], X[34, l], X[35, l] = x0, x1, x2, x3 - 2.0 * l33


@njit(inline="always", fastmath=True, error_model="numpy")
def correct(e, P, X, y, r):
    """The measurement update."""
    for l in range(W):
        mean = 0.125 * (X[4, l] + X[8, l] + X[12, l] + X[16, l] + X[20, l] + X[24, l] + X[28, l] + X[32, l])
        away = 2.0 * (X[0, l] - mean)
        spread = away * (X[0, l] - mean) + r
        g0, g1 = away * (X[0, l] - e[0, l]), away * (X[1, l] - e[1, l])
        g2, g3 = away * (X[2, l] - e[2, l]), away * (X[3, l] - e[3, l])
        for s in range(1, 9):
            away = 0.125 * (X[4 * s, l] - mean)
            spread += away * (X[4 * s, l] - mean)
            g0 += away * (X[4 * s, l] - e[0, l])
            g1 += away * (X[4 * s + 1, l] - e[1, l])
            g2 += away * (X[4 * s + 2, l] - e[2, l])
            g3 += away * (X[4 * s + 3, l] - e[3, l])
        k0, k1, k2, k3 = g0 / spread, g1 / spread, g2 / spread, g3 / spread
        error = y[l] - mean
        e[0, l] += k0 * error
        e[1, l] += k1 * error
        e[2, l] += k2 * error
        e[3, l] += k3 * error
        P[0, l] -= k0 * g0
        P[1, l] -= k1 * g0
        P[2, l] -= k1 * g1
        P[3, l] -= k2 * g0
        P[4, l] -= k2 * g1
        P[5, l] -= k2 * g2
        P[6, l] -= k3 * g0
        P[7, l] -= k3 * g1
        P[8, l] -= k3 * g2
        P[9, l] -= k3 * g3


@njit(inline="always", fastmath=True)
def law(e, w, t, f, u):
    """The cubic law: five linear terms, and 35 cubic ones nested after Horner."""
    for l in range(W):
        a, b, c, d, z = e[0, l], e[1, l], e[2, l], e[3, l], w[l]
        cubic = a * (
            a * (t[0] * a + t[1] * b + t[2] * c + t[3] * d + t[4] * z)
            + b * (t[5] * b + t[6] * c + t[7] * d + t[8] * z)
            + c * (t[9] * c + t[10] * d + t[11] * z) + d * (t[12] * d + t[13] * z) + t[14] * z * z
        )  # fmt: skip
        cubic += b * (
            b * (t[15] * b + t[16] * c + t[17] * d + t[18] * z)
            + c * (t[19] * c + t[20] * d + t[21] * z) + d * (t[22] * d + t[23] * z) + t[24] * z * z
        )  # fmt: skip
        cubic += c * (c * (t[25] * c + t[26] * d + t[27] * z) + d * (t[28] * d + t[29] * z) + t[30] * z * z)
        cubic += d * (d * (t[31] * d + t[32] * z) + t[33] * z * z) + t[34] * z * z * z
        u[l] = f[0] * a + f[1] * b + f[2] * c + f[3] * d + f[4] * z + cubic


@njit(inline="always", fastmath=True)
def collect(e, P, X, q):
    """Means and covariances of the predicted points."""
    for l in range(W):
        m0, m1, m2, m3 = 0.0, 0.0, 0.0, 0.0
        for s in range(1, 9):
            m0 += 0.125 * X[4 * s, l]
            m1 += 0.125 * X[4 * s + 1, l]
            m2 += 0.125 * X[4 * s + 2, l]
            m3 += 0.125 * X[4 * s + 3, l]
        a, b, c, d = X[0, l] - m0, X[1, l] - m1, X[2, l] - m2, X[3, l] - m3
        p0, p1, p2, p3, p4 = 2.0 * a * a, 2.0 * b * a, 2.0 * b * b, 2.0 * c * a, 2.0 * c * b
        p5, p6, p7, p8, p9 = 2.0 * c * c, 2.0 * d * a, 2.0 * d * b, 2.0 * d * c, 2.0 * d * d
        for s in range(1, 9):
            a, b, c, d = X[4 * s, l] - m0, X[4 * s + 1, l] - m1, X[4 * s + 2, l] - m2, X[4 * s + 3, l] - m3
            p0 += 0.125 * a * a
            p1 += 0.125 * b * a
            p2 += 0.125 * b * b
            p3 += 0.125 * c * a
            p4 += 0.125 * c * b
            p5 += 0.125 * c * c
            p6 += 0.125 * d * a
            p7 += 0.125 * d * b
            p8 += 0.125 * d * c
            p9 += 0.125 * d * d
        e[0, l], e[1, l], e[2, l], e[3, l] = m0, m1, m2, m3
        P[0, l], P[1, l], P[2, l], P[3, l], P[4, l] = p0 + q, p1, p2 + q, p3, p4
        P[5, l], P[6, l], P[7, l], P[8, l], P[9, l] = p5 + q, p6, p7, p8, p9 + q


@njit(parallel=True, fastmath=True, error_model="numpy")
def campaign(plants, model, first, third, period, q, r, goal, noise, given, steps, found):
    """As in `numba_loop`, for a number of plants that `W` divides."""
    for block in prange(len(plants) // W):
        x, e, P, X = np.zeros((N, W)), np.zeros((N, W)), np.zeros((10, W)), np.zeros((9 * N, W))
        own, u, y, integral, previous = np.zeros((5, W)), np.zeros(W), np.zeros(W), np.zeros(W), np.zeros(W)
        highest, peak, total = np.full(W, -1e300), np.zeros(W), np.zeros(W)
        m0, m1, m2, m3, m4 = model[0], model[1], model[2], model[3], model[4]
        for l in range(W):
            P[0, l] = P[2, l] = P[5, l] = P[9, l] = 1e-4
            for i in range(5):
                own[i, l] = plants[block * W + l, i]
        for k in range(steps):
            if len(given):
                for l in range(W):
                    y[l] = x[0, l] + given[k]
            else:
                for l in range(W):
                    y[l] = x[0, l] + noise * np.random.normal()  # noqa: NPY002 - what numba has
            draw_points(e, P, X)
            correct(e, P, X, y, r)
            size = period if k else 0.0
            for l in range(W):
                integral[l] += size * (0.5 * (previous[l] + y[l]) - goal)
                previous[l] = y[l]
            law(e, integral, third, first, u)
            for l in range(W):
                highest[l], peak[l] = max(highest[l], x[0, l]), max(peak[l], abs(u[l]))
                total[l] += (x[0, l] - goal) ** 2
            draw_points(e, P, X)
            for s in range(9):
                j = 4 * s
                for l in range(W):
                    X[j, l], X[j + 1, l], X[j + 2, l], X[j + 3, l] = advance(
                        X[j, l], X[j + 1, l], X[j + 2, l], X[j + 3, l], u[l], m0, m1, m2, m3, m4, period
                    )
            collect(e, P, X, q)
            for l in range(W):
                x[0, l], x[1, l], x[2, l], x[3, l] = advance(
                    x[0, l], x[1, l], x[2, l], x[3, l], u[l],
                    own[0, l], own[1, l], own[2, l], own[3, l], own[4, l], period,
                )  # fmt: skip
        for l in range(W):
            at = block * W + l
            found[at, 0], found[at, 1], found[at, 2] = highest[l], peak[l], total[l]


def simulate(task: dict[str, Any], plants: np.ndarray, steps: int, given: np.ndarray) -> np.ndarray:
    """As in `numba_loop`; the last plant is repeated until `W` divides their number."""
    numba.set_num_threads(min(task["threads"], numba.config.NUMBA_NUM_THREADS))
    whole = np.concatenate([plants, np.repeat(plants[-1:], -len(plants) % W, axis=0)])
    found = np.zeros((len(whole), 3))
    constants = (task["period"], task["q"], task["r"], task["goal"], task["noise"])
    model, first, third = (np.array(task[name]) for name in ("model", "first", "third"))
    campaign(whole, model, first, third, *constants, given, steps, found)
    return found[: len(plants)]


def versions() -> dict[str, str]:
    """For the record."""
    return {"numba": numba.__version__, "numpy": np.__version__}
