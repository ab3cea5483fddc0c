"""Robust certificates: the claim for every robot within its tolerances, and bounds of r over a box of parameters.

Law and V are the nominal ones, as functions of the deviation from each robot's own equilibrium at the goal. Parameters
change the vector field, which the search bounds over the whole box, and the equilibrium. Where the latter moves by δ,
the input in deviations x from it is u = k(x + δ) − k(δ); for a linear law this is k(x) again, whatever δ is, and where
the plant is linear in the states that move, its vector field is the same too. So for a linear law (V of degree two)
nothing more is needed at any goal; for a nonlinear one the equilibrium must not depend on the parameters: upright.

r is a sum of monomials of the parameters times functions of the state. In each parameter by itself (or in its inverse,
whichever occurs) it is convex: f and g2 are affine in it, |g1ᵀV_xᵀ|² is a square. A function that is convex in each
variable by itself is largest at a vertex of the box. So with p0 the middle, over the whole box

    r(p) − r(p0)  ≤  max over vertices v of  Σ_q C_vq Q_q(x),

where the Q_q are products of two factors: an entry of V_x with a part of ẋ, or with another entry. On a cell every
factor is enclosed as its value in the middle, slopes, and a rest of second order; so is every product, and the sum at
every vertex by its own value and slopes: the middles are exact, so nothing is lost as cells shrink.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from functools import partial
from math import comb, prod
from typing import Any

import numpy as np
from flint import fmpq, fmpq_mpoly

from flexhinf.certify.certificate import Certificate
from flexhinf.certify.claim import Term
from flexhinf.certify.inequality import Algebra, MeanForms, Rational, quotient_table
from flexhinf.certify.problem_to_claim import (
    Ranges,
    claim_of,
    coordinates,
    flat_names,
    law_polynomials,
    matrix_rows,
    nearest_double,
    plant_fields,
    rational,
    terms_of,
    value_polynomial,
)
from flexhinf.errors import InvalidInput
from flexhinf.hinf.value_function import ValueFunction
from flexhinf.plant.plant import GeneralisedPlant
from flexhinf.robot import Robot

_MOVED = 1e-12  # rates at the nominal equilibrium above this, relative to the parameters: it moves
#: Relative allowance for the rounding of the last sums: a few hundred operations in doubles.
_ROUNDING = 1e-12

_ORDER = 3  # of the polynomials that stand for quotients of elementary functions
_MOST_VERTICES = 4096


def parameter_ranges(robot: Robot, plant: Any, scale: float = 1.0) -> dict[str, tuple[float, float]]:
    """Ranges of a plant's parameters over `scale` times the robot's tolerances, rounded outwards.

    Each parameter of the plant is monotone in each of the robot's, so its extremes are at corners of the tolerances.
    """
    table = plant.parameters
    names = [parameter.name for parameter in robot.uncertain]
    rows = [
        table.replaced(table.known(robot.corner(dict(zip(names, signs))))).vector()
        for signs in itertools.product((-scale, scale), repeat=len(names))
    ]
    low, high = np.min(rows, axis=0), np.max(rows, axis=0)
    varies = low < high
    low = np.where(varies, np.nextafter(low, -np.inf), low)
    high = np.where(varies, np.nextafter(high, np.inf), high)
    return dict(zip(flat_names(table), zip(low.tolist(), high.tolist())))


def tolerance_statement(
    solution: ValueFunction,
    problem: GeneralisedPlant,
    ranges: Ranges,
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

    That is so where the equilibrium at the goal does not move with the parameters; otherwise the law must be linear,
    and so must the plant in all states that move: those of functions and products are held by an integrator.
    """
    table = problem.plant.parameters
    flat, nominal = flat_names(table), table.vector()
    point, u = np.asarray(problem.operating_point), np.asarray(problem.operating_input)
    rng, d = np.random.default_rng(0), np.zeros(len(problem.disturbance_names))
    varying = [p for p in statement.parameters if p.low < p.high]
    corners = [{p.name: end} for p in varying for end in (p.low, p.high)]
    corners += [{p.name: (p.low, p.high)[rng.integers(2)] for p in varying} for _ in range(16)]
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
    nonlinear = [term.powers for term in drift if sum(term.powers) + (term.function is not None) > 1]
    nonlinear += [term.powers for terms in itertools.chain(*statement.g1, *statement.g2) for term in terms]
    nonlinear += [powers for powers, _ in penalty if sum(powers) > 1]
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
    rows = itertools.chain(certificate.drift, *certificate.g1, *certificate.g2)
    pairs = [dict(term.parameters) for terms in rows for term in terms]
    exponents = {name: power for powers in pairs for name, power in powers.items() if power}
    ranges = {p.name: p for p in certificate.parameters if p.low < p.high}
    groups: dict[object, dict[str, int]] = {}
    for name in (name for name in exponents if name in ranges):
        places = frozenset(i for i, powers in enumerate(pairs) if powers.get(name))
        groups.setdefault(places if ranges[name].low > 0.0 else name, {})[name] = exponents[name]
    return list(groups.values())


def power_product(group: Mapping[str, int], values: Mapping[str, Any], unity: Any = 1.0) -> Any:
    """The product of powers of parameters."""
    return prod((values[name] ** power for name, power in group.items()), start=unity)


def group_ends(
    certificate: Certificate, number: Callable[[float], Any] = float
) -> list[list[dict[str, Any]]]:
    """Values of the parameters in the box at which the product of each of `parameter_groups` is least, and largest."""
    ranges, ends = {p.name: (number(p.low), number(p.high)) for p in certificate.parameters}, []
    for group in parameter_groups(certificate):
        corners = [dict(zip(group, part)) for part in itertools.product(*(ranges[name] for name in group))]
        corners.sort(key=partial(power_product, group, unity=number(1.0)))
        ends.append([corners[0], corners[-1]])
    return ends


class BoxExcess:
    """An upper bound of [r(p) − r(p0)]/ρ² on cells in max|z_i| ≤ reach, over the box of parameters.

    The difference is a sum of (an entry of V_x) · (a form) · (a quotient S_j or 1), with weights at each vertex.

    Raises
    ------
    InvalidInput
        Too many parameters, or a parameter that enters otherwise than the search can take.
    """

    def __init__(self, certificate: Certificate, reach: float) -> None:
        changes = _Changes(certificate)
        self.n, products = changes.n, changes.products()
        columns = [[nearest_double(c) for c in change] for change in products.values()]
        self._changes = np.array(columns).reshape(-1, len(changes.corners)).T  # (vertices, products)
        self._largest = np.abs(self._changes).max(axis=0, initial=0.0)
        self._factors = np.array(list(products), dtype=int).reshape(-1, 3).T.copy()  # no function: −1
        self._mean = MeanForms(self.n, changes.enclosed)
        self._lines = changes.forms(certificate.functions)
        self._tables = [
            quotient_table(f, reach * float(np.abs(line).sum()) * (1.0 + _ROUNDING) + 0.25, _ORDER)
            for f, line in zip(certificate.functions, self._lines)
        ]

    def __call__(
        self, face: np.ndarray, t: np.ndarray, half: np.ndarray, low: np.ndarray, high: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """The bound, (N,), and the contributions of the radius and of each t_j to it, (n, N).

        `face` is 2 f for the face z_f = ρ of the cube and 2 f + 1 for z_f = −ρ, (N,); `t` and `half` are centre and
        half width in the other z_i/ρ, (n − 1, N); `low` and `high` the interval of ρ, (N,).
        """
        middle = np.vstack([0.5 * (low + high), t])
        halves = np.vstack([0.5 * (high - low), half])
        value, slopes, rest = self._mean.enclose(face, middle, halves)
        quotient, spread = self._quotients(face, middle, halves)
        first, second, function = self._factors
        a, a_slope, a_rest = value[first], slopes[first], rest[first]
        c, c_spread = quotient[function], spread[function]
        b, b_slope, b_rest = c * value[second], c[:, None] * slopes[second], np.abs(c) * rest[second]
        b_rest += c_spread * (np.abs(value[second]) + np.abs(slopes[second]).sum(axis=1) + rest[second])
        a_size, b_size = (np.abs(each).sum(axis=1) for each in (a_slope, b_slope))
        centre, linear = a * b, a[:, None] * b_slope + b[:, None] * a_slope
        left = np.abs(a) * b_rest + np.abs(b) * a_rest + (a_size + a_rest) * (b_size + b_rest)
        left += _ROUNDING * (np.abs(centre) + np.abs(linear).sum(axis=1) + left)
        at_vertices = np.abs(np.tensordot(self._changes, linear, axes=1)).sum(axis=1)
        bound = self._changes @ centre + at_vertices * (1.0 + _ROUNDING) + np.abs(self._changes) @ left
        return bound.max(axis=0), np.tensordot(self._largest, np.abs(linear), axes=1)

    def _quotients(
        self, face: np.ndarray, middle: np.ndarray, halves: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Middles and radii of the quotients S_j, and of 1 in the last row, (functions + 1, N)."""
        values, radii = (make((len(self._tables) + 1, len(face))) for make in (np.ones, np.zeros))
        others = np.array([[*range(f), *range(f + 1, self.n)] for f in range(self.n)], dtype=int)[face // 2].T
        z, columns = np.empty((self.n, len(face))), np.arange(len(face))
        z[face // 2, columns], z[others, columns] = 1.0 - 2.0 * (face % 2), middle[1:]
        for j, (line, table) in enumerate(zip(self._lines, self._tables)):
            along, width = line @ z, (np.abs(line)[others] * halves[1:]).sum(axis=0)
            centre = along * middle[0]
            wide = (np.abs(along) * halves[0] + width * (middle[0] + halves[0])) * (1.0 + _ROUNDING) + 1e-13
            rows, error = table.enclose(centre - wide, centre + wide)
            values[j], *parts = (  # the polynomial about the cell's centre
                sum(comb(i, k) * rows[:, i] * centre ** (i - k) for i in range(k, _ORDER + 1))
                for k in range(_ORDER + 1)
            )
            spread = sum(np.abs(part) * wide**k for k, part in enumerate(parts, 1))
            radii[j] = (spread + error) * (1.0 + _ROUNDING) + 1e-13 * (1.0 + np.abs(values[j]))
        return values, radii


class _Changes(Algebra):
    """How the monomials of the parameters change from the middle of the box to its vertices (`corners`).

    `enclosed` are the polynomials in z without constants that are to be enclosed, each once.
    """

    def __init__(self, certificate: Certificate) -> None:
        super().__init__(certificate)
        self.enclosed: list[Rational] = []
        self._known: dict[object, int] = {}
        self._value, self._laws = self.in_x(certificate.value), [*map(self.in_x, certificate.law)]
        groups = parameter_groups(certificate)
        if 2 ** len(groups) > _MOST_VERTICES:
            raise InvalidInput(
                "The box of parameters has too many vertices.",
                f"expected at most {_MOST_VERTICES}, got 2^{len(groups)} of {groups}",
                "fewer parameters with tolerances",
            )
        #: Of each parameter that varies: its product counts once, by the first.
        self._group = {
            name: number if name == next(iter(group)) else None
            for number, group in enumerate(groups)
            for name in group
        }
        self._ends = [  # and in the middle
            [power_product(group, at, fmpq(1)) for at in (*ends, self.parameters)]
            for group, ends in zip(groups, group_ends(certificate, rational))
        ]
        self.corners = list(itertools.product((0, 1), repeat=len(groups)))

    def _at_ends(self, term: Term) -> list[fmpq]:
        """Values of coefficient · Π p^e of a term at all vertices, and at last in the middle."""
        known = {name: power for name, power in term.parameters if name not in self._group}
        constant = power_product(known, self.parameters, rational(term.coefficient))
        used = [k for name, _ in term.parameters if (k := self._group.get(name)) is not None]
        return [
            constant * prod((self._ends[k][at[k]] for k in used), start=fmpq(1))
            for at in [*self.corners, (2,) * len(self._ends)]
        ]

    def _number(self, key: object, polynomial: fmpq_mpoly) -> int:
        if key not in self._known:
            self._known[key] = len(self.enclosed)
            self.enclosed.append(terms_of(self.moved(polynomial)))
        return self._known[key]

    def _slope(self, i: int) -> int:
        return self._number(("slope", i), self._value.derivative(i))

    def products(self) -> dict[tuple[int, int, int], list[fmpq]]:
        """Changes of V_x (f + g2 k) and of ½ |g1ᵀV_xᵀ|²/γ² at all vertices, by two forms and a function or −1."""
        products, claim = dict[tuple[int, int, int], list[fmpq]](), self.certificate

        def add(key: tuple[int, int, int], changes: list[fmpq]) -> None:
            products[key] = [a + b for a, b in zip(products[key], changes)] if key in products else changes

        rows = [(i, term, None) for i, row in enumerate(claim.drift) for term in row]
        rows += [(i, t, j) for i, row in enumerate(claim.g2) for j, entry in enumerate(row) for t in entry]
        for i, term, driven in rows:
            *ends, middle = self._at_ends(term)
            if all(end == middle for end in ends):
                continue
            slope, number = self._slope(i), -1 if term.function is None else term.function
            if driven is not None:
                _refuse_powers(term)
                form = self._number(("law", driven), self._laws[driven])
            else:
                part = self.x.from_dict({term.powers: fmpq(1)})
                if term.function is not None:  # x^a ℓ, which S(ℓ) multiplies
                    part *= self.line(claim.functions[term.function].slope)
                form = self._number((term.powers, term.function), part)
            add((slope, form, number), [end - middle for end in ends])
        for column in zip(*claim.g1):
            entries = [[self._at_ends(term) for term in entry] for entry in column]
            if all(end == ends[-1] for entry in entries for ends in entry for end in ends):
                continue
            _refuse_powers(*itertools.chain(*column))
            sums = [
                [sum((ends[v] for ends in entry), fmpq(0)) for v in range(len(self.corners) + 1)]
                for entry in entries
            ]
            for i, j in itertools.combinations_with_replacement(range(len(column)), 2):
                *squares, middle = (a * b for a, b in zip(sums[i], sums[j]))
                weight = (1 if i == j else 2) / (2 * rational(claim.gamma) ** 2)
                changes = [weight * (square - middle) for square in squares]
                if any(changes):
                    add((self._slope(i), self._slope(j), -1), changes)
        return products


def _refuse_powers(*terms: Term) -> None:
    for term in terms:
        if any(term.powers):
            raise InvalidInput(
                "The box of parameters cannot be searched for this plant.",
                f"expected channels that do not depend on the state, got the term {term}",
                "nominal parameters, or sampled_region",
            )
