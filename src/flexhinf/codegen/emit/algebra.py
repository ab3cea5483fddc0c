"""Dense linear algebra in loops: sums of outer products, Cholesky factors, and polynomials.

In a kernel for a single run neighbouring columns travel in the lanes of one vector; in a kernel of several lanes
an element is one number of every lane. Every number is computed by the same operations in either case.

Polynomials in nested form: every coefficient is read once, one after the other, and no monomial is ever formed.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import chain

from flexhinf.codegen.emit.writer import Lanes, Writer
from flexhinf.polynomial import basis

#: Rows and columns of a sum that share what is loaded: 16 sums and what they are made of fill 24 of 32 registers in
#: lanes; in a kernel for a single run eight rows of eight columns in a vector each.
TILE, WIDE = 4, 8

#: Polynomials that are summed in one pass: in registers in lanes, in one vector in a kernel for a single run.
TOGETHER = 8

PIVOT_TOLERANCE = 1e-14  # as flexhinf.scalars.symbol, which says what it means


@dataclass(frozen=True)
class Operand:
    """Address of an array, and whether one number serves all lanes."""

    pointer: str
    shared: bool = False


@dataclass(frozen=True)
class Algebra:
    """Emits the loops."""

    writer: Writer

    @property
    def _single(self) -> bool:
        return self.writer.packs

    @property
    def _side(self) -> int:  # rows of a tile, and columns of a symmetric one
        return WIDE if self._single or self.writer.module.group > 1 else TILE

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
        (left, right, weights, plus), (rows, columns), writer = operands, shape, self.writer
        for i, height, number in writer.blocks(rows, self._side):
            factors = left, rows, i
            # w_k l_ki of these rows, (N, height): computed once, for all columns
            if weights is not None and writer.module.group == 1:
                memory = writer.allocate(f"[{count * height} x {writer.lanes.element}]")
                factors = Operand(memory), height, "0"
                with writer.loop(str(count)) as k:
                    weight = self._load(weights, k, 1)
                    for first, together in self._vectors(height):
                        product = self._wide(together).real(
                            "fmul",
                            self._load(left, self._at(k, rows, self._ahead(i, first)), together),
                            self._spread(weight, together),
                        )
                        self._store(memory, self._at(k, height, first), product, together)
            if (
                writer.module.group > 1
            ):  # a column for each thread; of a symmetric one, those up to the diagonal
                tiles = writer.singly(self._ahead(i, height) if symmetric else columns)
            elif symmetric:  # left of the diagonal, and across it
                tiles = chain(writer.turns("0", number, self._side), [(i, height, "")])
            else:
                tiles = writer.blocks(columns, self._side * max(1, self._side // height))
            for j, width, _ in tiles:
                place = (i, height), (j, width), columns
                for cell, together, total in self._tile(*place, factors, right, str(count), weights=weights):
                    if plus is not None:
                        total = self._wide(together).real("fadd", total, self._load(plus, cell, together))
                    self._store(target, cell, total, together)
        if symmetric:
            writer.wait()
            with writer.part(rows) as i, writer.loop(i) as j:
                cell = self._at(j, rows, i)
                self._store(target, cell, self._load(Operand(target), self._at(i, rows, j), 1), 1)

    def _tile(
        self,
        rows: tuple[str, int],
        columns: tuple[str, int],
        pitch: int,
        factors: tuple[Operand, int, str],
        right: Operand,
        count: str,
        begun: str = "",
        weights: Operand | None = None,
    ) -> list[tuple[str, int, str]]:
        """Σ_k<count l_kᵀ r_k, or what is in the matrix `begun` less that, of neighbouring rows and columns.

        `rows`, `columns`: The first, and how many. `pitch`: Numbers in a row of the matrix. `factors`: Matrix of l,
        numbers in its rows, and place of the first in a row. `weights`: Of the terms, for threads of a group. Returns
        for each vector the place of its first element in the matrix, its length, and its sums.
        """
        source, length, start = factors
        vectors = [(self._ahead(columns[0], first), n) for first, n in self._vectors(columns[1])]
        cells = list[tuple[int, int, str, int, str]]()
        for a in range(rows[1]):
            row = self._ahead(rows[0], a)
            for b, (column, together) in enumerate(vectors):
                cell = self._at(row, pitch, column)
                zero = self._wide(together).lanes.constant(0.0)
                total = self._load(Operand(begun), cell, together) if begun else zero
                cells.append((a, b, cell, together, self._place(total, together)))
        with self.writer.loop(count) as k:
            first = self._at(k, length, start)
            left = [self._load(source, self._ahead(first, a), 1) for a in range(rows[1])]
            if weights is not None and self.writer.module.group > 1:
                weight = self._load(weights, k, 1)
                left = [self.writer.real("fmul", factor, weight) for factor in left]
            if begun:
                left = [self.writer.real("fneg", factor) for factor in left]
            values = [self._load(right, self._at(k, pitch, column), n) for column, n in vectors]
            for a, b, _, together, place in cells:
                self._add_to(place, self._spread(left[a], together), values[b], together)
        return [(cell, together, self._loaded(place, together)) for *_, cell, together, place in cells]

    def _vectors(self, size: int) -> list[tuple[int, int]]:
        """First number and length of the vectors that hold so many neighbours; in lanes each goes alone."""
        vectors, first = list[tuple[int, int]](), 0
        while first < size:
            together = 1
            while self._single and together < WIDE and first + 2 * together <= size:
                together *= 2
            vectors.append((first, together))
            first += together
        return vectors

    # Lᵀ of A = L Lᵀ ----------------------------------------------------------------------------------
    def cholesky(self, source: Operand, target: str, n: int) -> None:
        """See `flexhinf.codegen.program.Cholesky`: some rows of Lᵀ after the other, less the terms of those above."""
        writer, together = self.writer, WIDE if self._single else 1
        pitch = -(-n // together) * together
        work = target if pitch == n else writer.allocate(f"[{n * pitch} x {writer.lanes.element}]")
        moved = writer.allocate(f"[{pitch} x {writer.lanes.element}]")
        zero = writer.lanes.constant(0.0)

        def copied(source: Operand, here: str, other: str, there: str) -> None:
            self._store(other, there, self._load(source, here, 1), 1)

        with writer.loop(str(n)) as i:
            self._store(moved, i, writer.intrinsic("fabs", self._load(source, self._at(i, n, i), 1)), 1)
            with writer.loop(str(n)) as j:
                copied(source, self._at(i, n, j), work, self._at(i, pitch, j))
            with writer.loop(str(pitch), str(n)) as j:
                self._store(work, self._at(i, pitch, j), zero, 1)
        with writer.loop(str(pitch), str(n)) as j:
            self._store(moved, j, zero, 1)
        for first, height, number in writer.blocks(n, self._side):
            remainder = pitch % self._side
            tiles = writer.turns(number, str(pitch // self._side), self._side)
            for j, width, _ in chain(tiles, [(str(pitch - remainder), remainder, "")] if remainder else []):
                place, factors = ((first, height), (j, width), pitch), (Operand(work), pitch, first)
                for cell, size, total in self._tile(*place, factors, Operand(work), first, work):
                    self._store(work, cell, total, size)
            end = writer.let(f"add nsw i64 {first}, {height}")
            with writer.loop(end, first) as j:
                self._eliminate(source, work, moved, (n, pitch, together), j, end)
        with writer.loop(str(n)) as i:  # what is left of the diagonal was computed in vain
            with writer.loop(i) as j:
                self._store(target, self._at(i, n, j), zero, 1)
            if work != target:
                with writer.loop(str(n), i) as j:
                    copied(Operand(work), self._at(i, pitch, j), target, self._at(i, n, j))

    def _eliminate(
        self, source: Operand, work: str, moved: str, sizes: tuple[int, int, int], j: str, end: str
    ) -> None:
        """Divide row j by its pivot's root, subtract its terms from rows j + 1 … end − 1, and add up the rounding."""
        (n, pitch, together), writer, rows = sizes, self.writer, Operand(work)
        wide = self._wide(together)
        pivot = self._load(rows, self._at(j, pitch, j), 1)
        diagonal = self._load(source, self._at(j, n, j), 1)
        rounding = self._load(Operand(moved), j, 1)
        inverse = self._spread(self._inverse(pivot, diagonal, rounding, n), together)
        rounding = self._spread(rounding, together)
        blocks = str(pitch // together)
        # Blocks left of the diagonal are computed in vain.
        with writer.loop(blocks, writer.let(f"udiv i64 {j}, {together}")) as q:
            column = writer.let(f"mul nsw i64 {q}, {together}")
            place = self._at(j, pitch, column)
            value = wide.real("fmul", self._load(rows, place, together), inverse)
            self._store(work, place, value, together)
            ratio = wide.real("fmul", value, inverse)
            square, before = wide.real("fmul", ratio, ratio), self._load(Operand(moved), column, together)
            self._store(moved, column, wide.multiply_add(square, rounding, before), together)
        with writer.loop(end, writer.let(f"add nsw i64 {j}, 1")) as k:
            spread = self._spread(writer.real("fneg", self._load(rows, self._at(j, pitch, k), 1)), together)
            with writer.loop(blocks, writer.let(f"udiv i64 {k}, {together}")) as q:
                column = writer.let(f"mul nsw i64 {q}, {together}")
                value = self._load(rows, self._at(j, pitch, column), together)
                place = self._at(k, pitch, column)
                total = wide.multiply_add(spread, value, self._load(rows, place, together))
                self._store(work, place, total, together)

    def _inverse(self, pivot: str, diagonal: str, rounding: str, n: int) -> str:
        """The inverse of a pivot's root; zero if the pivot is what rounding has left of the diagonal's element."""
        writer = self.writer
        tolerance = writer.lanes.constant(PIVOT_TOLERANCE * n)
        small = writer.compare(
            "ole", pivot, writer.real("fmul", writer.intrinsic("fabs", diagonal), tolerance)
        )
        low = writer.real("fneg", writer.real("fmul", rounding, tolerance))
        singular = writer.joined("and", small, writer.compare("oge", pivot, low))
        inverse = writer.real("fdiv", writer.lanes.constant(1.0), writer.intrinsic("sqrt", pivot))
        return writer.select(singular, writer.lanes.constant(0.0), inverse)

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
        width = min(TOGETHER, columns) if self._single else 1

        def some(first: int, count: int) -> list[str]:
            before, rows = 0, dict[int, str]()
            for degree in degrees:
                rows[degree] = writer.allocate("i64")
                writer.write("i64", before, rows[degree])
                before += basis.count(n, degree)

            def total(chosen: int, begin: str) -> list[str]:
                """c + Σ_i≥begin x_i (…) after so many variables were chosen; a row's coefficient after the last."""
                vectors = 1 if self._single else count
                start = [self._wide(width).lanes.constant(0.0)] * vectors
                if chosen in rows:
                    row = writer.read("i64", rows[chosen])
                    writer.write("i64", self._ahead(row, 1), rows[chosen])
                    starts = [self._at(row, columns, first + k) for k in range(vectors)]
                    start = [self._load(table, place, width) for place in starts]
                if chosen == degrees[-1]:
                    return start
                places = [self._place(value, width) for value in start]
                with writer.loop(str(n), begin) as i:
                    x = self._spread(self._load(point, i, 1), width)
                    for place, factor in zip(places, total(chosen + 1, i), strict=True):
                        self._add_to(place, x, factor, width)
                return [self._loaded(place, width) for place in places]

            numbers = total(0, "0")
            vector = f"extractelement {Lanes(width).real} {numbers[0]}"
            return numbers if width == 1 else [writer.let(f"{vector}, i64 {k}") for k in range(count)]

        for first in range(0, values, TOGETHER):
            for k, number in enumerate(some(first, min(TOGETHER, values - first))):
                self._store(target, str(first + k), number, 1)

    # Elements: so many neighbours together, from a place on; in lanes one element ------------------------
    def _wide(self, together: int) -> Writer:
        return self.writer if not self._single else self.writer.alike(Lanes(together))

    def _at(self, row: str, width: int, column: int | str) -> str:
        return self.writer.let(f"add nsw i64 {self.writer.let(f'mul nsw i64 {row}, {width}')}, {column}")

    def _ahead(self, index: str, k: int) -> str:
        return self.writer.let(f"add nsw i64 {index}, {k}") if k else index

    def _place(self, start: str, together: int) -> str:
        """Memory for a sum with this start value, until LLVM promotes it to a register."""
        kind = self._wide(together).lanes.real
        place = self.writer.allocate(kind)
        self.writer.write(kind, start, place)
        return place

    def _add_to(self, place: str, a: str, b: str, together: int) -> None:
        wide = self._wide(together)
        total = wide.multiply_add(a, b, self._loaded(place, together))
        self.writer.write(wide.lanes.real, total, place)

    def _loaded(self, place: str, together: int) -> str:
        return self.writer.read(self._wide(together).lanes.real, place)

    def _load(self, operand: Operand, place: str, together: int) -> str:
        if not self._single:
            return self.writer.load_element(operand.pointer, place, operand.shared)
        pointer = self.writer.at("double", operand.pointer, place)
        return self.writer.read(Lanes(together).real, pointer)

    def _store(self, target: str, place: str, value: str, together: int) -> None:
        lanes = Lanes(together) if self._single else self.writer.lanes
        pointer = self.writer.at(self.writer.lanes.element, target, place)
        self.writer.write(lanes.real, value, pointer)

    def _spread(self, value: str, together: int) -> str:
        return self._wide(together).splat(value) if self._single else value
