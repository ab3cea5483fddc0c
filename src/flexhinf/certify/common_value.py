"""A quadratic V for a given linear law and every robot of a box, by linear matrix inequalities.

V = ½ xᵀPx need not be the V that the law was made from. With ẋ = A_v x + B_v d at a vertex v of the box and of the
slopes of the elementary functions, the law inside A_v, V̇ ≤ ½γ²|d|² − ½|z|² is

    [A_vᵀP + P A_v + Q   P B_v]
    [B_vᵀP               −γ² I] ≤ 0,    Q = hᵀh + kᵀR2 k,                                                       (17)

which is linear in P and γ². The smallest γ², and then the P in the middle of those with a larger γ², are found by
Newton's method with logarithmic barriers [boyd1994]. It proves nothing: P and γ are proved by the search afterwards.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from flexhinf.certify.certificate import Certificate
from flexhinf.certify.sampled_gain import box_vertices, linear_part, quadratic_part, term_weight
from flexhinf.certify.starts import elementary
from flexhinf.certify.terms import Function

_FAR, _SLOPES = 4.0 * np.pi, 2001  # how far, and in how many points, the slopes of a function are looked at
_NEWTON, _DECREMENT = 60, 1e-2  # steps for one barrier, and the squared decrement at which they end
_GROWTH, _ACCURACY = 30.0, 0.01  # of the weight of the cost, and to what share γ² is found


@dataclass(frozen=True, eq=False)
class CommonValue:
    """The quadratic V of a law and a box.

    Attributes
    ----------
    smallest : float
        The smallest γ that any has.
    optimum : ndarray
        Upper triangle of its P in the coordinates of the search, then γ².
    constraints : _Constraints
        (17).
    inverse : ndarray, shape (n, n)
        Of the search's coordinates.
    """

    smallest: float
    optimum: np.ndarray
    constraints: _Constraints
    inverse: np.ndarray

    def p(self, larger: float) -> np.ndarray:
        """P (n, n) of the V = ½xᵀPx in the middle of those with `larger` times the smallest γ, above 1: the more, the
        fewer cells a proof takes."""
        y = self.constraints.middle(self.optimum, larger**2 * self.optimum[-1])
        p = self.inverse.T @ _matrix(y[:-1], len(self.inverse)) @ self.inverse
        return (p + p.T) / 2


def common_value(statement: Certificate) -> CommonValue | None:
    """The quadratic V with the smallest γ, and those with more; None where no quadratic V has any gain.

    Parameters
    ----------
    statement : Certificate
        With a linear law; its V scales the search, its γ and level do not count. Terms of the plant of a higher degree
        are left out.
    """
    n = len(statement.states)
    first = quadratic_part(statement.value, n)
    t = np.linalg.inv(np.linalg.cholesky(first)).T  # in these coordinates V of the statement is ½|z|²
    a, b, q = _vertices(statement)
    a, b, q = np.linalg.inv(t) @ a @ t, np.linalg.inv(t) @ b, t.T @ q @ t
    y = _feasible(a, b, q)
    if y is None:
        return None
    constraints = _Constraints.gain(a, b, q)
    y = constraints.smallest(y)
    return CommonValue(float(np.sqrt(y[-1])), y, constraints, np.linalg.inv(t))


def _vertices(statement: Certificate) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A_v with the law (V, n, n), B_v (V, n, w), and Q (n, n)."""
    n, r2 = len(statement.states), np.array(statement.r2)
    gain, h = linear_part(statement.law, n), linear_part(statement.penalty, n)
    ends = [_slopes(function) for function in statement.functions]
    systems = []
    for vertex, slopes in itertools.product(box_vertices(statement), itertools.product(*ends)):
        a, g2 = np.zeros((n, n)), np.zeros((n, len(gain)))
        b = np.zeros((n, len(statement.disturbances)))
        for i in range(n):
            for term in statement.drift[i]:
                weight = term_weight(term, vertex)
                if term.function is None and sum(term.powers) == 1:
                    a[i, term.powers.index(1)] += weight
                elif term.function is not None and not any(term.powers):
                    a[i] += (
                        weight * slopes[term.function] * np.array(statement.functions[term.function].slope)
                    )
            for matrix, entries in ((g2, statement.g2[i]), (b, statement.g1[i])):
                for j, terms in enumerate(entries):
                    matrix[i, j] += sum(term_weight(term, vertex) for term in terms if not any(term.powers))
        systems.append((a + g2 @ gain, b))
    return np.array([a for a, _ in systems]), np.array([b for _, b in systems]), h.T @ h + gain.T @ r2 @ gain


def _slopes(function: Function) -> tuple[float, float]:
    """The least and largest [φ(o + s) − φ(o)]/s."""
    phi, o = elementary(function.name), function.offset + function.pi_halves * np.pi / 2
    s = np.linspace(-_FAR, _FAR, _SLOPES)
    s = s[s != 0.0]
    with np.errstate(all="ignore"):
        values = (phi(o + s) - phi(o)) / s
    values = values[np.isfinite(values)]
    return float(values.min()), float(values.max())


def _units(n: int) -> list[np.ndarray]:
    """The symmetric matrices of which P is a sum."""
    return [_matrix(unit, n) for unit in np.eye(n * (n + 1) // 2)]


def _feasible(a: np.ndarray, b: np.ndarray, q: np.ndarray) -> np.ndarray | None:
    """Upper triangle of some P, and γ², that satisfy (17) at all vertices; None where no P decreases along all A_v."""
    n = a.shape[1]
    decay = _Constraints.decay(a)
    half = 0.5 * np.eye(n)
    slack = 1.0 + float(np.linalg.eigvalsh(np.swapaxes(a, 1, 2) @ half + half @ a).max())
    y = np.append(half[np.triu_indices(n)], slack)
    cost, weight, most = np.eye(len(y))[-1], 1.0 / slack, decay.base.shape[0] * n
    while y[-1] >= 0.0 and most / weight > _ACCURACY * slack:
        y = decay.centred(y, weight * cost)
        weight *= _GROWTH
    if y[-1] >= 0.0:
        return None
    p = _matrix(y[:-1], n) * (2.0 * np.linalg.eigvalsh(q).max() / -y[-1])
    inner = -(np.swapaxes(a, 1, 2) @ p + p @ a + q)
    through = p @ b
    square = np.linalg.eigvalsh(np.swapaxes(through, 1, 2) @ np.linalg.solve(inner, through)).max()
    return np.append(p[np.triu_indices(n)], 2.0 * square)


def _matrix(y: np.ndarray, n: int) -> np.ndarray:
    """The symmetric matrix of its upper triangle."""
    p = np.zeros((n, n))
    p[np.triu_indices(n)] = y
    return p + np.triu(p, 1).T


@dataclass(frozen=True, eq=False)
class _Constraints:
    """F_v(y) = base_v + Σ y_k parts_kv > 0 for every v.

    Attributes
    ----------
    base : ndarray, shape (V, m, m)
    parts : ndarray, shape (K, V, m, m)
    """

    base: np.ndarray
    parts: np.ndarray

    @classmethod
    def gain(cls, a: np.ndarray, b: np.ndarray, q: np.ndarray) -> _Constraints:
        """Minus (17) at every vertex; y is the upper triangle of P, then γ². P > 0 follows from stable A_v."""
        count, n, w = b.shape
        base = np.zeros((count, n + w, n + w))
        base[:, :n, :n] = -q
        parts = []
        for p in _units(n):
            part = np.zeros_like(base)
            part[:, :n, :n] = -(np.swapaxes(a, 1, 2) @ p + p @ a)
            part[:, :n, n:] = -p @ b
            part[:, n:, :n] = np.swapaxes(part[:, :n, n:], 1, 2)
            parts.append(part)
        level = np.zeros_like(base)
        level[:, n:, n:] = np.eye(w)
        return cls(base, np.array([*parts, level]))

    @classmethod
    def decay(cls, a: np.ndarray) -> _Constraints:
        """A_vᵀP + P A_v < λ, 0 < P < 1; y is the upper triangle of P, then λ."""
        count, n, _ = a.shape
        base = np.zeros((count + 2, n, n))
        base[-1] = np.eye(n)
        parts = []
        for p in _units(n):
            part = np.zeros_like(base)
            part[:-2] = -(np.swapaxes(a, 1, 2) @ p + p @ a)
            part[-2], part[-1] = p, -p
            parts.append(part)
        slack = np.zeros_like(base)
        slack[:-2] = np.eye(n)
        return cls(base, np.array([*parts, slack]))

    def values(self, y: np.ndarray) -> np.ndarray:
        """F_v (V, m, m)."""
        return self.base + np.tensordot(y, self.parts, 1)

    def smallest(self, y: np.ndarray) -> np.ndarray:
        """y with the smallest γ², to the accuracy."""
        cost = np.append(np.zeros(len(y) - 1), 1.0)
        weight, most = 1.0 / y[-1], len(self.base) * self.base.shape[1]
        while True:
            y = self.centred(y, weight * cost)
            if most / weight < _ACCURACY * y[-1]:
                return y
            weight *= _GROWTH

    def middle(self, y: np.ndarray, square: float) -> np.ndarray:
        """The y of a larger γ² that is farthest from all constraints, in the sense of the barrier."""
        y = np.append(y[:-1], square)
        fixed = _Constraints(self.base + square * self.parts[-1], self.parts[:-1])
        return np.append(fixed.centred(y[:-1], np.zeros(len(y) - 1)), square)

    def centred(self, y: np.ndarray, cost: np.ndarray) -> np.ndarray:
        """The minimum of costᵀy − Σ log det F_v from a feasible y on, by Newton's method with a line search."""
        now = self.barrier(y) + float(cost @ y)
        for _ in range(_NEWTON):
            inverse = np.linalg.inv(self.values(y))
            moved = inverse @ self.parts  # (K, V, m, m)
            gradient = cost - np.trace(moved, axis1=2, axis2=3).sum(axis=1)
            flat = moved.reshape(len(y), -1)
            hessian = flat @ np.swapaxes(moved, 2, 3).reshape(len(y), -1).T
            scale = 1.0 / np.sqrt(np.diag(hessian))
            step = -scale * np.linalg.lstsq(hessian * np.outer(scale, scale), scale * gradient, rcond=None)[0]
            slope = float(gradient @ step)
            if -slope < _DECREMENT:
                break
            size = 1.0
            while (
                new := self.barrier(y + size * step) + float(cost @ (y + size * step))
            ) > now + 0.1 * size * slope:
                size /= 2.0
                if size < 1e-9:
                    return y
            y, now = y + size * step, new
        return y

    def barrier(self, y: np.ndarray) -> float:
        """−Σ log det F_v; inf where an F_v is not positive definite."""
        try:
            roots = np.linalg.cholesky(self.values(y))
        except np.linalg.LinAlgError:
            return float("inf")
        return -2.0 * float(np.log(np.diagonal(roots, axis1=1, axis2=2)).sum())
