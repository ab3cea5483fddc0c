"""Paths of starts, in ball arithmetic, and the largest input of the runs that begin there.

A path x(a), 0 ≤ a ≤ amplitude, begins at 0. Where V(x(a)) ≤ c for all of its a, it stays in the component of {V ≤ c}
that contains 0, because it is continuous: no ray has to be followed. With uncertain parameters there is a path for each
of their values. A V of degree two is convex (positive definite, where a region is proved), so where x(a) is affine in a
power of each parameter, V is largest at a corner of their box. Otherwise parameters are balls.

V does not grow along a run without disturbances: from a start with V ≤ c₀ it stays so, and with V = xᵀWx, u = Kx,

    |u_i|² = |K_i x|² ≤ (K_i W⁻¹ K_iᵀ) V(x) ≤ (K_i W⁻¹ K_iᵀ) c₀    for every value of the parameters in the box.
"""

from __future__ import annotations

import functools
import itertools
import operator
from collections.abc import Callable
from itertools import pairwise
from typing import Any

from flint import Ordering, arb, arb_series, ctx, fmpq, fmpq_mpoly_ctx

from flexhinf.certify.checker.residual import (
    as_rational,
    form_of,
    offset_of,
    polynomial_of,
    positive_definite,
    require,
    row_of,
    series_of,
)
from flexhinf.certify.claim import Claim, Start

BITS = 128
_HALVINGS = 40  # of the amplitude, before an interval is refused
_FIRST = 16  # pieces


def check_start(claim: Claim, start: Start) -> int:
    """Number of intervals of a on which V ≤ c was proved; a `Refusal` where that fails."""
    number = claim.starts.index(start) + 1 if start in claim.starts else 1

    def inside(center: arb, whole: arb, middle: fmpq, depth: int) -> bool:
        require(
            bool(whole <= level) or not (center > level or depth >= _HALVINGS),
            f"the start of amplitude {float(middle.p) / float(middle.q):.6g} on path {number} is not inside",
        )
        return bool(whole <= level)

    with ctx.workprec(BITS):
        level = arb(claim.level) - (arb(claim.observer.energy) if claim.observer else 0)
        return _pieces_done(claim, start, inside)


def _pieces_done(claim: Claim, start: Start, done: Callable[[arb, arb, fmpq, int], bool]) -> int:
    """Number of intervals of a, each halved until `done(V in its middle, V on it, its middle, halvings)` is true, with
    all parameters in the box."""
    count = 0
    knots = [as_rational(a) for a in start.amplitudes] or [fmpq(0), as_rational(start.amplitude)]
    for values in parameter_values(claim, start):
        todo = [  # intervals that cover the path, the piece of the table that they lie in, and halvings
            (left + (right - left) * i / _FIRST, left + (right - left) * (i + 1) / _FIRST, piece, 0)
            for piece, (left, right) in enumerate(pairwise(knots))
            for i in range(_FIRST)
        ]
        while todo:
            left, right, piece, depth = todo.pop()
            middle = (left + right) / 2
            if done(*enclosed_value(claim, start, piece, left, right, values), middle, depth):
                count += 1
            else:
                todo += [(left, middle, piece, depth + 1), (middle, right, piece, depth + 1)]
    return count


def parameter_values(claim: Claim, start: Start) -> list[dict[str, arb]]:
    """Values of the parameters for which the path is looked at: corners of their box, or the box as balls."""
    pairs = {pair for row in start.path for term in row for pair in term.parameters if pair[1]}
    used = [p for p in claim.parameters if p.name in {name for name, _ in pairs}]
    if not (len(pairs) == len(used) and all(sum(powers) == 2 for powers, _ in claim.value)) or any(
        p.low <= 0 <= p.high for p in used
    ):
        return [{p.name: arb(p.low).union(arb(p.high)) for p in used}]
    return [
        {p.name: arb(v) for p, v in zip(used, corner, strict=True)}
        for corner in itertools.product(*(sorted({p.low, p.high}) for p in used))
    ]


def enclosed_value(
    claim: Claim, start: Start, piece: int, left: fmpq, right: fmpq, values: dict[str, arb]
) -> tuple[arb, arb]:
    """V in the middle of an interval of a between two knots of the table, and on all of it."""
    middle = (left + right) / 2
    center = _value(claim, _path(start, piece, arb(middle), values, 1))[0]
    slope = _value(claim, _path(start, piece, arb(left).union(arb(right)), values, 2))[1]
    return center, center + slope * arb(0, 1) * arb(right - middle)


def _path(start: Start, piece: int, about: arb, values: dict[str, arb], terms: int) -> list[Any]:
    """x(a + ε) as power series in ε, between two knots of the table."""
    a = arb_series([about, 1], prec=terms)
    states = []
    for i, row in enumerate(start.path):
        x = arb_series([0], prec=terms)
        for term in row:
            factor = arb(term.coefficient) * a ** term.powers[0]
            for name, exponent in term.parameters:
                factor *= values[name] ** exponent
            if term.function is not None:
                function = start.functions[term.function]
                offset = offset_of(function)
                factor *= (
                    series_of(function.name, arb_series([offset], prec=terms) + arb(function.slope[0]) * a)
                    - series_of(function.name, arb_series([offset], prec=1))[0]
                )
            x += factor
        table = start.table[i] if start.table else ()
        if table:
            (a0, a1), (y0, y1) = (
                [as_rational(v) for v in row[piece : piece + 2]] for row in (start.amplitudes, table)
            )
            x += arb(y0) + (a - arb(a0)) * arb((y1 - y0) / (a1 - a0))
        states.append(x)
    return states


def _value(claim: Claim, x: list[Any]) -> Any:
    tables = [
        list(itertools.accumulate([y] * most, operator.mul, initial=y * 0 + 1))
        for y, most in zip(
            x, [max(powers[i] for powers, _ in claim.value) for i in range(len(x))], strict=True
        )
    ]
    total = x[0] * 0
    for exponents, coefficient in claim.value:
        product = arb(coefficient)
        for table, exponent in zip(tables, exponents, strict=True):
            if exponent:
                product = table[exponent] * product
        total += product
    return total


_CLOSE = 1.002  # the bound of V over a value that V has on the path
_PEAK_HALVINGS = 30


def proved_peaks(claim: Claim) -> tuple[float, ...]:
    """Bounds of |u_i|, deviations from the input at the goal, along each run without disturbances from a stated start;
    empty where none is proved: without starts, for a law that is not linear and for a V of another degree than two."""
    n, quadratic = len(claim.states), all(sum(powers) == 2 for powers, _ in claim.value)
    if not (claim.starts and quadratic and all(sum(powers) == 1 for law in claim.law for powers, _ in law)):
        return ()
    ring = fmpq_mpoly_ctx.get([f"x{i}" for i in range(n)], Ordering.degrevlex)
    w = form_of(polynomial_of(claim.value, ring))
    if not positive_definite(w):
        return ()
    with ctx.workprec(BITS):
        level = functools.reduce(arb.max, (_largest_value(claim, start) for start in claim.starts), arb(0))
        peaks = []
        for law in claim.law:
            k = row_of(polynomial_of(law, ring))
            peaks.append(
                float((arb((k * w.inv() * k.transpose())[0, 0]) * level).sqrt().upper()) * (1 + 1e-12)
            )
    return tuple(peaks) if all(bound < float("inf") for bound in peaks) else ()


def _largest_value(claim: Claim, start: Start) -> arb:
    """An upper bound of V on a path of starts, for all parameters in the box."""
    seen, bound = arb(0), arb(0)

    def close(center: arb, whole: arb, middle: fmpq, depth: int) -> bool:
        nonlocal seen, bound
        seen = seen.max(center.lower())
        done = depth >= _PEAK_HALVINGS or bool(whole <= seen * _CLOSE)
        bound = bound.max(whole.upper()) if done else bound
        return done

    _pieces_done(claim, start, close)
    return bound
