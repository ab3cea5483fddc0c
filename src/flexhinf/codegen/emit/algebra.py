"""Dense linear algebra in loops: sums of outer products, and Cholesky factors.

In a kernel for a single run neighbouring columns travel in the lanes of one vector; in a kernel of several lanes
an element is one number of every lane. Every number is computed by the same operations in either case.

Polynomials in nested form: every coefficient is read once, one after the other, and no monomial is ever formed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from flexhinf.codegen.emit.function import load
from flexhinf.codegen.emit.opcodes import Lanes, Writer
from flexhinf.polynomial import basis

TILE, WIDE = 4, 8
"""Rows and columns of a sum that share what is loaded: 16 sums and what they are made of fill 24 of 32 registers in
lanes; in a kernel for a single run eight rows of eight columns in a vector each."""

TOGETHER = 8
"""Polynomials that are summed in one pass: in registers in lanes, in one vector in a kernel for a single run."""

PIVOT_TOLERANCE = 1e-14  # as flexhinf.scalars.symbol, which says what it means


@dataclass(frozen=True)
class Operand:
    """Address of an array, and whether one number serves all lanes."""

    pointer: str
    shared: bool = False


@dataclass(frozen=True)
class Tile:
    """Neighbouring elements of a matrix, from row i and column j on; the matrix has rows of `pitch` numbers."""

    i: str
    height: int
    j: str
    width: int
    pitch: int


@dataclass(frozen=True)
class Algebra:
    """Emits the loops.

    `loop`: (first, end, body): a loop over first ≤ k < end. `fused`: The target has a fused multiply-add.
    """

    writer: Writer
    loop: Callable[[str, str, Callable[[str], None]], None]
    fused: bool

    @property
    def single(self) -> bool:
        """Whether the kernel is for a single run."""
        return self.writer.lanes.width == 1

    # Σ_k w_k l_kᵀ r_k + plus -------------------------------------------------------------------------
    def outer_sum(
        self,
        operands: tuple[Operand, Operand, Operand | None, Operand | None],
        count: int,
        shape: tuple[int, int],
        target: str,
        symmetric: bool,
    ) -> None:
        """See `flexhinf.codegen.program.OuterSum`: tiles, whose sums stay in registers while k runs.

        `operands`: Left, right, weights and plus.
        """
        (left, right, weights, plus), (rows, columns) = operands, shape

        def weighted(weights: Operand, i: str, height: int) -> Operand:
            """w_k l_ki of some rows from i on, (N, height): computed once, for all columns."""
            memory = self.writer.allocate(f"[{count * height} x {self.writer.lanes.element}]")

            def term(k: str) -> None:
                weight = self.load(weights, k, 1)
                for first, together in self._vectors(height):
                    factor = self.load(left, self.at(k, rows, self.ahead(i, first)), together)
                    product = self.writer_of(together).real("fmul", factor, self.spread(weight, together))
                    self.store(memory, self.at(k, height, first), product, together)

            self.loop("0", str(count), term)
            return Operand(memory)

        def factors_of(i: str, height: int) -> Callable[[str], list[str]]:
            """Term k's factors of some rows from i on."""
            source, pitch, start = left, rows, i
            if weights is not None:
                source, pitch, start = weighted(weights, i, height), height, "0"

            def factors(k: str) -> list[str]:
                first = self.at(k, pitch, start)
                return [self.load(source, self.ahead(first, a), 1) for a in range(height)]

            return factors

        def some_rows(i: str, height: int, number: str) -> None:
            factors = factors_of(i, height)

            def tile(j: str, width: int) -> None:
                place = Tile(i, height, j, width, columns)
                for cell, together, total in self._tile(place, right, str(count), factors):
                    if plus is not None:
                        added = self.load(plus, cell, together)
                        total = self.writer_of(together).real("fadd", total, added)
                    self.store(target, cell, total, together)

            if symmetric:  # left of the diagonal, and across it
                self.loop("0", number, lambda turn: tile(self._times(turn, self.side), self.side))
                tile(i, height)
            else:
                wide = self.side * max(1, self.side // height)
                self._blocks(columns, wide, lambda j, width, _: tile(j, width))

        def mirrored(i: str) -> None:
            def element(j: str) -> None:
                value = self.at(j, rows, i)
                self.store(target, value, self.load(Operand(target), self.at(i, rows, j), 1), 1)

            self.loop("0", i, element)

        self._blocks(rows, self.side, some_rows)
        if symmetric:
            self.loop("0", str(rows), mirrored)

    def _tile(
        self,
        tile: Tile,
        right: Operand,
        count: str,
        factors: Callable[[str], list[str]],
        begun: str = "",
    ) -> list[tuple[str, int, str]]:
        """Σ_k<count factors(k)ᵀ r_k, beginning with zeros or with what is in a matrix.

        Returns for each vector the place of its first element in the tile's matrix, its length, and its sums.
        """
        vectors = [(self.ahead(tile.j, first), n) for first, n in self._vectors(tile.width)]
        cells = []
        for a in range(tile.height):
            row = self.ahead(tile.i, a)
            for b, (column, together) in enumerate(vectors):
                cell = self.at(row, tile.pitch, column)
                zero = self.writer_of(together).lanes.constant(0.0)
                start = self.load(Operand(begun), cell, together) if begun else zero
                cells.append((a, b, cell, together, self.place(start, together)))

        def term(k: str) -> None:
            rows = factors(k)
            values = [self.load(right, self.at(k, tile.pitch, column), n) for column, n in vectors]
            for a, b, _, together, place in cells:
                factor = self.spread(rows[a], together)
                total = self.multiply_add(
                    self.writer_of(together), factor, values[b], self.loaded(place, together)
                )
                self.keep(place, total, together)

        self.loop("0", count, term)
        return [(cell, together, self.loaded(place, together)) for *_, cell, together, place in cells]

    @property
    def side(self) -> int:
        """Rows of a tile, and columns of a symmetric one."""
        return WIDE if self.single else TILE

    def _blocks(self, size: int, block: int, body: Callable[[str, int, str], None]) -> None:
        """``body(first, length, number)`` of all blocks, of which the last may be shorter."""
        if size >= block:
            self.loop("0", str(size // block), lambda turn: body(self._times(turn, block), block, turn))
        if size % block:
            body(str(size - size % block), size % block, str(size // block))

    def _vectors(self, size: int) -> list[tuple[int, int]]:
        """First number and length of the vectors that hold so many neighbours; in lanes each goes alone."""
        vectors, first = [], 0
        while first < size:
            together = 1
            while self.single and together < WIDE and first + 2 * together <= size:
                together *= 2
            vectors.append((first, together))
            first += together
        return vectors

    # Lᵀ of A = L Lᵀ ----------------------------------------------------------------------------------
    def cholesky(self, source: Operand, target: str, n: int) -> None:
        """See `flexhinf.codegen.program.Cholesky`: some rows of Lᵀ after the other, less the terms of those above."""
        writer, together = self.writer, WIDE if self.single else 1
        pitch = -(-n // together) * together
        work = target if pitch == n else writer.allocate(f"[{n * pitch} x {writer.lanes.element}]")
        moved = writer.allocate(f"[{pitch} x {writer.lanes.element}]")
        zero = writer.lanes.constant(0.0)

        def fill(i: str) -> None:
            diagonal = self.load(source, self.at(i, n, i), 1)
            self.store(moved, i, writer.intrinsic("fabs", diagonal), 1)
            self.loop("0", str(n), lambda j: copied(source, self.at(i, n, j), work, self.at(i, pitch, j)))
            self.loop(str(n), str(pitch), lambda j: self.store(work, self.at(i, pitch, j), zero, 1))

        def finish(i: str) -> None:  # what is left of the diagonal was computed in vain
            self.loop("0", i, lambda j: self.store(target, self.at(i, n, j), zero, 1))
            if work != target:
                element = Operand(work)
                self.loop(
                    i, str(n), lambda j: copied(element, self.at(i, pitch, j), target, self.at(i, n, j))
                )

        def copied(source: Operand, here: str, other: str, there: str) -> None:
            self.store(other, there, self.load(source, here, 1), 1)

        def some_rows(first: str, height: int, number: str) -> None:
            def factors(k: str) -> list[str]:
                start = self.at(k, pitch, first)
                rows = [self.load(Operand(work), self.ahead(start, a), 1) for a in range(height)]
                return [writer.real("fneg", row) for row in rows]

            def tile(j: str, width: int) -> None:
                place = Tile(first, height, j, width, pitch)
                for cell, size, total in self._tile(place, Operand(work), first, factors, work):
                    self.store(work, cell, total, size)

            self.loop(
                number, str(pitch // self.side), lambda turn: tile(self._times(turn, self.side), self.side)
            )
            if pitch % self.side:
                tile(str(pitch - pitch % self.side), pitch % self.side)
            end = writer.let(f"add nsw i64 {first}, {height}")
            self.loop(
                first, end, lambda j: self._eliminate(source, work, moved, (n, pitch, together), j, end)
            )

        self.loop("0", str(n), fill)
        self.loop(str(n), str(pitch), lambda j: self.store(moved, j, zero, 1))
        self._blocks(n, self.side, some_rows)
        self.loop("0", str(n), finish)

    def _eliminate(
        self, source: Operand, work: str, moved: str, sizes: tuple[int, int, int], j: str, end: str
    ) -> None:
        """Divide row j by its pivot's root, subtract its terms from rows j + 1 … end − 1, and add up the rounding."""
        (n, pitch, together), writer = sizes, self.writer
        wide = self.writer_of(together)
        pivot, diagonal = (
            self.load(Operand(work), self.at(j, pitch, j), 1),
            self.load(source, self.at(j, n, j), 1),
        )
        tolerance = writer.lanes.constant(PIVOT_TOLERANCE * n)
        tiny = writer.real("fmul", writer.intrinsic("fabs", diagonal), tolerance)
        small = writer.compare("ole", pivot, tiny)
        rounding = self.load(Operand(moved), j, 1)
        low = writer.real("fneg", writer.real("fmul", rounding, tolerance))
        singular = writer.let(f"and {writer.lanes.boolean} {small}, {writer.compare('oge', pivot, low)}")
        inverse = writer.real("fdiv", writer.lanes.constant(1.0), writer.intrinsic("sqrt", pivot))
        inverse = self.spread(writer.select(singular, writer.lanes.constant(0.0), inverse), together)
        rounding = self.spread(rounding, together)

        def scale(q: str) -> None:  # left of the diagonal in vain
            column = self._times(q, together)
            place = self.at(j, pitch, column)
            value = wide.real("fmul", self.load(Operand(work), place, together), inverse)
            self.store(work, place, value, together)
            ratio = wide.real("fmul", value, inverse)
            grown = self.multiply_add(
                wide, wide.real("fmul", ratio, ratio), rounding, self.load(Operand(moved), column, together)
            )
            self.store(moved, column, grown, together)

        def take(k: str) -> None:
            factor = self.load(Operand(work), self.at(j, pitch, k), 1)
            spread = self.spread(writer.real("fneg", factor), together)

            def some(q: str) -> None:
                column = self._times(q, together)
                value = self.load(Operand(work), self.at(j, pitch, column), together)
                place = self.at(k, pitch, column)
                old = self.load(Operand(work), place, together)
                self.store(work, place, self.multiply_add(wide, spread, value, old), together)

            self.loop(writer.let(f"udiv i64 {k}, {together}"), str(pitch // together), some)

        self.loop(writer.let(f"udiv i64 {j}, {together}"), str(pitch // together), scale)
        self.loop(writer.let(f"add nsw i64 {j}, 1"), end, take)

    def polynomial(
        self,
        point: Operand,
        table: Operand,
        sizes: tuple[int, int, int],
        degrees: tuple[int, ...],
        target: str,
    ) -> None:
        """See `flexhinf.codegen.program.Polynomial`: loops, one inside the other for every degree.

        Each degree's rows are read in their order, whatever the loops: measured, several innermost sums side by side
        wait less for each other, and longer for what they read from many places. `sizes`: Variables, polynomials, and
        numbers of a row of the table, which is padded so that a vector takes it in a kernel for a single run.
        """
        writer, (n, values, columns) = self.writer, sizes
        width = min(TOGETHER, columns) if self.single else 1

        def some(first: int, count: int) -> None:
            before, rows = 0, {}
            for degree in degrees:
                rows[degree] = writer.allocate("i64")
                writer.do(f"store i64 {before}, ptr {rows[degree]}, align 8")
                before += basis.count(n, degree)

            def next_row(degree: int) -> list[str]:
                vectors = 1 if self.single else count
                if degree not in rows:
                    return [self.writer_of(width).lanes.constant(0.0)] * vectors
                row = writer.let(f"load i64, ptr {rows[degree]}, align 8")
                writer.do(f"store i64 {self.ahead(row, 1)}, ptr {rows[degree]}, align 8")
                starts = [self.at(row, columns, first + k) for k in range(vectors)]
                return [self.load(table, start, width) for start in starts]

            def total(chosen: int, begin: str) -> list[str]:
                """c + Σ_i≥begin x_i (…) after so many variables were chosen; a row's coefficient after the last."""
                start = next_row(chosen)
                if chosen == degrees[-1]:
                    return start
                places = [self.place(value, width) for value in start]

                def grow(i: str) -> None:
                    x = self.spread(self.load(point, i, 1), width)
                    for place, factor in zip(places, total(chosen + 1, i), strict=True):
                        so_far, wide = self.loaded(place, width), self.writer_of(width)
                        self.keep(place, self.multiply_add(wide, x, factor, so_far), width)

                self.loop(begin, str(n), grow)
                return [self.loaded(place, width) for place in places]

            numbers = total(0, "0")
            if width > 1:
                vector = f"extractelement {Lanes(width).real} {numbers[0]}, i64"
                numbers = [writer.let(f"{vector} {k}") for k in range(count)]
            for k, number in enumerate(numbers):
                self.store(target, str(first + k), number, 1)

        for first in range(0, values, TOGETHER):
            some(first, min(TOGETHER, values - first))

    # Elements ------------------------------------------------------------------------------------------
    def writer_of(self, together: int) -> Writer:
        """A writer for as many columns at once into the same text."""
        return self.writer if not self.single else self.writer.alike(Lanes(together))

    def at(self, row: str, width: int, column: int | str) -> str:
        """Place of an element of a matrix of rows of `width` numbers."""
        start = self.writer.let(f"mul nsw i64 {row}, {width}")
        return self.writer.let(f"add nsw i64 {start}, {column}")

    def ahead(self, index: str, k: int) -> str:
        """index + k."""
        return self.writer.let(f"add nsw i64 {index}, {k}") if k else index

    def _times(self, turn: str, block: int) -> str:
        return self.writer.let(f"mul nsw i64 {turn}, {block}")

    def place(self, start: str, together: int) -> str:
        """Memory for a sum with this start value, until LLVM promotes it to a register."""
        kind = self.writer_of(together).lanes.real
        place = self.writer.allocate(kind)
        self.keep(place, start, together)
        return place

    def keep(self, place: str, total: str, together: int) -> None:
        """Store the total of such a sum."""
        self.writer.do(f"store {self.writer_of(together).lanes.real} {total}, ptr {place}, align 8")

    def loaded(self, place: str, together: int) -> str:
        """Load the total of such a sum."""
        return self.writer.let(f"load {self.writer_of(together).lanes.real}, ptr {place}, align 8")

    def load(self, operand: Operand, place: str, together: int) -> str:
        """Load so many neighbours from a place on; in lanes one element."""
        if not self.single:
            return load(self.writer, operand.pointer, place, operand.shared)
        pointer = self.writer.let(f"getelementptr double, ptr {operand.pointer}, i64 {place}")
        return self.writer.let(f"load {Lanes(together).real}, ptr {pointer}, align 8")

    def store(self, target: str, place: str, value: str, together: int) -> None:
        """Store so many neighbours from a place on; in lanes one element."""
        lanes = Lanes(together) if self.single else self.writer.lanes
        pointer = self.writer.let(f"getelementptr {self.writer.lanes.element}, ptr {target}, i64 {place}")
        self.writer.do(f"store {lanes.real} {value}, ptr {pointer}, align 8")

    def spread(self, value: str, together: int) -> str:
        """Copy a number to so many neighbours; in lanes it stays as it is."""
        return self.writer_of(together).splat(value) if self.single else value

    def multiply_add(self, writer: Writer, a: str, b: str, c: str) -> str:
        """a·b + c, rounded once where the target can."""
        if self.fused:
            return writer.intrinsic("fma", a, b, c)
        return writer.real("fadd", writer.real("fmul", a, b), c)
