"""A claim's closed loop as exact polynomials, in coordinates that suit sums of squares.

x = T z with T = √(2c) L, P⁻¹ = L Lᵀ and L lower triangular: V_2 = c |z|², so that the level set is about the unit ball,
and x1, of which alone the plant has a function, is a multiple of z1. V, the cost and the supply are divided by c, and
d = √(2c)/γ δ, so that V̇ ≤ |δ|² − (cost) with coefficients of the order of one.

The function enters as S(x1)·x1 with S(s) = [φ(o + s) − φ(o)]/s. On an interval it lies between two polynomials, and
what is affine in S holds for all between if it holds for both.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from math import prod

import numpy as np
from flint import fmpq, fmpq_mpoly, fmpq_mpoly_ctx

from flexhinf.certify import Certificate, Function, Term
from flexhinf.certify.certificate import quadratic_part
from flexhinf.certify.claim import PolynomialTerms
from flexhinf.certify.problem_to_claim import few_bits, nearest_double, rational, terms_of

__all__ = ["Model", "evaluated", "even", "model_of", "quotient_bounds", "with_value"]

_SAMPLES = 20_001  # of the interval on which a polynomial is fitted to S


@dataclass(frozen=True, eq=False)
class Model:
    """ż = rates + S·factors + Σ_j g1_j δ_j, in units of the level; V̇ ≤ |δ|² − cost is to be shown.

    Attributes
    ----------
    transform : ndarray, (n, n)
        T.
    z, disturbances : list of polynomials, (n,) and (w,)
        The variables.
    rates, factors : list of polynomials, (n,)
    g1 : list of n rows of w polynomials
    cost, value : polynomial
        ½|z|²/c of the claim's penalty, and V/c.
    function : Function or None
    """

    transform: np.ndarray
    z: list[fmpq_mpoly]
    disturbances: list[fmpq_mpoly]
    rates: list[fmpq_mpoly]
    factors: list[fmpq_mpoly]
    g1: list[list[fmpq_mpoly]]
    cost: fmpq_mpoly
    value: fmpq_mpoly
    function: Function | None

    @property
    def radius(self) -> fmpq_mpoly:
        """|z|²."""
        return sum((z * z for z in self.z), self.number(0))

    def number(self, value: float | fmpq) -> fmpq_mpoly:
        """A constant."""
        return self.z[0].context().constant(value if isinstance(value, fmpq) else rational(float(value)))

    def derivative(self, value: fmpq_mpoly, quotient: fmpq_mpoly) -> fmpq_mpoly:
        """V̇ for δ = 0, with the polynomial `quotient` in the place of S."""
        slopes = [value.derivative(i) for i in range(len(self.z))]
        return sum(
            (
                slope * (rate + quotient * factor)
                for slope, rate, factor in zip(slopes, self.rates, self.factors)
            ),
            self.number(0),
        )

    def along(self, value: fmpq_mpoly) -> list[fmpq_mpoly]:
        """g1ᵀV_zᵀ."""
        slopes = [value.derivative(i) for i in range(len(self.z))]
        return [sum((a * b for a, b in zip(slopes, column)), self.number(0)) for column in zip(*self.g1)]

    def residual(self, value: fmpq_mpoly, quotient: fmpq_mpoly) -> fmpq_mpoly:
        """r/c, the worst disturbance inserted."""
        worst = sum((a * a for a in self.along(value)), self.number(0)) / 4
        return self.derivative(value, quotient) + self.cost + worst

    def supply(self, value: fmpq_mpoly, quotient: fmpq_mpoly) -> fmpq_mpoly:
        """V̇ + cost − |δ|², affine in V."""
        driven = sum(((a - d) * d for a, d in zip(self.along(value), self.disturbances)), self.number(0))
        return self.derivative(value, quotient) + self.cost + driven


def model_of(claim: Certificate, parameters: dict[str, float] | None = None) -> Model:
    """The closed loop of a claim in units of its level, at given parameters or in the middle of their ranges."""
    return _Reader(claim, parameters or {}).model()


class _Reader:
    """Polynomials in z and δ for the parts of one claim."""

    def __init__(self, claim: Certificate, parameters: dict[str, float]) -> None:
        self.claim = claim
        self.n, self.w = len(claim.states), len(claim.disturbances)
        names = [f"z{i}" for i in range(self.n)] + [f"d{j}" for j in range(self.w)]
        self.ring = fmpq_mpoly_ctx.get(names)
        self.x = fmpq_mpoly_ctx.get([f"x{i}" for i in range(self.n)])
        self.parameters = {p.name: rational(parameters.get(p.name, p.middle)) for p in claim.parameters}
        lower = np.linalg.cholesky(np.linalg.inv(quadratic_part(claim.value, self.n)))
        self.transform = few_bits(np.sqrt(2.0 * claim.level) * lower)
        gens = list(self.ring.gens())
        self.z, self.d = gens[: self.n], gens[self.n :]
        self.state = [self._form(row, self.z) for row in self.transform]

    def _form(self, row: Iterable[float], variables: Sequence[fmpq_mpoly]) -> fmpq_mpoly:
        zero = self.ring.constant(0)
        return sum((self.ring.constant(rational(float(a))) * z for a, z in zip(row, variables)), zero)

    def _moved(self, terms: dict[tuple[int, ...], fmpq]) -> fmpq_mpoly:
        return self.x.from_dict(terms).compose(*self.state, ctx=self.ring)

    def _polynomial(self, polynomial: PolynomialTerms) -> fmpq_mpoly:
        return self._moved({powers: rational(value) for powers, value in polynomial})

    def _terms(self, row: Iterable[Term]) -> fmpq_mpoly:
        total: dict[tuple[int, ...], fmpq] = {}
        for term in row:
            factors = (self.parameters[name] ** power for name, power in term.parameters)
            value = prod(factors, start=rational(term.coefficient))
            total[term.powers] = total.get(term.powers, fmpq(0)) + value
        return self._moved(total)

    def model(self) -> Model:
        """Everything."""
        claim, level = self.claim, rational(self.claim.level)
        law = [self._polynomial(row) for row in claim.law]
        zero = self.ring.constant(0)
        rates, factors = [], []
        for row, inputs in zip(claim.drift, claim.g2):
            rate = self._terms(term for term in row if term.function is None)
            rates.append(sum((self._terms(entry) * u for entry, u in zip(inputs, law)), rate))
            factors.append(self._terms(term for term in row if term.function is not None) * self.state[0])
        cost = sum((h * h / 2 for h in map(self._polynomial, claim.penalty)), zero)
        for i, row in enumerate(claim.r2):
            cost = sum((law[i] * law[j] * (rational(price) / 2) for j, price in enumerate(row)), cost)
        g1 = [[self._terms(entry) for entry in row] for row in claim.g1]
        scale = np.sqrt(2.0 * claim.level) / claim.gamma * (1 + 1e-14)  # a little more δ, never less
        (function,) = claim.functions or (None,)
        if function is not None and any(function.slope[1:]):
            raise ValueError(f"a function of the first state alone, not of {function.slope}")
        columns = [[a * rational(float(scale)) for a in row] for row in g1]
        return Model(
            self.transform,
            self.z,
            self.d,
            self._solved(rates),
            self._solved(factors),
            [list(row) for row in zip(*(self._solved(list(column)) for column in zip(*columns)))],
            cost / level,
            self._polynomial(claim.value) / level,
            function,
        )

    def _solved(self, fields: list[fmpq_mpoly]) -> list[fmpq_mpoly]:
        """T⁻¹ times a field."""
        zero = self.ring.constant(0)
        return [sum((a * f for a, f in zip(row, fields)), zero) for row in _inverse(self.transform)]


def _inverse(lower: np.ndarray) -> list[list[fmpq]]:
    """Of a lower triangular matrix, exactly."""
    n = len(lower)
    given = [[rational(float(a)) for a in row] for row in lower]
    found = [[fmpq(0)] * n for _ in range(n)]
    for j in range(n):
        for i in range(j, n):
            total = fmpq(int(i == j)) - sum((given[i][k] * found[k][j] for k in range(j, i)), fmpq(0))
            found[i][j] = total / given[i][i]
    return found


def quotient_bounds(model: Model, width: float, degree: int) -> tuple[list[fmpq_mpoly], float]:
    """Polynomials in z1 below and above S on |z1| ≤ `width`, and their distance; one zero without a function.

    Between two samples the error differs from its larger end by at most h²/8 max|S″ − p″|, and |S″| ≤ 1/3.
    """
    if model.function is None:
        return [model.number(0)], 0.0
    x = model.transform[0, 0] * width * np.linspace(-1.0, 1.0, _SAMPLES)
    nodes = model.transform[0, 0] * width * np.cos(np.pi * (np.arange(200) + 0.5) / 200)
    fit = np.polynomial.Chebyshev.fit(nodes, _quotient(model.function, nodes), degree).convert(
        kind=np.polynomial.Polynomial
    )
    powers = fit.coef.copy()
    if model.function.name == "sin" and model.function.pi_halves % 2 == 0 and model.function.offset == 0:
        powers[1::2] = 0.0  # S is even
    p = np.polynomial.Polynomial(powers)
    bend = np.abs(np.polynomial.Polynomial(np.abs(p.deriv(2).coef))(np.abs(x).max())) + 1 / 3
    spacing = x[1] - x[0]
    error = float(np.abs(_quotient(model.function, x) - p(x)).max() + spacing**2 / 8 * bend + 1e-12)
    state = model.z[0] * rational(float(model.transform[0, 0]))
    middle = sum((state**k * rational(float(a)) for k, a in enumerate(powers) if a), model.number(0))
    return [middle - model.number(error), middle + model.number(error)], 2 * error


def _quotient(function: Function, x: np.ndarray) -> np.ndarray:
    o = function.offset + function.pi_halves * np.pi / 2
    small = np.abs(x) < 1e-4
    safe = np.where(small, 1.0, x)
    if function.name != "sin":
        raise ValueError(f"a sine, not {function.name}")
    quotient = (np.sin(o + safe) - np.sin(o)) / safe
    return np.where(small, np.cos(o) - np.sin(o) * x / 2 - np.cos(o) * x**2 / 6, quotient)


def even(claim: Certificate) -> Certificate:
    """The claim with V even and an odd law where the other terms are rounding (1e-9 of the largest), about 180°."""
    keep = [(0, claim.value), *((1, row) for row in claim.law)]
    for parity, row in keep:
        largest = max(abs(value) for _, value in row)
        if any(sum(powers) % 2 != parity and abs(value) > 1e-9 * largest for powers, value in row):
            return claim

    def cleaned(row: PolynomialTerms, parity: int) -> PolynomialTerms:
        return tuple((powers, value) for powers, value in row if sum(powers) % 2 == parity)

    return replace(claim, value=cleaned(claim.value, 0), law=tuple(cleaned(row, 1) for row in claim.law))


def with_value(claim: Certificate, model: Model, value: fmpq_mpoly, level: float) -> Certificate:
    """The claim with another V, given in the model's coordinates and units, up to a level in these units."""
    n = len(model.z)
    ring = fmpq_mpoly_ctx.get([f"x{i}" for i in range(n)])
    zero = ring.constant(0)
    inverse = _inverse(model.transform)
    state = [sum((ring.constant(a) * x for a, x in zip(row, ring.gens())), zero) for row in inverse]
    moved = value.compose(*state, *(zero for _ in model.disturbances), ctx=ring) * rational(claim.level)
    terms = tuple((key, nearest_double(number)) for key, number in terms_of(moved).items())
    quadratic = quadratic_part(terms, n)
    return replace(
        claim,
        value=terms,
        level=level * claim.level,
        coordinates=tuple(map(tuple, few_bits(np.linalg.cholesky(np.linalg.inv(quadratic))).tolist())),
    )


def evaluated(model: Model, value: fmpq_mpoly) -> Callable[[np.ndarray], np.ndarray]:
    """A polynomial as a function of z, (N, n) to (N,)."""
    terms = terms_of(value)
    powers = np.array([key[: len(model.z)] for key in terms])
    numbers = np.array([nearest_double(number) for number in terms.values()])
    return lambda z: np.prod(z[:, None, :] ** powers, axis=2) @ numbers
