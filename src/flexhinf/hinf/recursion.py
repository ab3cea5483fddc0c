"""The recursion over degrees: V_2 from Riccati, every higher V_k from one homological equation (`flexhinf.hinf.hji`).

At degree k the unknown V_k appears twice, in V_k,x A x and in w_1 · V_k,x g(0): together V_k,x A_cl x. Everything else
is known from lower degrees. Degrees whose known part is empty vanish exactly: an odd plant has no V_3, V_5, …

*States in which V is bounded*, however close γ is to γ* (`BoundedStates`). P may grow without bound as γ falls to γ*,
in one direction v after the other: vᵀPv ~ 1/δ with δ = γ/γ* − 1. The coefficients of V_k in that direction then grow
like δ^(3−2k), what is known of V_k is a sum of terms that cancel to a fraction δ^k of their size, and the recursion in
x, whose linear solves are each backward stable, loses every digit.

The Hamiltonian matrix and its stable subspace, the graph of P, are well behaved there: with an orthonormal basis
(U1; U2) of it, P = U2 U1⁻¹, it is U1 alone that becomes singular, with singular values 1/√(1 + λ²) for the
eigenvalues λ of P. So the problem is written in the states y of

    x = T y,    T = Q S,    P = Q diag(λ) Qᵀ,    S = diag(1/√(1 + λ²)) rounded to powers of two,

where TᵀPT, and with it the closed loop, its eigenvectors and V, are of ordinary size. T need not be exact, only its
inverse must be: that, and the linear part in y, are formed in extended precision (where the machine has it). There
remains the conditioning of the problem itself.

*How far a solution can be trusted*: the residual of Eq. (8) itself, and the error of every degree. The residual of each
linear solve says little where the right-hand side has lost its digits. So V is inserted into Eq. (8) degree by degree,
at random points, along a route that shares nothing with the recursion. A small residual in turn says little where Eq.
(8) is ill-conditioned, as it is near γ*. So where the sensitivities of P say that digits may be lost, the error is
*measured*: the problem is solved once more in other states, with every number of it, γ included, moved in its last bit.
The digits common to both solutions are those that the data determine.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from time import perf_counter

import numpy as np

from flexhinf.errors import NumericalFailure
from flexhinf.hinf.homological import HomologicalEquation, change_variables
from flexhinf.hinf.linear_part import PartsByDegree, RiccatiSolution, ScaledProblem
from flexhinf.hinf.products import LARGE, product, square
from flexhinf.plant.polynomial_plant import PolynomialPlant
from flexhinf.polynomial import basis
from flexhinf.polynomial.algebra import add_part, gradient, matrix_product, monomials
from flexhinf.validation import read_only


@dataclass(frozen=True)
class BoundedStates:
    """x = `to_x` y and y = `to_y` x, both (n, n) in extended precision."""

    to_x: np.ndarray
    to_y: np.ndarray

    @classmethod
    def of(cls, eigenvalues: np.ndarray, q: np.ndarray, stretch: np.ndarray | None = None) -> BoundedStates:
        """For P = Q diag(λ) Qᵀ, known roughly; `stretch` (n,), near 1, gives other states of the same kind."""
        scale = np.exp2(-np.round(np.log2(np.hypot(1.0, eigenvalues))))
        scale = (scale if stretch is None else scale * stretch).astype(np.longdouble)
        q = q.astype(np.longdouble)
        # the inverse by a Newton step, which squares 1e-15
        return cls(q * scale, q.T @ (2 * np.eye(len(q), dtype=np.longdouble) - q @ q.T) / scale[:, None])

    def problem(self, problem: ScaledProblem) -> ScaledProblem:
        """Eq. (8) in y: ẏ = T⁻¹ f(T y) + T⁻¹ g(T y) · (d, u), with q(T y)."""
        return replace(
            problem,
            f={k: self._fields(part, k) for k, part in problem.f.items()},
            g={k: self._fields(part, k) for k, part in problem.g.items()},
            q={k: self._substituted(part, k) for k, part in problem.q.items()},
        )

    def value(self, value: PartsByDegree) -> PartsByDegree:
        """Tensor entries in x of a V given in y; degree 2 in the precision it comes in."""
        n, back = len(self.to_x), self.to_y.astype(float)
        parts = {k: change_variables(part, n, k, back) for k, part in value.items() if k > 2}
        p = np.zeros((n, n), value[2].dtype)
        p[np.triu_indices(n)] = value[2]
        p = self.to_y.T @ (p + np.triu(p, 1).T) @ self.to_y
        return {2: p[np.triu_indices(n)], **parts}

    def _fields(self, part: np.ndarray, k: int) -> np.ndarray:
        """T⁻¹ p(T y) for fields p: monomial coefficients (n, …, count(n, k))."""
        matrix = self.to_y if k <= 1 else self.to_y.astype(float)
        return np.tensordot(matrix, self._substituted(part, k), axes=1).astype(float)

    def _substituted(self, part: np.ndarray, k: int) -> np.ndarray:
        """Monomial coefficients (…, count(n, k)) of p(T y)."""
        if k <= 1:
            return part @ self.to_x if k else part
        n, weights, matrix = len(self.to_x), basis.multiplicity(len(self.to_x), k), self.to_x.astype(float)
        rows = part.reshape(-1, part.shape[-1])
        result = np.zeros(rows.shape)
        for i in np.flatnonzero(rows.any(axis=1)):
            result[i] = change_variables(rows[i] / weights, n, k, matrix) * weights
        return result.reshape(part.shape)


@dataclass(frozen=True)
class DegreeRecord:
    """Method, accuracy and time of one degree of V.

    `method`: "Riccati", "eigenbasis", "eigenbasis, refined", "Schur", or "zero by parity". `residual`: Of Eq. (8) at
    this degree with the V that is returned, relative to the largest of its terms there. `seconds`: Wall time. `error`:
    Estimate of the largest error of a coefficient, relative to the largest coefficient of this degree; nan where none
    was made.
    """

    degree: int
    method: str
    residual: float
    seconds: float
    error: float = float("nan")


def solve_degrees(
    problem: ScaledProblem, riccati: RiccatiSolution, seconds: float, advance: Callable[[int], None]
) -> tuple[PartsByDegree, tuple[DegreeRecord, ...], float]:
    """All degrees of V in scaled coordinates.

    `riccati`: Of the scaled linear part. `seconds`: Time of the Riccati equation, for the record. `advance`: Called
    with each degree once it is done. Returns `value`, dict degree → (count(n, degree),): Tensor entries, of degree 2 in
    the precision of P; vanishing degrees are missing. Returns `records`, Their residuals are those of the linear
    equation of each degree, relative to A_cl, V_k and right-hand side. Returns `condition`, Condition number of the
    closed loop's eigenvectors.
    """
    n, p = problem.n, riccati.p.astype(float)
    equation = HomologicalEquation(riccati.closed_loop)
    value: PartsByDegree = {2: p[np.triu_indices(n)] / 2}
    records = [DegreeRecord(2, "Riccati", riccati.residual, seconds)]
    gradients: PartsByDegree = {2: gradient(value[2], n, 2)}
    # w, of shape (count(n, degree), channels).
    rows: PartsByDegree = {1: matrix_product(gradients[2], problem.g[0][:, :, 0])}
    for k in range(3, problem.degree + 1):
        begin = perf_counter()
        # w_{k−1} without V_k,x g(0): Σ_{i<k} V_i,x g_{k−i}
        if higher := {i: problem.g[k - i] for i in gradients if i < k and k - i in problem.g}:
            rows[k - 1] = np.zeros((basis.count(n, k - 1), len(problem.signs)))
        for i, fields in higher.items():
            for channel in np.flatnonzero(fields.any(axis=(0, 2))):
                rows[k - 1][:, channel] += product(gradients[i], fields[:, channel], n, i - 1, k - i)
        known = _known_part(problem, gradients, rows, k)
        if known is None:
            records.append(DegreeRecord(k, "zero by parity", 0.0, perf_counter() - begin))
        else:
            solution = equation.solve(known / basis.multiplicity(n, k), k)
            value[k] = solution.entries
            if k < problem.degree:
                gradients[k] = gradient(value[k], n, k)
                add_part(rows, k - 1, matrix_product(gradients[k], problem.g[0][:, :, 0]))
            records.append(DegreeRecord(k, solution.method, solution.residual, perf_counter() - begin))
        advance(k)
    value[2] = riccati.p[np.triu_indices(n)] / 2
    return value, tuple(records), equation.eigenbasis.condition if problem.degree > 2 else float("nan")


def _known_part(
    problem: ScaledProblem, gradients: PartsByDegree, rows: PartsByDegree, k: int
) -> np.ndarray | None:
    n, terms = problem.n, [problem.q[k]] if k in problem.q else []
    joined: dict[tuple[int, int], list[tuple[np.ndarray, np.ndarray]]] = {}  # by their degrees

    def add(left: np.ndarray, right: np.ndarray, a: int, b: int) -> None:
        if len(left) * right.shape[1] > LARGE:  # to add up takes longer than to multiply, so they go together
            joined.setdefault((a, b), []).append((left, right))
        else:
            terms.append(product(left, right, n, a, b))

    for i, slope in gradients.items():
        if k + 1 - i >= 2 and k + 1 - i in problem.f:
            add(slope, problem.f[k + 1 - i], i - 1, k + 1 - i)
    for a, left in rows.items():
        b = k - a
        if a == b:
            terms.append(square(left, problem.signs, n, a))
        elif b < a and b in rows:
            add(left, (rows[b] * problem.signs).T, a, b)
    for (a, b), parts in joined.items():
        left, right = parts[0]
        if len(parts) > 1:
            left, right = np.hstack([part[0] for part in parts]), np.vstack([part[1] for part in parts])
        terms.append(product(left, right, n, a, b))
    return sum(terms[1:], start=terms[0]) if terms else None


DOUBTFUL = 1e-8  # estimated error of a degree from which the report warns
_LARGEST_ERROR = 1e-2  # estimated error of a degree that is not returned
_POINTS = 4  # at which the residual is measured
_ROWS = 16_384  # monomials whose gradients are formed at a time
_MARGIN = 16.0  # on the estimate that is not measured
_SAFETY = 4.0  # on the measured difference, which is one draw of the rounding errors
_LAST_BIT = float(np.finfo(float).eps)


def equation_residuals(problem: ScaledProblem, value: PartsByDegree) -> dict[int, float]:
    """Left-hand side of Eq. (8) by degree, relative to the largest of its four terms (root mean squares at points).

    `value`: Tensor entries of V, in the states of the problem.
    """
    used = {k - 1 for k in value} | {*problem.f, *problem.g, *problem.q}
    powers = monomials(_points(problem.n), {k for k in used if k <= problem.degree})
    slopes = {k: _slope(part.astype(float), powers[k - 1], problem.n, k) for k, part in value.items()}
    f = {k: powers[k] @ part.T for k, part in problem.f.items() if k < problem.degree}
    channels = {k: part @ powers[k].T for k, part in problem.g.items() if k < problem.degree}
    rows: PartsByDegree = {}
    for i, slope in slopes.items():
        for j, fields in channels.items():
            if i - 1 + j < problem.degree:
                add_part(rows, i - 1 + j, np.einsum("ai,ica->ac", slope, fields))
    nothing = np.zeros((_POINTS, len(problem.signs)))
    residuals: dict[int, float] = {}
    for k in range(2, problem.degree + 1):
        drift = sum(
            ((slopes[i] * f[k + 1 - i]).sum(1) for i in slopes if k + 1 - i in f), start=nothing[:, 0]
        )
        penalty = powers[k] @ problem.q[k] if k in problem.q else nothing[:, 0]
        squares = (
            sum((rows[a] * rows[k - a] for a in rows if k - a in rows), start=nothing) * problem.signs / 2
        )
        terms = drift, penalty, squares[:, problem.signs > 0].sum(1), squares[:, problem.signs < 0].sum(1)
        largest = max(float(np.linalg.norm(term)) for term in terms)
        residuals[k] = float(np.linalg.norm(sum(terms))) / largest if largest > 0 else 0.0
    return residuals


@lru_cache(16)
def _points(n: int) -> np.ndarray:
    return read_only(np.random.default_rng(0).standard_normal((_POINTS, n)))


def _slope(entries: np.ndarray, powers: np.ndarray, n: int, k: int) -> np.ndarray:
    """V_k,x at the points of `powers` (N, count(n, k−1)), shape (N, n)."""
    table, weights = basis.insertion(n, k), k * basis.multiplicity(n, k - 1)
    total = np.zeros((len(powers), n))
    for begin in range(0, len(table), _ROWS):
        chunk = slice(begin, begin + _ROWS)
        total += (powers[:, chunk] * weights[chunk]) @ entries[table[chunk]]
    return total


def moved(plant: PolynomialPlant, rng: np.random.Generator) -> PolynomialPlant:
    """The plant with every coefficient multiplied by 1 ± ε; what is zero stays zero."""

    def move(parts: PartsByDegree) -> PartsByDegree:
        return {k: part * (1 + _LAST_BIT * rng.choice((-1.0, 1.0), part.shape)) for k, part in parts.items()}

    f, g1, g2, h = (move(parts) for parts in (plant.f_parts, plant.g1_parts, plant.g2_parts, plant.h_parts))
    return PolynomialPlant.from_parts(len(plant.state_names), f, g1, g2, h, plant.r2)


def degree_errors(
    value: PartsByDegree, growth: float, largest: float, other: PartsByDegree | None = None
) -> dict[int, float]:
    """Estimated error of each degree, relative to its largest coefficient.

    `growth`: ‖dP/d log γ‖/‖P‖, the relative change of P with that of γ. `largest`: Largest eigenvalue of P in balanced
    states. `other`: V of the moved problem. Without it the estimate is 16 (k − 1) ε (1 + growth² + largest), without
    the square for degree 2: the form is that of the two ways in which P is lost at γ* (growth ~ δ^(−½) where
    eigenvalues reach the imaginary axis, largest ~ 1/δ where P grows without bound; coefficients of higher degree lose
    ε/δ in both), the factor bounds nearly all of what was measured on random plants.
    """
    if other is None:
        power = {k: growth if k == 2 else growth**2 for k in value}
        return {k: _MARGIN * (k - 1) * _LAST_BIT * (1 + power[k] + largest) for k in value}
    errors: dict[int, float] = {}
    for k, part in value.items():
        size, apart = float(np.abs(part).max()), float(np.abs(other[k] - part).max())
        errors[k] = max(_SAFETY * apart / size, (k - 1) * _LAST_BIT * (1 + growth)) if size > 0 else apart
    return errors


def checked_records(
    records: Sequence[DegreeRecord],
    residuals: dict[int, float],
    errors: dict[int, float],
    gamma: float,
    growth: float,
) -> tuple[DegreeRecord, ...]:
    """The records with the residual of Eq. (8) and the error; degrees that vanish have neither.

    Raises NumericalFailure for a degree of which no digits are left, with its estimated error.
    """
    for degree, error in errors.items():
        if error > _LARGEST_ERROR:
            lower = f", or degree {degree - 1}" if degree > 2 else ""
            raise NumericalFailure(
                f"V of degree {degree} is not determined by the data at this attenuation level.",
                f"expected an error of its coefficients below {_LARGEST_ERROR:g}, got about {error:.1g} at "
                f"gamma = {gamma:.15g}, where P changes by {growth:.1g} times the relative change of gamma",
                f"a gamma further above gamma*{lower}",
            )
    return tuple(
        replace(record, residual=residuals[record.degree], error=errors[record.degree])
        if record.degree in errors
        else record
        for record in records
    )
