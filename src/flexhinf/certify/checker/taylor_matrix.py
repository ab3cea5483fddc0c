"""Matrices as polynomials of one variable −1 ≤ u ≤ 1 with remainders, in ball arithmetic [makino2003].

An entry is Σ c_k uᵏ for k below `TERMS`, plus a remainder that a ball encloses at every u. Polynomials have narrow
balls where plain balls of a whole interval would grow by the dependencies between entries.
"""

# Not checked strictly: parts of SciPy and NumPy have no types.
# pyright: reportMissingTypeStubs=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportUnknownMemberType=false

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from itertools import product

import numpy as np
from flint import arb, arb_mat, arb_series, ctx
from scipy.linalg import matrix_balance

#: Coefficients of the polynomials; powers of a matrix in its exponential.
TERMS, POWERS = 6, 32

#: Largest entry of a matrix that has an exponential here.
LARGEST = 1e6

Rows = Iterable[Iterable[arb | int | float]]


class TaylorMatrix:
    """A matrix with entries Σ c_k uᵏ + remainder."""

    def __init__(self, parts: Sequence[arb_mat]) -> None:
        self.parts = list(
            parts
        )  # coefficients of 1, u, …, as far as there are any, at most `TERMS`; the remainder

    @classmethod
    def of(cls, rows: Rows) -> TaylorMatrix:
        """A matrix of numbers and balls that do not depend on u."""
        value = arb_mat([list(row) for row in rows])
        return cls([value, value * 0])

    @classmethod
    def stacked(cls, blocks: Sequence[Sequence[TaylorMatrix]]) -> TaylorMatrix:
        """Of blocks in rows."""
        degree = max(len(block.parts) for row in blocks for block in row) - 1
        parts: list[arb_mat] = []
        for k in range(degree + 1):
            rows: list[list[arb]] = []
            for line in blocks:
                tables = [block.part(k, degree).tolist() for block in line]
                rows += [[entry for table in tables for entry in table[i]] for i in range(len(tables[0]))]
            parts.append(arb_mat(rows))
        return cls(parts)

    def part(self, k: int, degree: int) -> arb_mat:
        """The k-th coefficient; the remainder for k = degree."""
        if k == degree:
            return self.parts[-1]
        return self.parts[k] if k < len(self.parts) - 1 else self.parts[-1] * 0

    @property
    def range(self) -> arb_mat:
        """An enclosure for all u."""
        first, *others = self.parts[:-1]
        return sum((part * UNIT for part in others), first) + self.parts[-1]

    def rows(self, begin: int, end: int) -> TaylorMatrix:
        """Some rows."""
        return TaylorMatrix([arb_mat(part.tolist()[begin:end]) for part in self.parts])

    def columns(self, begin: int, end: int) -> TaylorMatrix:
        """Some columns."""
        return self.transpose().rows(begin, end).transpose()

    def transpose(self) -> TaylorMatrix:
        """Transposed."""
        return TaylorMatrix([part.transpose() for part in self.parts])

    def __add__(self, other: TaylorMatrix) -> TaylorMatrix:
        degree = max(len(self.parts), len(other.parts)) - 1
        return TaylorMatrix([self.part(k, degree) + other.part(k, degree) for k in range(degree + 1)])

    def __neg__(self) -> TaylorMatrix:
        return TaylorMatrix([-part for part in self.parts])

    def __sub__(self, other: TaylorMatrix) -> TaylorMatrix:
        return self + -other

    def times(self, number: arb) -> TaylorMatrix:
        """Times a number."""
        return TaylorMatrix([part * number for part in self.parts])

    def __matmul__(self, other: TaylorMatrix) -> TaylorMatrix:
        mine, theirs = self.parts[:-1], other.parts[:-1]
        zero = mine[0] * theirs[0] * 0
        parts = [zero for _ in range(min(TERMS, len(mine) + len(theirs) - 1))]
        remainder = self.parts[-1] * other.range + (self.range - self.parts[-1]) * other.parts[-1]
        for (i, x), (j, y) in product(enumerate(mine), enumerate(theirs)):
            if i + j < TERMS:
                parts[i + j] += x * y
            else:
                remainder += x * y * UNIT
        return TaylorMatrix([*parts, remainder])

    def inverse(self) -> TaylorMatrix:
        """The inverse at every u; ZeroDivisionError where none is found."""
        own = [self.part(k, TERMS) for k in range(TERMS)]
        first = own[0].inv()
        parts = [first]
        for k in range(1, TERMS):
            parts.append(-first * sum((own[i] * parts[k - i] for i in range(1, k + 1)), first * 0))
        near = TaylorMatrix([*parts, first * 0])
        unit = TaylorMatrix.of(np.eye(first.nrows()).tolist())
        error = frobenius((unit - self @ near).range.entries())
        if not error < 1:
            raise ZeroDivisionError("an inverse that may not exist")
        # A⁻¹ = X (1 − E)⁻¹ with E = 1 − A X.
        remainder = (frobenius(near.range.entries()) * error / (1 - error)).abs_upper()
        return TaylorMatrix([*parts, _filled(first, arb(0, remainder))])

    def exponential(self) -> TaylorMatrix:
        """exp of a square matrix, by its power series and squares; rows and columns are scaled by powers of two."""
        middle = np.array([[float(e.mid()) for e in row] for row in self.parts[0].tolist()])
        if not np.abs(middle).max() < LARGEST:
            raise ZeroDivisionError("a matrix whose exponential has no use")
        _, (scale, _) = matrix_balance(middle, permute=False, separate=True)
        own = self._scaled(scale)
        size = frobenius(own.range.entries())
        squares = max(0, int(np.ceil(np.log2(max(1.0, float(size.abs_upper()))))))
        power = own.times(arb(1) / 2**squares)
        norm = size / 2**squares
        remainder = (norm**POWERS * norm.exp() / arb(POWERS + 1).gamma()).abs_upper()
        unit = TaylorMatrix.of(np.eye(len(middle)).tolist())
        values = unit
        for k in range(POWERS - 1, 0, -1):
            values = unit + (power @ values).times(arb(1) / k)
        values.parts[-1] += _filled(values.parts[-1], arb(0, remainder))
        for _ in range(squares):
            values = values @ values
        return values._scaled(1.0 / scale)

    def _scaled(self, scale: np.ndarray) -> TaylorMatrix:
        """Column j times scale_j, row i divided by scale_i; powers of two."""
        left = arb_mat(np.diag(1.0 / scale).tolist())
        right = arb_mat(np.diag(scale).tolist())
        return TaylorMatrix([left * part * right for part in self.parts])


UNIT = arb(0, 1)


def taylor_row(
    function: Callable[[arb_series], Sequence[arb_series]], centre: arb, half: arb
) -> TaylorMatrix:
    """A row of analytic functions of centre + half·u: coefficients at the centre, and the next one on the interval."""
    cap = ctx.cap
    try:
        ctx.cap = TERMS
        inside = [value + arb_series([0]) for value in function(arb_series([centre, half]))]
        ctx.cap = TERMS + 1
        around = [value + arb_series([0]) for value in function(arb_series([centre + half * UNIT, half]))]
    finally:
        ctx.cap = cap
    parts = [arb_mat([[value[k] for value in inside]]) for k in range(TERMS)]
    return TaylorMatrix([*parts, arb_mat([[value[TERMS] * UNIT for value in around]])])


def frobenius(entries: Iterable[arb]) -> arb:
    """An upper bound of the Frobenius norm."""
    return sum((entry.abs_upper() ** 2 for entry in entries), arb(0)).sqrt()


def positive_definite(matrix: arb_mat) -> bool:
    """Whether a symmetric matrix of balls is positive definite: X' M X is, by Gershgorin's circles, with any X."""
    middle = np.array([[float(entry.mid()) for entry in row] for row in matrix.tolist()])
    if not np.isfinite(middle).all():
        return False
    x = arb_mat(np.linalg.eigh(0.5 * (middle + middle.T))[1].tolist())
    turned = (x.transpose() * matrix * x).tolist()
    return all(
        row[i] > sum((abs(e) for j, e in enumerate(row) if j != i), arb(0)) for i, row in enumerate(turned)
    )


def _filled(like: arb_mat, entry: arb) -> arb_mat:
    return arb_mat([[entry] * like.ncols() for _ in range(like.nrows())])
