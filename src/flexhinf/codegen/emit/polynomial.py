"""Polynomials in nested form: every coefficient is read once, one after the other, and no monomial is ever formed."""

from __future__ import annotations

from dataclasses import dataclass

from flexhinf.codegen.emit.algebra import Algebra, Operand
from flexhinf.codegen.emit.text import Lanes
from flexhinf.polynomial import basis

TOGETHER = 8
"""Values that are summed in one pass: in registers in lanes, in one vector in a kernel for a single run."""


@dataclass(frozen=True)
class Nested:
    """Emits the loops of a `flexhinf.codegen.steps.Polynomial`, one inside the other for every degree.

    Each degree's rows are read in their order, whatever the loops: measured, several innermost sums side by side wait
    less for each other, and longer for what they read from many places.

    Parameters
    ----------
    n, values, columns : int
        Variables, polynomials, and numbers of a row of the table.
    """

    algebra: Algebra
    point: Operand
    table: Operand
    n: int
    values: int
    columns: int
    degrees: tuple[int, ...]

    def emit(self, target: str) -> None:
        """All values, some at a time."""
        for first in range(0, self.values, TOGETHER):
            self._some(first, min(TOGETHER, self.values - first), target)

    def _some(self, first: int, count: int, target: str) -> None:
        """The values of some columns."""
        writer, before, rows = self.algebra.writer, 0, {}
        for degree in self.degrees:
            rows[degree] = writer.allocate("i64")
            writer.do(f"store i64 {before}, ptr {rows[degree]}, align 8")
            before += basis.count(self.n, degree)
        numbers = self._sum(0, "0", rows, first, count)
        if self.width > 1:
            vector = f"extractelement {Lanes(self.width).real} {numbers[0]}, i64"
            numbers = [writer.let(f"{vector} {k}") for k in range(count)]
        for k, number in enumerate(numbers):
            self.algebra.store(target, str(first + k), number, 1)

    def _sum(self, chosen: int, begin: str, rows: dict[int, str], first: int, count: int) -> list[str]:
        """c + Σ_i≥begin x_i (…) after so many variables were chosen; a row's coefficient after the last."""
        start = self._next_row(rows.get(chosen), first, count)
        if chosen == self.degrees[-1]:
            return start
        algebra = self.algebra
        places = [algebra.place(value, self.width) for value in start]

        def grow(i: str) -> None:
            x = algebra.spread(algebra.load(self.point, i, 1), self.width)
            inner = self._sum(chosen + 1, i, rows, first, count)
            for place, factor in zip(places, inner, strict=True):
                so_far, wide = algebra.loaded(place, self.width), algebra.writer_of(self.width)
                algebra.keep(place, algebra.multiply_add(wide, x, factor, so_far), self.width)

        algebra.loop(begin, str(self.n), grow)
        return [algebra.loaded(place, self.width) for place in places]

    def _next_row(self, place: str | None, first: int, count: int) -> list[str]:
        """The next row of a degree; zeros where the polynomials have none of it."""
        algebra, vectors = self.algebra, 1 if self.algebra.single else count
        if place is None:
            return [algebra.writer_of(self.width).lanes.constant(0.0)] * vectors
        row = algebra.writer.let(f"load i64, ptr {place}, align 8")
        algebra.writer.do(f"store i64 {algebra.ahead(row, 1)}, ptr {place}, align 8")
        starts = [algebra.at(row, self.columns, first + k) for k in range(vectors)]
        return [algebra.load(self.table, start, self.width) for start in starts]

    @property
    def width(self) -> int:
        """Columns in one vector: in a kernel for a single run those of a row, which is padded for that."""
        return min(TOGETHER, self.columns) if self.algebra.single else 1
