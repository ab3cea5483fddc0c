"""Claims in which r is a quadratic form for each value of the functions' quotients: definite matrices decide, in exact
rationals and without cells.

With V = zᵀWz and r(z, p) = −zᵀQ(S, p)z, S_j the quotients of the functions, r is affine in each S_j and convex in each
power of a parameter (affine, but for |V_x g1|²). So Q ≻ 0 at the corners of the box of S and p gives r ≤ −ε|z|²
wherever each S_j is in its range, and with W ≻ 0 the region is all of {V ≤ c}: docs/certificate.md, section 7.
"""

from __future__ import annotations

import itertools
from math import ceil, isfinite, log2
from typing import Any, NamedTuple

import numpy as np
from flint import arb, arb_series, fmpq, fmpq_mat

from flexhinf.certify.checker.residual import (
    Refusal,
    Residual,
    as_rational,
    box_corners,
    form_of,
    leading_minors,
    offset_of,
    parameter_corners,
    positive_definite,
    rounded,
    row_of,
    series_of,
)
from flexhinf.certify.claim import Claim, Function

_MOST_CORNERS = 2**15
_MOST_FAILED = 64  # corners that are kept
_GRID = 512  # pieces of an interval of length one
_NEAR, _FARTHEST = 64, 10**6  # |ℓᵀx| of a function: in short pieces, and in ones that double


class Corner(NamedTuple):
    """Parameters, their products and quotients of functions at which r is not negative definite: −r = zᵀ`form`z."""

    parameters: dict[str, fmpq]
    weights: list[fmpq]
    quotients: tuple[fmpq, ...]
    form: fmpq_mat


def definite_corners(claim: Claim, exact: Residual) -> int:
    """The number of corners of quotients and parameters, where r is negative definite at all of them and {V ≤ c} lies
    within the reach; 0 where that is not so, or where r is no quadratic form: then nothing is said."""
    count, failed = look_at_corners(claim, exact)
    return 0 if failed else count


def look_at_corners(claim: Claim, exact: Residual) -> tuple[int, list[Corner]]:
    """The number of corners, 0 where r is no quadratic form or the region is not within the reach; and of those that
    fail the first few, the one with the smallest minor before the others."""
    parts: list[tuple[Any, ...]] = list(
        zip(exact.plain, *exact.factors, strict=True)
    )  # by product of parameters
    if any(sum(map(int, e)) != 2 for form in (exact.value, *itertools.chain(*parts)) for e in form.to_dict()):
        return 0, []
    value = form_of(exact.value)
    if not positive_definite(value):
        return 0, []
    widest = value.inv() * as_rational(claim.level)  # wᵀ(widest)w is the largest |wᵀz|² where V ≤ c
    known = [
        quotient_range(function, (row * widest * row.transpose())[0, 0])
        for function, row in zip(claim.functions, map(row_of, exact.arguments), strict=True)
    ]
    ranges, weights = [ends for ends in known if ends], parameter_corners(claim, exact.products)
    if len(ranges) < len(known) or len(weights) * 2 ** len(ranges) > _MOST_CORNERS:
        return 0, []
    count, failed = 0, list[tuple[fmpq, Corner]]()
    forms = [list(map(form_of, row)) for row in parts]
    for (parameters, products), ends in itertools.product(
        zip(box_corners(claim, exact.products), weights), itertools.product(*ranges)
    ):
        total = value * 0
        for weight, row in zip(products, forms, strict=True):
            for quotient, form in zip((fmpq(1), *ends), row, strict=True):
                total -= form * (weight * quotient)
        count += 1
        least = min(leading_minors(total))
        if not least > 0:
            failed.append((least, Corner(parameters, products, ends, total)))
            if len(failed) == _MOST_FAILED:
                break
    corners = [corner for _, corner in sorted(failed, key=lambda pair: pair[0])]
    return 0 if _farther(claim, widest) else count, corners


def _farther(claim: Claim, widest: fmpq_mat) -> list[int]:
    """Indices i of which |z_i| exceeds the reach somewhere in {V ≤ c}."""
    return [i for i in range(widest.nrows()) if widest[i, i] > as_rational(claim.reach) ** 2]


def check_reach(claim: Claim, exact: Residual) -> None:
    """Raise a `Refusal` where V is a quadratic form and {V ≤ c} leaves the reach: no cell ends there."""
    if any(sum(map(int, e)) != 2 for e in exact.value.to_dict()):
        return
    value = form_of(exact.value)
    if positive_definite(value):
        widest = value.inv() * as_rational(claim.level)
        for i in _farther(claim, widest):
            row = np.array([rounded(widest[j, i]) for j in range(widest.nrows())])
            place = row / np.sqrt(row[i])  # where z_i is largest on {V = c}
            raise Refusal("the level set reaches beyond the stated reach", place, claim.level)


def corner_text(claim: Claim, corner: Corner) -> str:
    """The text "a corner fails" with the values of its parameters."""
    units = {p.name: p.unit for p in claim.parameters}
    values = (f"{n} = {rounded(v):.6g} {units[n]}".rstrip() for n, v in corner.parameters.items())
    return "a corner fails" + (f" ({', '.join(values)})" if corner.parameters else "")


def quotient_range(function: Function, square: fmpq) -> tuple[fmpq, fmpq] | None:
    """Rational bounds of S(s) = (φ(o + s) − φ(o))/s for s² ≤ `square`; None where φ is not analytic there.

    On a piece about m of half width w, |S(s) − S(m)| ≤ w max |S′| ≤ w max |φ″|/2 between o and o + s, as in (5). Beyond
    `_NEAR` the quotient itself is enclosed.
    """
    farthest = arb(square).sqrt().upper()
    if not farthest <= _FARTHEST:
        return None
    offset, ends = offset_of(function), []
    start = series_of(function.name, arb_series([offset], prec=1))[0]
    for side in (1, -1):
        bend, pieces = arb(0), list[arb]()
        for i in range(ceil(min(float(farthest), _NEAR) * _GRID) + 1):
            middle, half = arb(side * (2 * i + 1)) / (2 * _GRID), arb(1) / (2 * _GRID)
            bend = bend.max(
                abs(series_of(function.name, arb_series([offset + middle + half * arb(0, 1), 1], prec=3))[2])
            )
            pieces.append(
                (series_of(function.name, arb_series([offset + middle], prec=1))[0] - start) / middle
                + bend * half * arb(0, 1)
            )
        for k in range(ceil(log2(max(float(farthest) / _NEAR, 1.0)))):
            piece = arb(side * _NEAR * 2**k).union(arb(side * _NEAR * 2 ** (k + 1)))
            pieces.append((series_of(function.name, arb_series([offset + piece], prec=1))[0] - start) / piece)
        for enclosed in pieces:
            if not isfinite(float(enclosed.rad())) or not enclosed.is_finite():
                return None
            ends += [enclosed.lower().fmpq(), enclosed.upper().fmpq()]
    return min(ends), max(ends)
