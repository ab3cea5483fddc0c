"""What is shown on each cell: bounds of V and of its growth along rays, and of r where V ≤ c, with all rounding.

`Proof` has the tables of one claim, `Face` bounds the cells of one face. Nothing else decides whether a cell is proved.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from flint import ctx, fmpq

from flexhinf.certify.checker.quotient import ORDER, Quotient
from flexhinf.certify.checker.residual import parameter_corners, residual, rounded
from flexhinf.certify.checker.taylor import UNIT, CentredForm, TaylorTable, powers
from flexhinf.certify.claim import Claim
from flexhinf.certify.terms import Function

BITS = 128  # of the balls from which tables are rounded
_NOMINAL = (np.ones(1), np.zeros(1))
_ODD = 1e-9  # of an even polynomial
_TINY = 1e-180  # more than what underflow loses anywhere: a million products of 5e-324 and ρ^12 ≤ 1e120
_UP = 1 + 1e-12  # more than a few roundings


@dataclass(frozen=True, eq=False)
class Bounds:
    """What is known on each cell of a batch, arrays of shape (cells,) where not said.

    Attributes
    ----------
    least_value : ndarray
        Lower bound of V at the inner end of the interval of ρ.
    least_growth : ndarray
        Lower bound of ∂V/∂ρ / ρ.
    largest, largest_inside : ndarray
        Upper bounds of r/ρ², and of r/ρ² + λ(c − V): so of r/ρ² where V ≤ c.
    multiplier : ndarray
        λ ≥ 0.
    level : float
        c.
    value, constant : ndarray
        V and r/ρ² at the centre, rounded; proves nothing.
    remainder, rounding : ndarray
        What the other bounds allow for functions' remainders, and for rounding and odd parts.
    form : CentredForm
        Of r/ρ²; where a cut is worth most.
    """

    least_value: np.ndarray
    least_growth: np.ndarray
    largest: np.ndarray
    largest_inside: np.ndarray
    multiplier: np.ndarray
    level: float
    value: np.ndarray
    constant: np.ndarray
    remainder: np.ndarray
    rounding: np.ndarray
    form: CentredForm

    @property
    def finished(self) -> np.ndarray:
        """Whether the level set has ended in all directions of the cell."""
        return self.least_value > self.level

    @property
    def proved(self) -> np.ndarray:
        """Whether V grows, and r < 0 wherever V ≤ c."""
        return (self.least_growth > 0) & ((self.largest < 0) | (self.largest_inside < 0))


class Proof:
    """Exact polynomials of a claim, the corners of its parameters, and the shapes of its tables."""

    def __init__(self, claim: Claim) -> None:
        self.claim, self.n = claim, len(claim.states)
        exact = self.exact = residual(claim)
        self.exact_corners = parameter_corners(claim, exact.products)
        self.corners = np.array([[rounded(weight) for weight in row] for row in self.exact_corners])
        low, high = self.corners.min(0), self.corners.max(0)
        self.mid = (low + high) / 2
        self.rad = np.where(low == high, 0.0, (high - low) / 2 * (1 + 4 * UNIT) + np.abs(self.mid) * 4 * UNIT)
        unit = [tuple(int(i == j) for j in range(self.n)) for i in range(self.n)]
        slopes = [[float(rounded(s.to_dict().get(e, fmpq(0)))) for e in unit] for s in exact.arguments]
        self.slopes = np.array(slopes).reshape(-1, self.n)  # ℓᵀT
        reach = claim.reach * np.abs(self.slopes).sum(1) * 1.01 + 0.1
        with ctx.workprec(BITS):
            self.quotients = [Quotient(f, float(s)) for f, s in zip(claim.functions, reach, strict=True)]
        factors = [b for row in exact.factors for b in row]
        sb, small = _degree(factors), _degree([exact.value, *factors])
        degree = max(_degree(exact.plain), sb + ORDER * bool(factors))
        highest = max(degree - 1, small + 1, 3)  # of the powers of ρ in r/ρ², in V, and in (8)
        self.table, self.small = TaylorTable(self.n, degree, highest), TaylorTable(self.n, small, highest)
        self.even = all(_nearly_even(p, claim.reach) for p in (exact.value, *exact.plain, *factors))
        self.even &= all(map(_is_odd, claim.functions))
        self.faces = [(face, sign) for face in range(self.n) for sign in ((1,) if self.even else (1, -1))]

    def parts(self, polynomial: Any) -> tuple[Any, Any]:
        """What goes into tables, and what is only bounded: the odd part, where half of the faces stand for all."""
        kept, left = {}, {}
        for e, value in polynomial.to_dict().items():
            (left if self.even and sum(map(int, e)) % 2 else kept)[e] = value
        return polynomial.context().from_dict(kept), polynomial.context().from_dict(left)


def _degree(polynomials: list[Any]) -> int:
    return max([2, *(int(p.total_degree()) for p in polynomials)])


def _nearly_even(polynomial: Any, reach: float) -> bool:
    """Whether terms of odd degree are, at the reach, below `_ODD` of the others; they are bounded, not forgotten."""
    size = [0.0, 0.0]
    for e, value in polynomial.to_dict().items():
        degree = sum(map(int, e))
        size[degree % 2] += abs(rounded(value)) * reach**degree
    return size[1] <= _ODD * size[0]


def _is_odd(function: Function) -> bool:
    """Whether φ(o + s) − φ(o) is odd in s."""
    whole = {"sin": function.pi_halves % 2 == 0, "cos": function.pi_halves % 2 == 1}
    other = function.name in ("tanh", "arctan") and function.pi_halves == 0
    return function.offset == 0 and whole.get(function.name, other)


class _Columns(NamedTuple):
    """A table's rows (rows, components), and by degree a bound of what rounding and odd parts add at ρ = 1."""

    rows: np.ndarray
    errors: np.ndarray

    def error(self, end: np.ndarray) -> np.ndarray:
        """Σ_k errors_k ρ^(k−2) at the outer end: (11), and the odd part."""
        return np.einsum("k,kc->c", self.errors, powers(end, len(self.errors)))


class Face:
    """Bounds of V and r on the cells of one face z_f = sign · ρ."""

    def __init__(self, proof: Proof, face: tuple[int, int]) -> None:
        self.proof, self.face = proof, face
        exact, weight = proof.exact, np.abs(proof.mid) + proof.rad

        def columns(table: TaylorTable, pairs: list[tuple[Any, Any]], weight: np.ndarray) -> _Columns:
            kept, left = (
                np.stack([table.fill(p, *face) for p in half], 1) for half in zip(*pairs, strict=True)
            )
            count = _roundings(table, len(proof.mid), len(exact.arguments)) * UNIT
            errors = count * table.magnitudes(kept) + table.magnitudes(left) * _UP
            return _Columns(kept, errors @ weight)

        self._value = columns(proof.small, [proof.parts(exact.value)], np.ones(1))
        self._plain = columns(proof.table, [proof.parts(p) for p in exact.plain], weight)
        self._factors, self._lifted = [], []
        for s, row in zip(exact.arguments, exact.factors, strict=True):
            pairs = [proof.parts(p) for p in row]
            self._factors.append(columns(proof.small, pairs, weight))
            lifted = [[(a * s**m, b * s**m) for a, b in pairs] for m in range(ORDER + 1)]
            self._lifted.append([columns(proof.table, one, weight) for one in lifted])

    def bounds(self, t: np.ndarray, h: np.ndarray, begin: np.ndarray, end: np.ndarray) -> Bounds:
        """On cells |t_i − τ_i| ≤ h_i, `begin` ≤ ρ ≤ `end`; t and h are (n − 1, cells)."""
        proof, small, table, c = self.proof, self.proof.small, self.proof.table, self.proof.claim.level
        interval, at_begin = _interval(begin, end), (begin, np.zeros_like(end), begin)
        value, error = self._shifted(small, self._value, t, h), self._value.error(end) + _TINY
        inner, _ = small.on_interval(-value, at_begin, _NOMINAL)
        least_value = (-small.upper(inner) - error) * begin**2
        growth, _ = small.on_interval(-value * small.k[:, None, None], interval, _NOMINAL)
        level, at_center = small.on_interval(value, interval, _NOMINAL, lift=2)

        form, constants, remainder, rounding = self._residual(t, h, interval)
        constant = (proof.corners @ constants).max(0)
        slope = level.low[small.linear]
        multiplier = np.maximum(
            (form.low[table.linear] * slope).sum(0) / ((slope * slope).sum(0) + _TINY), 0.0
        )
        lowered = table.upper(form.less(multiplier, level), constant + multiplier * (c - at_center[0]))
        return Bounds(
            least_value=least_value - 8 * UNIT * np.abs(least_value),
            least_growth=-small.upper(growth) - small.degree * error,
            largest=table.upper(form, constant) + remainder + rounding,
            largest_inside=lowered + remainder + rounding + multiplier * (error * end**2 + 4 * UNIT * c),
            multiplier=multiplier, level=c, value=at_center[0], constant=constant,
            remainder=remainder, rounding=rounding, form=form,
        )  # fmt: skip

    def _residual(self, t: np.ndarray, h: np.ndarray, interval: Any) -> tuple[CentredForm, Any, Any, Any]:
        """Centred form of r/ρ², its components' constants, and the allowances for remainders and for rounding."""
        proof, (f, sign), (middle, radius, end) = self.proof, self.face, interval
        others = [i for i in range(proof.n) if i != f]
        rows = np.repeat(self._plain.rows[..., None], len(end), 2)
        rounding, remainder = self._plain.error(end) + _TINY, np.zeros_like(end)
        for slope, quotient, lifted, factor in zip(
            proof.slopes, proof.quotients, self._lifted, self._factors, strict=True
        ):
            ray, half = sign * slope[f] + slope[others] @ t, np.abs(slope[others]) @ h
            width = np.abs(ray) * radius + half * end + 1e-12 * np.abs(slope).sum() * end
            coefficients, rest = quotient.at(ray * middle - width, ray * middle + width)
            for one, a in zip(lifted, coefficients, strict=True):
                rows += one.rows[..., None] * a
                rounding += one.error(end) * np.abs(a)
            form, _ = proof.small.on_interval(
                self._shifted(proof.small, factor, t, h), interval, (proof.mid, proof.rad)
            )
            size = (np.abs(form.low) + form.radius).sum(0) + form.tail.sum(0) + factor.error(end)
            remainder += rest * size * _UP
        form, constants = proof.table.on_interval(
            proof.table.shifted(rows, t, h), interval, (proof.mid, proof.rad)
        )
        return form, constants, remainder, rounding * _UP

    def _shifted(self, table: TaylorTable, columns: _Columns, t: np.ndarray, h: np.ndarray) -> np.ndarray:
        return table.shifted(np.repeat(columns.rows[..., None], t.shape[1], 2), t, h)


def _interval(begin: np.ndarray, end: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Middle, radius (rounded up) and end of an interval of ρ."""
    return (begin + end) / 2, (end - begin) / 2 * (1 + 8 * UNIT) + 8 * UNIT * end, end


def _roundings(table: TaylorTable, components: int, functions: int) -> float:
    """Twice the number K of roundings in (11): tables, Horner's scheme, powers, weights, sums."""
    assembled = 2 + 2 * (ORDER + 1) * functions
    return 2.0 * (assembled + 2 * table.n * table.degree + 6 * table.degree + components + len(table.k) + 64)
