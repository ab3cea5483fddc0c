"""Enclosures of many small polynomials on cells of a cube's face, divided by the radius.

On the face z_f = ±ρ of the cube max|z_i| ≤ ρ, with z_i = ρ t_i for the others, a polynomial q without a constant is
q/ρ = Q(w), a polynomial in w = (ρ, t). On the cell |w_i − m_i| ≤ h_i, by Taylor's formula,

    |Q(w) − Q(m)|  ≤  Σ_i |∂_i Q(m)| h_i + ½ Σ_ij H_ij h_i h_j,    H_ij = Σ |coefficients of ∂_ij Q| (|m| + h)^powers.

All values and derivatives of all polynomials at all centres are one product of matrices.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np
from flint import fmpq

from flexhinf.certify.reading import nearest_double

_ROUNDING = 1e-12  # relative to the sum of all terms' magnitudes: some hundred operations in doubles


class MeanForms:
    """Polynomials in z without constants, on the 2n faces.

    Parameters
    ----------
    n : int
        States.
    polynomials : sequence of dict of exponents to fmpq
        Enclosed as value + Σ slope_i s_i ± rest, |s_i| ≤ 1.
    """

    def __init__(self, n: int, polynomials: Sequence[dict[tuple[int, ...], fmpq]]) -> None:
        self.n, self.count = n, len(polynomials)
        degree = max((sum(powers) for q in polynomials for powers in q), default=1)
        self.rows = np.array(
            sorted(
                (
                    (p, *b)
                    for p in range(degree)
                    for b in product(range(degree + 1), repeat=n - 1)
                    if sum(b) <= min(degree, p + 3)
                ),
                key=sum,
            )
        )
        self._index = {tuple(row): i for i, row in enumerate(self.rows.tolist())}
        self._levels = self._parents()
        self._pairs = [(i, j) for i in range(n) for j in range(i, n)]
        self._tables = [self._face(polynomials, f, s) for f in range(n) for s in (1, -1)]

    def _parents(self) -> list[tuple[slice, np.ndarray, np.ndarray]]:
        """Of all monomials of each degree after the first: one of a degree less, and the variable between them."""
        total = self.rows.sum(1)
        levels = []
        for degree in range(1, int(total.max()) + 1):
            places = np.flatnonzero(total == degree)
            parents, axes = [], []
            for row in self.rows[places].tolist():
                for axis in range(self.n - 1, -1, -1):
                    less = tuple(e - (i == axis) for i, e in enumerate(row))
                    if less in self._index:
                        parents.append(self._index[less])
                        axes.append(axis)
                        break
            levels.append((slice(int(places[0]), int(places[-1]) + 1), np.array(parents), np.array(axes)))
        return levels

    def _face(
        self, polynomials: Sequence[dict[tuple[int, ...], fmpq]], face: int, sign: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Rows for values and gradients, and for magnitudes of values and second derivatives."""
        values = [self._column(q, face, sign) for q in polynomials]
        gradients = [self._derivative(c, i) for c in values for i in range(self.n)]
        seconds = []
        for c in values:
            for i, j in self._pairs:
                weight = 0.5 if i == j else 1.0
                seconds.append(weight * np.abs(self._derivative(self._derivative(c, i), j)))
        return (
            np.array([*values, *gradients]).reshape(-1, len(self.rows)),
            np.array([*np.abs(values), *seconds]).reshape(-1, len(self.rows)),
        )

    def _column(self, polynomial: dict[tuple[int, ...], fmpq], face: int, sign: int) -> np.ndarray:
        column = np.zeros(len(self.rows))
        for powers, value in polynomial.items():
            row = (sum(powers) - 1, *powers[:face], *powers[face + 1 :])
            column[self._index[row]] += nearest_double(value) * sign ** powers[face]
        return column

    def _derivative(self, column: np.ndarray, axis: int) -> np.ndarray:
        result = np.zeros(len(column))
        for i in np.flatnonzero(column):
            row = self.rows[i].copy()
            if row[axis]:
                row[axis] -= 1
                result[self._index[tuple(row.tolist())]] += (row[axis] + 1) * column[i]
        return result

    def _monomials(self, w: np.ndarray) -> np.ndarray:
        values = np.ones((len(self.rows), w.shape[1]))
        for places, parents, axes in self._levels:
            np.multiply(values[parents], w[axes], out=values[places])
        return values

    def enclose(
        self, face: np.ndarray, middle: np.ndarray, half: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The value in the middle (polynomials, N), slopes h_i ∂_i Q (polynomials, n, N), and a bound of what is left.

        Parameters
        ----------
        face : ndarray of int, shape (N,)
            2 f for z_f = ρ, 2 f + 1 for z_f = −ρ.
        middle, half : ndarray, shape (n, N)
            Of the cell in (ρ, t).
        """
        at, beyond = self._monomials(middle), self._monomials(np.abs(middle) + half)
        k, pairs, size = self.count, len(self._pairs), len(face)
        spread = np.array([half[i] * half[j] for i, j in self._pairs])
        value_at, rest = np.zeros((k, size)), np.zeros((k, size))
        slopes = np.zeros((k, self.n, size))
        for number in np.unique(face):
            cells = np.flatnonzero(face == number)
            table, magnitudes = self._tables[number]
            value, size_of = table @ at[:, cells], magnitudes @ beyond[:, cells]
            second = size_of[k:].reshape(k, pairs, -1)
            value_at[:, cells] = value[:k]
            slopes[:, :, cells] = value[k:].reshape(k, self.n, -1) * half[:, cells]
            rest[:, cells] = np.einsum("kic,ic->kc", second, spread[:, cells]) + _ROUNDING * size_of[:k]
        rest += _ROUNDING * (np.abs(slopes).sum(axis=1) + rest)
        return value_at, slopes, rest
