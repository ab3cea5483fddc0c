"""The tables of one claim, and the two inequalities on cells: V grows along rays, and r < 0 where V ≤ c."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from flint import ctx

from flexhinf.certify.checker.algebra import Residual, parameter_weights, residual, rounded
from flexhinf.certify.checker.quotient import ORDER, Quotient
from flexhinf.certify.checker.tables import UNIT, CellTable, CentredForm, powers
from flexhinf.certify.claim import Claim

__all__ = ["Bounds", "FaceInequality", "Inequality"]

_BITS = 128  # of the balls from which tables are rounded
_NOMINAL = (np.ones(1), np.zeros(1))
_ODD = 1e-9  # of an even polynomial
_TINY = 1e-280  # more than what underflow loses anywhere


@dataclass(frozen=True, eq=False)
class Bounds:
    """What is known on each cell of a batch, shape (cells,) where not said.

    Attributes
    ----------
    least_value : float
        Lower bound of V at the inner end of the interval of ρ.
    least_growth : float
        Lower bound of ∂V/∂ρ / ρ.
    largest : float
        Upper bound of r/ρ².
    largest_inside : float
        Upper bound of r/ρ² + λ(c − V), so of r/ρ² where V ≤ c.
    multiplier : float
        λ ≥ 0.
    value, constant : float
        V and r/ρ² at the centre, rounded.
    remainder, rounding : float
        What the other bounds allow for functions' remainders and for rounding.
    score : (n, cells)
        What to split: ρ first, then the t_i.
    level : float
        c.
    """

    least_value: np.ndarray
    least_growth: np.ndarray
    largest: np.ndarray
    largest_inside: np.ndarray
    multiplier: np.ndarray
    value: np.ndarray
    constant: np.ndarray
    remainder: np.ndarray
    rounding: np.ndarray
    score: np.ndarray
    level: float

    @property
    def finished(self) -> np.ndarray:
        """Whether the level set has ended in all directions of the cell."""
        return self.least_value > self.level

    @property
    def proved(self) -> np.ndarray:
        """Whether V grows, and r < 0 wherever V ≤ c."""
        return (self.least_growth > 0) & ((self.largest < 0) | (self.largest_inside < 0))


class Inequality:
    """Exact polynomials of a claim, and their tables in doubles by face."""

    def __init__(self, claim: Claim) -> None:
        self.claim = claim
        self.n = len(claim.states)
        with ctx.workprec(_BITS):
            exact = self.exact = residual(claim)
            self.products = sorted({*exact.plain, *(product for _, product in exact.factors)})
            self.exact_corners = parameter_weights(claim.parameters, self.products)
            self.corners = np.array([[rounded(weight) for weight in row] for row in self.exact_corners])
            low, high = self.corners.min(0), self.corners.max(0)
            self.mid = (low + high) / 2
            self.rad = np.where(
                low == high, 0.0, (high - low) / 2 * (1 + 4 * UNIT) + np.abs(self.mid) * 4 * UNIT
            )
            n = self.n
            unit = [tuple(int(i == j) for j in range(n)) for i in range(n)]
            slopes = [[a.to_dict().get(e) for e in unit] for a in exact.arguments]
            self.slopes = np.array([[rounded(v) if v else 0.0 for v in row] for row in slopes]).reshape(-1, n)
            reach = claim.reach * np.abs(self.slopes).sum(1) * 1.01 + 0.1
            pairs = zip(claim.functions, reach, strict=True)
            self.quotients = [Quotient(function, float(largest)) for function, largest in pairs]
        factors = max((int(p.total_degree()) for p in exact.factors.values()), default=2)
        plain = max((int(p.total_degree()) for p in exact.plain.values()), default=2)
        self.table = CellTable(n, max(plain, factors + ORDER if exact.factors else 2, 2))
        self.small = CellTable(n, max(int(exact.value.total_degree()), factors))
        self.even = is_even(exact, claim)
        signs = (1,) if self.even else (1, -1)
        self.faces = [(face, sign) for face in range(n) for sign in signs]

    def column(self, table: CellTable, polynomial: Any, face: tuple[int, int]) -> np.ndarray:
        """The rounded coefficients of a polynomial on a face."""
        entries = {} if polynomial is None else polynomial.to_dict()
        return table.fill({tuple(map(int, e)): rounded(v) for e, v in entries.items()}, *face)

    def parts(self, polynomial: Any) -> tuple[Any, Any]:
        """What of a polynomial goes into tables, and what is only bounded: its odd part where half of the faces do."""
        if polynomial is None or not self.even:
            return polynomial, None
        entries = polynomial.to_dict().items()
        halves = [{e: v for e, v in entries if sum(map(int, e)) % 2 == odd} for odd in (0, 1)]
        return tuple(polynomial.context().from_dict(half) for half in halves)


def is_even(exact: Residual, claim: Claim) -> bool:
    """Whether V and r are even in z but for rounding in coefficients: then half of the faces say all."""
    polynomials = (exact.value, *exact.plain.values(), *exact.factors.values())
    return all(_nearly_even(p, claim.reach) for p in polynomials) and all(
        _is_odd(f.name, f.offset, f.pi_halves) for f in claim.functions
    )


def _nearly_even(polynomial: Any, reach: float) -> bool:
    """Whether terms of odd degree are, at the reach, below `_ODD` of the others; they are bounded, not forgotten."""
    size = [0.0, 0.0]
    for exponents, value in polynomial.to_dict().items():
        degree = sum(map(int, exponents))
        size[degree % 2] += abs(rounded(value)) * reach**degree
    return size[1] <= _ODD * size[0]


def _is_odd(name: str, offset: float, pi_halves: int) -> bool:
    """Whether φ(o + s) − φ(o) is odd in s."""
    whole = {"sin": pi_halves % 2 == 0, "cos": pi_halves % 2 == 1}
    return offset == 0 and whole.get(name, name in ("tanh", "arctan") and pi_halves == 0)


class _Columns(NamedTuple):
    """Rows (rows, components) of a table; by degree the sums of their magnitudes, and of those left out as odd."""

    rows: np.ndarray
    sizes: np.ndarray
    odd: np.ndarray


class FaceInequality:
    """Bounds of V and r on the cells of one face z_f = sign · ρ."""

    def __init__(self, inequality: Inequality, face: tuple[int, int]) -> None:
        self._of, self.face = inequality, face
        exact, table, small = inequality.exact, inequality.table, inequality.small
        weight = np.abs(inequality.mid) + inequality.rad

        def columns(target: CellTable, get: Callable[[Any], tuple[Any, Any]]) -> _Columns:
            pairs = [[inequality.column(target, part, face) for part in get(p)] for p in inequality.products]
            kept, odd = (np.stack(half, 1) for half in zip(*pairs, strict=True))
            return _Columns(kept, target.magnitudes(kept) @ weight, target.magnitudes(odd) @ weight)

        value, odd = (inequality.column(small, p, face)[:, None] for p in inequality.parts(exact.value))
        self._value = _Columns(value, small.magnitudes(value)[:, 0], small.magnitudes(odd)[:, 0])
        self._plain = columns(table, lambda p: inequality.parts(exact.plain.get(p)))
        self._lifted, self._factors = [], []
        for j, argument in enumerate(exact.arguments):
            halves = {p: inequality.parts(exact.factors.get((j, p))) for p in inequality.products}
            powers_ = [argument**m for m in range(ORDER + 1)]
            self._lifted.append(
                [columns(table, lambda p, a=a, h=halves: tuple(b and b * a for b in h[p])) for a in powers_]
            )
            self._factors.append(columns(small, halves.__getitem__))
        self._roundings = _roundings(table, len(inequality.products), len(exact.arguments)) * UNIT
        self._small_roundings = _roundings(small, len(inequality.products), 0) * UNIT

    def bounds(self, t: np.ndarray, h: np.ndarray, begin: np.ndarray, end: np.ndarray) -> Bounds:
        """On cells |t_i − τ_i| ≤ h_i, `begin` ≤ ρ ≤ `end`; t and h are (n − 1, cells)."""
        of, small, c = self._of, self._of.small, self._of.claim.level
        interval = _interval(begin, end)
        value = small.shifted(np.repeat(self._value.rows[..., None], len(end), 2), t, h)
        value_error = (
            self._small_roundings * _size(self._value.sizes, end) + _size(self._value.odd, end) + _TINY
        )
        zero = np.zeros_like(end)
        inner, _ = small.on_interval(-value, (begin, zero, begin), _NOMINAL)
        least_value = (-small.upper(inner) - value_error) * begin**2
        growth, _ = small.on_interval(-value * small.k[:, None, None], interval, _NOMINAL)

        form, constants, remainder, rounding = self._residual(t, h, interval)
        constant = (of.corners @ constants).max(0)
        level, at_center = small.on_interval(value, interval, _NOMINAL, lift=2)
        slope = small.slopes(level)
        size = (slope * slope).sum(0)
        multiplier = (of.table.slopes(form) * slope).sum(0) / np.where(size > 0, size, np.inf)
        multiplier = np.maximum(multiplier, 0.0)
        lowered = of.table.upper(form.less(multiplier, level), constant + multiplier * (c - at_center[0]))
        beside = multiplier * (value_error * end**2 + 4 * UNIT * c)
        return Bounds(
            least_value=least_value - 8 * UNIT * np.abs(least_value),
            least_growth=-small.upper(growth) - small.degree * value_error,
            largest=of.table.upper(form, constant) + remainder + rounding,
            largest_inside=lowered + remainder + rounding + beside,
            multiplier=multiplier,
            value=at_center[0],
            constant=constant,
            remainder=remainder,
            rounding=rounding,
            score=of.table.nonlinearity(form),
            level=c,
        )

    def _residual(
        self, t: np.ndarray, h: np.ndarray, interval: Any
    ) -> tuple[CentredForm, np.ndarray, np.ndarray, np.ndarray]:
        """Centred form of r/ρ², its components' constants, and the allowances for remainders and for rounding."""
        of, (f, sign) = self._of, self.face
        middle, radius, end = interval
        others = [i for i in range(of.n) if i != f]
        rows = np.repeat(self._plain.rows[..., None], len(end), 2)
        size, odd, remainder = _size(self._plain.sizes, end), _size(self._plain.odd, end), np.zeros_like(end)
        for j, quotient in enumerate(of.quotients):
            slope = of.slopes[j]
            ray, half = sign * slope[f] + slope[others] @ t, np.abs(slope[others]) @ h
            pad = 1e-12 * np.abs(slope).sum() * end
            reach = np.abs(ray) * radius + half * end + pad
            coefficients, rest = quotient.at(ray * middle - reach, ray * middle + reach)
            for lifted, a in zip(self._lifted[j], coefficients, strict=True):
                rows += lifted.rows[..., None] * a
                size += _size(lifted.sizes, end) * np.abs(a)
                odd += _size(lifted.odd, end) * np.abs(a)
            factor = self._factors[j]
            shifted = of.small.shifted(np.repeat(factor.rows[..., None], len(end), 2), t, h)
            form, _ = of.small.on_interval(shifted, interval, (of.mid, of.rad))
            error = self._small_roundings * _size(factor.sizes, end) + _size(factor.odd, end)
            remainder += rest * (of.small.magnitude(form) + error) * (1 + 1e-12)
        rows = of.table.shifted(rows, t, h)
        form, constants = of.table.on_interval(rows, interval, (of.mid, of.rad))
        return form, constants, remainder, self._roundings * size + odd * (1 + 1e-12) + _TINY


def _interval(begin: np.ndarray, end: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Middle, radius (rounded up) and end of an interval of ρ."""
    return (begin + end) / 2, (end - begin) / 2 * (1 + 8 * UNIT) + 8 * UNIT * end, end


def _size(magnitudes: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Σ_k M_k ρ^(k−2) at the outer end."""
    return np.einsum("k,kc->c", magnitudes, powers(end, len(magnitudes)))


def _roundings(table: CellTable, components: int, functions: int) -> float:
    """Twice the number K of roundings in (11): tables, Horner's scheme, powers, weights, sums."""
    assembled = 2 + 2 * (ORDER + 1) * functions
    return 2.0 * (assembled + 2 * table.n * table.degree + 6 * table.degree + components + table.size + 64)
