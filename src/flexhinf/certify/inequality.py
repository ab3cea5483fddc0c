"""The dissipation inequality as exact polynomials in coordinates z, x = T z.

    r = V_x f + ½ hᵀh + ½ V_x (g1 g1ᵀ/γ² − g2 R2⁻¹ g2ᵀ) V_xᵀ + α V = A(z) + Σ_j Q_j(z) S_j(ℓ_j(z))

V's doubles, the plant's, γ and the penalty are the rational numbers they are, and so are T's, rounded to few bits.
S_j = (Φ_j(ℓ) − Φ_j(0))/ℓ is the quotient of an elementary function, and Q_j = B_j ℓ_j where Φ_j has the factor B_j: so
r/|z|² needs nothing special at 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from flint import arb_series, fmpq, fmpq_mat, fmpq_mpoly, fmpq_mpoly_ctx

from flexhinf.certify.reading import Atom, ExactFields, rational, terms_of
from flexhinf.errors import InvalidInput
from flexhinf.hinf.value_function import ValueFunction

__all__ = ["Inequality", "Quotient", "coordinates", "inequality_of"]

Terms = dict[tuple[int, ...], fmpq]
_BITS = 20  # of the entries of T
_ZERO = fmpq(1, 1 << 200)  # what is smaller is the rounding of Φ(0)


@dataclass(frozen=True, eq=False)
class Quotient:
    """One term Q S(ℓ) of r.

    Attributes
    ----------
    factor : dict of exponents to fmpq
        Q(z).
    form : tuple of fmpq
        ℓ as a linear form of z.
    function : callable
        Φ on power series.
    value : fmpq
        Φ(0).
    text : str
    """

    factor: Terms
    form: tuple[fmpq, ...]
    function: Any
    value: fmpq
    text: str


@dataclass(frozen=True, eq=False)
class Inequality:
    """V and r in coordinates z.

    Attributes
    ----------
    states : int
    transform : ndarray, shape (n, n)
        T, exact doubles.
    value, polynomial : dict of exponents to fmpq
        V(z) and A(z).
    quotients : tuple of Quotient
    """

    states: int
    transform: np.ndarray
    value: Terms
    polynomial: Terms
    quotients: tuple[Quotient, ...]


def coordinates(solution: ValueFunction, quadratic: np.ndarray) -> np.ndarray:
    """T with V_2 = ½|z|² and r_2 = ½ xᵀ `quadratic` x diagonal, both up to the 20 bits that T is rounded to."""
    root = np.linalg.cholesky(np.linalg.inv(solution.P))
    _, vectors = np.linalg.eigh(-root.T @ quadratic @ root)
    transform = root @ vectors
    largest = np.abs(transform).max(axis=0, keepdims=True)
    scale = np.exp2(_BITS - 2 - np.ceil(np.log2(largest)))
    return np.round(transform * scale) / scale


def quadratic_part(solution: ValueFunction, fields: ExactFields, gamma: float, alpha: float) -> np.ndarray:
    """R of r_2 = ½ xᵀRx, in doubles, from Taylor coefficients of the plant."""
    plant, p = solution.expansion, solution.P
    a = plant.f_parts[1]
    c = np.array([_linear(h, fields) for h in fields.h])
    b1, b2 = plant.g1_parts[0][:, :, 0], plant.g2_parts[0][:, :, 0]
    s = b1 @ b1.T / gamma**2 - b2 @ np.linalg.solve(plant.r2, b2.T)
    return p @ a + a.T @ p + c.T @ c + p @ s @ p + alpha * p


def _linear(field: fmpq_mpoly, fields: ExactFields) -> list[float]:
    """The gradient at 0 of a polynomial in states and atoms, the atoms taken as constant: for coordinates only."""
    row = [0.0] * fields.states
    for exponents, value in terms_of(field).items():
        if sum(exponents[: fields.states]) == 1 and not any(exponents[fields.states :]):
            row[exponents.index(1)] = float(int(value.p) / int(value.q))
    return row


def inequality_of(
    solution: ValueFunction, fields: ExactFields, gamma: float, alpha: float, transform: np.ndarray | None = None
) -> Inequality:
    """The exact inequality of a solution, for a checked γ, penalty (in `fields`) and decay α."""
    if transform is None:
        transform = coordinates(solution, quadratic_part(solution, fields, gamma, alpha))
    n, context = fields.states, fields.context
    terms: Terms = {}
    room = (0,) * (len(context.names()) - n)
    for degree, part in solution.value_parts.items():
        for exponents, value in zip(solution.exponents(degree).tolist(), part.tolist()):
            if value:
                terms[(*exponents, *room)] = rational(value)
    value = context.from_dict(terms)
    small = fmpq_mpoly_ctx.get([f"z{i}" for i in range(n)])
    z = [
        sum((small.constant(rational(transform[i, j])) * small.gen(j) for j in range(n)), small.constant(0))
        for i in range(n)
    ]

    def moved(polynomial: fmpq_mpoly) -> dict[tuple[int, ...], fmpq_mpoly]:
        """A polynomial in x and atoms in coordinates z, by monomial of the atoms."""
        groups: dict[tuple[int, ...], Terms] = {}
        for exponents, entry in terms_of(polynomial).items():
            groups.setdefault(tuple(exponents[n:]), {})[tuple(exponents[:n])] = entry
        x = fmpq_mpoly_ctx.get([f"x{i}" for i in range(n)])
        return {key: x.from_dict(part).compose(*z, ctx=small) for key, part in groups.items()}

    slopes = [moved(value.derivative(i)) for i in range(n)]
    slope = [part.get(room, small.constant(0)) for part in slopes]
    total = _Sum(small)
    for i in range(n):
        total.add(moved(fields.f[i]), slope[i])
    for h in fields.h:
        total.add_product(moved(h), moved(h), fmpq(1, 2))
    if np.isfinite(gamma):
        factor = fmpq(1, 2) / (rational(gamma) * rational(gamma))
        for column in zip(*fields.g1):
            along = _Sum(small)
            for i, entry in enumerate(column):
                along.add(moved(entry), slope[i])
            total.add_product(along.groups, along.groups, factor)
    price = fmpq_mat(fields.r2).inv()
    effort = []
    for column in zip(*fields.g2):
        along = _Sum(small)
        for i, entry in enumerate(column):
            along.add(moved(entry), slope[i])
        effort.append(along.groups)
    for i, first in enumerate(effort):
        for j, second in enumerate(effort):
            if price[i, j]:
                total.add_product(first, second, -price[i, j] / 2)
    in_z = moved(value)[room]
    if alpha:
        total.add({room: in_z}, small.constant(rational(alpha)))
    return _collected(fields, transform, in_z, total.groups, room, small)


class _Sum:
    """A polynomial in z by monomial of the atoms, growing."""

    def __init__(self, context: fmpq_mpoly_ctx) -> None:
        self.groups: dict[tuple[int, ...], fmpq_mpoly] = {}
        self.context = context

    def add(self, groups: dict[tuple[int, ...], fmpq_mpoly], factor: fmpq_mpoly) -> None:
        """Add a product with a polynomial in z."""
        for key, part in groups.items():
            self.groups[key] = self.groups.get(key, self.context.constant(0)) + part * factor

    def add_product(self, first: Any, second: Any, factor: fmpq) -> None:
        """Add a product of two polynomials, times a number."""
        for one, a in first.items():
            for other, b in second.items():
                key = tuple(i + j for i, j in zip(one, other))
                product = a * b * factor
                self.groups[key] = self.groups.get(key, self.context.constant(0)) + product


def _collected(
    fields: ExactFields,
    transform: np.ndarray,
    value: fmpq_mpoly,
    groups: dict[tuple[int, ...], fmpq_mpoly],
    room: tuple[int, ...],
    small: fmpq_mpoly_ctx,
) -> Inequality:
    """Each product of atoms as one function of one linear form, with its factor."""
    polynomial = groups.get(room, small.constant(0))
    quotients = []
    for key, factor in groups.items():
        chosen = [(fields.atoms[j], e) for j, e in _chosen(key, fields)]
        if not chosen or not factor:
            continue
        directions = {atom.direction for atom, _ in chosen}
        text = " ".join(f"{atom.text}^{e}" if e > 1 else atom.text for atom, e in chosen)
        if len(directions) > 1:
            raise InvalidInput(
                "The method cannot prove anything about this plant.",
                f"expected products of functions of the same linear form, got {text}",
                "sampled_region, or problem.expand(degree) as the plant",
            )
        (direction,) = directions
        at_zero = fmpq(1)
        for atom, e in chosen:
            at_zero *= atom.at_zero() ** e
        form = tuple(
            sum((direction[i] * rational(transform[i, j]) for i in range(fields.states)), fmpq(0))
            for j in range(fields.states)
        )
        line = sum((small.constant(c) * small.gen(j) for j, c in enumerate(form)), small.constant(0))
        polynomial += factor * at_zero
        quotients.append(Quotient(terms_of(factor * line), form, _product(chosen), at_zero, text))
    return Inequality(
        fields.states, transform, terms_of(value), _without_linear(terms_of(polynomial)), tuple(quotients)
    )


def _chosen(key: tuple[int, ...], fields: ExactFields) -> list[tuple[int, int]]:
    """The atoms of a monomial, by their numbers."""
    return [(j, e) for j, e in enumerate(key[fields.first_atom - fields.states :]) if e]


def _product(chosen: Sequence[tuple[Atom, int]]) -> Any:
    def product(s: arb_series) -> arb_series:
        total: Any = None
        for atom, times in chosen:
            inner = atom.function(s)
            for _ in range(times):
                total = inner if total is None else total * inner
        return total

    return product


def _without_linear(terms: Terms) -> Terms:
    """r has no part of degree 0 or 1 but for the rounding of Φ(0) to 300 bits."""
    low = {key: value for key, value in terms.items() if sum(key) < 2}
    largest = max((abs(value) for value in terms.values()), default=fmpq(0))
    assert all(abs(value) <= largest * _ZERO for value in low.values())
    return {key: value for key, value in terms.items() if sum(key) >= 2}
