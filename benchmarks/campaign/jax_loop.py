"""The peer: the closed loop of the paper's arm with JAX: scalars, `lax.scan` over time, `vmap` over plants.

Of the forms that were tried (matrices with `jnp.linalg`, unrolled matrices, scalars) the one of scalars is the fastest.
"""

from __future__ import annotations

from functools import lru_cache, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

jax.config.update("jax_enable_x64", True)

__all__ = ["simulate", "versions"]

N, WEIGHTS = 4, (2.0, *(0.125,) * 8)


def flow(x, u, p):
    """As in the numba peer."""
    spring = x[0] - x[2]
    return x[1], -p[0] * jnp.sin(x[0]) - p[1] * spring, x[3], p[2] * spring + p[3] * u - p[4] * x[3]


def advance(x, u, p, h):
    """One Runge–Kutta step."""

    def along(k, size):
        return [a + size * b for a, b in zip(x, k)]

    k1 = flow(x, u, p)
    k2 = flow(along(k1, h / 2), u, p)
    k3 = flow(along(k2, h / 2), u, p)
    k4 = flow(along(k3, h), u, p)
    return [x[i] + h / 6.0 * (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i]) for i in range(N)]


def points(x, P):
    """Sigma points; P is the lower triangle by (i, j)."""
    L: dict[tuple[int, int], Any] = {}
    for j in range(N):
        L[j, j] = jnp.sqrt(P[j, j] - sum(L[j, k] * L[j, k] for k in range(j)))
        inverse = 1.0 / L[j, j]
        for i in range(j + 1, N):
            L[i, j] = (P[i, j] - sum(L[i, k] * L[j, k] for k in range(j))) * inverse
    offsets = [[2.0 * L[i, j] if i >= j else 0.0 for i in range(N)] for j in range(N)]
    plus = [[a + b for a, b in zip(x, offset)] for offset in offsets]
    return [list(x), *plus, *([a - b for a, b in zip(x, offset)] for offset in offsets)]


def correct(x, P, y, r):
    """The measurement update with redrawn points."""
    X = points(x, P)
    expected = 0.125 * sum(s[0] for s in X[1:])
    away = [w * (s[0] - expected) for w, s in zip(WEIGHTS, X)]
    spread = sum(a * (s[0] - expected) for a, s in zip(away, X)) + r
    gain = [sum(a * (s[i] - x[i]) for a, s in zip(away, X)) / spread for i in range(N)]
    x = [x[i] + gain[i] * (y - expected) for i in range(N)]
    return x, {(i, j): P[i, j] - gain[i] * gain[j] * spread for i in range(N) for j in range(i + 1)}


def predict(x, P, u, p, h, q):
    """The time update."""
    X = [advance(s, u, p, h) for s in points(x, P)]
    x = [0.125 * sum(s[i] for s in X[1:]) for i in range(N)]
    D = [[s[i] - x[i] for i in range(N)] for s in X]
    P = {
        (i, j): sum(w * d[i] * d[j] for w, d in zip(WEIGHTS, D)) + (q if i == j else 0.0)
        for i in range(N)
        for j in range(i + 1)
    }
    return x, P


def law(w, first, third):
    """The cubic law."""
    u, n = sum(first[i] * w[i] for i in range(5)), 0
    for i in range(5):
        for j in range(i, 5):
            product = w[i] * w[j]
            for k in range(j, 5):
                u, n = u + third[n] * product * w[k], n + 1
    return u


def one(plant, key, task, steps, given):
    """Largest position, largest input and Σ error² of a plant."""
    h, q, r, goal = (task[name] for name in ("period", "q", "r", "goal"))

    def step(carry, now):
        x, estimate, P, integral, previous, highest, peak, total = carry
        k, v = now
        v = v if given else task["noise"] * jax.random.normal(jax.random.fold_in(key, k), dtype=jnp.float64)
        y = x[0] + v
        estimate, P = correct(estimate, P, y, r)
        integral = jnp.where(k > 0, integral + h * (0.5 * (previous + y) - goal), integral)
        u = law([*estimate, integral], task["first"], task["third"])
        highest, peak = jnp.maximum(highest, x[0]), jnp.maximum(peak, jnp.abs(u))
        total = total + (x[0] - goal) ** 2
        estimate, P = predict(estimate, P, u, task["model"], h, q)
        return (advance(x, u, plant, h), estimate, P, integral, y, highest, peak, total), None

    zero = jnp.zeros(())
    P = {(i, j): jnp.full((), 1e-4 if i == j else 0.0) for i in range(N) for j in range(i + 1)}
    start = ([zero] * N, [zero] * N, P, zero, zero, zero - jnp.inf, zero, zero)
    found, _ = lax.scan(step, start, (jnp.arange(len(steps)), steps))
    return jnp.stack(found[-3:])


@lru_cache(maxsize=4)
def compiled(task: tuple, given: bool):
    """One program for all plants; the constants of the task are constants of the program."""
    run = partial(one, task=dict(task), given=given)
    return jax.jit(lambda plants, keys, steps: jax.vmap(lambda p, k: run(p, k, steps=steps))(plants, keys))


def simulate(task: dict[str, Any], plants: np.ndarray, steps: int, given: np.ndarray) -> np.ndarray:
    """Results (N, 3) of a task, see `benchmarks.campaign.peer`."""
    constants = tuple((name, tuple(v) if isinstance(v, list) else v) for name, v in task.items())
    keys = jax.vmap(lambda k: jax.random.fold_in(jax.random.PRNGKey(0), k))(jnp.arange(len(plants)))
    noise = given if len(given) else np.zeros(steps)
    return np.asarray(compiled(constants, bool(len(given)))(plants, keys, noise).block_until_ready())


def versions() -> dict[str, str]:
    """For the record."""
    return {"jax": jax.__version__}
