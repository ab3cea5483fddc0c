"""Robust certificates: the claim for every robot within its tolerances, and bounds of r over a box of parameters.

Law and V are the nominal ones, as functions of the deviation from each robot's own equilibrium at the goal. Parameters
change the vector field, which the search bounds over the whole box, and the equilibrium. If the equilibrium moves by δ,
the input in deviations x from it is u = k(x + δ) − k(δ). For a linear law this equals k(x) for any δ; if the plant is
linear in the states that move, its vector field does not change either. So a linear law (V of degree two) can be proved
at any goal; for a nonlinear law the equilibrium must not depend on the parameters, as in the upright pose.

Sampled estimate of the smallest gain of a law on a level set, over all vertices of a box of parameters.

With s V as the storage function, s > 0, the dissipation inequality at x reads

    s A(x) + Z(x) + s² G(x)/γ² ≤ 0,    A = max over vertices of V_x (f + g2 k),  Z = ½ |z|²,  G = ½ |g1ᵀV_xᵀ|².

A, Z and G do not depend on s and γ, so one sample of points gives the smallest γ for every s. The search starts at
random points and improves the worst ones by smaller and smaller random steps. The result is an estimate, not a proof:
it shows for which γ a proof may succeed.

A quadratic V for a given linear law and every robot of a box, by linear matrix inequalities.

V = ½ xᵀPx may differ from the V of the law's synthesis. With ẋ = A_v x + B_v d at a vertex v of the box and of the
slopes of the elementary functions, the law inside A_v, V̇ ≤ ½γ²|d|² − ½|z|² is

    [A_vᵀP + P A_v + Q   P B_v]
    [B_vᵀP               −γ² I] ≤ 0,    Q = hᵀh + kᵀR2 k,                                                       (17)

which is linear in P and γ². Newton's method with logarithmic barriers [boyd1994] finds the smallest γ², and then the
analytic centre P for a larger γ². This proves nothing; the search proves P and γ afterwards.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from math import prod
from typing import TypeVar, cast

import numpy as np
from flint import fmpq

from flexhinf.arrays import Matrix, Vector
from flexhinf.certify.certificate import (
    Certificate,
    bracket,
    linear_part,
    linear_system,
    polynomial_at,
    quadratic_part,
    term_weight,
)
from flexhinf.certify.claim import Function, Term
from flexhinf.certify.problem_to_claim import (
    ParameterRanges,
    claim_of,
    coordinates,
    flat_names,
    law_polynomials,
    matrix_rows,
    plant_fields,
    value_polynomial,
)
from flexhinf.errors import InvalidInput
from flexhinf.hinf.value_function import ValueFunction
from flexhinf.plant.plant import GeneralisedPlant, Plant
from flexhinf.robot import Robot

#: What a product of parameters is computed with.
Exact = TypeVar("Exact", float, fmpq)

_MOVED = 1e-12  # rates at the nominal equilibrium above this, relative to the parameters: it moves


def parameter_ranges(robot: Robot, plant: Plant, scale: float = 1.0) -> dict[str, tuple[float, float]]:
    """Ranges of a plant's parameters over `scale` times the robot's tolerances, rounded outwards.

    Each parameter of the plant is monotone in each of the robot's, so its extremes are at corners of the tolerances.
    """
    table = plant.parameters
    names = [parameter.name for parameter in robot.uncertain]
    rows = [
        table.replaced(table.known(robot.corner(dict(zip(names, signs))))).vector()
        for signs in itertools.product((-scale, scale), repeat=len(names))
    ]
    smallest, largest = np.min(rows, axis=0), np.max(rows, axis=0)
    varies = smallest < largest
    low = cast("Vector", np.where(varies, np.nextafter(smallest, -np.inf), smallest))
    high = cast("Vector", np.where(varies, np.nextafter(largest, np.inf), largest))
    return dict(zip(flat_names(table), zip(low.tolist(), high.tolist())))


def tolerance_statement(
    solution: ValueFunction,
    problem: GeneralisedPlant,
    ranges: ParameterRanges,
    gamma: float,
    *,
    scale: float = 1.0,
    p: np.ndarray | None = None,
    about: str = "",
) -> Certificate:
    """The certificate to be proved, at level 1; arguments as `certify_tolerances`."""
    fields = plant_fields(problem, ranges=ranges)
    weight, n = scale * solution.P if p is None else p, len(solution.P)
    value = tuple(
        (tuple(int(k == i) + int(k == j) for k in range(n)), float(weight[i, j] / (2.0 if i == j else 1.0)))
        for i in range(n)
        for j in range(i, n)
        if weight[i, j]
    )
    law, plant = law_polynomials(solution, fields), problem.expand(1)
    root = np.linalg.inv(np.linalg.cholesky(weight)).T
    statement = claim_of(
        solution,
        problem,
        fields,
        about=about or "a state feedback, for all parameters in the box",
        r2=matrix_rows(problem.r2),
        value=value_polynomial(solution, scale) if p is None else value,
        law=law,
        gamma=float(gamma),
        level=1.0,
        coordinates=matrix_rows(coordinates(plant, plant.h_parts[1], law, weight, root, gamma)),
        reach=1.0,
    )
    _refuse_moved(statement, problem)
    return statement


def _refuse_moved(statement: Certificate, problem: GeneralisedPlant) -> None:
    """Raise unless law and vector field in deviations from each robot's own equilibrium are those of this statement.

    This holds if the equilibrium at the goal does not depend on the parameters. Otherwise the law must be linear, and
    so must the plant in all states that move; states of functions and products are then held by an integrator.
    """
    table = problem.plant.parameters
    flat, nominal = flat_names(table), table.vector()
    point, u = np.asarray(problem.operating_point), np.asarray(problem.operating_input)
    rng, d = np.random.default_rng(0), np.zeros(len(problem.disturbance_names))
    varying = [p for p in statement.parameters if p.low < p.high]
    corners = [
        *({p.name: end} for p in varying for end in (p.low, p.high)),
        *({p.name: (p.low, p.high)[rng.integers(2)] for p in varying} for _ in range(16)),
    ]
    limit = _MOVED * max(1.0, float(np.abs(nominal).max()))
    for corner in corners:
        there = table.named(np.array([*(dict(zip(flat, nominal)) | corner).values()]))
        if np.abs(np.asarray(problem.flow(point, u, d, there), dtype=float)).max() > limit:
            break
    else:  # ẋ = 0 at the nominal equilibrium
        return
    linear = all(sum(powers) == 1 for law in statement.law for powers, _ in law)
    bent = {i for f in statement.functions for i, slope in enumerate(f.slope) if slope}
    drift, penalty = itertools.chain(*statement.drift), itertools.chain(*statement.penalty)
    nonlinear = [
        *(term.powers for term in drift if sum(term.powers) + (term.function is not None) > 1),
        *(term.powers for terms in itertools.chain(*statement.g1, *statement.g2) for term in terms),
        *(powers for powers, _ in penalty if sum(powers) > 1),
    ]
    bent |= {i for powers in nonlinear for i, power in enumerate(powers) if power}
    held = {
        row[0].powers.index(1)
        for row, inputs in zip(statement.drift, statement.g2)
        if len(row) == 1 and row[0].function is None and sum(row[0].powers) == 1 and not any(inputs)
    }
    if not linear or bent - held:
        raise InvalidInput(
            "The equilibrium at the goal moves with the parameters, and the law is not linear, or the plant is not "
            "linear in what moves.",
            f"expected no moving equilibrium, or a law of degree 1 and integrators that hold {sorted(bent)}, got "
            f"a law of degree {max(sum(powers) for law in statement.law for powers, _ in law)}",
            "degree=2, whose law is linear, or a goal at which no torque is held",
        )


def parameter_groups(certificate: Certificate) -> list[dict[str, int]]:
    """Parameters (with their exponents) that occur as one product only, such as m g l: each product is one variable."""
    pairs = [
        dict(term.parameters)
        for terms in itertools.chain(certificate.drift, *certificate.g1, *certificate.g2)
        for term in terms
    ]
    exponents = {name: power for powers in pairs for name, power in powers.items() if power}
    ranges = {p.name: p for p in certificate.parameters if p.low < p.high}
    groups: dict[object, dict[str, int]] = {}
    for name in (name for name in exponents if name in ranges):
        places = frozenset(i for i, powers in enumerate(pairs) if powers.get(name))
        groups.setdefault(places if ranges[name].low > 0.0 else name, {})[name] = exponents[name]
    return list(groups.values())


def power_product(group: Mapping[str, int], values: Mapping[str, Exact], unity: Exact) -> Exact:
    """The product of powers of parameters."""
    return prod((values[name] ** power for name, power in group.items()), start=unity)


def group_ends(
    certificate: Certificate, number: Callable[[float], Exact] = float
) -> list[list[dict[str, Exact]]]:
    """Values of the parameters in the box at which the product of each of `parameter_groups` is smallest and
    largest."""
    ranges = {p.name: (number(p.low), number(p.high)) for p in certificate.parameters}
    ends: list[list[dict[str, Exact]]] = []
    for group in parameter_groups(certificate):
        corners = (dict(zip(group, part)) for part in itertools.product(*(ranges[name] for name in group)))
        smallest, *_, largest = sorted(corners, key=partial(power_product, group, unity=number(1.0)))
        ends.append([smallest, largest])
    return ends


_RAYS, _SHARES = 1500, (1e-3, 0.15, 0.3, 0.45, 0.6, 0.75, 0.9, 1.0)
_ROUNDS, _KEPT, _TRIES = 8, 40, 12  # of the local search: each round halves its steps
_AGAIN = 3  # number of local searches; after each, s is chosen anew
# Factors of s, relative to the s at which the inputs of law and penalty cost the same.
_SCALES = np.geomspace(0.2, 8.0, 30)


def sampled_gain(statement: Certificate, level: float, about: float, seed: int = 0) -> tuple[float, float]:
    """The smallest γ for which s V satisfies the inequality at sampled points of {V ≤ level} (infinite if none does),
    and s.

    V is that of the statement, whose γ and level are ignored; the values of s that are tried lie around `about`.
    """
    rng, vertices = np.random.default_rng(seed), box_vertices(statement)
    root = np.linalg.inv(np.linalg.cholesky(quadratic_part(statement.value, len(statement.states)))).T
    value = partial(polynomial_at, statement.value)
    # points on random rays, each ray up to where V passes the level, at most to four times where ½ xᵀPx does
    rays = rng.standard_normal((_RAYS, len(root)))
    rays = rays / np.linalg.norm(rays, axis=1, keepdims=True) @ root.T * np.sqrt(2.0 * level)
    grid = np.linspace(0.0, 4.0, 161)[1:]
    inside = np.stack([value(rays * r) <= level for r in grid]).cumprod(axis=0)
    reach = grid[np.maximum(inside.sum(axis=0) - 1, 0)]
    points = np.vstack([rays * (reach * share)[:, None] for share in _SHARES])
    parts = _parts(statement, vertices, points)
    scale = about
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
            moved = np.vstack(starts + step * size[:, None] * moves / np.sqrt(starts.shape[1]))
            near = np.vstack([starts, moved[value(moved) <= level]])
            near_parts = _parts(statement, vertices, near)
            worst, step = _gamma(near_parts, scale), step / 2
            points = np.vstack([points, near])
            parts = np.hstack([parts, near_parts])
    return float(_gamma(parts, scale).max()), scale


def _gamma(parts: np.ndarray, scale: float) -> np.ndarray:
    a, z, g = parts
    room = -scale * a - z
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(room > 0, np.sqrt(scale**2 * g / np.where(room > 0, room, 1.0)), np.inf)


def box_vertices(statement: Certificate) -> list[dict[str, float]]:
    """Values of all parameters at the vertices of the box; parameters that occur as one product only are one axis."""
    return [
        statement.middle | {name: value for part in corner for name, value in part.items()}
        for corner in itertools.product(*group_ends(statement))
    ]


def _parts(statement: Certificate, vertices: list[dict[str, float]], x: np.ndarray) -> np.ndarray:
    """A, Z and G at points (N, n), (3, N)."""

    def weights_of(term: Term) -> np.ndarray:
        return np.array([term_weight(term, vertex) for vertex in vertices])

    slope = [
        polynomial_at(
            [(tuple(e - (j == i) for j, e in enumerate(k)), c * k[i]) for k, c in statement.value if k[i]], x
        )
        for i in range(len(statement.states))
    ]
    law = [polynomial_at(row, x) for row in statement.law]
    columns, weights = list[Vector](), list[Vector]()
    for i, along in enumerate(slope):
        rows = [
            *((term, np.ones(len(x))) for term in statement.drift[i]),
            *((term, u) for u, entry in zip(law, statement.g2[i]) for term in entry),
        ]
        for term, factor in rows:
            monomial = np.prod(x ** np.array(term.powers), axis=1)
            if term.function is not None:
                function = statement.functions[term.function]
                monomial = monomial * bracket(function, x @ np.array(function.slope))
            columns.append(along * factor * monomial)
            weights.append(weights_of(term))
    z = sum((0.5 * polynomial_at(row, x) ** 2 for row in statement.penalty), np.zeros(len(x)))
    prices = zip(itertools.product(law, law), itertools.chain(*statement.r2))
    z = sum((0.5 * price * a * b for (a, b), price in prices), z)
    g = np.zeros((len(vertices), len(x)))
    for column in zip(*statement.g1):
        parts = [
            weights_of(term)[:, None] * (along * np.prod(x ** np.array(term.powers), axis=1))
            for along, entry in zip(slope, column)
            for term in entry
        ]
        g += 0.5 * sum(parts, np.zeros_like(g)) ** 2
    return np.stack([(np.array(weights).T @ np.array(columns)).max(axis=0), z, g.max(axis=0)])


_FAR, _SLOPES = 4.0 * np.pi, 2001  # range and number of points for the slopes of a function
_NEWTON, _DECREMENT = 60, 1e-2  # steps for one barrier, and the squared decrement at which they end
_GROWTH, _ACCURACY = 30.0, 0.01  # growth of the cost's weight, and relative accuracy of γ²


@dataclass(frozen=True, eq=False)
class CommonValue:
    """Quadratic storage functions V of a linear law, common to all robots of a box."""

    smallest: float  # smallest γ of all
    optimum: np.ndarray  # upper triangle of its P in the coordinates of the search, then γ²
    base: np.ndarray  # (17), see `_centred`
    parts: np.ndarray
    inverse: np.ndarray  # of the search's coordinates, (n, n)

    def p(self, larger: float) -> np.ndarray:
        """P (n, n) of V = ½xᵀPx at the analytic centre of (17) for `larger` (above 1) times the smallest γ; a larger γ
        needs fewer cells in a proof."""
        base = self.base + larger**2 * self.optimum[-1] * self.parts[-1]
        y = _centred(base, self.parts[:-1], self.optimum[:-1], np.zeros(len(self.optimum) - 1))
        p = self.inverse.T @ _matrix(y, len(self.inverse)) @ self.inverse
        return (p + p.T) / 2


def common_value(statement: Certificate) -> CommonValue | None:
    """Quadratic V for the smallest γ and for larger ones; None if (17) has no solution.

    The statement has a linear law; its V scales the search, its γ and level are ignored. Terms of the plant of a
    higher degree are left out.
    """
    n, r2 = len(statement.states), np.array(statement.r2)
    # In these coordinates V is ½|z|².
    t = np.linalg.inv(np.linalg.cholesky(quadratic_part(statement.value, n))).T
    gain, h = linear_part(statement.law, n), linear_part(statement.penalty, n)
    slopes = itertools.product(*map(_slopes, statement.functions))
    systems = (linear_system(statement, *at) for at in itertools.product(box_vertices(statement), slopes))
    a, b = map(np.array, zip(*((a + b2 @ gain, b) for a, b, b2 in systems)))  # A_v with the law, and B_v
    q = t.T @ (h.T @ h + gain.T @ r2 @ gain) @ t
    a, b = np.linalg.inv(t) @ a @ t, np.linalg.inv(t) @ b
    if (y := _feasible(a, b, q)) is None:
        return None
    count, _, w = b.shape  # minus (17) at every vertex; P > 0 follows from stable A_v
    base = np.zeros((count, n + w, n + w))
    base[:, :n, :n] = -q
    parts = np.zeros((len(y), *base.shape))
    for part, p in zip(parts, _matrix(np.eye(n * (n + 1) // 2), n)):
        part[:, :n, :n] = -(np.swapaxes(a, 1, 2) @ p + p @ a)
        part[:, :n, n:] = -p @ b
        part[:, n:, :n] = np.swapaxes(part[:, :n, n:], 1, 2)
    parts[-1, :, n:, n:] = np.eye(w)
    y = _lowest(base, parts, y, lambda y, gap: _GROWTH * gap < _ACCURACY * y[-1])
    return CommonValue(float(np.sqrt(y[-1])), y, base, parts, np.linalg.inv(t))


def _slopes(function: Function) -> tuple[float, float]:
    """The least and largest [φ(o + s) − φ(o)]/s."""
    s = np.linspace(-_FAR, _FAR, _SLOPES)
    s = s[s != 0.0]
    with np.errstate(all="ignore"):
        values = bracket(function, s) / s
    values = values[np.isfinite(values)]
    return float(values.min()), float(values.max())


def _matrix(y: np.ndarray, n: int) -> np.ndarray:
    """The symmetric matrices (…, n, n) with the upper triangles y (…, n (n + 1)/2)."""
    p, (i, j) = np.zeros((*y.shape[:-1], n, n)), np.triu_indices(n)
    p[..., i, j] = p[..., j, i] = y
    return p


def _feasible(a: np.ndarray, b: np.ndarray, q: np.ndarray) -> np.ndarray | None:
    """Upper triangle of a P, and γ², that satisfy (17) at all vertices; None without a common Lyapunov function.

    A_vᵀP + P A_v < λ, 0 < P < 1; y is the upper triangle of P, then λ.
    """
    count, n, _ = a.shape
    base = np.zeros((count + 2, n, n))
    base[-1] = np.eye(n)
    parts = np.zeros((n * (n + 1) // 2 + 1, *base.shape))
    for part, p in zip(parts, _matrix(np.eye(n * (n + 1) // 2), n)):
        part[:-2] = -(np.swapaxes(a, 1, 2) @ p + p @ a)
        part[-2], part[-1] = p, -p
    parts[-1, :-2] = np.eye(n)
    half = 0.5 * np.eye(n)
    slack = 1.0 + float(np.linalg.eigvalsh(np.swapaxes(a, 1, 2) @ half + half @ a).max())
    y = np.append(half[np.triu_indices(n)], slack)
    y = _lowest(base, parts, y, lambda y, gap: y[-1] < 0.0 or gap <= _ACCURACY * slack)
    if y[-1] >= 0.0:
        return None
    p = _matrix(y[:-1], n) * (2.0 * np.linalg.eigvalsh(q).max() / -y[-1])
    through = p @ b
    solved = cast("Matrix", np.linalg.solve(-(np.swapaxes(a, 1, 2) @ p + p @ a + q), through))
    square = np.linalg.eigvalsh(np.swapaxes(through, 1, 2) @ solved).max()
    return np.append(p[np.triu_indices(n)], 2.0 * square)


def _lowest(
    base: np.ndarray, parts: np.ndarray, y: np.ndarray, done: Callable[[np.ndarray, float], bool]
) -> np.ndarray:
    """Minimise the last entry of y by a path-following barrier method, from a feasible y whose last entry is positive,
    until `done(y, gap)` is true; `gap` bounds the distance to the minimum after the next step."""
    weight, most = 1.0 / y[-1], base.shape[0] * base.shape[1]
    while not done(y, most / weight):
        y = _centred(base, parts, y, weight * np.eye(len(y))[-1])
        weight *= _GROWTH
    return y


def _centred(base: np.ndarray, parts: np.ndarray, y: np.ndarray, cost: np.ndarray) -> np.ndarray:
    """The minimum of costᵀy − Σ log det F_v from a feasible y on, by Newton's method with a line search.

    F_v(y) = base_v + Σ y_k parts_kv > 0 for every v; `base` is (V, m, m), `parts` (K, V, m, m).
    """

    def objective(y: np.ndarray) -> float:
        try:
            roots = np.linalg.cholesky(base + np.tensordot(y, parts, 1))
        except np.linalg.LinAlgError:
            return float("inf")
        return -2.0 * float(np.log(np.diagonal(roots, axis1=1, axis2=2)).sum()) + float(cost @ y)

    now = objective(y)
    for _ in range(_NEWTON):
        moved = np.linalg.inv(base + np.tensordot(y, parts, 1)) @ parts  # (K, V, m, m)
        gradient = cost - np.trace(moved, axis1=2, axis2=3).sum(axis=1)
        hessian = moved.reshape(len(y), -1) @ np.swapaxes(moved, 2, 3).reshape(len(y), -1).T
        scale = 1.0 / np.sqrt(np.diag(hessian))
        system = hessian * np.outer(scale, scale)
        step = cast("Vector", -scale * np.linalg.lstsq(system, scale * gradient, rcond=None)[0])
        slope = float(gradient @ step)
        if -slope < _DECREMENT:
            break
        size = 1.0
        while (new := objective(y + size * step)) > now + 0.1 * size * slope:
            size /= 2.0
            if size < 1e-9:
                return y
        y, now = y + size * step, new
    return y
