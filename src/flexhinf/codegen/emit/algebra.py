"""Dense linear algebra in loops: sums of outer products, Cholesky factors, and reflections.

In a kernel for a single run neighbouring columns travel in the lanes of one vector; in a kernel of several lanes
an element is one number of every lane. Every number is computed by the same operations in either case.

Polynomials in nested form: every coefficient is read once, one after the other, and no monomial is ever formed.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import chain

from flexhinf.codegen.emit.opcodes import Lanes, Writer
from flexhinf.polynomial import basis
from flexhinf.scalars.symbol import SMALLEST, SPLIT

#: Rows and columns of a sum that share what is loaded: 16 sums and what they are made of fill 24 of 32 registers in
#: lanes; in a kernel for a single run eight rows of eight columns in a vector each.
TILE, WIDE = 4, 8

#: Polynomials that are summed in one pass: in registers in lanes, in one vector in a kernel for a single run.
TOGETHER = 8

#: So many reflections are written one after the other, others in a loop.
SHORT = 8

PIVOT_TOLERANCE = 1e-14  # as flexhinf.scalars.symbol, which says what it means


@dataclass(frozen=True)
class Operand:
    """Address of an array, and whether one number serves all lanes."""

    pointer: str
    shared: bool = False


@dataclass(frozen=True)
class Algebra:
    """Emits the loops. `fused`: The target has a fused multiply-add."""

    writer: Writer
    fused: bool

    @property
    def _single(self) -> bool:
        return self.writer.lanes.width == 1

    @property
    def _side(self) -> int:  # rows of a tile, and columns of a symmetric one
        return WIDE if self._single else TILE

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
            if weights is not None:  # w_k l_ki of these rows, (N, height): computed once, for all columns
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
            if symmetric:  # left of the diagonal, and across it
                tiles = chain(writer.turns("0", number, self._side), [(i, height, "")])
            else:
                tiles = writer.blocks(columns, self._side * max(1, self._side // height))
            for j, width, _ in tiles:
                place = (i, height), (j, width), columns
                for cell, together, total in self._tile(*place, factors, right, str(count)):
                    if plus is not None:
                        total = self._wide(together).real("fadd", total, self._load(plus, cell, together))
                    self._store(target, cell, total, together)
        if symmetric:
            with writer.loop(str(rows)) as i, writer.loop(i) as j:
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
    ) -> list[tuple[str, int, str]]:
        """Σ_k<count l_kᵀ r_k, or what is in the matrix `begun` less that, of neighbouring rows and columns.

        `rows`, `columns`: The first, and how many. `pitch`: Numbers in a row of the matrix. `factors`: Matrix of l,
        numbers in its rows, and place of the first in a row. Returns for each vector the place of its first element
        in the matrix, its length, and its sums.
        """
        source, length, start = factors
        vectors = [(self._ahead(columns[0], first), n) for first, n in self._vectors(columns[1])]
        cells = []
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
            if begun:
                left = [self.writer.real("fneg", factor) for factor in left]
            values = [self._load(right, self._at(k, pitch, column), n) for column, n in vectors]
            for a, b, _, together, place in cells:
                self._add_to(place, self._spread(left[a], together), values[b], together)
        return [(cell, together, self._loaded(place, together)) for *_, cell, together, place in cells]

    def _vectors(self, size: int) -> list[tuple[int, int]]:
        """First number and length of the vectors that hold so many neighbours; in lanes each goes alone."""
        vectors, first = [], 0
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
        tolerance = writer.lanes.constant(PIVOT_TOLERANCE * n)
        small = writer.compare(
            "ole", pivot, writer.real("fmul", writer.intrinsic("fabs", diagonal), tolerance)
        )
        rounding = self._load(Operand(moved), j, 1)
        low = writer.real("fneg", writer.real("fmul", rounding, tolerance))
        singular = writer.let(f"and {writer.lanes.boolean} {small}, {writer.compare('oge', pivot, low)}")
        inverse = writer.real("fdiv", writer.lanes.constant(1.0), writer.intrinsic("sqrt", pivot))
        inverse = self._spread(writer.select(singular, writer.lanes.constant(0.0), inverse), together)
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
            self._store(moved, column, self.multiply_add(wide, square, rounding, before), together)
        with writer.loop(end, writer.let(f"add nsw i64 {j}, 1")) as k:
            spread = self._spread(writer.real("fneg", self._load(rows, self._at(j, pitch, k), 1)), together)
            with writer.loop(blocks, writer.let(f"udiv i64 {k}, {together}")) as q:
                column = writer.let(f"mul nsw i64 {q}, {together}")
                value = self._load(rows, self._at(j, pitch, column), together)
                place = self._at(k, pitch, column)
                total = self.multiply_add(wide, spread, value, self._load(rows, place, together))
                self._store(work, place, total, together)

    # Rows with the same TᵀT ---------------------------------------------------------------------------
    def householder(self, source: Operand, target: str, shape: tuple[int, int], count: int) -> None:
        """See `flexhinf.codegen.program.Householder`: one column after the other, of rows in groups of four."""
        writer, (m, k) = self.writer, shape
        together = (WIDE if k > TILE else TILE) if self._single else 1
        pitch, height = -(-k // together) * together, -(-m // TILE) * TILE
        work = writer.allocate(f"[{height * pitch} x {writer.lanes.element}]")
        v = writer.allocate(f"[{height} x {writer.lanes.element}]")
        zero = writer.lanes.constant(0.0)
        with writer.loop(str(m)) as i:
            with writer.loop(str(k)) as j:
                self._store(work, self._at(i, pitch, j), self._load(source, self._at(i, k, j), 1), 1)
            with writer.loop(str(pitch), str(k)) as j:
                self._store(work, self._at(i, pitch, j), zero, 1)
        with writer.loop(str(height * pitch), str(m * pitch)) as i:
            self._store(work, i, zero, 1)
        sizes = height, pitch, together
        if count <= SHORT:
            for c in range(count):
                self._reflect(work, v, sizes, str(c))
        else:
            with writer.loop(str(count)) as c:
                self._reflect(work, v, sizes, c)
        with writer.loop(str(m)) as i, writer.loop(str(k)) as j:
            self._store(target, self._at(i, k, j), self._load(Operand(work), self._at(i, pitch, j), 1), 1)

    def _reflect(self, work: str, v: str, sizes: tuple[int, int, int], c: str) -> None:
        """Zero column c below the diagonal, see `flexhinf.scalars.householder`; v is zero down to row c."""
        (height, pitch, together), writer, rows = sizes, self.writer, Operand(work)
        wide, zero, end = self._wide(together), writer.lanes.constant(0.0), str(height // TILE)
        group, block = (writer.let(f"udiv i64 {c}, {size}") for size in (TILE, together))

        def members(q: str) -> list[str]:
            first = writer.let(f"mul nsw i64 {q}, {TILE}")
            return [self._ahead(first, a) for a in range(TILE)]

        def summed(parts: list[str], wide: Writer) -> str:
            pairs = [wide.real("fadd", *parts[a : a + 2]) for a in (0, 2)]
            return wide.real("fadd", *pairs)

        with writer.loop(end, group) as q:
            for i in members(q):
                value = self._load(rows, self._at(i, pitch, c), 1)
                above = writer.splat(writer.let(f"icmp slt i64 {i}, {c}"), "i1")
                self._store(v, i, writer.select(above, zero, value), 1)
        largest = self._largest(v, c, str(height))
        diagonal = self._exchange(v, (height, 1, 1), c, largest, "0")
        self._store(v, c, zero, 1)
        places = [self._place(zero, 1) for _ in range(TILE)]
        with writer.loop(end, group) as q:
            for i, place in zip(members(q), places):
                value = self._load(Operand(v), i, 1)
                self._add_to(place, value, value, 1)
        square = summed([self._loaded(place, 1) for place in places], writer)
        whole = self.multiply_add(writer, diagonal, diagonal, square)
        empty = writer.compare("ole", whole, writer.lanes.constant(SMALLEST))
        size = writer.intrinsic("sqrt", whole)
        norm = writer.select(writer.compare("olt", diagonal, zero), writer.real("fneg", size), size)
        part, inverse = (
            writer.select(empty, zero, writer.real("fdiv", writer.lanes.constant(1.0), number))
            for number in (writer.real("fadd", norm, diagonal), norm)
        )
        less = self._spread(writer.real("fneg", writer.real("fmul", square, part)), together)
        part, inverse = (self._spread(number, together) for number in (part, inverse))
        with writer.loop(str(pitch // together), block) as b:
            column = writer.let(f"mul nsw i64 {b}, {together}")
            first = self._exchange(work, sizes, c, largest, column)
            sums = [self._place(wide.lanes.constant(0.0), together) for _ in range(TILE)]
            with writer.loop(end, group) as q:
                for i, place in zip(members(q), sums):
                    factor = self._spread(self._load(Operand(v), i, 1), together)
                    number = self._load(rows, self._at(i, pitch, column), together)
                    self._add_to(place, factor, number, together)
            total = summed([self._loaded(place, together) for place in sums], wide)
            moved = self.multiply_add(wide, less, first, total)
            self._store(
                work, self._at(c, pitch, column), self.multiply_add(wide, moved, inverse, first), together
            )
            turned = wide.real("fmul", self.multiply_add(wide, total, part, first), inverse)
            turned = wide.real("fneg", turned)
            with writer.loop(end, group) as q:
                for i in members(q):
                    here = self._at(i, pitch, column)
                    factor = self._spread(self._load(Operand(v), i, 1), together)
                    value = self.multiply_add(wide, factor, turned, self._load(rows, here, together))
                    self._store(work, here, value, together)
        with writer.loop(str(height), self._ahead(c, 1)) as i:
            here = self._at(i, pitch, c)
            self._store(work, here, writer.select(empty, self._load(rows, here, 1), zero), 1)
        self._store(work, self._at(c, pitch, c), writer.select(empty, diagonal, norm), 1)

    def _largest(self, v: str, c: str, height: str) -> str:
        """Index, from c on, of the first of the numbers of the largest magnitude; that at c counts twice."""
        writer = self.writer
        kind, index = writer.lanes.integer, writer.allocate(writer.lanes.integer)
        writer.do(f"store {kind} {writer.splat(c, 'i64')}, ptr {index}, align 8")
        size = writer.intrinsic("fabs", self._load(Operand(v), c, 1))
        best = self._place(writer.real("fadd", size, size), 1)
        with writer.loop(height, self._ahead(c, 1)) as i:
            size, so_far = writer.intrinsic("fabs", self._load(Operand(v), i, 1)), self._loaded(best, 1)
            larger = writer.compare("ogt", size, so_far)
            before = writer.let(f"load {kind}, ptr {index}, align 8")
            here = writer.splat(i, "i64")
            place = writer.let(f"select {writer.lanes.boolean} {larger}, {kind} {here}, {kind} {before}")
            writer.do(f"store {kind} {place}, ptr {index}, align 8")
            size = writer.select(larger, size, so_far)
            writer.do(f"store {writer.lanes.real} {size}, ptr {best}, align 8")
        return writer.let(f"load {kind}, ptr {index}, align 8")

    def _exchange(self, work: str, sizes: tuple[int, int, int], c: str, other: str, column: str) -> str:
        """Let row c and another, in lanes one of its own for each, change places in a column; what is in row c then."""
        (height, pitch, together), writer, rows = sizes, self.writer, Operand(work)
        here = self._at(c, pitch, column)
        top = self._load(rows, here, together)
        if self._single:
            there = self._at(other, pitch, column)
            found = self._load(rows, there, together)
            self._store(work, there, top, together)
        else:
            place = self._place(top, 1)
            with writer.loop(str(height), self._ahead(c, 1)) as i:
                there, index = self._at(i, pitch, column), writer.splat(i, "i64")
                same = writer.let(f"icmp eq {writer.lanes.integer} {other}, {index}")
                value, so_far = self._load(rows, there, 1), self._loaded(place, 1)
                kept = writer.select(same, value, so_far)
                writer.do(f"store {writer.lanes.real} {kept}, ptr {place}, align 8")
                self._store(work, there, writer.select(same, top, value), 1)
            found = self._loaded(place, 1)
        self._store(work, here, found, together)
        return found

    # e − C x − v in twice the digits -------------------------------------------------------------------
    def residual(
        self, rows: Operand, slope: Operand, target: str, count: int, shape: tuple[int, int]
    ) -> None:
        """See `flexhinf.codegen.program.Residual`; in a kernel for a single run rows travel side by side."""
        writer, (p, n) = self.writer, shape
        together = WIDE if self._single and count > 1 else 1
        pitch = -(-count // together) * together
        width, wide = n + 2 * p, self._wide(together)
        turned = writer.allocate(f"[{width * pitch} x {writer.lanes.element}]")
        result = writer.allocate(f"[{p * pitch} x {writer.lanes.element}]")
        with writer.loop(str(width)) as j:
            with writer.loop(str(count)) as q:
                self._store(turned, self._at(j, pitch, q), self._load(rows, self._at(q, width, j), 1), 1)
            with writer.loop(str(pitch), str(count)) as q:
                self._store(turned, self._at(j, pitch, q), writer.lanes.constant(0.0), 1)
        with writer.loop(str(pitch // together)) as block, writer.loop(str(p)) as i:
            first = writer.let(f"mul nsw i64 {block}, {together}")

            def number(row: str, first: str = first, source: Operand = Operand(turned)) -> str:
                return self._load(source, self._at(row, pitch, first), together)

            noise = wide.real("fneg", number(self._ahead(i, p + n)))
            high, low = self._two_sum(wide, number(i), noise)
            places = self._place(high, together), self._place(low, together)
            with writer.loop(str(n)) as j:
                high, low = (self._loaded(place, together) for place in places)
                factor = self._spread(self._load(slope, self._at(i, n, j), 1), together)
                product, error = self._two_product(wide, factor, number(self._ahead(j, p)))
                high, lost = self._two_sum(wide, high, wide.real("fneg", product))
                low = wide.real("fadd", wide.real("fsub", low, error), lost)
                for place, value in zip(places, (high, low)):
                    writer.do(f"store {wide.lanes.real} {value}, ptr {place}, align 8")
            high, low = (self._loaded(place, together) for place in places)
            finite = wide.compare("ord", wide.real("fsub", low, low), wide.lanes.constant(0.0))
            total = wide.select(finite, wide.real("fadd", high, low), high)
            self._store(result, self._at(i, pitch, first), total, together)
        with writer.loop(str(count)) as q, writer.loop(str(p)) as i:
            self._store(target, self._at(q, p, i), self._load(Operand(result), self._at(i, pitch, q), 1), 1)

    def _two_sum(self, writer: Writer, a: str, b: str) -> tuple[str, str]:
        """a + b, rounded, and what rounding took."""
        total = writer.real("fadd", a, b)
        part = writer.real("fsub", total, a)
        left = writer.real("fsub", a, writer.real("fsub", total, part))
        return total, writer.real("fadd", left, writer.real("fsub", b, part))

    def _two_product(self, writer: Writer, a: str, b: str) -> tuple[str, str]:
        """a b likewise."""
        product = writer.real("fmul", a, b)
        if self.fused:
            return product, writer.intrinsic("fma", a, b, writer.real("fneg", product))

        def halves(x: str) -> tuple[str, str]:
            shifted = writer.real("fmul", writer.lanes.constant(SPLIT), x)
            first = writer.real("fsub", shifted, writer.real("fsub", shifted, x))
            return first, writer.real("fsub", x, first)

        (a1, a2), (b1, b2) = halves(a), halves(b)
        error = writer.real("fsub", writer.real("fmul", a1, b1), product)
        for x, y in ((a1, b2), (a2, b1), (a2, b2)):
            error = writer.real("fadd", error, writer.real("fmul", x, y))
        return product, error

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
            before, rows = 0, {}
            for degree in degrees:
                rows[degree] = writer.allocate("i64")
                writer.do(f"store i64 {before}, ptr {rows[degree]}, align 8")
                before += basis.count(n, degree)

            def total(chosen: int, begin: str) -> list[str]:
                """c + Σ_i≥begin x_i (…) after so many variables were chosen; a row's coefficient after the last."""
                vectors = 1 if self._single else count
                start = [self._wide(width).lanes.constant(0.0)] * vectors
                if chosen in rows:
                    row = writer.let(f"load i64, ptr {rows[chosen]}, align 8")
                    writer.do(f"store i64 {self._ahead(row, 1)}, ptr {rows[chosen]}, align 8")
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
        self.writer.do(f"store {kind} {start}, ptr {place}, align 8")
        return place

    def _add_to(self, place: str, a: str, b: str, together: int) -> None:
        wide = self._wide(together)
        total = self.multiply_add(wide, a, b, self._loaded(place, together))
        self.writer.do(f"store {wide.lanes.real} {total}, ptr {place}, align 8")

    def _loaded(self, place: str, together: int) -> str:
        return self.writer.let(f"load {self._wide(together).lanes.real}, ptr {place}, align 8")

    def _load(self, operand: Operand, place: str, together: int) -> str:
        if not self._single:
            return self.writer.load_element(operand.pointer, place, operand.shared)
        pointer = self.writer.let(f"getelementptr double, ptr {operand.pointer}, i64 {place}")
        return self.writer.let(f"load {Lanes(together).real}, ptr {pointer}, align 8")

    def _store(self, target: str, place: str, value: str, together: int) -> None:
        lanes = Lanes(together) if self._single else self.writer.lanes
        pointer = self.writer.let(f"getelementptr {self.writer.lanes.element}, ptr {target}, i64 {place}")
        self.writer.do(f"store {lanes.real} {value}, ptr {pointer}, align 8")

    def _spread(self, value: str, together: int) -> str:
        return self._wide(together).splat(value) if self._single else value

    def multiply_add(self, writer: Writer, a: str, b: str, c: str) -> str:
        """a·b + c, rounded once where the target can."""
        return (
            writer.intrinsic("fma", a, b, c)
            if self.fused
            else writer.real("fadd", writer.real("fmul", a, b), c)
        )
