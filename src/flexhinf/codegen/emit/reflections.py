"""Reflections of rows and sums in twice the digits, of beliefs that carry rows of deviations."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from flexhinf.codegen.emit.algebra import TILE, WIDE, Algebra, Operand
from flexhinf.codegen.emit.writer import Lanes, Writer
from flexhinf.scalars.symbol import SMALLEST, SPLIT

#: So many reflections are written one after the other, others in a loop.
SHORT = 8


@dataclass(frozen=True)
class _Rows:
    """The rows that are reflected, in memory `work`: m of them, `pitch` numbers each, of which `together` travel.

    Of the last rows, `triangle` are upper triangular. `v`: memory for a column.
    """

    work: str
    v: str
    m: int
    pitch: int
    together: int
    triangle: int


class Reflections(Algebra):
    """Emits the loops."""

    # Rows with the same TᵀT ---------------------------------------------------------------------------
    def householder(
        self, source: Operand, target: str, shape: tuple[int, int], count: int, triangle: int
    ) -> None:
        """See `flexhinf.codegen.program.Householder`: one column after the other, of rows in groups of four."""
        writer, (m, k) = self.writer, shape
        together = (WIDE if k > TILE else TILE) if self._single else 1
        pitch, room = -(-k // together) * together, -(-m // WIDE) * WIDE
        work, v = (writer.allocate(f"[{size} x {writer.lanes.element}]") for size in (room * pitch, room))
        zero = writer.lanes.constant(0.0)
        with writer.loop(str(m)) as i:
            for j, size in self._row(k):
                self._store(work, self._at(i, pitch, j), self._load(source, self._at(i, k, j), size), size)
            with writer.loop(str(pitch), str(k)) as j:
                self._store(work, self._at(i, pitch, j), zero, 1)
        with writer.loop(str(room * pitch), str(m * pitch)) as i:
            self._store(work, i, zero, 1)
        rows = _Rows(work, v, m, pitch, together, triangle)
        if count <= SHORT:
            for c in range(count):
                self._reflect(rows, str(c))
        else:
            with writer.loop(str(count)) as c:
                self._reflect(rows, c)
        with writer.loop(str(m)) as i:
            for j, size in self._row(k):
                value = self._load(Operand(work), self._at(i, pitch, j), size)
                self._store(target, self._at(i, k, j), value, size)

    def _row(self, size: int) -> Iterator[tuple[str, int]]:
        """Places in a row, and how many neighbours are copied from there; in lanes one after the other."""
        if self._single:
            yield from ((str(first), together) for first, together in self._vectors(size))
        else:
            with self.writer.loop(str(size)) as place:
                yield place, 1

    def _groups(self, rows: _Rows, c: str, size: int) -> str:
        """Number of groups of so many rows, up to the last one that is not zero in column c."""
        if not rows.triangle:
            return str(-(-rows.m // size))
        last = rows.m - rows.triangle + size
        return (
            str((last + int(c)) // size)
            if c.isdigit()
            else self.writer.let(f"udiv i64 {self._ahead(c, last)}, {size}")
        )

    def _reflect(self, rows: _Rows, c: str) -> None:
        """Zero column c below the diagonal, see `flexhinf.scalars.householder`; v is zero down to row c."""
        writer, pitch, together, work, v = (
            self.writer,
            rows.pitch,
            rows.together,
            Operand(rows.work),
            Operand(rows.v),
        )
        wide, zero, end = self._wide(together), writer.lanes.constant(0.0), self._groups(rows, c, TILE)
        group, block = (writer.let(f"udiv i64 {c}, {size}") for size in (TILE, together))
        pivot = self._pivot_of_run if self._single and rows.m > 2 * WIDE else self._pivot_row_by_row
        diagonal, square, largest = pivot(rows, c)
        whole = writer.multiply_add(diagonal, diagonal, square)
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
            first = self._exchange(rows.work, (rows.m, pitch, together), c, largest, column)
            sums = [self._place(wide.lanes.constant(0.0), together) for _ in range(TILE)]
            with writer.loop(end, group) as q:
                for i, place in zip(self._members(q), sums):
                    factor = self._spread(self._load(v, i, 1), together)
                    self._add_to(
                        place, factor, self._load(work, self._at(i, pitch, column), together), together
                    )
            total = self._summed([self._loaded(place, together) for place in sums], wide)
            moved = wide.multiply_add(less, first, total)
            moved = wide.multiply_add(moved, inverse, first)
            self._store(rows.work, self._at(c, pitch, column), moved, together)
            turned = wide.real("fmul", wide.multiply_add(total, part, first), inverse)
            turned = wide.real("fneg", turned)
            with writer.loop(end, group) as q:
                for i in self._members(q):
                    here = self._at(i, pitch, column)
                    factor = self._spread(self._load(v, i, 1), together)
                    value = wide.multiply_add(factor, turned, self._load(work, here, together))
                    self._store(rows.work, here, value, together)
        with writer.loop(writer.let(f"mul nsw i64 {end}, {TILE}"), self._ahead(c, 1)) as i:
            self._store(rows.work, self._at(i, pitch, c), zero, 1)
        self._store(rows.work, self._at(c, pitch, c), writer.select(empty, diagonal, norm), 1)

    def _summed(self, parts: list[str], wide: Writer) -> str:
        """The sum of four, by pairs."""
        return wide.real("fadd", *(wide.real("fadd", *parts[k : k + 2]) for k in (0, 2)))

    def _members(self, q: str) -> list[str]:
        first = self.writer.let(f"mul nsw i64 {q}, {TILE}")
        return [self._ahead(first, a) for a in range(TILE)]

    def _elements(self, vector: str, count: int) -> list[str]:
        kind = Lanes(count).real
        return [self.writer.let(f"extractelement {kind} {vector}, i64 {k}") for k in range(count)]

    def _pivot_of_run(self, rows: _Rows, c: str) -> tuple[str, str, str]:
        """The largest entry of column c from row c on, the sum of the others' squares, and its row; v has the others.

        Eight rows travel in a vector; v is as long as so many vectors.
        """
        work, v, pitch, writer, wide = rows.work, rows.v, rows.pitch, self.writer, self._wide(WIDE)
        lanes, first_group = wide.lanes, writer.let(f"udiv i64 {c}, {WIDE}")
        end = self._groups(rows, c, WIDE)
        zero, here = lanes.constant(0.0), wide.splat(c, "i64")

        def numbers(first: str) -> str:
            counted = ", ".join(f"i64 {k}" for k in range(WIDE))
            return wide.let(f"add nsw {lanes.integer} {wide.splat(first, 'i64')}, <{counted}>")

        most = self._place(zero, WIDE)
        with writer.loop(end, first_group) as q:
            first, value = writer.let(f"mul nsw i64 {q}, {WIDE}"), "poison"
            for k in range(WIDE):
                number = self._load(Operand(work), self._at(self._ahead(first, k), pitch, c), 1)
                value = wide.let(f"insertelement {lanes.real} {value}, double {number}, i64 {k}")
            above = wide.compare_whole("slt", numbers(first), here)
            value = wide.select(above, zero, value)
            self._store(v, first, value, WIDE)
            size, so_far = wide.intrinsic("fabs", value), self._loaded(most, WIDE)
            larger = wide.select(wide.compare("ogt", size, so_far), size, so_far)
            writer.write(lanes.real, larger, most)
        lengths = self._elements(self._loaded(most, WIDE), WIDE)
        while len(lengths) > 1:
            pairs = zip(lengths[::2], lengths[1::2])
            lengths = [writer.select(writer.compare("ogt", x, y), x, y) for x, y in pairs]
        top = self._load(Operand(v), c, 1)
        size = writer.intrinsic("fabs", top)
        largest = self._first_of(v, lengths[0], first_group, end)
        exchanged = writer.compare("ogt", lengths[0], writer.real("fadd", size, size))
        largest = writer.let(f"select i1 {exchanged}, i64 {largest}, i64 {c}")
        diagonal = self._load(Operand(v), largest, 1)
        there, instead = wide.splat(largest, "i64"), wide.splat(top)
        total = self._place(Lanes(TILE).constant(0.0), TILE)
        with writer.loop(end, first_group) as q:
            first = writer.let(f"mul nsw i64 {q}, {WIDE}")
            value, places = self._load(Operand(v), first, WIDE), numbers(first)
            value = wide.select(wide.compare_whole("eq", places, there), instead, value)
            value = wide.select(wide.compare_whole("eq", places, here), zero, value)
            self._store(v, first, value, WIDE)
            for half in range(0, WIDE, TILE):
                part = wide.shuffled(value, "poison", range(half, half + TILE))
                self._add_to(total, part, part, TILE)
        return diagonal, self._summed(self._elements(self._loaded(total, TILE), TILE), writer), largest

    def _first_of(self, v: str, size: str, first_group: str, end: str) -> str:
        """Index of the first number of this size, from a group of eight on: looked for from the last one on."""
        writer, wide = self.writer, self._wide(WIDE)
        lanes, wanted, index = wide.lanes, wide.splat(size), writer.allocate("i64")
        name = "llvm.cttz.i64"
        writer.module.declarations[name] = f"declare i64 @{name}(i64, i1)"
        writer.write("i64", "0", index)
        with writer.loop(writer.let(f"sub nsw i64 {end}, {first_group}")) as q:
            group = writer.let(f"sub nsw i64 {writer.let(f'sub nsw i64 {end}, 1')}, {q}")
            first = writer.let(f"mul nsw i64 {group}, {WIDE}")
            same = wide.compare("oeq", wide.intrinsic("fabs", self._load(Operand(v), first, WIDE)), wanted)
            bits = writer.let(f"bitcast {lanes.boolean} {same} to i{WIDE}")
            count = writer.let(f"call i64 @{name}(i64 {writer.let(f'zext i{WIDE} {bits} to i64')}, i1 false)")
            place = writer.let(f"add nsw i64 {first}, {count}")
            some, before = writer.let(f"icmp ne i{WIDE} {bits}, 0"), writer.read("i64", index)
            place = writer.let(f"select i1 {some}, i64 {place}, i64 {before}")
            writer.write("i64", place, index)
        return writer.read("i64", index)

    def _pivot_row_by_row(self, rows: _Rows, c: str) -> tuple[str, str, str]:
        """The same row by row: for few rows, and in lanes, where each has a row of its own."""
        work, v, pitch, writer, end = rows.work, rows.v, rows.pitch, self.writer, self._groups(rows, c, TILE)
        group, zero = writer.let(f"udiv i64 {c}, {TILE}"), writer.lanes.constant(0.0)
        with writer.loop(end, group) as q:
            for i in self._members(q):
                value = self._load(Operand(work), self._at(i, pitch, c), 1)
                above = writer.splat(writer.let(f"icmp slt i64 {i}, {c}"), "i1")
                self._store(v, i, writer.select(above, zero, value), 1)
        height = writer.let(f"mul nsw i64 {end}, {TILE}")
        largest = self._largest(v, c, height)
        diagonal = self._exchange(v, (height, 1, 1), c, largest, "0")
        self._store(v, c, zero, 1)
        places = [self._place(zero, 1) for _ in range(TILE)]
        with writer.loop(end, group) as q:
            for i, place in zip(self._members(q), places):
                value = self._load(Operand(v), i, 1)
                self._add_to(place, value, value, 1)
        return diagonal, self._summed([self._loaded(place, 1) for place in places], writer), largest

    def _largest(self, v: str, c: str, height: str) -> str:
        """Index, from c on, of the first of the numbers of the largest magnitude; that at c counts twice."""
        writer = self.writer
        kind, index = writer.lanes.integer, writer.allocate(writer.lanes.integer)
        writer.write(kind, writer.splat(c, "i64"), index)
        size = writer.intrinsic("fabs", self._load(Operand(v), c, 1))
        best = self._place(writer.real("fadd", size, size), 1)
        with writer.loop(height, self._ahead(c, 1)) as i:
            size, so_far = writer.intrinsic("fabs", self._load(Operand(v), i, 1)), self._loaded(best, 1)
            larger = writer.compare("ogt", size, so_far)
            before = writer.read(kind, index)
            here = writer.splat(i, "i64")
            place = writer.select(larger, here, before, kind)
            writer.write(kind, place, index)
            size = writer.select(larger, size, so_far)
            writer.write(writer.lanes.real, size, best)
        return writer.read(kind, index)

    def _exchange(self, work: str, sizes: tuple[int | str, int, int], c: str, other: str, column: str) -> str:
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
                same = writer.compare_whole("eq", other, index)
                value, so_far = self._load(rows, there, 1), self._loaded(place, 1)
                kept = writer.select(same, value, so_far)
                writer.write(writer.lanes.real, kept, place)
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
        source = Operand(turned)
        with writer.loop(str(pitch // together)) as block:
            first = writer.let(f"mul nsw i64 {block}, {together}")

            def number(row: str, first: str = first) -> str:
                return self._load(source, self._at(row, pitch, first), together)

            for start, height, _ in writer.blocks(
                p, TILE
            ):  # sums of several outputs wait less for each other
                outputs = [self._ahead(start, a) for a in range(height)]
                sums = list[tuple[str, str]]()
                for i in outputs:
                    noise = wide.real("fneg", number(self._ahead(i, p + n)))
                    high, low = self._two_sum(wide, number(i), noise)
                    sums.append((self._place(high, together), self._place(low, together)))
                with writer.loop(str(n)) as j:
                    x = number(self._ahead(j, p))
                    for i, places in zip(outputs, sums):
                        high, low = (self._loaded(place, together) for place in places)
                        factor = self._spread(self._load(slope, self._at(i, n, j), 1), together)
                        product, error = self._two_product(wide, factor, x)
                        high, lost = self._two_sum(wide, high, wide.real("fneg", product))
                        low = wide.real("fadd", wide.real("fsub", low, error), lost)
                        for place, value in zip(places, (high, low)):
                            writer.write(wide.lanes.real, value, place)
                for i, places in zip(outputs, sums):
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
        if writer.module.fused:
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
