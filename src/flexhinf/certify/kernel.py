"""The machine code that bounds V and r on cells: LLVM text of loops over index tables, eight cells a vector.

What it computes, and why its results are bounds, is said in `flexhinf.certify.cells`. Arithmetic may be fused or not:
the allowance for rounding covers both. The text depends on the degrees of the polynomials alone, so the object code
is kept on disk like that of other kernels.

On a face z_f = ±ρ, z_j = ρ t_j of a cube, P = Σ_k ρᵏ P_k(t). A coefficient belongs to a degree k and a monomial tᵝ,
|β| ≤ k. Monomials stand in groups by |β|, those with even exponents only first; the degrees of one monomial stand
together.
"""

from __future__ import annotations

from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager
from functools import cache, partialmethod
from itertools import groupby, product
from typing import NamedTuple

import numpy as np

from flexhinf.codegen.emit.writer import Lanes, ModuleText, Writer

LANES = 8
LOW = 3  # monomials through this degree are kept as polynomials in ρ; the others only bounded

#: What the kernel's argument points to, in this order: 64-bit words.
POINTERS = (
    "first",
    "last",
    "faces",
    "inputs",
    "outputs",
    "work",
    "level",
    "value_table",
    "quotient_table",
    "table",
    "segments",
    "lines",
    "signs",
)

#: What is found of each cell, and at last `score`: how much the radius and each t_j add to `upper`.
OUTPUTS = (
    "least_value",  # V ≥ this on the inner end of the cell
    "growth",  # ∂V/∂ρ /ρ ≥ this on the cell
    "upper",  # r/ρ² ≤ this on the cell
    "upper_inside",  # r/ρ² ≤ this where V ≤ level
    "centre",  # r/ρ² in the middle, up to the allowance
    "allowance",
    "value",  # V in the middle
    "value_range",  # how far it goes from there
    "growth_at_centre",  # ∂V/∂ρ /ρ in the middle
)

_VECTOR, _TRUTHS = f"<{LANES} x double>", f"<{LANES} x i1>"
_ATTRIBUTES = 'nounwind "min-legal-vector-width"="512" "prefer-vector-width"="512"'


class MonomialGroup(NamedTuple):
    """The monomials of one |β|, `size`, of a polynomial.

    The coefficient (monomial, degree) stands at offset + monomial · degrees + degree.
    """

    size: int
    first: int  # number of the first monomial
    count: int  # pyright: ignore[reportIncompatibleMethodOverride]  # a tuple counts, too
    even: int  # how many have even exponents only
    degrees: tuple[int, ...]  # those k ≥ |β| that the polynomial has
    offset: int


@cache
def monomials_of(directions: int, highest: int) -> tuple[tuple[int, ...], ...]:
    """Exponents of the monomials in t through degree `highest`."""
    every: list[tuple[int, ...]] = [()]
    for _ in range(directions):
        every = [(*head, e) for head in every for e in range(highest + 1 - sum(head))]
    return tuple(sorted(every, key=lambda beta: (sum(beta), any(e % 2 for e in beta), beta)))


class MonomialLayout:
    """Where the coefficients of a polynomial with these ascending degrees in z stand; t has `directions` entries."""

    def __init__(self, directions: int, degrees: Sequence[int]) -> None:
        self.directions, self.degrees = directions, tuple(degrees)
        self.monomials, first = monomials_of(directions, max(self.degrees)), 0
        self.groups, self.place = list[MonomialGroup](), dict[tuple[int, tuple[int, ...]], int]()
        for size, betas in groupby(self.monomials, sum):
            group, degrees = list(betas), tuple(k for k in self.degrees if k >= size)
            even = sum(not any(e % 2 for e in beta) for beta in group)
            self.groups.append(MonomialGroup(size, first, len(group), even, degrees, len(self.place)))
            keys, first = [(k, beta) for beta in group for k in degrees], first + len(group)
            self.place |= zip(keys, range(len(self.place), len(self.place) + len(keys)))
        self.count = len(self.place)

    def shift_lines(self) -> list[tuple[int, int, np.ndarray]]:
        """(variable, length, places (lines, length + 1)): lines of coefficients along which t_j is shifted."""
        result = []
        for k, j in product(self.degrees, range(self.directions)):
            for length in range(1, k + 1):
                others = [beta for beta in monomials_of(self.directions - 1, k) if sum(beta) == k - length]
                lines = [[self.place[k, (*b[:j], p, *b[j:])] for p in range(length + 1)] for b in others]
                if lines:
                    result.append((j, length, np.array(lines)))
        return result


class CellShape:
    """Sizes that the text depends on.

    `value`, `whole` and `quotients` lay out V, r with all quotients multiplied out, and the factors Q_j; `terms` are
    the degrees of Q_j ℓᵐ for every quotient and power. `inputs`, `outputs`, `work` are the first row of each input and
    result of a group of cells and of each part of the work buffer, in vectors, and their "count".
    """

    def __init__(
        self,
        states: int,
        value: Sequence[int],
        quotients: Sequence[Sequence[int]],
        whole: Sequence[int],
        terms: Sequence[tuple[int, ...]],
    ) -> None:
        self.states, d = states, states - 1
        self.directions, self.terms = d, terms
        self.value, self.whole = MonomialLayout(d, value), MonomialLayout(d, whole)
        self.quotients = [MonomialLayout(d, degrees) for degrees in quotients]
        #: What stands in the table of r on a face, in this order: the polynomial, 0 or 1 and up for `terms`, and the
        #: place of the coefficient.
        self.columns = [
            (part, place)
            for (k, _), place in self.whole.place.items()
            for part in (0, *(1 + q for q, degrees in enumerate(terms) if k in degrees))
        ]
        self.longest = max((self.whole, self.value), key=lambda layout: layout.degrees[-1])
        scalars = dict.fromkeys(
            ("inner", "outer", "middle", "half", "value_rounding", "growth_rounding", "rounding"), 1
        )
        self.inputs = _places({"t": d, "h": d} | scalars | {"error": len(quotients), "s": len(terms)})
        self.outputs = _places(dict.fromkeys(OUTPUTS, 1) | {"score": states})
        highest, monomials = self.longest.degrees[-1], len(self.longest.monomials)
        low = sum(group.count for group in self.whole.groups if group.size <= LOW) * (highest + 1)
        self.work = _places(
            {
                "value": self.value.count,
                "quotient": max((q.count for q in self.quotients), default=0),
                "whole": self.whole.count,
                "scale": monomials,
                "weight": monomials,
                "low": low,
                "low_value": low,
                "powers": 5 * (highest + 3),
            }
        )


def _places(sizes: dict[str, int]) -> dict[str, int]:
    return dict(zip([*sizes, "count"], np.cumsum([0, *sizes.values()]).tolist()))


def kernel_text(shape: CellShape, entry: str) -> str:
    """LLVM text of the entry and of the shift it calls."""
    module = ModuleText(Lanes(LANES))
    layouts = (shape.whole, shape.value, *shape.quotients)
    _CellKernel(module, shape).write_shift(max(1, *(layout.degrees[-1] for layout in layouts)))
    _CellKernel(module, shape).write(entry)
    return str(module)


class _CellKernel(Writer):
    """The text of one function of the kernel: rows, tables and buffers of a group of cells, and what is done to the
    polynomials in them."""

    zero = "zeroinitializer"
    plus = partialmethod(Writer.real, "fadd")
    minus = partialmethod(Writer.real, "fsub")
    times = partialmethod(Writer.real, "fmul")
    absolute = partialmethod(Writer.intrinsic, "fabs")
    fused = partialmethod(Writer.intrinsic, "fmuladd")  # a b + c, fused where the processor can

    def __init__(self, module: ModuleText, shape: CellShape) -> None:
        super().__init__(module)
        self.shape = shape
        self.top = max(shape.whole.degrees[-1] - 2, shape.value.degrees[-1])  # highest power of ρ

    def at(self, base: str, index: str, kind: str = _VECTOR) -> str:
        return self.let(f"getelementptr inbounds {kind}, ptr {base}, i64 {index}")

    def load(self, pointer: str) -> str:
        return self.let(f"load {_VECTOR}, ptr {pointer}, align 64")

    def store(self, value: str, pointer: str) -> None:
        self.do(f"store {_VECTOR} {value}, ptr {pointer}, align 64")

    def number(self, base: str, index: str) -> str:
        return self.splat(self.let(f"load double, ptr {self.at(base, index, 'double')}, align 8"))

    def word(self, base: str, index: str) -> str:
        return self.let(f"load i64, ptr {self.at(base, index, 'i64')}, align 8")

    def largest(self, a: str, even: bool) -> str:
        """The largest a s for 0 ≤ s ≤ 1, or for |s| ≤ 1; of NaN, NaN."""
        return self.select(self.compare("ole", a, self.zero), self.zero, a) if even else self.absolute(a)

    def moved_by(self, a: str, values: list[str], degree: int) -> list[str]:
        """The coefficients of P(t + a), by synthetic division."""
        for i in range(degree):
            for p in range(degree - 1, i - 1, -1):
                values[p] = self.fused(a, values[p + 1], values[p])
        return values

    def integer(self, operation: str, a: str, b: str) -> str:
        return self.let(f"{operation} i64 {a}, {b}")

    def affine(self, index: str, stride: int, offset: str | int) -> str:
        return self.integer("add", self.integer("mul", index, str(stride)), str(offset))

    def logical(self, operation: str, a: str, b: str) -> str:
        return self.let(f"{operation} {_TRUTHS} {a}, {b}")

    @contextmanager
    def where(self, condition: str) -> Generator[None]:
        yes, end = self.label("yes"), self.label("end")
        self.do(f"br i1 {condition}, label %{yes}, label %{end}")
        self.place(yes)
        yield
        self.do(f"br label %{end}")
        self.place(end)

    def sum(self, start: str = zero) -> str:
        """Place of a new vector on the stack, to which `add` adds."""
        place = self.allocate(_VECTOR)
        self.store(start, place)
        return place

    def add(self, place: str, value: str, operation: str = "fadd") -> None:
        self.store(self.real(operation, self.load(place), value), place)

    def finish(self, head: str, name: str) -> None:
        self.module.definitions[name] = "\n".join([f"{head} {_ATTRIBUTES} {{", *self.first, *self.lines, "}"])

    def input(self, name: str, index: int = 0) -> str:
        return self.load(self.at(self.rows, str(self.shape.inputs[name] + index)))

    def output(self, name: str, value: str, index: int = 0) -> None:
        self.store(value, self.at(self.out, str(self.shape.outputs[name] + index)))

    def result(self, name: str) -> str:
        return self.load(self.at(self.out, str(self.shape.outputs[name])))

    def work(self, name: str, index: str = "0") -> str:
        return self.at(self.pointers["work"], self.integer("add", str(self.shape.work[name]), index))

    def power(self, which: int, exponent: int) -> str:
        """inner, outer, middle, half, outer − middle (of the powers), to an exponent."""
        return self.load(self.work("powers", str(which * (self.top + 3) + exponent)))

    def moved(self, layout: MonomialLayout, table: str, base: str, place: str, number: int) -> None:
        """Coefficients of the face in every lane, re-expanded about the middle of the box of directions."""
        with self.loop(str(layout.count)) as i:
            self.store(self.number(self.pointers[table], self.integer("add", base, i)), self.work(place, i))
        self.shift(place, number)

    def shift(self, place: str, number: int) -> None:
        bounds = [self.word(self.pointers["segments"], str(number + i)) for i in range(2)]
        segments = self.at(self.pointers["segments"], str(len(self.shape.quotients) + 3), "i64")
        arguments = f"ptr {self.work(place)}, ptr {segments}, ptr {self.pointers['lines']}, ptr {self.rows}"
        self.do(f"call void @shift({arguments}, i64 {bounds[0]}, i64 {bounds[1]})")

    def each(self, groups: Sequence[MonomialGroup]) -> Iterator[tuple[MonomialGroup, str, bool]]:
        """Loops over the monomials of groups: of each first those with even exponents, then the others."""
        for group in groups:
            for start, end, even in ((0, group.even, True), (group.even, group.count, False)):
                if end > start:
                    with self.loop(str(end), str(start)) as b:
                        yield group, b, even

    def coefficients(self, group: MonomialGroup, b: str, place: str) -> list[str]:
        scale = self.load(self.work("scale", self.integer("add", b, str(group.first))))
        start = self.affine(b, len(group.degrees), group.offset)
        return [
            self.times(self.load(self.work(place, self.integer("add", start, str(i)))), scale)
            for i in range(len(group.degrees))
        ]

    def low_place(self, place: str, group: MonomialGroup, b: str, power: int) -> str:
        return self.work(place, self.affine(self.integer("add", b, str(group.first)), self.top + 1, power))

    def kept(self, place: str, group: MonomialGroup, b: str) -> list[str]:
        return [self.load(self.low_place(place, group, b, p)) for p in range(self.top + 1)]

    def about_middle(self, layout: MonomialLayout, place: str, lift: int = 0) -> tuple[str, str]:
        """V, or with `lift` 2 r/ρ², about the middle of the cell in the cell's own variables.

        The value there is an output, the low coefficients stand in their buffer. Returned are sums of what the others
        can add to it, at most: of those that are not kept, and of the low ones; for V to both sides, and of all.
        """
        low, output = ("low", "centre") if lift else ("low_value", "value")
        highest, tail = layout.degrees[-1] - lift, self.sum()
        for group, b, even in self.each(layout.groups[LOW + 1 :]):
            value, width = self.zero, self.zero
            for k, c in zip(group.degrees, self.coefficients(group, b, place)):
                value = self.fused(c, self.power(2, k - lift), value)
                width = self.fused(self.absolute(c), self.power(4, k - lift), width)
            self.add(tail, self.plus(self.largest(value, even and lift > 0), width))
            if lift:
                weight = self.work("weight", self.integer("add", b, str(group.first)))
                self.store(self.plus(self.absolute(value), width), weight)
        total, middle = self.sum(self.zero if lift else self.load(tail)), self.power(2, 1)
        for group, b, even in self.each(layout.groups[: LOW + 1]):
            by_degree = dict(zip(group.degrees, self.coefficients(group, b, place)))
            values = [by_degree.get(p + lift, self.zero) for p in range(self.top + 1)]
            for p, value in enumerate(self.moved_by(middle, values, highest)):
                scaled = value if p == 0 or p > highest else self.times(value, self.power(3, p))
                self.store(scaled, self.low_place(low, group, b, p))
                if centre := group.size == 0 and p == 0:
                    self.output(output, scaled)
                if p <= highest and (lift or not centre):
                    self.add(
                        total, scaled if centre else self.largest(scaled, even and p % 2 == 0 and lift > 0)
                    )
        return tail, total

    # The shift -----------------------------------------------------------------------------------
    def write_shift(self, longest: int) -> None:
        """shift(coefficients, segments, lines, t, first, last): P(t + a) by synthetic division, line after line.

        A segment is (variable, length, number of lines, place of the lines); a line has length + 1 places of
        coefficients.
        """
        with self.loop("%last", "%first") as index:
            variable, length, count, start = (
                self.word("%segments", self.affine(index, 4, i)) for i in range(4)
            )
            a = self.load(self.at("%t", variable))
            done = self.label("done")
            labels = [self.label(f"length{L}_") for L in range(1, longest + 1)]
            cases = " ".join(f"i64 {L}, label %{label}" for L, label in enumerate(labels, 1))
            self.do(f"switch i64 {length}, label %{done} [ {cases} ]")
            for L, label in enumerate(labels, 1):
                self.place(label)
                with self.loop(count) as line:
                    base = self.affine(line, L + 1, start)
                    places = []
                    for p in range(L + 1):
                        pointer = self.at("%lines", self.integer("add", base, str(p)), "i32")
                        narrow = self.let(f"load i32, ptr {pointer}, align 4")
                        places.append(self.at("%coefficients", self.let(f"zext i32 {narrow} to i64")))
                    for value, place in zip(
                        self.moved_by(a, [self.load(place) for place in places], L)[:L], places
                    ):
                        self.store(value, place)
                self.do(f"br label %{done}")
            self.place(done)
        self.do("ret void")
        arguments = "ptr noalias %coefficients, ptr noalias %segments, ptr noalias %lines, ptr noalias %t"
        self.finish(f"define internal void @shift({arguments}, i64 %first, i64 %last) noinline", "shift")

    # The entry -----------------------------------------------------------------------------------
    def write(self, entry: str) -> None:
        context = {name: self.word("%context", str(i)) for i, name in enumerate(POINTERS)}
        self.pointers = {name: self.let(f"inttoptr i64 {word} to ptr") for name, word in context.items()}
        self.level = self.number(self.pointers["level"], "0")
        inputs, outputs = self.shape.inputs["count"], self.shape.outputs["count"]
        with self.loop(context["last"], context["first"]) as group:
            self.rows = self.at(self.pointers["inputs"], self.integer("mul", group, str(inputs)))
            self.out = self.at(self.pointers["outputs"], self.integer("mul", group, str(outputs)))
            self.face = self.word(self.pointers["faces"], group)
            self._powers()
            self._value()
            outside = self.compare("ogt", self.result("least_value"), self.level)
            for name in ("upper", "upper_inside"):
                self.output(name, self.lanes.constant(float("inf")))
            with self.where(self.any(self.logical("xor", outside, "splat (i1 true)"))):
                self._inequality()
        self.do("ret i64 0")
        self.finish(f"define i64 @{entry}(ptr %context)", entry)

    def _powers(self) -> None:
        """Write powers of the radii, and h^β of every monomial as another one times one h, into the work buffer."""
        size = self.top + 3
        for which, name in enumerate(("inner", "outer", "middle", "half")):
            base, value = self.input(name), self.lanes.constant(1.0)
            for exponent in range(size):
                self.store(value, self.work("powers", str(which * size + exponent)))
                value = self.times(value, base)
        for exponent in range(size):
            self.store(
                self.minus(self.power(1, exponent), self.power(2, exponent)),
                self.work("powers", str(4 * size + exponent)),
            )
        self.store(self.lanes.constant(1.0), self.work("scale"))
        with self.loop(str(len(self.shape.longest.monomials)), "1") as b:
            parent, variable = (self.word(self.pointers["signs"], self.affine(b, 2, i)) for i in (0, 1))
            h = self.load(self.at(self.rows, self.integer("add", variable, str(self.shape.inputs["h"]))))
            self.store(self.times(self.load(self.work("scale", parent)), h), self.work("scale", b))

    # V ------------------------------------------------------------------------------------------
    def _value(self) -> None:
        layout = self.shape.value
        self.moved(layout, "value_table", self.integer("mul", self.face, str(layout.count)), "value", 0)
        lowest, growth = self.sum(), self.sum()
        for group, b, even in self.each(layout.groups):
            inner, slope, width = [self.zero] * 3
            for k, c in zip(group.degrees, self.coefficients(group, b, "value")):
                inner = self.fused(c, self.power(0, k), inner)
                times = self.times(self.lanes.constant(float(k)), c)
                slope = self.fused(times, self.power(2, k - 2), slope)
                width = self.fused(self.absolute(times), self.power(4, k - 2), width)
            if group.size == 0:
                self.add(lowest, inner)
                self.output("growth_at_centre", slope)
                self.add(growth, self.minus(slope, width))
            else:
                down, falls = (self.let(f"fneg {_VECTOR} {a}") if even else a for a in (inner, slope))
                self.add(lowest, self.largest(down, even), "fsub")
                self.add(growth, self.plus(self.largest(falls, even), width), "fsub")
        self.output("least_value", self.minus(self.load(lowest), self.input("value_rounding")))
        self.output("growth", self.minus(self.load(growth), self.input("growth_rounding")))
        self.value_tail, total = self.about_middle(layout, "value")
        self.output("value_range", self.load(total))

    # r ------------------------------------------------------------------------------------------
    def _inequality(self) -> None:
        shape = self.shape
        allowance = self.sum(self.input("rounding"))
        every, start = sum(layout.count for layout in shape.quotients), 0
        for j, layout in enumerate(shape.quotients):  # a bound of |Q_j|/ρ² on the cell
            base = self.affine(self.face, every, start)
            start += layout.count
            self.moved(layout, "quotient_table", base, "quotient", 1 + j)
            bound = self.sum()
            for group, b, _ in self.each(layout.groups):
                value = self.zero
                for k, c in zip(group.degrees, self.coefficients(group, b, "quotient")):
                    value = self.fused(self.absolute(c), self.power(1, k - 2), value)
                self.add(bound, value)
            error = self.times(self.input("error", j), self.lanes.constant(1.000001))
            self.add(allowance, self.times(self.load(bound), error))
        self.output("allowance", self.load(allowance))
        table, value, before = self.pointers["table"], self.zero, 0  # of A + Σ s_jm Q_j ℓᵐ on the face
        factors = [self.input("s", q) for q in range(len(shape.terms))]
        base = self.integer("mul", self.face, str(len(shape.columns)))
        for group in shape.whole.groups:
            size, places = len(group.degrees), [(part, place - group.offset) for part, place in shape.columns]
            columns = [(part, i) for part, i in places if 0 <= i < size]  # of one monomial
            with self.loop(str(group.count)) as b:
                start, target = self.affine(b, len(columns), base), self.affine(b, size, group.offset)
                for entry, (part, i) in enumerate(columns, before):
                    number = self.number(table, self.integer("add", start, str(entry)))
                    value = self.fused(factors[part - 1], number, value) if part else number
                    self.store(value, self.work("whole", self.integer("add", target, str(i))))
            before += len(columns) * group.count
        self.shift("whole", 1 + len(shape.quotients))
        self.tail, total = self.about_middle(shape.whole, "whole", 2)
        upper = self.plus(self.plus(self.load(total), self.load(self.tail)), self.load(allowance))
        self.output("upper", upper)
        lowest, centre, spread = map(self.result, ("least_value", "value", "value_range"))
        reaches = self.compare("ogt", self.plus(centre, spread), self.level)
        undecided = self.logical("xor", self.compare("olt", upper, self.zero), "splat (i1 true)")
        crossing = self.logical("and", undecided, reaches)
        with self.where(self.any(self.logical("and", crossing, self.compare("ole", lowest, self.level)))):
            self._multipliers(allowance)
        with self.where(self.any(undecided)):
            self._scores()

    def _multipliers(self, allowance: str) -> None:
        """The least bound of F + λ(c − V) with λ a ratio of linear coefficients, one for each variable."""
        shape = self.shape
        best = self.sum(self.lanes.constant(float("inf")))
        with self.loop(str(shape.states)) as candidate:
            place = self.integer("mul", candidate, str(self.top + 1))
            place = self.let(f"select i1 {self.let(f'icmp eq i64 {candidate}, 0')}, i64 1, i64 {place}")
            slope, growth = (self.load(self.work(name, place)) for name in ("low", "low_value"))
            ratio = self.real("fdiv", slope, growth)
            positive = self.compare("ogt", ratio, self.zero)
            small = self.compare("olt", ratio, self.lanes.constant(1e200))
            factor = self.select(self.logical("and", positive, small), ratio, self.zero)
            total = self.sum()
            for group, b, even in self.each(shape.whole.groups[: min(LOW, shape.value.degrees[-1]) + 1]):
                for p, (f, v) in enumerate(zip(self.kept("low", group, b), self.kept("low_value", group, b))):
                    value = self.minus(f, self.times(factor, v))
                    if group.size == 0 and p == 0:
                        self.add(total, self.fused(factor, self.level, value))
                    else:
                        self.add(total, self.largest(value, even and p % 2 == 0))
            self.add(total, self.plus(self.load(self.tail), self.load(allowance)))
            self.add(
                total, self.times(factor, self.plus(self.load(self.value_tail), self.input("value_rounding")))
            )
            bound, before = self.load(total), self.load(best)
            self.store(self.select(self.compare("olt", bound, before), bound, before), best)
        self.output("upper_inside", self.load(best))

    def _scores(self) -> None:
        """For each variable, how much its nonlinear coefficients add to the bound; a cell is split in the largest."""
        shape, d = self.shape, self.shape.directions
        scores = [self.sum() for _ in range(shape.states)]
        centre, *others = shape.whole.groups[: LOW + 1]
        for group, b, _ in self.each((*others, centre)):
            total = self.zero
            for p, value in enumerate(self.kept("low", group, b)):
                linear, size = group.size + p == 1, self.absolute(value)
                size = self.times(size, self.lanes.constant(0.25)) if linear else size
                if p:
                    self.add(scores[0], size)
                total = self.plus(total, size)
            self.store(total, self.work("weight", self.integer("add", b, str(group.first))))
        if d:
            masks = self.at(self.pointers["signs"], str(2 * len(shape.longest.monomials)), "i64")
            with self.loop(str(len(shape.whole.monomials)), "1") as b:
                weight = self.load(self.work("weight", b))
                for j in range(d):
                    self.add(scores[1 + j], self.times(weight, self.number(masks, self.affine(b, d, j))))
        for j, score in enumerate(scores):
            self.output("score", self.load(score), j)
