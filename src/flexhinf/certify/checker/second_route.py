"""Single cells proved again on another route: exact rational substitution, ball arithmetic, no table and no rounding.

The variables of the polynomials are reused: the first becomes ρ and then s_0, the others t_i and then s_i.
"""

from __future__ import annotations

from typing import Any

from flint import arb, arb_series, fmpq

from flexhinf.certify.checker.algebra import as_rational
from flexhinf.certify.checker.inequality import Inequality
from flexhinf.certify.checker.march import Cell
from flexhinf.certify.checker.quotient import offset_of, series_of
from flexhinf.certify.terms import Function

__all__ = ["cell_holds"]

_ORDER = 6  # of the Taylor polynomials of S: not that of the first route
_PIECES = 32  # in which a bound of a derivative is looked for


def cell_holds(inequality: Inequality, cell: Cell, corner: int) -> bool:
    """Whether V grows and r < 0 (or r/ρ² + λ(c − V) < 0) on a cell, at one corner of the box of parameters."""
    claim, exact = inequality.claim, inequality.exact
    n, context = inequality.n, exact.value.context()
    rational = [as_rational(v) for v in (cell.begin, cell.end)]
    middle, half = (rational[0] + rational[1]) / 2, (rational[1] - rational[0]) / 2
    places = [context.constant(middle) + half * context.gens()[0]]
    for t, h, s in zip(cell.t, cell.h, context.gens()[1:], strict=True):
        places.append(context.constant(as_rational(t)) + as_rational(h) * s)

    def on_face(polynomial: Any, lift: int, weight: int = 0) -> Any:
        """Σ_k k^weight ρ^(k−2+lift) P_k(t) in the variables s."""
        terms: dict[tuple[int, ...], fmpq] = {}
        f, sign = cell.face
        for powers, value in polynomial.to_dict().items():
            e = [int(p) for p in powers]
            row = (sum(e) - 2 + lift, *e[:f], *e[f + 1 :])
            terms[row] = terms.get(row, fmpq(0)) + value * sign ** e[f] * sum(e) ** weight
        return context.from_dict(terms).compose(*places, ctx=context)

    zero = context.constant(0)
    growth = -on_face(exact.value, 0, weight=1)
    if not _upper(growth, n) < 0:
        return False
    weights = dict(zip(inequality.products, inequality.exact_corners[corner], strict=True))
    total = sum((weights[p] * on_face(a, 0) for p, a in exact.plain.items()), zero)
    remainder = arb(0)
    for j, function in enumerate(claim.functions):
        factor = sum((weights[p] * on_face(b, 0) for (i, p), b in exact.factors.items() if i == j), zero)
        argument = on_face(exact.arguments[j], 2)
        center, radius = argument.to_dict().get((0,) * n, fmpq(0)), arb(0)
        for powers, value in argument.to_dict().items():
            radius += abs(arb(value)) if any(powers) else 0
        polynomial, rest = _taylor(function, center, radius)
        power, shifted = context.constant(1), argument - context.constant(center)
        for coefficient in polynomial:
            total += coefficient * power * factor
            power *= shifted
        remainder += rest * _magnitude(factor)
    if cell.multiplier:
        total += as_rational(cell.multiplier) * (
            context.constant(as_rational(claim.level)) - on_face(exact.value, 2)
        )
    return bool(_upper(total, n) + remainder < 0)


def _taylor(function: Function, center: fmpq, radius: arb) -> tuple[list[fmpq], arb]:
    """Rational coefficients about a centre, and a bound of what they leave within the radius."""
    offset, about = offset_of(function), arb(center)
    series = series_of(function.name, arb_series([offset + about, 1], prec=_ORDER + 2))
    if abs(about) > 2.0**-20:
        start = series_of(function.name, arb_series([offset], prec=1))[0]
        quotient = (series - start) / arb_series([about, 1], prec=_ORDER + 1)
        local = [quotient[m] for m in range(_ORDER + 1)]
    else:  # S^(m)/m! = ∫ u^m φ^(m+1)(o + u s)/m! du, enclosed over all u at once
        series = series_of(function.name, arb_series([offset + about.union(arb(0)), 1], prec=_ORDER + 2))
        local = [series[m + 1] for m in range(_ORDER + 1)]
    values = [as_rational(float(value.mid())) for value in local]
    rest = sum(
        (abs(v - arb(q)) * radius**m for m, (v, q) in enumerate(zip(local, values, strict=True))), arb(0)
    )
    low, high = (about - radius).union(arb(0)).lower(), (about + radius).union(arb(0)).upper()
    worst = 0.0
    for i in range(_PIECES):
        piece = (low + (high - low) * i / _PIECES).union(low + (high - low) * (i + 1) / _PIECES)
        term = series_of(function.name, arb_series([offset + piece, 1], prec=_ORDER + 3))[_ORDER + 2]
        worst = max(worst, float(abs(term).upper()) * (1 + 1e-12))
    return values, rest + worst * radius ** (_ORDER + 1)


def _magnitude(polynomial: Any) -> arb:
    return sum((abs(arb(value)) for value in polynomial.to_dict().values()), arb(0))


def _upper(polynomial: Any, n: int) -> arb:
    """Bound (8): constant, slopes with their squares, pairs shared between squares, and the rest."""
    slopes, squares = [arb(0)] * n, [fmpq(0)] * n
    total, pairs = arb(0), [arb(0)] * n
    for exponents, value in polynomial.to_dict().items():
        e = [int(p) for p in exponents]
        touched = [i for i in range(n) if e[i]]
        if not touched:
            total += arb(value)
        elif sum(e) == 1:
            slopes[touched[0]] = abs(arb(value))
        elif sum(e) == 2 and len(touched) == 1:
            squares[touched[0]] = value
        elif sum(e) == 2:
            for i in touched:
                pairs[i] += abs(arb(value)) / 2
        else:
            total += abs(arb(value))
    for g, q, p in zip(slopes, squares, pairs, strict=True):
        square = arb(q) + p
        if -2 * square > g:
            total += g * g / (-4 * square)
        else:  # at s = 1; where the balls do not tell, what holds in any case
            total += g + square if -2 * square < g else g + abs(square)
    return total
