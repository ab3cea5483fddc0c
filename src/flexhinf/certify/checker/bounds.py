"""Bounds on cells: of V, of its growth along rays, and of r where V ≤ c, with all rounding.

`Proof` has the tables of one claim, `Face` bounds the cells of one face, many at once. Nothing else decides whether a
cell is proved. docs/theorem.md proves the bounds; equations have the same numbers there.

**Polynomials** (`TaylorTable`, `CentredForm`). On the face z_f = ±ρ of the cube max|z_i| ≤ ρ, with z_i = ρ t_i for the
others, a polynomial without terms below degree two is P(z) = ρ² Σ_k ρ^(k−2) P_k(t). A cell is a box |t_i − τ_i| ≤ h_i
times an interval of ρ.

**Functions** (`Quotient`). S(s) = (φ(o + s) − φ(o))/s = ∫₀¹ φ′(o + u s) du, so |S^(m)(s)| ≤ max |φ^(m+1)|/(m + 1)
between o and o + s, and a Taylor polynomial of order M about s_i leaves at most max |φ^(M+2)/(M+2)!| |s − s_i|^(M+1):
(5). All in ball arithmetic, on a grid of s_i.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from math import ceil, comb, inf, isfinite, prod
from typing import NamedTuple

import numpy as np
from flint import arb, arb_series, ctx, fmpq_mpoly

from flexhinf.certify.checker.residual import (
    ExactResidual,
    box_corners,
    offset_of,
    rounded,
    row_of,
    series_of,
)
from flexhinf.certify.claim import Claim, Function

#: Largest relative error of one rounded operation.
UNIT = 2.0**-53


class CentredForm(NamedTuple):
    """Σ over low terms (low ± radius) s_0^p s^β + rest in |s_i| ≤ 1, |rest| ≤ Σ tail; all of shape (…, cells).

    `low` are the coefficients with |β| ≤ 2 at the middle of the parameters, `radius` how much they differ over the box
    of parameters. The last row of `tail` is what the other coefficients differ by over the interval of ρ.
    """

    low: np.ndarray
    radius: np.ndarray
    tail: np.ndarray


class TaylorTable:
    """Rows (k, β), 2 ≤ k ≤ `degree`, |β| ≤ k, of the coefficients of Σ_k ρ^(k−2) P_k(t).

    Arrays of coefficients have the shape (rows, components, cells), components being products of parameters. Low terms
    have powers of s_0 below `highest`, for all tables of one proof alike.
    """

    def __init__(self, n: int, degree: int, highest: int) -> None:
        self.n, self.degree, self.highest = n, degree, highest
        monomials = [b for b in itertools.product(range(degree + 1), repeat=n - 1) if sum(b) <= degree]
        rows = np.array([(k, *b) for k in range(2, degree + 1) for b in monomials if sum(b) <= k])
        self._row = {tuple(row): i for i, row in enumerate(rows.tolist())}
        self._first = [int(np.searchsorted(rows[:, 0], k)) for k in range(2, degree + 1)]
        # Where rows go before each axis is shifted, so that a step of Horner's scheme is an operation on two slices;
        # and at last: to blocks of one β, of low |β| first, those with every k.
        self._gathers, self._sizes, place = list[np.ndarray](), list[list[int]](), np.arange(len(rows))
        for axis in range(1, n):
            others = np.delete(rows, axis, 1)
            room = rows[:, 0] - others[:, 1:].sum(1)  # highest exponent that the axis may have in this row
            order = np.lexsort((*others.T[::-1], -room, rows[:, axis]))
            self._gathers.append(place[order])
            self._sizes.append(np.bincount(rows[:, axis]).tolist())
            place = np.argsort(order)
        order = np.lexsort((rows[:, 0], *rows[:, 1:].T[::-1], rows[:, 1:].sum(1)))
        self._gathers.append(place[order])
        rows = rows[order]
        starts = np.flatnonzero(np.r_[True, (np.diff(rows[:, 1:], axis=0) != 0).any(1)])
        self.beta, self.k = rows[starts, 1:], rows[:, 0]
        self._block = np.repeat(np.arange(len(starts)), np.diff(np.r_[starts, len(rows)]))
        self._low = int((self.beta.sum(1) <= 2).sum())
        self._head = self._low * (degree - 1)
        self._starts = starts[self._low :] - self._head
        low = [(p, *b) for b in self.beta[: self._low].tolist() for p in range(highest)]
        self.terms, unit = np.array(low), np.eye(n, dtype=int)  # exponents of s_0, s_1, … of each low term
        total, mixed = self.terms.sum(1), (self.terms > 0).sum(1)
        self.linear, self.square = (np.array([low.index((*e,)) for e in m * unit]) for m in (1, 2))
        self.pairs = np.flatnonzero((total == 2) & (mixed == 2))
        self.in_pair = (self.terms[self.pairs] > 0).T.astype(float)
        self.others, self.tail_powers = total > 2, self.beta[self._low :]

    def fill(self, polynomial: fmpq_mpoly, face: int, sign: int) -> np.ndarray:
        """The correctly rounded rows (rows,) of an exact polynomial on the face z_f = sign · ρ."""
        column = np.zeros(len(self._row))
        for powers_, value in polynomial.to_dict().items():
            e = [*map(int, powers_)]
            column[self._row[sum(e), *e[:face], *e[face + 1 :]]] = rounded(value) * sign ** e[face]
        return column

    def magnitudes(self, column: np.ndarray) -> np.ndarray:
        """M_k = Σ |coefficients of P_k|, (degree − 1, …)."""
        return np.add.reduceat(np.abs(column), self._first, axis=0)

    def shifted(self, c: np.ndarray, center: np.ndarray, half: np.ndarray) -> np.ndarray:
        """Coefficients in s of P_k(τ + h s), by Horner's scheme along each axis (7); τ and h are (n − 1, cells)."""
        for axis, sizes in enumerate(self._sizes):
            c = c[self._gathers[axis]]
            begin = [0, *itertools.accumulate(sizes)]
            for i in range(len(sizes) - 1):
                for p in range(len(sizes) - 2, i - 1, -1):
                    size = sizes[p + 1]
                    c[begin[p] : begin[p] + size] += center[axis] * c[begin[p + 1] : begin[p + 1] + size]
        c = c[self._gathers[-1]]
        factors = (powers(half[axis], self.degree + 1)[self.beta[:, axis]] for axis in range(self.n - 1))
        return c * prod(factors, start=np.ones((len(self.beta), half.shape[1])))[self._block, None]

    def on_interval(
        self,
        c: np.ndarray,
        interval: tuple[np.ndarray, np.ndarray, np.ndarray],
        weights: tuple[np.ndarray, np.ndarray],
        lift: int = 0,
    ) -> tuple[CentredForm, np.ndarray]:
        """Σ_k ρ^(k−2+lift) P_k over an interval of ρ given as (middle, radius, end) by (10), for intervals (middle,
        radius) of the components' weights; and each component at the centre, (components, cells)."""
        (middle, radius, end), (mid, rad) = interval, weights
        m = np.arange(self.degree - 1) + lift
        binomial = np.array([[comb(int(k), p) for k in m] for p in range(self.highest)], dtype=float)
        lower = np.array([[max(int(k) - p, 0) for k in m] for p in range(self.highest)])
        at, width = powers(middle, self.degree + 2), powers(radius, self.highest)
        head = c[: self._head].reshape(self._low, self.degree - 1, *c.shape[1:])
        parts = np.einsum("pkc,bkjc->jbpc", binomial[..., None] * at[lower] * width[:, None], head)
        low = np.einsum("j,jbpc->bpc", mid, parts).reshape(-1, len(end))
        spread = (
            np.einsum("j,jbpc->bpc", rad, np.abs(parts)).reshape(-1, len(end)) if rad.any() else 0.0 * low
        )
        high, k = c[self._head :], self.k[self._head :] - 2 + lift
        signed = np.einsum("j,rjc->rc", mid, high)
        size, tail = np.abs(signed), np.zeros((0, len(end)))
        if len(high):
            tail = np.abs(np.add.reduceat(signed * at[k], self._starts, axis=0))
            if rad.any():
                beside = np.einsum("j,rjc->rc", rad, np.abs(high))
                tail += np.add.reduceat(beside * at[k], self._starts, axis=0)
                size += beside
        size *= (powers(end, self.degree + 2) - at)[k]
        return CentredForm(low, spread, np.concatenate([tail, size.sum(0)[None]])), parts[:, 0, 0]

    def upper(self, form: CentredForm, constant: np.ndarray | None = None) -> np.ndarray:
        """Upper bound (8) of a form on its cells; `constant` replaces its constant term."""
        size = np.abs(form.low) + form.radius
        square = (form.low + form.radius)[self.square] + self.in_pair @ size[self.pairs] / 2
        total = concave_bound(size[self.linear], square).sum(0) + size[self.others].sum(0) + form.tail.sum(0)
        return total + (form.low[0] + form.radius[0] if constant is None else constant)


def powers(base: np.ndarray, count: int) -> np.ndarray:
    """1, base, base², … along a new first axis, by repeated multiplication."""
    return np.cumprod([np.ones_like(base), *[base] * (count - 1)], axis=0)


def concave_bound(slope: np.ndarray, square: np.ndarray) -> np.ndarray:
    """Largest g s + q s² for 0 ≤ s ≤ 1 and g ≥ 0: (9)."""
    inner = -2.0 * square > slope
    return np.where(inner, slope * slope / np.where(inner, -4.0 * square, 1.0), slope + square)


ORDER = 4  # of the Taylor polynomials
GRID = 64  # their centres on an interval of length one: a power of two, so that the centres are doubles


class Quotient:
    """Polynomials Σ_m a_m s^m with |S − Σ| bounded, for cells whose s lies in [low, high]."""

    def __init__(self, function: Function, largest: float) -> None:
        count = self._count = ceil(largest * GRID) + 1
        self._offset, self._name = offset_of(function), function.name
        self._coefficients = np.zeros((2 * count + 1, ORDER + 1))
        self._error, self._remainder = np.zeros(2 * count + 1), np.zeros(2 * count + 1)
        for side in (1, -1):
            worst = 0.0
            for i in range(count + 1):
                place, s = count + side * i, arb(side * i) / GRID
                series = self._series(s + arb(0, 1 / GRID), ORDER + 3)  # within one step of the grid
                bound = float(abs(series[ORDER + 2]).upper()) * _UP
                worst = max(worst, bound if isfinite(bound) else inf)
                self._remainder[place] = worst
                self._coefficients[place], self._error[place] = self._about(s)

    def _series(self, about: arb, terms: int) -> arb_series:
        return series_of(self._name, arb_series([self._offset + about, 1], prec=terms))

    def _about(self, s: arb) -> tuple[list[float], float]:
        """Doubles a_m of the Taylor polynomial about s, in powers of s, and their error where |s − s_i| ≤ 1."""
        series = self._series(s, ORDER + 2)
        if s != 0:
            series = (series - self._series(arb(0), 1)[0]) / arb_series([s, 1], prec=ORDER + 2)
        local, values, error = [series[m + int(s == 0)] for m in range(ORDER + 1)], list[float](), arb(0)
        for m in range(ORDER + 1):
            exact = sum((local[j] * comb(j, m) * (-s) ** (j - m) for j in range(m, ORDER + 1)), arb(0))
            values.append(float(exact.mid()))
            error += abs(exact - arb(values[-1])) * (abs(s) + 1) ** m
        bound = float(error.upper()) * _UP
        return values, bound if isfinite(bound) else inf

    def at(self, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Coefficients (ORDER + 1, cells) of powers of s, and the bound (cells,) of the remainder."""
        index = np.clip(np.rint((low + high) / 2 * GRID), -self._count, self._count).astype(int)
        width = np.maximum(high - index / GRID, index / GRID - low) * _UP
        edge = np.ceil(np.maximum(np.abs(low), np.abs(high)) * GRID)
        inside = np.minimum(edge, self._count).astype(int)
        remainder = np.maximum(self._remainder[self._count + inside], self._remainder[self._count - inside])
        error = self._error[self._count + index] * np.maximum(width, 1.0) ** ORDER
        return self._coefficients[self._count + index].T, np.where(
            edge > self._count, inf, (remainder * width ** (ORDER + 1) + error) * _UP
        )


BITS = 128  # of the balls from which tables are rounded
_NOMINAL = (np.ones(1), np.zeros(1))
_ODD = 1e-9  # of an even polynomial
_TINY = 1e-180  # more than what underflow loses anywhere: a million products of 5e-324 and ρ^12 ≤ 1e120
_UP = 1 + 1e-12  # more than a few roundings


@dataclass(frozen=True, eq=False)
class CellEnclosure:
    """Bounds of V, its growth and r on each cell of a batch; arrays (cells,) unless stated."""

    least_value: np.ndarray  # lower bound of V at the inner end of the interval of ρ
    least_growth: np.ndarray  # lower bound of ∂V/∂ρ / ρ
    largest: np.ndarray  # upper bound of r/ρ²
    largest_inside: np.ndarray  # of r/ρ² + λ(c − V): so of r/ρ² where V ≤ c
    multiplier: np.ndarray  # λ ≥ 0
    level: float  # c
    value: np.ndarray  # V at the centre, rounded; proves nothing
    constant: np.ndarray  # r/ρ² at the centre, rounded; proves nothing
    remainder: np.ndarray  # what the other bounds allow for functions' remainders
    rounding: np.ndarray  # and for rounding and odd parts
    form: CentredForm  # of r/ρ²; where a cut is worth most

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
        exact = self.exact = ExactResidual(claim)
        self.exact_corners = [weights for _, weights in box_corners(claim, exact.products)]
        self.corners = np.array([[rounded(weight) for weight in row] for row in self.exact_corners])
        low, high = self.corners.min(0), self.corners.max(0)
        self.mid = (low + high) / 2
        self.rad = np.where(low == high, 0.0, (high - low) / 2 * (1 + 4 * UNIT) + np.abs(self.mid) * 4 * UNIT)
        self.slopes = np.array(  # ℓᵀT
            [[rounded(v) for v in row_of(s).entries()] for s in exact.arguments], dtype=float
        ).reshape(-1, self.n)
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

    def parts(self, polynomial: fmpq_mpoly) -> tuple[fmpq_mpoly, fmpq_mpoly]:
        """The part for tables and the part that is only bounded: by symmetry, the odd one."""
        odd = polynomial.context().from_dict(
            {e: v for e, v in polynomial.to_dict().items() if self.even and sum(map(int, e)) % 2}
        )
        return polynomial - odd, odd


def _degree(polynomials: list[fmpq_mpoly]) -> int:
    return max([2, *(int(p.total_degree()) for p in polynomials)])


def _nearly_even(polynomial: fmpq_mpoly, reach: float) -> bool:
    """Whether all terms of odd degree together are, at the reach, below `_ODD` of the others. They are bounded too."""
    size = [0.0, 0.0]
    for e, value in polynomial.to_dict().items():
        degree = sum(map(int, e))
        size[degree % 2] += abs(rounded(value)) * reach**degree
    return size[1] <= _ODD * size[0]


def _is_odd(function: Function) -> bool:
    """Whether φ(o + s) − φ(o) is odd in s."""
    return function.offset == 0 and {
        "sin": function.pi_halves % 2 == 0,
        "cos": function.pi_halves % 2 == 1,
    }.get(function.name, function.name in ("tanh", "arctan") and function.pi_halves == 0)


class _TableColumns(NamedTuple):
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

        def columns(
            table: TaylorTable, pairs: list[tuple[fmpq_mpoly, fmpq_mpoly]], weight: np.ndarray
        ) -> _TableColumns:
            kept, left = (
                np.stack([table.fill(p, *face) for p in half], 1) for half in zip(*pairs, strict=True)
            )
            count = _roundings(table, len(proof.mid), len(exact.arguments)) * UNIT
            return _TableColumns(
                kept, (count * table.magnitudes(kept) + table.magnitudes(left) * _UP) @ weight
            )

        self._value = columns(proof.small, [proof.parts(exact.value)], np.ones(1))
        self._plain = columns(proof.table, [proof.parts(p) for p in exact.plain], weight)
        self._factors, self._lifted = list[_TableColumns](), list[list[_TableColumns]]()
        for s, row in zip(exact.arguments, exact.factors, strict=True):
            pairs = [proof.parts(p) for p in row]
            self._factors.append(columns(proof.small, pairs, weight))
            lifted = ([(a * s**m, b * s**m) for a, b in pairs] for m in range(ORDER + 1))
            self._lifted.append([columns(proof.table, power, weight) for power in lifted])

    def bounds(self, t: np.ndarray, h: np.ndarray, begin: np.ndarray, end: np.ndarray) -> CellEnclosure:
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
        low, tail = form.low - multiplier * level.low, np.concatenate([form.tail, multiplier * level.tail])
        lowered = table.upper(  # r/ρ² − λV, and V has no radius
            CentredForm(low, form.radius, tail), constant + multiplier * (c - at_center[0])
        )
        return CellEnclosure(
            least_value=least_value - 8 * UNIT * np.abs(least_value),
            least_growth=-small.upper(growth) - small.degree * error,
            largest=table.upper(form, constant) + remainder + rounding,
            largest_inside=lowered + remainder + rounding + multiplier * (error * end**2 + 4 * UNIT * c),
            multiplier=multiplier,
            level=c,
            value=at_center[0],
            constant=constant,
            remainder=remainder,
            rounding=rounding,
            form=form,
        )

    def _residual(
        self, t: np.ndarray, h: np.ndarray, interval: tuple[np.ndarray, np.ndarray, np.ndarray]
    ) -> tuple[CentredForm, np.ndarray, np.ndarray, np.ndarray]:
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
            coefficients, error = quotient.at(ray * middle - width, ray * middle + width)
            for columns, a in zip(lifted, coefficients, strict=True):
                rows += columns.rows[..., None] * a
                rounding += columns.error(end) * np.abs(a)
            form, _ = proof.small.on_interval(
                self._shifted(proof.small, factor, t, h), interval, (proof.mid, proof.rad)
            )
            remainder += (
                error * ((np.abs(form.low) + form.radius).sum(0) + form.tail.sum(0) + factor.error(end)) * _UP
            )
        form, constants = proof.table.on_interval(
            proof.table.shifted(rows, t, h), interval, (proof.mid, proof.rad)
        )
        return form, constants, remainder, rounding * _UP

    def _shifted(
        self, table: TaylorTable, columns: _TableColumns, t: np.ndarray, h: np.ndarray
    ) -> np.ndarray:
        return table.shifted(np.repeat(columns.rows[..., None], t.shape[1], 2), t, h)


def _interval(begin: np.ndarray, end: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return (begin + end) / 2, (end - begin) / 2 * (1 + 8 * UNIT) + 8 * UNIT * end, end


def _roundings(table: TaylorTable, components: int, functions: int) -> float:
    """Twice the number K of roundings in (11): tables, Horner's scheme, powers, weights, sums."""
    assembled = 2 + 2 * (ORDER + 1) * functions
    return 2.0 * (assembled + 2 * table.n * table.degree + 6 * table.degree + components + len(table.k) + 64)
