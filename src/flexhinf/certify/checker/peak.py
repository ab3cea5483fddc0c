"""The largest input without disturbances, for a linear law and a V of degree two, in rationals and balls.

V does not grow along a run without disturbances: from a start with V ≤ c₀ it stays so, and with V = xᵀWx, u = Kx,

    |u_i|² = |K_i x|² ≤ (K_i W⁻¹ K_iᵀ) V(x) ≤ (K_i W⁻¹ K_iᵀ) c₀    for every value of the parameters in the box.
"""

from __future__ import annotations

from itertools import pairwise

from flint import arb, ctx, fmpq, fmpq_mat

from flexhinf.certify.checker.residual import as_rational, positive_definite
from flexhinf.certify.checker.starts import BITS, enclosed_value, parameter_values
from flexhinf.certify.claim import Claim
from flexhinf.certify.terms import Polynomial, Start

_CLOSE = 1.002  # the bound of V over a value that V has on the path
_HALVINGS = 30
_FIRST = 16  # pieces


def proved_peaks(claim: Claim) -> tuple[float, ...]:
    """Bounds of |u_i|, deviations from the input at the goal, along each run without disturbances from a stated start;
    empty where none is proved: without starts, for a law that is not linear and for a V of another degree than two."""
    n, quadratic = len(claim.states), all(sum(powers) == 2 for powers, _ in claim.value)
    linear = all(sum(powers) == 1 for law in claim.law for powers, _ in law)
    if not (claim.starts and quadratic and linear):
        return ()
    w = _symmetric(claim.value, n)
    if not positive_definite(w):
        return ()
    with ctx.workprec(BITS):
        level = arb(0)
        for start in claim.starts:
            level = level.max(_largest_value(claim, start))
        found = []
        for law in claim.law:
            k = fmpq_mat([[fmpq(0)] * n])
            for powers, value in law:
                k[0, powers.index(1)] = as_rational(value)
            square = (k * w.inv() * k.transpose())[0, 0]
            found.append(float((arb(square) * level).sqrt().upper()) * (1 + 1e-12))
    return tuple(found) if all(bound < float("inf") for bound in found) else ()


def _symmetric(value: Polynomial, n: int) -> fmpq_mat:
    """W of V = xᵀWx."""
    rows = [[fmpq(0)] * n for _ in range(n)]
    for powers, coefficient in value:
        i, j = (k for k, e in enumerate(powers) for _ in range(e))
        rows[i][j] += as_rational(coefficient) / 2
        rows[j][i] += as_rational(coefficient) / 2
    return fmpq_mat(rows)


def _largest_value(claim: Claim, start: Start) -> arb:
    """An upper bound of V on a path of starts, for all parameters in the box."""
    seen, bound = arb(0), arb(0)
    for values in parameter_values(claim, start):
        knots = [as_rational(a) for a in start.amplitudes] or [fmpq(0), as_rational(start.amplitude)]
        todo = [
            (left + (right - left) * i / _FIRST, left + (right - left) * (i + 1) / _FIRST, piece, 0)
            for piece, (left, right) in enumerate(pairwise(knots))
            for i in range(_FIRST)
        ]
        while todo:
            left, right, piece, depth = todo.pop()
            center, whole = enclosed_value(claim, start, piece, left, right, values)
            seen = seen.max(center.lower())
            if depth >= _HALVINGS or whole <= seen * _CLOSE:
                bound = bound.max(whole.upper())
                continue
            middle = (left + right) / 2
            todo += [(left, middle, piece, depth + 1), (middle, right, piece, depth + 1)]
    return bound
