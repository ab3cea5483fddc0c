"""The residual r of a claim in exact rationals: V, A and B_j with r = A + Σ_j S_j(ℓ_jᵀx) B_j, in z (x = T z)."""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from flint import Ordering, fmpq, fmpq_mpoly_ctx

from flexhinf.certify.claim import Claim
from flexhinf.certify.terms import Parameter, Polynomial, Terms

__all__ = [
    "Exponents",
    "Residual",
    "as_rational",
    "parameter_weights",
    "polynomial_of",
    "residual",
    "rounded",
]

#: A product of powers of parameters: sorted (name, exponent) pairs.
Exponents = tuple[tuple[str, int], ...]


def as_rational(value: float) -> fmpq:
    """A double as the rational that it is."""
    return fmpq(*float(value).as_integer_ratio())


def rounded(value: fmpq) -> float:
    """The nearest double: Python's division of integers is correctly rounded."""
    return int(value.p) / int(value.q)


@dataclass(frozen=True)
class Residual:
    """r(z, p) = Σ over products π of parameters: π(p) · (A_π(z) + Σ_j S_j(ℓ_jᵀTz) B_{π,j}(z)).

    S_j(s) = (φ_j(o + s) − φ_j(o))/s, and B_j has the factor s = ℓ_jᵀTz.

    Attributes
    ----------
    value : fmpq_mpoly
        V(Tz).
    plain : dict Exponents → fmpq_mpoly
        A_π.
    factors : dict (j, Exponents) → fmpq_mpoly
        B_{π,j}.
    arguments : list of fmpq_mpoly
        ℓ_jᵀTz.
    gradient_law : bool
        Whether g2 is certain and R2 k = −g2ᵀV_xᵀ up to rounding of the coefficients, for 4. of the theorem.
    """

    value: Any
    plain: dict[Exponents, Any]
    factors: dict[tuple[int, Exponents], Any]
    arguments: list[Any]
    gradient_law: bool


def residual(claim: Claim) -> Residual:
    """V_x (f + g2 k) + ½ hᵀh + ½ kᵀR2 k + |V_x g1|²/(2γ²) + αV, from its data alone."""
    n, half = len(claim.states), fmpq(1, 2)
    context = fmpq_mpoly_ctx.get([f"z{i + 1}" for i in range(n)], Ordering.degrevlex)
    coordinates = [[as_rational(v) for v in row] for row in claim.coordinates]
    x = [_linear(row, context) for row in coordinates]
    in_x = polynomial_of(claim.value, context)
    slope = [in_x.derivative(i).compose(*x, ctx=context) for i in range(n)]
    value = in_x.compose(*x, ctx=context)
    law = [polynomial_of(row, context).compose(*x, ctx=context) for row in claim.law]

    plain: dict[Exponents, Any] = {}
    factors: dict[tuple[int, Exponents], Any] = {}

    def add(target: dict[Any, Any], key: Any, polynomial: Any) -> None:
        target[key] = target.get(key, context.constant(0)) + polynomial

    fixed = {p.name: as_rational(p.low) for p in claim.parameters if p.low == p.high}
    slopes = [[as_rational(v) for v in function.slope] for function in claim.functions]
    arguments = [sum((a * y for a, y in zip(row, x, strict=True)), context.constant(0)) for row in slopes]
    input_slopes = [context.constant(0) for _ in law]  # V_x g2
    certain = True
    for i in range(n):
        for (parameters, function), field in _fields(claim.drift[i], x, fixed).items():
            if function is None:
                add(plain, parameters, slope[i] * field)
            else:
                add(factors, (function, parameters), slope[i] * field * arguments[function])
        for j, entry in enumerate(claim.g2[i]):
            for (parameters, _), field in _fields(entry, x, fixed).items():
                add(plain, parameters, slope[i] * field * law[j])
                input_slopes[j] += slope[i] * field
                certain &= not parameters
    for j in range(len(claim.disturbances)):
        rate: dict[Exponents, Any] = {}
        for i in range(n):
            for (parameters, _), field in _fields(claim.g1[i][j], x, fixed).items():
                add(rate, parameters, slope[i] * field)
        attenuation = half / as_rational(claim.gamma) ** 2
        for (p, first), (q, second) in itertools.product(rate.items(), repeat=2):
            add(plain, _merged((*p, *q)), attenuation * first * second)
    r2 = [[as_rational(v) for v in row] for row in claim.r2]
    for i, j in itertools.product(range(len(law)), repeat=2):
        add(plain, (), half * r2[i][j] * law[i] * law[j])
    priced = [sum((r2[i][j] * law[j] for j in range(len(law))), context.constant(0)) for i in range(len(law))]
    gradient = certain and all(_opposite(p, q) for p, q in zip(priced, input_slopes, strict=True))
    for row in claim.penalty:
        output = polynomial_of(row, context).compose(*x, ctx=context)
        add(plain, (), half * output * output)
    add(plain, (), as_rational(claim.decay) * value)
    return Residual(value, plain, factors, arguments, gradient)


def _opposite(one: Any, other: Any) -> bool:
    """Whether the sum of two polynomials is rounding: below 1e-12 of the largest coefficient of their degree."""
    largest: dict[int, fmpq] = {}
    for powers, value in other.to_dict().items():
        degree = sum(map(int, powers))
        largest[degree] = max(largest.get(degree, fmpq(0)), abs(value))
    rest = (one + other).to_dict().items()
    return all(abs(v) <= largest.get(sum(map(int, p)), fmpq(0)) * fmpq(1, 10**12) for p, v in rest)


def polynomial_of(polynomial: Polynomial, context: Any) -> Any:
    """A claim's polynomial as an exact one."""
    return context.from_dict({powers: as_rational(value) for powers, value in polynomial})


def _linear(row: Iterable[fmpq], context: Any) -> Any:
    return sum((a * z for a, z in zip(row, context.gens(), strict=True)), context.constant(0))


def _fields(terms: Terms, x: list[Any], fixed: dict[str, fmpq]) -> dict[tuple[Exponents, int | None], Any]:
    """Polynomials in z by product of uncertain parameters and function; known parameters become numbers."""
    context = x[0].context()
    grouped: dict[tuple[Exponents, int | None], dict[tuple[int, ...], fmpq]] = {}
    for term in terms:
        value = as_rational(term.coefficient)
        for name, exponent in term.parameters:
            value *= fixed.get(name, fmpq(1)) ** exponent
        uncertain = _merged(pair for pair in term.parameters if pair[0] not in fixed)
        group = grouped.setdefault((uncertain, term.function), {})
        group[term.powers] = group.get(term.powers, fmpq(0)) + value
    return {key: context.from_dict(part).compose(*x, ctx=context) for key, part in grouped.items()}


def _merged(pairs: Iterable[tuple[str, int]]) -> Exponents:
    total: dict[str, int] = {}
    for name, exponent in pairs:
        total[name] = total.get(name, 0) + exponent
    return tuple(sorted((name, exponent) for name, exponent in total.items() if exponent))


def parameter_weights(parameters: tuple[Parameter, ...], products: list[Exponents]) -> list[list[fmpq]]:
    """Each product of parameters (columns) at the corners of the box (rows).

    Between them each product stays between its values there, because no parameter of another exponent than 1 vanishes;
    for the squares that |V_x g1|² brings, a parameter that may vanish has 0 as a third end.
    """
    used = {name for product in products for name, _ in product}
    ends = []
    for p in parameters:
        ends.append({p.low, p.high} | ({0.0} if p.low < 0 < p.high else set()) if p.name in used else {p.low})
    rows = []
    for corner in itertools.product(*ends):
        at = {p.name: as_rational(v) for p, v in zip(parameters, corner, strict=True)}
        row = []
        for product in products:
            weight = fmpq(1)
            for name, exponent in product:
                weight *= at[name] ** exponent
            row.append(weight)
        rows.append(row)
    return rows
