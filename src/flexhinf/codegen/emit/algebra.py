"""Dense linear algebra in loops: sums of outer products, and Cholesky factors.

In a kernel for a single run neighbouring columns travel in the lanes of one vector; in a kernel of several lanes
an element is one number of every lane. Every number is computed by the same operations in either case.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from flexhinf.codegen.emit.function import load
from flexhinf.codegen.emit.text import Lanes, Writer

__all__ = ["PARTS", "Algebra", "Operand"]

PARTS = 8
"""Parts of a sum: as many sums as the latency of an addition asks for."""

GROUP = 3
"""Columns of a sum that share what is loaded, in lanes: three times eight parts leave a few of 32 registers."""

STRETCH = 24
"""Blocks of terms that are summed for all elements before the next: 192 numbers in lanes are 12 kB, a quarter of the
first cache."""

PIVOT_TOLERANCE = 1e-14  # as flexhinf.scalars.linear_algebra, which says what it means


@dataclass(frozen=True)
class Operand:
    """Address of an array, and whether one number serves all lanes."""

    pointer: str
    shared: bool = False


@dataclass(frozen=True)
class Terms:
    """What is summed: N rows of r and of c numbers, and weights."""

    left: Operand
    right: Operand
    weights: Operand | None
    count: int
    rows: int
    columns: int


@dataclass(frozen=True)
class Algebra:
    """Emits the loops.

    Parameters
    ----------
    writer : Writer
    loop : callable
        (first, end, body): a loop over first ≤ k < end.
    fused : bool
        The target has a fused multiply-add.
    """

    writer: Writer
    loop: Callable[[str, str, Callable[[str], None]], None]
    fused: bool

    @property
    def single(self) -> bool:
        """A kernel for a single run."""
        return self.writer.lanes.width == 1

    # Σ_k w_k l_kᵀ r_k + plus -------------------------------------------------------------------------
    def outer_sum(
        self,
        left: Operand,
        right: Operand,
        weights: Operand | None,
        plus: Operand | None,
        target: str,
        sizes: tuple[int, int, int],
        symmetric: bool,
    ) -> None:
        """See `flexhinf.codegen.steps.OuterSum`; sizes are (N, r, c)."""
        if not self.single:
            self._outer_sum_in_lanes(Terms(left, right, weights, *sizes), plus, target, symmetric)
            return
        _, rows, columns = sizes
        column = 0
        while column < columns:
            together = 1
            while together < 8 and column + 2 * together <= columns:
                together *= 2

            def row(i: str, column: int = column, together: int = together) -> None:
                total = self._sum(left, right, weights, sizes, i, column, together)
                place = self._at(i, columns, column)
                if plus is not None:
                    total = self.writer_of(together).real("fadd", total, self._load(plus, place, together))
                self._store(target, place, total, together)

            self.loop(str(column if symmetric else 0), str(rows), row)
            column += together
        if symmetric:
            self._mirror(target, rows)

    def _sum(
        self,
        left: Operand,
        right: Operand,
        weights: Operand | None,
        sizes: tuple[int, int, int],
        i: str,
        column: int,
        together: int,
    ) -> str:
        """Elements (i, column …) of the sum."""
        count, rows, columns = sizes
        writer, wide = self.writer, self.writer_of(together)
        parts = [writer.allocate(wide.lanes.real) for _ in range(PARTS)]
        for part in parts:
            writer.do(f"store {wide.lanes.real} {wide.lanes.constant(0.0)}, ptr {part}, align 8")

        def term(k: str, part: str) -> None:
            place = writer.let(f"add nsw i64 {writer.let(f'mul nsw i64 {k}, {rows}')}, {i}")
            factor = self._load(left, place, 1)
            if weights is not None:
                factor = writer.real("fmul", factor, self._load(weights, k, 1))
            value = self._load(right, self._at(k, columns, column), together)
            so_far = writer.let(f"load {wide.lanes.real}, ptr {part}, align 8")
            total = self.multiply_add(wide, self._spread(factor, together), value, so_far)
            writer.do(f"store {wide.lanes.real} {total}, ptr {part}, align 8")

        def block(turn: str) -> None:
            first = writer.let(f"mul nsw i64 {turn}, {PARTS}")
            for k, part in enumerate(parts):
                term(writer.let(f"add nsw i64 {first}, {k}"), part)

        if count >= PARTS:
            self.loop("0", str(count // PARTS), block)
        for k in range(count - count % PARTS, count):
            term(str(k), parts[k % PARTS])
        sums = [writer.let(f"load {wide.lanes.real}, ptr {part}, align 8") for part in parts]
        while len(sums) > 1:
            sums = [wide.real("fadd", a, b) for a, b in zip(sums[::2], sums[1::2], strict=True)]
        return sums[0]

    def _outer_sum_in_lanes(self, terms: Terms, plus: Operand | None, target: str, symmetric: bool) -> None:
        """Three columns at a time, whose sums stay in registers; long sums in stretches that stay in a cache."""
        rows, columns, writer = terms.rows, terms.columns, self.writer
        groups = [range(first, min(first + GROUP, columns)) for first in range(0, columns, GROUP)]
        blocks = terms.count // PARTS

        def finished(i: str, group: range, sums: list[list[str]]) -> None:
            for j, parts in zip(group, sums, strict=True):
                for k in range(blocks * PARTS, terms.count):
                    self._add_terms(terms, str(k), i, range(j, j + 1), [parts[k % PARTS]])
                values = [self._loaded(part) for part in parts]
                while len(values) > 1:
                    values = [
                        writer.real("fadd", a, b) for a, b in zip(values[::2], values[1::2], strict=True)
                    ]
                place = self._at(i, columns, j)
                added = (
                    values[0] if plus is None else writer.real("fadd", values[0], self._load(plus, place, 1))
                )
                self._store(target, place, added, 1)

        if blocks <= STRETCH:
            for group in groups:

                def row(i: str, group: range = group) -> None:
                    sums = [self._zeros() for _ in group]
                    self._add_blocks(terms, "0", str(blocks), i, group, sums)
                    finished(i, group, sums)

                self.loop(str(group[0]) if symmetric else "0", str(rows), row)
        else:
            self._stretches(terms, blocks, groups, finished)
        if symmetric:
            self._mirror(target, rows)

    def _stretches(
        self,
        terms: Terms,
        blocks: int,
        groups: list[range],
        finished: Callable[[str, range, list[list[str]]], None],
    ) -> None:
        """All elements of the sum over one stretch after the other; in between their parts are in memory."""
        writer, columns, rows = self.writer, terms.columns, str(terms.rows)
        memory = writer.allocate(f"[{terms.rows * columns * PARTS} x {writer.lanes.element}]")

        def places(i: str, group: range) -> list[list[str]]:
            starts = [writer.let(f"mul nsw i64 {self._at(i, columns, j)}, {PARTS}") for j in group]
            element = writer.lanes.element
            offsets = [[writer.let(f"add nsw i64 {start}, {k}") for k in range(PARTS)] for start in starts]
            return [
                [writer.let(f"getelementptr {element}, ptr {memory}, i64 {at}") for at in several]
                for several in offsets
            ]

        def moved(i: str, group: range, work: Callable[[list[list[str]]], None]) -> None:
            kept, sums = places(i, group), [self._zeros() for _ in group]
            pairs = [pair for several in zip(kept, sums, strict=True) for pair in zip(*several, strict=True)]
            for place, part in pairs:
                writer.do(f"store {writer.lanes.real} {self._loaded(place)}, ptr {part}, align 8")
            work(sums)
            for place, part in pairs:
                writer.do(f"store {writer.lanes.real} {self._loaded(part)}, ptr {place}, align 8")

        def clear(i: str) -> None:
            for group in groups:
                for place in (place for several in places(i, group) for place in several):
                    writer.do(f"store {writer.lanes.real} {writer.lanes.constant(0.0)}, ptr {place}, align 8")

        def stretch(turn: str) -> None:
            first = writer.let(f"mul nsw i64 {turn}, {STRETCH}")
            end = writer.let(f"add nsw i64 {first}, {STRETCH}")
            more = writer.let(f"icmp slt i64 {end}, {blocks}")
            end = writer.let(f"select i1 {more}, i64 {end}, i64 {blocks}")

            def row(i: str) -> None:
                for group in groups:
                    moved(
                        i,
                        group,
                        lambda sums, group=group: self._add_blocks(terms, first, end, i, group, sums),
                    )

            self.loop("0", rows, row)

        def finish(i: str) -> None:
            for group in groups:
                moved(i, group, lambda sums, group=group: finished(i, group, sums))

        self.loop("0", rows, clear)
        self.loop("0", str(-(-blocks // STRETCH)), stretch)
        self.loop("0", rows, finish)

    def _zeros(self) -> list[str]:
        """Places for the parts of a sum, zero."""
        writer = self.writer
        parts = [writer.allocate(writer.lanes.real) for _ in range(PARTS)]
        for part in parts:
            writer.do(f"store {writer.lanes.real} {writer.lanes.constant(0.0)}, ptr {part}, align 8")
        return parts

    def _loaded(self, place: str) -> str:
        return self.writer.let(f"load {self.writer.lanes.real}, ptr {place}, align 8")

    def _add_blocks(
        self, terms: Terms, first: str, end: str, i: str, group: range, sums: list[list[str]]
    ) -> None:
        """Row i of the sums grows by blocks of `PARTS` terms."""

        def block(turn: str) -> None:
            start = self.writer.let(f"mul nsw i64 {turn}, {PARTS}")
            for k in range(PARTS):
                term = self.writer.let(f"add nsw i64 {start}, {k}")
                self._add_terms(terms, term, i, group, [parts[k] for parts in sums])

        self.loop(first, end, block)

    def _add_terms(self, terms: Terms, k: str, i: str, group: range, parts: list[str]) -> None:
        """Term k of row i, for each column of a group, to a part of its sum."""
        writer = self.writer
        factor = self._load(terms.left, self._at(k, terms.rows, i), 1)
        if terms.weights is not None:
            factor = writer.real("fmul", factor, self._load(terms.weights, k, 1))
        for j, part in zip(group, parts, strict=True):
            value = self._load(terms.right, self._at(k, terms.columns, j), 1)
            total = self.multiply_add(writer, factor, value, self._loaded(part))
            writer.do(f"store {writer.lanes.real} {total}, ptr {part}, align 8")

    def _mirror(self, target: str, n: int) -> None:
        def row(i: str) -> None:
            def element(j: str) -> None:
                self._store(target, self._at(j, n, i), self._load(Operand(target), self._at(i, n, j), 1), 1)

            self.loop("0", i, element)

        self.loop("0", str(n), row)

    # Lᵀ of A = L Lᵀ ----------------------------------------------------------------------------------
    def cholesky(self, source: Operand, target: str, n: int) -> None:
        """See `flexhinf.codegen.steps.Cholesky`: row by row of Lᵀ, which is then taken from the rows below."""
        writer = self.writer
        together = 8 if self.single else 1
        pitch = -(-n // together) * together
        work = writer.allocate(f"[{n * pitch} x {writer.lanes.element}]")
        tolerance = writer.lanes.constant(PIVOT_TOLERANCE * n)
        one, zero = writer.lanes.constant(1.0), writer.lanes.constant(0.0)

        def fill(i: str) -> None:
            def element(j: str) -> None:
                self._store(work, self._at(i, pitch, j), self._load(source, self._at(i, n, j), 1), 1)

            self.loop("0", str(n), element)
            self.loop(str(n), str(pitch), lambda j: self._store(work, self._at(i, pitch, j), zero, 1))

        def eliminate(j: str) -> None:
            pivot = self._load(Operand(work), self._at(j, pitch, j), 1)
            diagonal = self._load(source, self._at(j, n, j), 1)
            tiny = writer.real("fmul", writer.intrinsic("fabs", diagonal), tolerance)
            singular = writer.compare("ole", writer.intrinsic("fabs", pivot), tiny)
            inverse = writer.real("fdiv", one, writer.intrinsic("sqrt", pivot))
            inverse = writer.select(singular, zero, inverse)
            chunk = writer.let(f"udiv i64 {j}, {together}")

            def scale(q: str) -> None:
                place = self._at(j, pitch, writer.let(f"mul nsw i64 {q}, {together}"))
                value = self._load(Operand(work), place, together)
                wide = self.writer_of(together)
                self._store(work, place, wide.real("fmul", value, self._spread(inverse, together)), together)

            self.loop(chunk, str(pitch // together), scale)

            def take(k: str) -> None:
                factor = self._load(Operand(work), self._at(j, pitch, k), 1)
                spread = self._spread(writer.real("fneg", factor), together)

                def some(q: str) -> None:
                    column = writer.let(f"mul nsw i64 {q}, {together}")
                    value = self._load(Operand(work), self._at(j, pitch, column), together)
                    place = self._at(k, pitch, column)
                    old = self._load(Operand(work), place, together)
                    new = self.multiply_add(self.writer_of(together), spread, value, old)
                    self._store(work, place, new, together)

                self.loop(writer.let(f"udiv i64 {k}, {together}"), str(pitch // together), some)

            self.loop(writer.let(f"add nsw i64 {j}, 1"), str(n), take)

        def finish(i: str) -> None:
            self.loop("0", i, lambda j: self._store(target, self._at(i, n, j), zero, 1))

            def element(j: str) -> None:
                self._store(target, self._at(i, n, j), self._load(Operand(work), self._at(i, pitch, j), 1), 1)

            self.loop(i, str(n), element)

        for body in (fill, eliminate, finish):
            self.loop("0", str(n), body)

    # Elements ------------------------------------------------------------------------------------------
    def writer_of(self, together: int) -> Writer:
        """A writer for as many columns at once into the same text."""
        return self.writer if not self.single else self.writer.alike(Lanes(together))

    def _at(self, row: str, width: int, column: int | str) -> str:
        start = self.writer.let(f"mul nsw i64 {row}, {width}")
        return self.writer.let(f"add nsw i64 {start}, {column}")

    def _load(self, operand: Operand, place: str, together: int) -> str:
        if not self.single:
            return load(self.writer, operand.pointer, place, operand.shared)
        pointer = self.writer.let(f"getelementptr double, ptr {operand.pointer}, i64 {place}")
        return self.writer.let(f"load {Lanes(together).real}, ptr {pointer}, align 8")

    def _store(self, target: str, place: str, value: str, together: int) -> None:
        lanes = Lanes(together) if self.single else self.writer.lanes
        pointer = self.writer.let(f"getelementptr {self.writer.lanes.element}, ptr {target}, i64 {place}")
        self.writer.do(f"store {lanes.real} {value}, ptr {pointer}, align 8")

    def _spread(self, value: str, together: int) -> str:
        return self.writer_of(together).splat(value) if self.single else value

    def multiply_add(self, writer: Writer, a: str, b: str, c: str) -> str:
        """a·b + c, rounded once where the target can."""
        if self.fused:
            return writer.intrinsic("fma", a, b, c)
        return writer.real("fadd", writer.real("fmul", a, b), c)
