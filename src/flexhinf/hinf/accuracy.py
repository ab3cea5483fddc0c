"""How far a solution can be trusted: the residual of Eq. (8) itself, and the error of every degree.

The residual of each linear solve says little where the right-hand side has lost its digits. So V is inserted into
Eq. (8) degree by degree, at random points, along a route that shares nothing with the recursion. A small residual in
turn says little where Eq. (8) is ill-conditioned, as it is near γ*. So where the sensitivities of P say that digits
may be lost, the error is *measured*: the problem is solved once more in other states, with every number of it, γ
included, moved in its last bit. What the two solutions have in common are the digits that the data determine.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np

from flexhinf.errors import NumericalFailure
from flexhinf.hinf.linear_part import Parts, ScaledProblem
from flexhinf.hinf.recursion import DegreeRecord
from flexhinf.plant.polynomial_plant import PolynomialPlant
from flexhinf.polynomial import basis
from flexhinf.polynomial.algebra import monomials

DOUBTFUL = 1e-8  # estimated error of a degree from which the report warns
_LARGEST_ERROR = 1e-2  # estimated error of a degree that is not returned
_POINTS = 4  # at which the residual is measured
_ROWS = 16_384  # monomials whose gradients are formed at a time
_MARGIN = 16.0  # on the estimate that is not measured
_SAFETY = 4.0  # on the measured difference, which is one draw of the rounding errors
_LAST_BIT = float(np.finfo(float).eps)


def equation_residuals(problem: ScaledProblem, value: Parts) -> dict[int, float]:
    """Left-hand side of Eq. (8) by degree, relative to the largest of its four terms (root mean squares at points).

    `value`: Tensor entries of V, in the states of the problem.
    """
    used = {k - 1 for k in value} | {*problem.f, *problem.g, *problem.q}
    powers = monomials(_points(problem.n), {k for k in used if k <= problem.degree})
    slopes = {k: _slope(part.astype(float), powers[k - 1], problem.n, k) for k, part in value.items()}
    f = {k: powers[k] @ part.T for k, part in problem.f.items() if k < problem.degree}
    channels = {k: part @ powers[k].T for k, part in problem.g.items() if k < problem.degree}
    rows: Parts = {}
    for i, slope in slopes.items():
        for j, fields in channels.items():
            if i - 1 + j < problem.degree:
                w = np.einsum("ai,ica->ac", slope, fields)
                rows[i - 1 + j] = rows[i - 1 + j] + w if i - 1 + j in rows else w
    nothing, found = np.zeros((_POINTS, len(problem.signs))), {}
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
        found[k] = float(np.linalg.norm(sum(terms))) / largest if largest > 0 else 0.0
    return found


@lru_cache(16)
def _points(n: int) -> np.ndarray:
    points = np.random.default_rng(0).standard_normal((_POINTS, n))
    points.flags.writeable = False
    return points


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

    def move(parts: Parts) -> Parts:
        return {k: part * (1 + _LAST_BIT * rng.choice((-1.0, 1.0), part.shape)) for k, part in parts.items()}

    f, g1, g2, h = (move(parts) for parts in (plant.f_parts, plant.g1_parts, plant.g2_parts, plant.h_parts))
    return PolynomialPlant.from_parts(len(plant.state_names), f, g1, g2, h, plant.r2)


def degree_errors(
    value: Parts, growth: float, largest: float, other: Parts | None = None
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
    errors = {}
    for k, part in value.items():
        size, apart = float(np.abs(part).max()), float(np.abs(other[k] - part).max())
        least = (k - 1) * _LAST_BIT * (1 + growth)
        errors[k] = max(_SAFETY * apart / size, least) if size > 0 else apart
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
