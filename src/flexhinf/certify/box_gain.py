"""The smallest gain that sampling does not refuse, for a law on a level set, at all vertices of a box of parameters.

With s V as the storage function, s > 0, the dissipation inequality at x reads

    s A(x) + Z(x) + s² G(x)/γ² ≤ 0,    A = max over vertices of V_x (f + g2 k),  Z = ½ |z|²,  G = ½ |g1ᵀV_xᵀ|².

A, Z and G do not depend on s and γ, so one sample of points gives the smallest γ for every s. Points are random, and
the worst are followed by smaller and smaller random steps. It proves nothing: it says what is worth a proof.

A quadratic V for a given linear law and every robot of a box, by linear matrix inequalities.

V = ½ xᵀPx need not be the V that the law was made from. With ẋ = A_v x + B_v d at a vertex v of the box and of the
slopes of the elementary functions, the law inside A_v, V̇ ≤ ½γ²|d|² − ½|z|² is

    [A_vᵀP + P A_v + Q   P B_v]
    [B_vᵀP               −γ² I] ≤ 0,    Q = hᵀh + kᵀR2 k,                                                       (17)

which is linear in P and γ². The smallest γ², and then the P in the middle of those with a larger γ², are found by
Newton's method with logarithmic barriers [boyd1994]. It proves nothing: P and γ are proved by the search afterwards.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from flexhinf.certify.box import parameter_groups
from flexhinf.certify.certificate import Certificate
from flexhinf.certify.claim import Function, Polynomial, Term
from flexhinf.certify.starts import bracket, term_weight

_RAYS, _SHARES = 1500, (1e-3, 0.15, 0.3, 0.45, 0.6, 0.75, 0.9, 1.0)
_ROUNDS, _KEPT, _TRIES = 8, 40, 12  # of the local search: each round halves its steps
_AGAIN = 3  # local searches: after each, s is chosen anew
_SCALES = np.geomspace(
    0.2, 8.0, 30
)  # of s, about the one at which the inputs of law and penalty cost the same


@dataclass(frozen=True)
class SampledGain:
    """The smallest γ (inf where no s has one) and its s."""

    gamma: float
    scale: float


def sampled_gain(statement: Certificate, level: float, about: float, seed: int = 0) -> SampledGain:
    """The smallest γ that no point of {V ≤ level} refuses.

    Parameters
    ----------
    statement : Certificate
        Its V is taken as it is, its γ and level do not count.
    about : float
        The s in the middle of those that are tried.
    """
    rng = np.random.default_rng(seed)
    fields = _Fields(statement)
    root = np.linalg.inv(np.linalg.cholesky(quadratic_part(statement.value, len(statement.states)))).T
    points = _points(fields.value, root, level, rng)
    parts = fields.parts(points)
    for _ in range(_AGAIN):
        gammas = [_gamma(parts, s) for s in about * _SCALES]
        best = int(np.argmin([values.max() for values in gammas]))
        scale, worst = float(about * _SCALES[best]), gammas[best]
        if not np.isfinite(worst.max()):
            break
        step, near = 0.3, points
        for _ in range(_ROUNDS):
            starts = near[np.argsort(worst)[-_KEPT:]]
            size = np.sqrt(np.sum(np.linalg.solve(root, starts.T) ** 2, axis=0))
            moves = rng.standard_normal((_TRIES, *starts.shape)) @ root.T
            moved = (starts + step * size[:, None] * moves / np.sqrt(starts.shape[1])).reshape(
                -1, starts.shape[1]
            )
            near = np.vstack([starts, moved[fields.value(moved) <= level]])
            found = fields.parts(near)
            worst, step = _gamma(found, scale), step / 2
            points = np.vstack([points, near])
            parts = np.hstack([parts, found])
    return SampledGain(float(_gamma(parts, scale).max()), scale)


def _gamma(found: np.ndarray, scale: float) -> np.ndarray:
    """The smallest γ at each point; inf where there is none."""
    a, z, g = found
    room = -scale * a - z
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(room > 0, np.sqrt(scale**2 * g / np.where(room > 0, room, 1.0)), np.inf)


def _points(
    value: Callable[[np.ndarray], np.ndarray], root: np.ndarray, level: float, rng: np.random.Generator
) -> np.ndarray:
    """Points on random rays, each ray up to where V passes the level, at most to four times where ½ xᵀPx does."""
    n = len(root)
    rays = rng.standard_normal((_RAYS, n))
    rays = rays / np.linalg.norm(rays, axis=1, keepdims=True) @ root.T * np.sqrt(2.0 * level)
    grid = np.linspace(0.0, 4.0, 161)[1:]
    inside = np.stack([value(rays * r) <= level for r in grid]).cumprod(axis=0).sum(axis=0)
    reach = grid[np.maximum(inside - 1, 0)]
    return np.vstack([rays * (reach * share)[:, None] for share in _SHARES])


def linear_part(rows: Sequence[Polynomial], n: int) -> np.ndarray:
    """The linear part (rows, n) of polynomials."""
    found = np.zeros((len(rows), n))
    for k, row in enumerate(rows):
        for powers, coefficient in row:
            if sum(powers) == 1:
                found[k, powers.index(1)] += coefficient
    return found


def quadratic_part(value: Polynomial, n: int) -> np.ndarray:
    """P of V_2 = ½ xᵀPx."""
    p = np.zeros((n, n))
    for powers, coefficient in value:
        if sum(powers) == 2:
            i, j = (k for k, power in enumerate(powers) for _ in range(power))
            p[i, j] += coefficient
            p[j, i] += coefficient
    return p


def box_vertices(statement: Certificate) -> list[dict[str, float]]:
    """Values of all parameters at the vertices of the box; parameters that occur as one product only are one axis."""
    ranges = {p.name: (p.low, p.high) for p in statement.parameters}
    ends = []
    for group in parameter_groups(statement):
        every = itertools.product(*([{name: end} for end in ranges[name]] for name in group))
        merged = [{name: value for part in chosen for name, value in part.items()} for chosen in every]
        size = [np.prod([part[name] ** power for name, power in group.items()]) for part in merged]
        ends.append([merged[int(np.argmin(size))], merged[int(np.argmax(size))]])
    return [
        statement.middle | {k: v for part in corner for k, v in part.items()}
        for corner in itertools.product(*ends)
    ]


class _Fields:
    """V, and the parts of the inequality, in doubles."""

    def __init__(self, statement: Certificate) -> None:
        self.statement = statement
        self.n = len(statement.states)
        self.vertices = box_vertices(statement)

    def value(self, x: np.ndarray) -> np.ndarray:
        """V (N,)."""
        return _polynomial(self.statement.value, x)

    def parts(self, x: np.ndarray) -> np.ndarray:
        """A, Z and G at points (N, n), (3, N)."""
        given = self.statement
        slope = [_polynomial(_derivative(given.value, i), x) for i in range(self.n)]
        law = [_polynomial(row, x) for row in given.law]
        columns, weights = [], []
        for i in range(self.n):
            rows = [(term, np.ones(len(x))) for term in given.drift[i]]
            rows += [(term, law[j]) for j, entry in enumerate(given.g2[i]) for term in entry]
            for term, factor in rows:
                columns.append(slope[i] * factor * self._monomial(term, x))
                weights.append([term_weight(term, vertex) for vertex in self.vertices])
        a = (np.array(weights).T @ np.array(columns)).max(axis=0)
        z = sum((0.5 * _polynomial(row, x) ** 2 for row in given.penalty), np.zeros(len(x)))
        for i, row in enumerate(given.r2):
            for j, price in enumerate(row):
                z = z + 0.5 * price * law[i] * law[j]
        g = np.zeros((len(self.vertices), len(x)))
        for column in zip(*given.g1):
            along = np.zeros((len(self.vertices), len(x)))
            for i, entry in enumerate(column):
                for term in entry:
                    weight = np.array([term_weight(term, vertex) for vertex in self.vertices])
                    along += weight[:, None] * (slope[i] * self._monomial(term, x))
            g += 0.5 * along**2
        return np.stack([a, z, g.max(axis=0)])

    def _monomial(self, term: Term, x: np.ndarray) -> np.ndarray:
        result = np.prod(x ** np.array(term.powers), axis=1)
        if term.function is None:
            return result
        function = self.statement.functions[term.function]
        return result * bracket(function, x @ np.array(function.slope))


def _polynomial(polynomial: Polynomial, x: np.ndarray) -> np.ndarray:
    result = np.zeros(len(x))
    for powers, coefficient in polynomial:
        term = np.full(len(x), coefficient)
        for i, power in enumerate(powers):
            if power:
                term = term * x[:, i] ** power
        result += term
    return result


def _derivative(polynomial: Polynomial, i: int) -> Polynomial:
    return tuple(
        (tuple(e - (j == i) for j, e in enumerate(powers)), coefficient * powers[i])
        for powers, coefficient in polynomial
        if powers[i]
    )


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
    """Matrices A_v with the law (V, n, n), B_v (V, n, w), and Q (n, n)."""
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
    s = np.linspace(-_FAR, _FAR, _SLOPES)
    s = s[s != 0.0]
    with np.errstate(all="ignore"):
        values = bracket(function, s) / s
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
