"""Elementary functions inside cells: polynomials with a proved bound on what they leave out.

A function Φ of a linear form ℓ enters r through its quotient S(ℓ) = (Φ(ℓ) − Φ(0))/ℓ = ∫₀¹ Φ'(uℓ) du. Near a node a,

    S(ℓ) = Σ_{m ≤ M} s_m ℓᵐ + e,    |e| ≤ C |ℓ − a|^(M+1),    C = max |Φ^(M+2)|/(M+2)! between 0 and ℓ,

because S⁽ᵐ⁾/m! is the mean of uᵐ Φ⁽ᵐ⁺¹⁾(uℓ)/m! over 0 ≤ u ≤ 1, at most max |Φ⁽ᵐ⁺¹⁾|/(m+1)!. The s_m are the Taylor
polynomial about a in powers of ℓ, and C comes from power series over intervals (`arb`), which bound the derivatives of
any elementary function: sin, exp and tanh alike.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import comb

import flint
import numpy as np
from flint import arb, arb_series

from flexhinf.certify.terms import Function

Series = Callable[[arb_series], arb_series]


def _undefined(s: arb_series) -> arb_series:
    return arb_series([arb("nan")] * s.prec, prec=s.prec)


#: The functions of certificates on power series over intervals, which bound their own derivatives.
SERIES: dict[str, Series] = {
    "sin": lambda s: s.sin(),
    "cos": lambda s: s.cos(),
    "exp": lambda s: s.exp(),
    "tanh": lambda s: 1 - 2 / below if (below := (2 * s).exp() + 1)[0] > 0 else _undefined(s),
    "arctan": lambda s: s.atan(),
    "log": lambda s: s.log(),
}

#: Radius of a ball that counts as its middle: the allowance for rounding is larger, see `flexhinf.certify.cells`.
NARROW = 2.0**-160

_SPACING = 2.0**-6  # of the nodes
_FARTHEST = 100.0  # |ℓ| beyond which a function is not enclosed, so that nothing is proved there
_PIECE = 2.0**-3  # length of the intervals on which derivatives are bounded
_BITS = 320  # of the arithmetic on balls


@dataclass(frozen=True)
class QuotientTable:
    """Nodes with their polynomials, and bounds of the derivatives by distance from 0.

    Attributes
    ----------
    first : int
        Number of the first node, in spacings from 0.
    rows : ndarray, shape (nodes, M + 1)
        s_m; nan where the function is not defined.
    above, below : ndarray
        C on [0, (i + 1) pieces] and on [−(i + 1) pieces, 0].
    largest : float
        Bound of |S| in the whole table.
    """

    first: int
    rows: np.ndarray
    above: np.ndarray
    below: np.ndarray
    largest: float

    @property
    def order(self) -> int:
        """M."""
        return self.rows.shape[1] - 1

    def enclose(self, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Polynomials (N, M + 1) for intervals of ℓ, and bounds (N,) of what they leave out: inf beyond the table."""
        node = np.rint((low + high) / (2 * _SPACING))
        place = node.astype(np.int64) - self.first
        known = (place >= 0) & (place < len(self.rows))
        rows = self.rows[np.where(known, place, 0)]
        distance = np.maximum(high - node * _SPACING, node * _SPACING - low)
        constant = np.maximum(_beyond(self.above, high), _beyond(self.below, -low))
        error = constant * distance ** (self.order + 1) * (1 + 1e-12)
        bad = ~known | ~np.isfinite(error) | ~np.isfinite(rows).all(axis=1)
        return np.where(bad[:, None], 0.0, rows), np.where(bad, np.inf, error)


def _beyond(table: np.ndarray, reach: np.ndarray) -> np.ndarray:
    """The bound out to `reach` on one side; the first piece for a reach of the other sign."""
    place = np.maximum(np.ceil(reach / _PIECE).astype(np.int64) - 1, 0)
    return np.where(place < len(table), table[np.minimum(place, len(table) - 1)], np.inf)


def quotient_table(function: Function, reach: float, order: int) -> QuotientTable:
    """The table of S for Φ(ℓ) = φ(o + ℓ) and |ℓ| ≤ `reach`, with M = `order`."""
    series = _shifted(function)
    reach = min(reach, _FARTHEST)
    count = int(np.ceil(reach / _SPACING)) + 1
    pieces = int(np.ceil(reach / _PIECE)) + 2
    cap, bits = flint.ctx.cap, flint.ctx.prec
    try:
        flint.ctx.cap, flint.ctx.prec = order + 3, _BITS
        rows = [_row(series, node, order) for node in range(-count, count + 1)]
        flint.ctx.prec = 64
        sides = []
        for sign in (1, -1):
            bounds = [_derivative(series, sign * (i + 0.5) * _PIECE, order + 2) for i in range(pieces)]
            sides.append(np.maximum.accumulate(bounds))
        ends = [_derivative(series, (i + 0.5) * _PIECE, 1) for i in range(-pieces, pieces)]
    finally:
        flint.ctx.cap, flint.ctx.prec = cap, bits
    return QuotientTable(-count, np.array(rows), sides[0], sides[1], max(ends))


def _shifted(function: Function) -> Series:
    """Φ on power series over intervals."""
    elementary, offset, halves = SERIES[function.name], function.offset, function.pi_halves
    return lambda s: elementary(s + (arb(offset) + arb.pi() * halves / 2))


def _row(function: Series, node: int, order: int) -> list[float]:
    """The Taylor polynomial of the quotient about a node, in powers of ℓ, rounded to doubles."""
    a = arb(node) * _SPACING
    series = function(arb_series([a, 1], prec=order + 3))
    taken = [series[k] for k in range(order + 3)]
    if node == 0:
        taylor = taken[1 : order + 2]
    else:  # S_0 = (Φ(a) − Φ(0))/a, S_m = (Φ_m − S_{m−1})/a
        taylor = [(taken[0] - function(arb_series([0, 1], prec=1))[0]) / a]
        for m in range(1, order + 1):
            taylor.append((taken[m] - taylor[-1]) / a)
    result = []
    for m in range(order + 1):
        total = arb(0)
        for k in range(m, order + 1):
            total += taylor[k] * comb(k, m) * (-a) ** (k - m)
        middle = float(total.mid())
        narrow = total.is_finite() and total.rad() <= max(abs(middle) * 2.0**-60, NARROW)
        result.append(middle if narrow else float("nan"))
    return result


def _derivative(function: Series, centre: float, order: int) -> float:
    """An upper bound of |Φ^(order)|/order! on the piece about `centre`."""
    ball = arb(centre, _PIECE * 0.5)
    bound = function(arb_series([ball, 1], prec=order + 1))[order].abs_upper()
    return float(bound) * (1 + 1e-12) if bound.is_finite() else float("inf")
