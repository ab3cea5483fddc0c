"""Matrices as polynomials of −1 ≤ u, v ≤ 1 with remainders, in ball arithmetic [makino2003].

An entry is Σ c_kl uᵏ vˡ for k + l below `TERMS`, plus a remainder that a ball encloses at every u and v. Polynomials
have narrow balls where plain balls of whole intervals would grow by the dependencies between entries. What does not
depend on v costs nothing for it.
"""

# Not checked strictly: parts of SciPy and NumPy have no types.
# pyright: reportMissingTypeStubs=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportUnknownMemberType=false

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cached_property

import numpy as np
from flint import arb, arb_mat, arb_series, ctx
from scipy.linalg import matrix_balance

#: Degrees below which polynomials have terms, of one variable and of two; most powers of a matrix in its exponential.
TERMS, POWERS = (8, 7), 32

#: Largest entry of a matrix that has an exponential here.
LARGEST = 1e6

#: Size of a row or a column that its coordinate alone can make smaller.
SLIGHT = 0.125

#: What is raised where an enclosure does not exist.
NO_ENCLOSURE = ZeroDivisionError, OverflowError, ValueError, np.linalg.LinAlgError

Rows = Iterable[Iterable[arb | int | float]]

#: The powers (k, l) of u and v.
Powers = tuple[int, int]
CONSTANT: Powers = (0, 0)


class TaylorMatrix:
    """A matrix with entries Σ c_kl uᵏ vˡ + remainder."""

    def __init__(self, terms: Mapping[Powers, arb_mat], remainder: arb_mat | None = None) -> None:
        self.terms = {CONSTANT: terms[CONSTANT], **terms}  # coefficients, as far as there are any
        self.remainder = terms[CONSTANT] * 0 if remainder is None else remainder

    @classmethod
    def of(cls, rows: Rows) -> TaylorMatrix:
        """A matrix of numbers and balls that do not depend on u and v."""
        return cls({CONSTANT: arb_mat([list(row) for row in rows])})

    @classmethod
    def stacked(cls, blocks: Sequence[Sequence[TaylorMatrix]]) -> TaylorMatrix:
        """Of blocks in rows."""

        def joined(parts: list[list[arb_mat]]) -> arb_mat:
            rows: list[list[arb]] = []
            for line in parts:
                tables = [part.tolist() for part in line]
                rows += [[entry for table in tables for entry in table[i]] for i in range(len(tables[0]))]
            return arb_mat(rows)

        every = dict.fromkeys(powers for line in blocks for block in line for powers in block.terms)
        terms = {
            powers: joined([[b.coefficient(powers) for b in line] for line in blocks]) for powers in every
        }
        return cls(terms, joined([[block.remainder for block in line] for line in blocks]))

    def coefficient(self, powers: Powers) -> arb_mat:
        """Of a product of powers of u and v."""
        found = self.terms.get(powers)
        return self.terms[CONSTANT] * 0 if found is None else found

    @property
    def constant(self) -> arb_mat:
        """The coefficient of 1."""
        return self.terms[CONSTANT]

    @property
    def degree(self) -> int:
        """Below which products and inverses have terms."""
        return TERMS[any(l for _, l in self.terms)]

    @property
    def range(self) -> arb_mat:
        """An enclosure for all u and v."""
        return self._polynomial + self.remainder

    @cached_property
    def _tails(self) -> list[arb_mat]:
        """Enclosures of all terms of degree 1 and more, 2 and more, and so on."""
        tails: list[arb_mat] = []
        for degree in range(max(map(sum, self.terms)), 0, -1):
            own = [part * UNIT for powers, part in self.terms.items() if sum(powers) == degree]
            tails.insert(0, sum(own[1:], own[0]) if not tails else sum(own, tails[0]))
        return tails

    @cached_property
    def _polynomial(self) -> arb_mat:
        return self.constant + self._tails[0] if self._tails else self.constant

    def each(self, change: Callable[[arb_mat], arb_mat]) -> TaylorMatrix:
        """A linear change of all coefficients, and of the remainder."""
        return TaylorMatrix(
            {powers: change(part) for powers, part in self.terms.items()}, change(self.remainder)
        )

    def rows(self, begin: int, end: int) -> TaylorMatrix:
        """Some rows."""
        return self.each(lambda part: arb_mat(part.tolist()[begin:end]))

    def columns(self, begin: int, end: int) -> TaylorMatrix:
        """Some columns."""
        return self.each(lambda part: arb_mat([row[begin:end] for row in part.tolist()]))

    def transpose(self) -> TaylorMatrix:
        """Transposed."""
        return self.each(lambda part: part.transpose())

    def __add__(self, other: TaylorMatrix) -> TaylorMatrix:
        terms = dict(self.terms)
        for powers, part in other.terms.items():
            terms[powers] = terms[powers] + part if powers in terms else part
        return TaylorMatrix(terms, self.remainder + other.remainder)

    def __neg__(self) -> TaylorMatrix:
        return self.each(lambda part: -part)

    def __sub__(self, other: TaylorMatrix) -> TaylorMatrix:
        return self + -other

    def times(self, number: arb) -> TaylorMatrix:
        """Times a number."""
        return self.each(lambda part: part * number)

    def along(self, constant: arb, slope: arb) -> TaylorMatrix:
        """Times constant + slope · v."""
        if slope == 0:
            return self.times(constant)
        terms = {powers: part * constant for powers, part in self.terms.items()}
        for (k, l), part in self.terms.items():
            more = part * slope
            terms[k, l + 1] = terms[k, l + 1] + more if (k, l + 1) in terms else more
        return TaylorMatrix(terms, self.remainder * (constant + slope * UNIT))

    def turned(self) -> TaylorMatrix:
        """The same at −v."""
        terms = {(k, l): -part if l % 2 else part for (k, l), part in self.terms.items()}
        return TaylorMatrix(terms, self.remainder)

    def __matmul__(self, other: TaylorMatrix) -> TaylorMatrix:
        degree, tails = min(self.degree, other.degree), other._tails
        remainder = self.remainder * other.range
        remainder += self._polynomial * other.remainder
        terms: dict[Powers, arb_mat] = {}
        for (k, l), x in self.terms.items():
            for (i, j), y in other.terms.items():
                if k + l + i + j < degree:
                    place, part = (k + i, l + j), x * y
                    terms[place] = terms[place] + part if place in terms else part
            # What is left out: uᵏ vˡ times the other's terms of some degree or more.
            least = degree - k - l
            if least <= 0:
                remainder += x * other._polynomial * UNIT
            elif least <= len(tails):
                remainder += x * tails[least - 1]
        return TaylorMatrix(terms, remainder)

    def inverse(self) -> TaylorMatrix:
        """The inverse at every u and v; ZeroDivisionError where none is found."""
        first, degree = self.constant.inv(), self.degree
        others = [(powers, part) for powers, part in self.terms.items() if powers != CONSTANT]
        both = degree == TERMS[1]
        terms = {CONSTANT: first}
        for total in range(1, degree):
            for l in range(total + 1) if both else [0]:
                k = total - l
                found = [part * terms[k - i, l - j] for (i, j), part in others if (k - i, l - j) in terms]
                if found:
                    terms[k, l] = -first * sum(found[1:], found[0])
        near = TaylorMatrix(terms)
        unit = TaylorMatrix.of(np.eye(first.nrows()).tolist())
        left = (unit - self @ near).range
        error = frobenius(left.entries())
        if not error < 1:
            raise ZeroDivisionError("an inverse that may not exist")
        # A⁻¹ = X (1 + E + E² (1 − E)⁻¹) with E = 1 − A X. Of E entries are kept, of what follows a norm.
        more = _filled(first, arb(0, (error**2 / (1 - error)).abs_upper()))
        return TaylorMatrix(terms, near.range * (left + more))

    def exponential(self) -> TaylorMatrix:
        """exp of a square matrix, by its power series and squares; rows and columns are scaled by powers of two."""
        middle = np.array([[float(e.mid()) for e in row] for row in self.constant.tolist()])
        if not np.abs(middle).max() < LARGEST:
            raise ZeroDivisionError("a matrix whose exponential has no use")
        scale = _balanced(middle)
        own = self._scaled(scale)
        size = frobenius(own.range.entries())
        squares = max(0, int(np.ceil(np.log2(max(1.0, float(size.abs_upper()))))))
        power = own.times(arb(1) / 2**squares)
        norm = size / 2**squares
        count, remainder = 1, norm * norm.exp()
        while count < POWERS and not remainder < arb(2) ** -ctx.prec:
            count += 1
            remainder = remainder * norm / count
        unit = TaylorMatrix.of(np.eye(len(middle)).tolist())
        values = unit
        for k in range(count - 1, 0, -1):
            values = unit + (power @ values).times(arb(1) / k)
        values = TaylorMatrix(
            values.terms, values.remainder + _filled(values.remainder, arb(0, remainder.abs_upper()))
        )
        for _ in range(squares):
            values = values @ values
        return values._scaled(1.0 / scale)

    def _scaled(self, scale: np.ndarray) -> TaylorMatrix:
        """Column j times scale_j, row i divided by scale_i; powers of two."""
        left = arb_mat(np.diag(1.0 / scale).tolist())
        right = arb_mat(np.diag(scale).tolist())
        return self.each(lambda part: left * part * right)


UNIT = arb(0, 1)


def taylor_row(
    function: Callable[[arb_series], Sequence[arb_series]], centre: arb, half: arb
) -> TaylorMatrix:
    """A row of analytic functions of centre + half·u: coefficients at the centre, and the next one on the interval."""
    cap, terms = ctx.cap, TERMS[0]
    try:
        ctx.cap = terms
        inside = [value + arb_series([0]) for value in function(arb_series([centre, half]))]
        ctx.cap = terms + 1
        around = [value + arb_series([0]) for value in function(arb_series([centre + half * UNIT, half]))]
    finally:
        ctx.cap = cap
    return TaylorMatrix(
        {(k, 0): arb_mat([[value[k] for value in inside]]) for k in range(terms)},
        arb_mat([[value[terms] * UNIT for value in around]]),
    )


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


def _balanced(matrix: np.ndarray) -> np.ndarray:
    """Powers of two that make a matrix small by `TaylorMatrix._scaled`: rows as large as columns, and what no other
    coordinate drives, or what drives none, as small as is of use, since balance leaves these as they are."""
    _, (scale, _) = matrix_balance(matrix, permute=False, separate=True)
    for alone, sign in ((0, -1.0), (1, 1.0)):
        sizes = np.abs(matrix) * scale / scale[:, None]
        np.fill_diagonal(sizes, 0.0)
        largest = np.sqrt((sizes**2).sum(axis=alone))
        free = (sizes.sum(axis=1 - alone) == 0.0) & (largest > SLIGHT)
        scale[free] *= 2.0 ** (sign * np.ceil(np.log2(largest[free] / SLIGHT)))
    return scale


def _filled(like: arb_mat, entry: arb) -> arb_mat:
    return arb_mat([[entry] * like.ncols() for _ in range(like.nrows())])
