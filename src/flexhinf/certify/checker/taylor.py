"""Polynomials on cells of a cube's face, many cells at once: Taylor shift, powers of the radius, centred form.

On the face z_f = ±ρ of the cube max|z_i| ≤ ρ, with z_i = ρ t_i for the others, a polynomial without terms below degree
two is P(z) = ρ² Σ_k ρ^(k−2) P_k(t). A cell is a box |t_i − τ_i| ≤ h_i times an interval of ρ. The bounds are proved in
docs/certificate.md, where equations have the same numbers.
"""

from __future__ import annotations

import itertools
from math import comb
from typing import Any, NamedTuple

import numpy as np

from flexhinf.certify.checker.residual import rounded

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

    def chosen(self, cells: np.ndarray) -> CentredForm:
        """Some of the cells."""
        return CentredForm(*(part[:, cells] for part in self))

    def less(self, factor: np.ndarray, other: CentredForm) -> CentredForm:
        """Self − factor · other, for factor ≥ 0 per cell; `other` has no radius."""
        return CentredForm(
            self.low - factor * other.low, self.radius, np.concatenate([self.tail, factor * other.tail])
        )


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
        self._order_rows(rows)
        low: list[tuple[int, ...]] = [
            (p, *b) for b in self.beta[: self._low].tolist() for p in range(highest)
        ]
        self.terms = np.array(low)  # exponents of s_0, s_1, … of each low term
        total, mixed = self.terms.sum(1), (self.terms > 0).sum(1)
        unit = np.eye(n, dtype=int)
        self.linear, self.square = (np.array([low.index((*e,)) for e in m * unit]) for m in (1, 2))
        self.pairs = np.flatnonzero((total == 2) & (mixed == 2))
        self.in_pair = (self.terms[self.pairs] > 0).T.astype(float)
        self.others, self.tail_powers = total > 2, self.beta[self._low :]

    def _order_rows(self, rows: np.ndarray) -> None:
        """Where rows go before each axis is shifted, so that a step of Horner's scheme is an operation on two slices;
        and at last: to blocks of one β, of low |β| first, those with every k."""
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
        starts = np.flatnonzero(np.r_[True, (np.diff(rows[:, 1:], axis=0) != 0).any(1)])
        self.beta, self.k = rows[starts, 1:], rows[:, 0]
        self._block = np.repeat(np.arange(len(starts)), np.diff(np.r_[starts, len(rows)]))
        self._low = int((self.beta.sum(1) <= 2).sum())
        self._head = self._low * (self.degree - 1)
        self._starts = starts[self._low :] - self._head

    def fill(self, polynomial: Any, face: int, sign: int) -> np.ndarray:
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
        self, c: np.ndarray, interval: Any, weights: Any, lift: int = 0
    ) -> tuple[CentredForm, np.ndarray]:
        """Σ_k ρ^(k−2+lift) P_k over an interval of ρ given as (middle, radius, end) by (10), for intervals (middle,
        radius) of the components' weights; and each component at the centre, (components, cells)."""
        (middle, radius, end), (mid, rad) = interval, weights
        m = np.arange(self.degree - 1) + lift
        binomial = np.array([[comb(int(k), p) for k in m] for p in range(self.highest)], dtype=float)
        lower = np.array([[max(int(k) - p, 0) for k in m] for p in range(self.highest)])
        at, width = powers(middle, self.degree + 2), powers(radius, self.highest)
        taylor = binomial[..., None] * at[lower] * width[:, None]
        head = c[: self._head].reshape(self._low, self.degree - 1, *c.shape[1:])
        parts = np.einsum("pkc,bkjc->jbpc", taylor, head)
        low = np.einsum("j,jbpc->bpc", mid, parts).reshape(-1, len(end))
        spread = (
            np.einsum("j,jbpc->bpc", rad, np.abs(parts)).reshape(-1, len(end)) if rad.any() else 0.0 * low
        )
        rest, k = c[self._head :], self.k[self._head :] - 2 + lift
        signed = np.einsum("j,rjc->rc", mid, rest)
        size, tail = np.abs(signed), np.zeros((0, len(end)))
        if len(rest):
            tail = np.abs(np.add.reduceat(signed * at[k], self._starts, axis=0))
        if len(rest) and rad.any():
            beside = np.einsum("j,rjc->rc", rad, np.abs(rest))
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
    table = np.empty((count, *np.shape(base)))
    table[0] = 1.0
    for p in range(1, count):
        table[p] = table[p - 1] * base
    return table


def concave_bound(slope: np.ndarray, square: np.ndarray) -> np.ndarray:
    """Largest g s + q s² for 0 ≤ s ≤ 1 and g ≥ 0: (9)."""
    inner = -2.0 * square > slope
    return np.where(inner, slope * slope / np.where(inner, -4.0 * square, 1.0), slope + square)
