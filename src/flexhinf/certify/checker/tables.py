"""Polynomials on cells of a cube's face, many cells at once: Taylor shift, powers of the radius, centred form.

On the face z_f = ±ρ of the cube max|z_i| ≤ ρ, with z_i = ρ t_i for the others, a polynomial without terms below degree
two is P(z) = ρ² Σ_k ρ^(k−2) P_k(t). A cell is a box |t_i − τ_i| ≤ h_i times an interval of ρ. The bounds are proved in
docs/certificate.md, where equations have the same numbers.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from math import comb

import numpy as np

__all__ = ["UNIT", "CellTable", "CentredForm", "concave_bound", "powers"]

#: Largest relative error of one rounded operation.
UNIT = 2.0**-53


@dataclass(frozen=True, eq=False)
class CentredForm:
    """Σ low_{β,p} s_0^p s^β + rest in |s_i| ≤ 1: exact below |β| ≤ 2, with intervals for parameters.

    Attributes
    ----------
    low : (low β, powers of s_0, cells)
        Coefficients at the middle of the parameters.
    radius : the same shape, or 0
        By how much they differ over the box of parameters.
    tail : (β, cells)
        Bounds of the other coefficients.
    spread : (cells,)
        Bound of what the others differ by over the interval of ρ.
    """

    low: np.ndarray
    radius: np.ndarray | float
    tail: np.ndarray
    spread: np.ndarray

    def less(self, factor: np.ndarray, other: CentredForm) -> CentredForm:
        """Self − factor · other, for factor ≥ 0 per cell."""
        low = self.low.copy()
        common = min(low.shape[1], other.low.shape[1])
        low[:, :common] -= factor * other.low[:, :common]
        beyond = np.abs(factor * other.low[:, common:]).sum((0, 1))
        return CentredForm(
            low, self.radius, self.tail, self.spread + beyond + factor * (other.tail.sum(0) + other.spread)
        )


class CellTable:
    """Rows (k, β), 2 ≤ k ≤ `degree`, |β| ≤ k, of the coefficients of Σ_k ρ^(k−2) P_k(t), shifted to cells' centres.

    Rows are kept in orders in which each step of a synthetic division is one operation on two slices. Arrays of
    coefficients have the shape (rows, components, cells).
    """

    def __init__(self, n: int, degree: int) -> None:
        self.n, self.degree = n, degree
        monomials = [b for b in itertools.product(range(degree + 1), repeat=n - 1) if sum(b) <= degree]
        rows = np.array([(k, *b) for k in range(2, degree + 1) for b in monomials if sum(b) <= k])
        self.size = len(rows)
        self._row = {tuple(row): i for i, row in enumerate(rows.tolist())}
        self.first = [int(np.searchsorted(rows[:, 0], k)) for k in range(2, degree + 1)]
        self._order_rows(rows)
        self._order_low()

    def _order_rows(self, rows: np.ndarray) -> None:
        """Where rows go before each axis is shifted, and at last: to blocks of one β, of low |β| first."""
        self._gathers, self._sizes, place = [], [], np.arange(len(rows))
        for axis in range(1, self.n):
            rest = np.delete(rows, axis, 1)
            room = rows[:, 0] - rest[:, 1:].sum(1)  # highest exponent that the axis may have in this row
            order = np.lexsort((*rest.T[::-1], -room, rows[:, axis]))
            self._gathers.append(place[order])
            self._sizes.append(np.bincount(rows[:, axis]).tolist())
            place = np.argsort(order)
        order = np.lexsort((rows[:, 0], *rows[:, 1:].T[::-1], rows[:, 1:].sum(1)))
        self._gathers.append(place[order])
        rows = rows[order]
        new = (np.diff(rows[:, 1:], axis=0) != 0).any(1) if self.n > 1 else np.zeros(len(rows) - 1, bool)
        starts = np.flatnonzero(np.r_[True, new])
        self.beta, self.k = rows[starts, 1:], rows[:, 0]
        self._block = np.repeat(np.arange(len(starts)), np.diff(np.r_[starts, len(rows)]))
        self._low = int((self.beta.sum(1) <= 2).sum())  # these β stand with every k
        self._head = self._low * (self.degree - 1)
        self._starts = starts[self._low :] - self._head

    def _order_low(self) -> None:
        """Places (β, p) of constant, slopes, squares and pairs among the low coefficients; variable 0 is s_0."""
        at = {tuple(b): i for i, b in enumerate(self.beta[: self._low].tolist())}
        unit = [tuple(int(i == j) for j in range(1, self.n)) for i in range(self.n)]
        both = list(itertools.combinations_with_replacement(range(self.n), 2))
        place = {(i, j): (at[tuple(map(sum, zip(unit[i], unit[j])))], (i == 0) + (j == 0)) for i, j in both}
        self._slopes = np.array([(at[unit[i]], int(i == 0)) for i in range(self.n)]).T
        self._squares = np.array([place[i, i] for i in range(self.n)]).T
        pairs = [(i, j) for i, j in both if i < j]
        self._pairs = np.array([place[pair] for pair in pairs], dtype=int).reshape(-1, 2).T
        self._in_pair = np.array([[float(i in pair) for pair in pairs] for i in range(self.n)]).reshape(
            self.n, -1
        )
        self.powers = max(self.degree - 1, 3)
        other = np.ones((self._low, self.powers + 2), bool)
        for used in (self._slopes, self._squares, self._pairs):
            other[tuple(used)] = False
        other[0, 0] = False
        self._others = other
        self._touch_low = np.c_[np.zeros(self._low), self.beta[: self._low] > 0].T
        self._touch_tail = np.c_[np.zeros(len(self.beta) - self._low), self.beta[self._low :] > 0].T

    # From polynomials to centred forms --------------------------------------------------------------
    def fill(self, polynomial: dict[tuple[int, ...], float], face: int, sign: int) -> np.ndarray:
        """The rows (rows,) of a polynomial {exponents: coefficient} on the face z_f = sign · ρ."""
        column = np.zeros(self.size)
        for exponents, value in polynomial.items():
            row = (sum(exponents), *exponents[:face], *exponents[face + 1 :])
            column[self._row[row]] = value * sign ** exponents[face]
        return column

    def magnitudes(self, column: np.ndarray) -> np.ndarray:
        """M_k = Σ |coefficients of P_k|, (degree − 1, …)."""
        return np.add.reduceat(np.abs(column), self.first, axis=0)

    def shifted(self, c: np.ndarray, center: np.ndarray, half: np.ndarray) -> np.ndarray:
        """Coefficients in s of P_k(τ + h s), by Horner's scheme along each axis (7); τ and h are (n − 1, cells)."""
        for axis, sizes in enumerate(self._sizes):
            c = c[self._gathers[axis]]
            begin = np.r_[0, np.cumsum(sizes)].tolist()
            for i in range(len(sizes) - 1):
                for p in range(len(sizes) - 2, i - 1, -1):
                    size = sizes[p + 1]
                    c[begin[p] : begin[p] + size] += center[axis] * c[begin[p + 1] : begin[p + 1] + size]
        c = c[self._gathers[-1]]
        scale = np.ones((len(self.beta), half.shape[1]))
        for axis in range(self.n - 1):
            scale *= powers(half[axis], self.degree + 1)[self.beta[:, axis]]
        c *= scale[self._block, None]
        return c

    def on_interval(
        self,
        c: np.ndarray,
        interval: tuple[np.ndarray, np.ndarray, np.ndarray],
        weights: tuple[np.ndarray, np.ndarray],
        lift: int = 0,
    ) -> tuple[CentredForm, np.ndarray]:
        """Σ_k ρ^(k−2+lift) P_k over an interval of ρ given as (middle, radius, end) by (10); weights are intervals.

        Returns
        -------
        CentredForm
        constants : (components, cells)
            Each component at the centre.
        """
        middle, radius, end = interval
        mid, rad = weights
        m = np.arange(self.degree - 1) + lift
        count = max(self.powers, self.degree - 1 + lift)
        binomial = np.array([[comb(int(k), p) for k in m] for p in range(count)], dtype=float)
        at, width = powers(middle, self.degree + 2), powers(radius, count)
        lower = np.array([[max(int(k) - p, 0) for k in m] for p in range(count)])
        taylor = binomial[..., None] * at[lower] * width[:, None]
        head = c[: self._head].reshape(self._low, self.degree - 1, *c.shape[1:])
        parts = np.einsum("pkc,bkjc->jbpc", taylor, head)
        low = np.einsum("j,jbpc->bpc", mid, parts)
        spread_low = np.einsum("j,jbpc->bpc", rad, np.abs(parts)) if rad.any() else 0.0
        rest, k = c[self._head :], self.k[self._head :] - 2 + lift
        if not len(rest):
            nothing = np.zeros((0, c.shape[2]))
            return CentredForm(low, spread_low, nothing, nothing.sum(0)), parts[:, 0, 0]
        signed = np.einsum("j,rjc->rc", mid, rest) if len(mid) > 1 or rad.any() else rest[:, 0] * mid[0]
        beside = np.einsum("j,rjc->rc", rad, np.abs(rest)) if rad.any() else None
        tail = np.abs(np.add.reduceat(signed * at[k], self._starts, axis=0))
        size = np.abs(signed)
        if beside is not None:
            tail += np.add.reduceat(beside * at[k], self._starts, axis=0)
            size += beside
        size *= (powers(end, self.degree + 2) - at)[k]
        return CentredForm(low, spread_low, tail, size.sum(0)), parts[:, 0, 0]

    # Bounds -----------------------------------------------------------------------------------------
    def upper(self, form: CentredForm, constant: np.ndarray | None = None) -> np.ndarray:
        """Upper bound (8) of a form on its cells; `constant` replaces its constant term."""
        low, magnitude = form.low, np.abs(form.low) + form.radius
        pairs = self._in_pair @ magnitude[tuple(self._pairs)] / 2
        squares = low[tuple(self._squares)] + (
            form.radius[tuple(self._squares)] if isinstance(form.radius, np.ndarray) else 0.0
        )
        total = concave_bound(magnitude[tuple(self._slopes)], squares + pairs).sum(0)
        total += magnitude[self._others[:, : low.shape[1]]].sum(0) + form.tail.sum(0) + form.spread
        if constant is not None:
            return total + constant
        return total + low[0, 0] + (form.radius[0, 0] if isinstance(form.radius, np.ndarray) else 0.0)

    def magnitude(self, form: CentredForm) -> np.ndarray:
        """Upper bound of |form|."""
        return (np.abs(form.low) + form.radius).sum((0, 1)) + form.tail.sum(0) + form.spread

    def slopes(self, form: CentredForm) -> np.ndarray:
        """Coefficients of s_i, (n, cells)."""
        return form.low[tuple(self._slopes)]

    def nonlinearity(self, form: CentredForm) -> np.ndarray:
        """How much each variable adds to the bound beyond the constant, (n, cells): the largest is worth a split."""
        magnitude = np.abs(form.low) + form.radius
        others = magnitude * self._others[:, : form.low.shape[1], None]
        score = np.abs(form.low[tuple(self._squares)]) + magnitude[tuple(self._slopes)] / 4
        score += self._in_pair @ magnitude[tuple(self._pairs)]
        score += self._touch_low @ others.sum(1) + self._touch_tail @ form.tail
        score[0] += others[:, 1:].sum((0, 1)) + form.spread
        return score


def powers(base: np.ndarray, count: int) -> np.ndarray:
    """1, base, base², … along a new first axis, by repeated multiplication."""
    table = np.empty((count, *np.shape(base)))
    table[0] = 1.0
    for p in range(1, count):
        table[p] = table[p - 1] * base
    return table


def concave_bound(slope: np.ndarray, square: np.ndarray) -> np.ndarray:
    """Largest g s + q s² for 0 ≤ s ≤ 1 and g ≥ 0: (9)."""
    inner = -2.0 * square > slope
    return np.where(inner, slope * slope / np.where(inner, -4.0 * square, 1.0), slope + square)
