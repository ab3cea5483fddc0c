"""Linear algebra by threads of a GPU that make one run together: a column of a matrix, or a part of a sum, for each.

Each number is computed by the operations of `flexhinf.codegen.emit.algebra`, in their order.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import factorial

from flexhinf.codegen.emit.algebra import TOGETHER, Algebra, Operand
from flexhinf.polynomial import basis

#: Terms of the innermost sum of a polynomial that are written one after the other.
UNROLLED = 4


@dataclass(frozen=True)
class GroupAlgebra(Algebra):
    """Emits the loops; sums of outer products share those of one thread.

    `workspace`: Address of memory in which the threads pass numbers to each other.
    """

    workspace: str

    def cholesky(self, source: Operand, target: str, n: int) -> None:
        """See `flexhinf.codegen.program.Cholesky`: row after row is subtracted from those below, by columns."""
        writer, moved, rows = self.writer, self.workspace, Operand(target)
        with writer.part(n * n) as k:
            self._store(target, k, self._load(source, k, 1), 1)
        with writer.part(n) as i:
            self._store(moved, i, writer.intrinsic("fabs", self._load(source, self._at(i, n, i), 1)), 1)
        writer.wait()
        with writer.loop(str(n)) as j:
            here = self._at(j, n, j)
            pivot, diagonal = self._load(rows, here, 1), self._load(source, here, 1)
            rounding = self._load(Operand(moved), j, 1)
            inverse = self._inverse(pivot, diagonal, rounding, n)
            writer.wait()
            with writer.part(n) as i:  # left of the diagonal in vain
                place = self._at(j, n, i)
                value = writer.real("fmul", self._load(rows, place, 1), inverse)
                self._store(target, place, value, 1)
                ratio = writer.real("fmul", value, inverse)
                square, before = writer.real("fmul", ratio, ratio), self._load(Operand(moved), i, 1)
                self._store(moved, i, writer.multiply_add(square, rounding, before), 1)
            writer.wait()
            with writer.part(n) as i:
                value = self._load(rows, self._at(j, n, i), 1)
                with writer.loop(self._ahead(i, 1), self._ahead(j, 1)) as k:
                    factor = writer.real("fneg", self._load(rows, self._at(j, n, k), 1))
                    place = self._at(k, n, i)
                    total = writer.multiply_add(factor, value, self._load(rows, place, 1))
                    self._store(target, place, total, 1)
            writer.wait()
        with writer.part(n) as i, writer.loop(i) as j:
            self._store(target, self._at(i, n, j), writer.lanes.constant(0.0), 1)

    def polynomial(
        self,
        point: Operand,
        table: Operand,
        sizes: tuple[int, int, int],
        degrees: tuple[int, ...],
        target: str,
    ) -> None:
        """See `flexhinf.codegen.program.Polynomial`: threads take values, and every so manyth of the outermost terms.

        What a term is multiplied by is a sum of its own, from the rows on that belong to it.
        """
        writer, (n, values, columns) = self.writer, sizes
        if degrees[-1] == 0:
            with writer.part(values) as k:
                self._store(target, k, self._load(table, k, 1), 1)
            return
        own, group = (
            writer.whole("urem", writer.thread, TOGETHER),
            writer.whole("udiv", writer.thread, TOGETHER),
        )
        for first in range(0, values, TOGETHER):
            count = min(TOGETHER, values - first)
            value = writer.whole("add", own, first)
            there, turns = writer.compare_whole("slt", own, str(count)), writer.module.group // TOGETHER
            with writer.when(there), writer.loop(str(n), group, turns) as i:
                rows = self._rows(i, n, degrees)
                total = self._term(point, table, (n, columns), degrees, rows, value, 1, i)
                self._store(self.workspace, self._at(i, TOGETHER, own), total, 1)
            writer.wait()
            with writer.part(count) as k:
                start = (
                    self._load(table, self._ahead(k, first), 1)
                    if 0 in degrees
                    else writer.lanes.constant(0.0)
                )
                place = self._place(start, 1)
                with writer.loop(str(n)) as i:
                    factor = self._load(Operand(self.workspace), self._at(i, TOGETHER, k), 1)
                    self._add_to(place, self._load(point, i, 1), factor, 1)
                self._store(target, self._ahead(k, first), self._loaded(place, 1), 1)
            writer.wait()

    def _rows(self, i: str, n: int, degrees: tuple[int, ...]) -> dict[int, str]:
        """For each degree, memory with the first row of which variable i is the first: behind those of all before."""
        writer, before, rows = self.writer, 0, dict[int, str]()
        left = writer.let(f"sub nsw i64 {n}, {i}")
        for degree in degrees:
            behind = left  # rows of this degree of variables i, i + 1, …
            for k in range(1, degree):
                behind = writer.let(f"mul nsw i64 {behind}, {self._ahead(left, k)}")
            behind = writer.let(f"udiv i64 {behind}, {factorial(degree)}")
            end = before + basis.count(n, degree)
            rows[degree] = writer.allocate("i64")
            writer.write("i64", writer.let(f"sub nsw i64 {end}, {behind}"), rows[degree])
            before = end
        return rows

    def _term(
        self,
        point: Operand,
        table: Operand,
        sizes: tuple[int, int],
        degrees: tuple[int, ...],
        rows: dict[int, str],
        value: str,
        chosen: int,
        begin: str,
    ) -> str:
        """c + Σ_i≥begin x_i (…) after so many variables were chosen; a row's coefficient after the last."""
        writer, (n, columns) = self.writer, sizes
        start = writer.lanes.constant(0.0)
        if chosen in rows:
            row = writer.read("i64", rows[chosen])
            writer.write("i64", self._ahead(row, 1), rows[chosen])
            start = self._load(table, self._at(row, columns, value), 1)
        if chosen == degrees[-1]:
            return start
        place = self._place(start, 1)
        if chosen + 1 == degrees[-1]:
            self._last(point, table, (n, columns), rows[chosen + 1], value, begin, place)
            return self._loaded(place, 1)
        with writer.loop(str(n), begin) as i:
            x = self._load(point, i, 1)
            factor = self._term(point, table, sizes, degrees, rows, value, chosen + 1, i)
            self._add_to(place, x, factor, 1)
        return self._loaded(place, 1)

    def _last(
        self,
        point: Operand,
        table: Operand,
        sizes: tuple[int, int],
        rows: str,
        value: str,
        begin: str,
        place: str,
    ) -> None:
        """Add the products of the variables from one on with neighbouring rows, some of them without a loop."""
        writer, (n, columns) = self.writer, sizes
        row = writer.read("i64", rows)
        before = writer.let(f"sub nsw i64 {row}, {begin}")  # row of variable 0, had it one
        writer.write("i64", self._ahead(before, n), rows)
        full = writer.whole("and", writer.let(f"sub nsw i64 {n}, {begin}"), -UNROLLED)
        end = writer.let(f"add nsw i64 {begin}, {full}")
        for first, last, step in ((begin, end, UNROLLED), (end, str(n), 1)):
            with writer.loop(last, first, step) as i:
                x = writer.at("double", point.pointer, i)
                first_row = writer.let(f"add nsw i64 {before}, {i}")
                coefficient = writer.at("double", table.pointer, self._at(first_row, columns, value))
                for k in range(step):
                    factor = self._load(Operand(coefficient), str(k * columns), 1)
                    self._add_to(place, self._load(Operand(x), str(k), 1), factor, 1)
