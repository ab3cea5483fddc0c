"""The machine code that bounds V and r on cells: LLVM text of loops over index tables, eight cells a vector.

What it computes, and why its results are bounds, is said in `flexhinf.certify.cells`. Arithmetic may be fused or not:
the allowance for rounding covers both. The text depends on the degrees of the polynomials alone, so the object code
is kept on disk like that of other kernels.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from flexhinf.certify.layouts import LANES, LOW, POINTERS, Group, Layout, Shape
from flexhinf.codegen.emit.opcodes import Lanes, ModuleText, Writer

_VECTOR = f"<{LANES} x double>"
_ATTRIBUTES = 'nounwind "min-legal-vector-width"="512" "prefer-vector-width"="512"'


def kernel_text(shape: Shape, entry: str) -> tuple[str, str]:
    """LLVM text of the entry and of the shift it calls."""
    module = ModuleText(Lanes(LANES))
    longest = max(1, *(layout.degrees[-1] for layout in (shape.whole, shape.value, *shape.quotients)))
    _write_shift(module, longest)
    _Kernel(module, shape).write(entry)
    return str(module), entry


class _Code(Writer):
    """Writing helpers: vectors in memory, loops, running sums."""

    zero = "zeroinitializer"

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

    def plus(self, a: str, b: str) -> str:
        return self.real("fadd", a, b)

    def minus(self, a: str, b: str) -> str:
        return self.real("fsub", a, b)

    def times(self, a: str, b: str) -> str:
        return self.real("fmul", a, b)

    def fused(self, a: str, b: str, c: str) -> str:
        """a b + c, fused where the processor can."""
        return self.intrinsic("fmuladd", a, b, c)

    def absolute(self, a: str) -> str:
        return self.intrinsic("fabs", a)

    def negative(self, a: str) -> str:
        return self.let(f"fneg {_VECTOR} {a}")

    def positive(self, a: str) -> str:
        """max(a, 0); of NaN, NaN."""
        return self.select(self.compare("ole", a, self.zero), self.zero, a)

    def constant(self, value: float) -> str:
        return self.lanes.constant(value)

    def integer(self, operation: str, a: str, b: str) -> str:
        return self.let(f"{operation} i64 {a}, {b}")

    @contextmanager
    def loop(self, count: str, start: str = "0") -> Iterator[str]:
        """A loop over the integers from `start` to `count`."""
        counter = self.allocate("i64")
        head, body, end = (self.label(what) for what in ("head", "body", "end"))
        self.do(f"store i64 {start}, ptr {counter}")
        self.do(f"br label %{head}")
        self.place(head)
        index = self.let(f"load i64, ptr {counter}")
        inside = self.let(f"icmp slt i64 {index}, {count}")
        self.do(f"br i1 {inside}, label %{body}, label %{end}")
        self.place(body)
        yield index
        self.do(f"store i64 {self.integer('add', index, '1')}, ptr {counter}")
        self.do(f"br label %{head}")
        self.place(end)

    @contextmanager
    def where(self, condition: str) -> Iterator[None]:
        yes, end = self.label("yes"), self.label("end")
        self.do(f"br i1 {condition}, label %{yes}, label %{end}")
        self.place(yes)
        yield
        self.do(f"br label %{end}")
        self.place(end)

    def sum(self, start: str = zero) -> _RunningSum:
        total = _RunningSum(self, self.allocate(_VECTOR))
        total.put(start)
        return total


@dataclass
class _RunningSum:
    """A vector on the stack that is added to."""

    code: _Code
    place: str

    def get(self) -> str:
        return self.code.load(self.place)

    def put(self, value: str) -> None:
        self.code.store(value, self.place)

    def add(self, value: str) -> None:
        self.put(self.code.plus(self.get(), value))

    def take(self, value: str) -> None:
        self.put(self.code.minus(self.get(), value))


def _finish(code: _Code, head: str, name: str) -> None:
    """Put a function that is written into the module."""
    code.module.definitions[name] = "\n".join([f"{head} {_ATTRIBUTES} {{", *code.first, *code.lines, "}"])


def _write_shift(module: ModuleText, longest: int) -> None:
    """shift(coefficients, segments, lines, t, first, last): P(t + a) by synthetic division, line after line.

    A segment is (variable, length, number of lines, place of the lines); a line has length + 1 places of coefficients.
    """
    code = _Code(module)
    with code.loop("%last", "%first") as index:
        row = code.integer("mul", index, "4")
        variable, length, count, start = (
            code.word("%segments", code.integer("add", row, str(i))) for i in range(4)
        )
        a = code.load(code.at("%t", variable))
        done = code.label("done")
        labels = [code.label(f"length{L}_") for L in range(1, longest + 1)]
        cases = " ".join(f"i64 {L}, label %{label}" for L, label in enumerate(labels, 1))
        code.do(f"switch i64 {length}, label %{done} [ {cases} ]")
        for L, label in enumerate(labels, 1):
            code.place(label)
            with code.loop(count) as line:
                base = code.integer("add", start, code.integer("mul", line, str(L + 1)))
                places = []
                for p in range(L + 1):
                    pointer = code.at("%lines", code.integer("add", base, str(p)), "i32")
                    narrow = code.let(f"load i32, ptr {pointer}, align 4")
                    places.append(code.at("%coefficients", code.let(f"zext i32 {narrow} to i64")))
                values = [code.load(place) for place in places]
                for i in range(L):
                    for p in range(L - 1, i - 1, -1):
                        values[p] = code.fused(a, values[p + 1], values[p])
                for p in range(L):
                    code.store(values[p], places[p])
            code.do(f"br label %{done}")
        code.place(done)
    code.do("ret void")
    arguments = "ptr noalias %coefficients, ptr noalias %segments, ptr noalias %lines, ptr noalias %t"
    _finish(code, f"define internal void @shift({arguments}, i64 %first, i64 %last) noinline", "shift")


class _Kernel:
    """The entry's text: rows, tables and buffers of a group of cells, and what is done to polynomials in them."""

    pointers: dict[str, str]
    rows: str
    out: str

    def __init__(self, module: ModuleText, shape: Shape) -> None:
        self.shape, self.code = shape, _Code(module)
        self.inputs, self.outputs, self.places = shape.input_rows, shape.output_rows, shape.work_places()
        self.top = max(shape.whole.degrees[-1] - 2, shape.value.degrees[-1])  # highest power of ρ

    def input(self, name: str, index: int = 0) -> str:
        return self.code.load(self.code.at(self.rows, str(self.inputs[name] + index)))

    def output(self, name: str, value: str, index: int = 0) -> None:
        self.code.store(value, self.code.at(self.out, str(self.outputs[name] + index)))

    def work(self, name: str, index: str = "0") -> str:
        place = self.code.integer("add", str(self.places[name]), index)
        return self.code.at(self.pointers["work"], place)

    def power(self, which: int, exponent: int) -> str:
        """inner, outer, middle, half, outer − middle (of the powers), to an exponent."""
        return self.code.load(self.work("powers", str(which * (self.top + 3) + exponent)))

    def powers(self) -> None:
        """Powers of the radii into the work buffer."""
        code, size = self.code, self.top + 3
        for which, name in enumerate(("inner", "outer", "middle", "half")):
            base, value = self.input(name), code.constant(1.0)
            for exponent in range(size):
                code.store(value, self.work("powers", str(which * size + exponent)))
                value = code.times(value, base)
        for exponent in range(size):
            difference = code.minus(self.power(1, exponent), self.power(2, exponent))
            code.store(difference, self.work("powers", str(4 * size + exponent)))

    def scales(self) -> None:
        """h^β for every monomial: each is another one times one h."""
        code, layout = self.code, self.shape.longest
        code.store(code.constant(1.0), self.work("scale"))
        with code.loop(str(len(layout.monomials)), "1") as b:
            parent = code.word(self.pointers["signs"], code.integer("mul", b, "2"))
            variable = code.word(
                self.pointers["signs"], code.integer("add", code.integer("mul", b, "2"), "1")
            )
            h = code.load(code.at(self.rows, code.integer("add", variable, str(self.inputs.get("h", 0)))))
            code.store(code.times(code.load(self.work("scale", parent)), h), self.work("scale", b))

    def shift(self, place: str, number: int) -> None:
        """Re-expand a polynomial about the middle of the box of directions."""
        code = self.code
        bounds = [code.word(self.pointers["segments"], str(number + i)) for i in range(2)]
        header = 2 + len(self.shape.quotients) + 1
        segments = code.at(self.pointers["segments"], str(header), "i64")
        arguments = f"ptr {self.work(place)}, ptr {segments}, ptr {self.pointers['lines']}, ptr {self.rows}"
        code.do(f"call void @shift({arguments}, i64 {bounds[0]}, i64 {bounds[1]})")

    def copy(self, layout: Layout, table: str, base: str, place: str) -> None:
        """Coefficients of the face in every lane."""
        code = self.code
        with code.loop(str(layout.count)) as i:
            code.store(code.number(table, code.integer("add", base, i)), self.work(place, i))

    def each(self, group: Group) -> Iterator[tuple[str, bool]]:
        """Loops over the monomials of a group: those with even exponents, then the others."""
        for start, end, even in ((0, group.even, True), (group.even, group.count, False)):
            if end > start:
                with self.code.loop(str(end), str(start)) as b:
                    yield b, even

    def coefficients(self, group: Group, b: str, place: str) -> list[str]:
        """The coefficients of one monomial, by degree, in the cell's own variables."""
        code = self.code
        scale = code.load(self.work("scale", code.integer("add", b, str(group.first))))
        start = code.integer("add", code.integer("mul", b, str(len(group.degrees))), str(group.offset))
        return [
            code.times(code.load(self.work(place, code.integer("add", start, str(i)))), scale)
            for i in range(len(group.degrees))
        ]

    def keep(self, place: str, group: Group, b: str, power: int, value: str) -> None:
        """A coefficient of ρ for one of the low monomials."""
        start = self.code.integer("mul", self.code.integer("add", b, str(group.first)), str(self.top + 1))
        self.code.store(value, self.work(place, self.code.integer("add", start, str(power))))

    def kept(self, place: str, group: Group, b: str) -> list[str]:
        code = self.code
        start = code.integer("mul", code.integer("add", b, str(group.first)), str(self.top + 1))
        return [code.load(self.work(place, code.integer("add", start, str(p)))) for p in range(self.top + 1)]

    def about_middle(self, values: list[str], highest: int) -> list[str]:
        """A polynomial in ρ about the middle of the cell, scaled by its half width."""
        code, middle = self.code, self.power(2, 1)
        values = list(values)
        for i in range(highest):
            for p in range(highest - 1, i - 1, -1):
                values[p] = code.fused(middle, values[p + 1], values[p])
        return [v if p == 0 or p > highest else code.times(v, self.power(3, p)) for p, v in enumerate(values)]

    # The entry -----------------------------------------------------------------------------------
    def write(self, entry: str) -> None:
        code = self.code
        self.words = {name: code.word("%context", str(i)) for i, name in enumerate(POINTERS)}
        self.pointers = {name: code.let(f"inttoptr i64 {word} to ptr") for name, word in self.words.items()}
        self.level = code.number(self.pointers["level"], "0")
        with code.loop(self.words["last"], self.words["first"]) as group:
            self.rows = code.at(
                self.pointers["inputs"], code.integer("mul", group, str(self.inputs["count"]))
            )
            self.out = code.at(
                self.pointers["outputs"], code.integer("mul", group, str(self.outputs["count"]))
            )
            self.face = code.word(self.pointers["faces"], group)
            self._group()
        code.do("ret i64 0")
        _finish(code, f"define i64 @{entry}(ptr %context)", entry)

    # The group ----------------------------------------------------------------------------------
    def _group(self) -> None:
        code = self.code
        self.powers()
        self.scales()
        self._value()
        outside = code.compare(
            "ogt", code.load(code.at(self.out, str(self.outputs["least_value"]))), self.level
        )
        for name in ("upper", "upper_inside"):
            self.output(name, code.constant(float("inf")))
        full = f"llvm.vector.reduce.and.v{LANES}i1"
        every = code.let(f"call i1 @{full}(<{LANES} x i1> {outside})")
        code.module.declarations[full] = f"declare i1 @{full}(<{LANES} x i1>)"
        with code.where(code.let(f"xor i1 {every}, true")):
            self._inequality()

    # V ------------------------------------------------------------------------------------------
    def _value(self) -> None:
        code, layout = self.code, self.shape.value
        self.copy(
            layout, self.pointers["value_table"], code.integer("mul", self.face, str(layout.count)), "value"
        )
        self.shift("value", 0)
        least, growth, spread = code.sum(), code.sum(), code.sum()
        for group in layout.groups:
            for b, even in self.each(group):
                found = self.coefficients(group, b, "value")
                inner, slope, width = code.zero, code.zero, code.zero
                high, high_width = code.zero, code.zero
                for k, c in zip(group.degrees, found):
                    size = code.absolute(c)
                    inner = code.fused(c, self.power(0, k), inner)
                    times = code.times(code.constant(float(k)), c)
                    slope = code.fused(times, self.power(2, k - 2), slope)
                    width = code.fused(code.absolute(times), self.power(4, k - 2), width)
                    if group.size > LOW:
                        high = code.fused(c, self.power(2, k), high)
                        high_width = code.fused(size, self.power(4, k), high_width)
                if group.size == 0:
                    least.add(inner)
                    self.output("growth_at_centre", slope)
                    growth.add(code.minus(slope, width))
                else:
                    least.take(code.positive(code.negative(inner)) if even else code.absolute(inner))
                    smaller = code.positive(code.negative(slope)) if even else code.absolute(slope)
                    growth.take(code.plus(smaller, width))
                if group.size > LOW:
                    spread.add(code.plus(code.absolute(high), high_width))
                else:
                    for p in range(self.top + 1):
                        value = found[group.degrees.index(p)] if p in group.degrees else code.zero
                        self.keep("low_value", group, b, p, value)
        self.output("least_value", code.minus(least.get(), self.input("value_rounding")))
        self.output("growth", code.minus(growth.get(), self.input("growth_rounding")))
        self.value_tail = spread
        self._centre_value()

    def _centre_value(self) -> None:
        """V about the middle of the cell: its value there, and a bound of how far it goes from it."""
        code, highest = self.code, self.shape.value.degrees[-1]
        spread = self.value_tail.get()
        total = code.sum(spread)
        for group in self.shape.value.groups:
            if group.size > LOW:
                continue
            for b, _ in self.each(group):
                moved = self.about_middle(self.kept("low_value", group, b), highest)
                for p, value in enumerate(moved):
                    self.keep("low_value", group, b, p, value)
                    if group.size == 0 and p == 0:
                        self.output("value", value)
                    elif p <= highest:
                        total.add(code.absolute(value))
        self.output("value_range", total.get())

    # r ------------------------------------------------------------------------------------------
    def _inequality(self) -> None:
        code, shape = self.code, self.shape
        allowance = code.sum(self.input("rounding"))
        for j, layout in enumerate(shape.quotients):
            bound = self._quotient_bound(j, layout)
            allowance.add(code.times(bound, code.times(self.input("error", j), code.constant(1.000001))))
        self.output("allowance", allowance.get())
        self._load_whole()
        self.shift("whole", 1 + len(shape.quotients))
        self.tail, total = code.sum(), code.sum()
        for group in shape.whole.groups:
            self._whole_group(group, total)
        upper = code.plus(code.plus(total.get(), self.tail.get()), allowance.get())
        self.output("upper", upper)
        least, centre, spread = (
            code.load(code.at(self.out, str(self.outputs[name])))
            for name in ("least_value", "value", "value_range")
        )
        reaches = code.compare("ogt", code.plus(centre, spread), self.level)
        undecided = code.let(f"xor <{LANES} x i1> {code.compare('olt', upper, code.zero)}, splat (i1 true)")
        crossing = code.let(f"and <{LANES} x i1> {undecided}, {reaches}")
        begun = code.compare("ole", least, self.level)
        wanted = code.any(code.let(f"and <{LANES} x i1> {crossing}, {begun}"))
        with code.where(wanted):
            self._multipliers(allowance)
        with code.where(code.any(undecided)):
            self._scores()

    def _quotient_bound(self, j: int, layout: Layout) -> str:
        """A bound of |Q_j|/ρ² on the cell."""
        code = self.code
        start = sum(self.shape.quotients[i].count for i in range(j))
        every = sum(layout.count for layout in self.shape.quotients)
        base = code.integer("add", code.integer("mul", self.face, str(every)), str(start))
        self.copy(layout, self.pointers["quotient_table"], base, "quotient")
        self.shift("quotient", 1 + j)
        total = code.sum()
        for group in layout.groups:
            for b, _ in self.each(group):
                value = code.zero
                for k, c in zip(group.degrees, self.coefficients(group, b, "quotient")):
                    value = code.fused(code.absolute(c), self.power(1, k - 2), value)
                total.add(value)
        return total.get()

    def _load_whole(self) -> None:
        """A + Σ s_jm Q_j ℓᵐ on the face."""
        code, shape = self.code, self.shape
        factors = [self.input("s", q) for q in range(len(shape.terms))]
        size = shape.table_size
        base = code.integer("mul", self.face, str(size))
        offset = 0
        for group in shape.whole.groups:
            chosen = [[q for q, degrees in enumerate(shape.terms) if k in degrees] for k in group.degrees]
            entries = sum(1 + len(q) for q in chosen)
            with code.loop(str(group.count)) as b:
                start = code.integer("add", base, code.integer("mul", b, str(entries)))
                entry = offset
                target = code.integer(
                    "add", code.integer("mul", b, str(len(group.degrees))), str(group.offset)
                )
                for i, quotients in enumerate(chosen):
                    value = code.number(self.pointers["table"], code.integer("add", start, str(entry)))
                    for q in quotients:
                        entry += 1
                        number = code.number(self.pointers["table"], code.integer("add", start, str(entry)))
                        value = code.fused(factors[q], number, value)
                    entry += 1
                    code.store(value, self.work("whole", code.integer("add", target, str(i))))
            offset += entries * group.count

    def _whole_group(self, group: Group, total: _RunningSum) -> None:
        code, highest = self.code, self.shape.whole.degrees[-1] - 2
        for b, even in self.each(group):
            found = self.coefficients(group, b, "whole")
            if group.size > LOW:
                value, width = code.zero, code.zero
                for k, c in zip(group.degrees, found):
                    value = code.fused(c, self.power(2, k - 2), value)
                    width = code.fused(code.absolute(c), self.power(4, k - 2), width)
                self.tail.add(code.plus(code.positive(value) if even else code.absolute(value), width))
                weight = self.work("weight", code.integer("add", b, str(group.first)))
                code.store(code.plus(code.absolute(value), width), weight)
                continue
            values = [
                found[group.degrees.index(p + 2)] if p + 2 in group.degrees else code.zero
                for p in range(self.top + 1)
            ]
            for p, value in enumerate(self.about_middle(values, highest)):
                self.keep("low", group, b, p, value)
                if group.size == 0 and p == 0:
                    self.output("centre", value)
                    total.add(value)
                elif p <= highest:
                    total.add(code.positive(value) if even and p % 2 == 0 else code.absolute(value))

    def _multipliers(self, allowance: _RunningSum) -> None:
        """The least bound of F + λ(c − V) with λ a ratio of linear coefficients, one for each variable."""
        code, shape = self.code, self.shape
        groups = [group for group in shape.whole.groups if group.size <= min(LOW, shape.value.degrees[-1])]
        best = code.sum(code.constant(float("inf")))
        width = str(self.top + 1)
        with code.loop(str(shape.states)) as candidate:
            place = code.integer("mul", candidate, width)
            first = code.let(f"icmp eq i64 {candidate}, 0")
            place = code.let(f"select i1 {first}, i64 1, i64 {place}")
            slope, growth = (code.load(self.work(name, place)) for name in ("low", "low_value"))
            ratio = code.real("fdiv", slope, growth)
            good = code.let(
                f"and <{LANES} x i1> {code.compare('ogt', ratio, code.zero)}, "
                f"{code.compare('olt', ratio, code.constant(1e200))}"
            )
            factor = code.select(good, ratio, code.zero)
            total = code.sum()
            for group in groups:
                for b, even in self.each(group):
                    pairs = zip(self.kept("low", group, b), self.kept("low_value", group, b))
                    for p, (f, v) in enumerate(pairs):
                        value = code.minus(f, code.times(factor, v))
                        if group.size == 0 and p == 0:
                            total.add(code.fused(factor, self.level, value))
                        else:
                            total.add(code.positive(value) if even and p % 2 == 0 else code.absolute(value))
            total.add(code.plus(self.tail.get(), allowance.get()))
            rounding = code.plus(self.value_tail.get(), self.input("value_rounding"))
            total.add(code.times(factor, rounding))
            bound = total.get()
            best.put(code.select(code.compare("olt", bound, best.get()), bound, best.get()))
        self.output("upper_inside", best.get())

    def _scores(self) -> None:
        """How much each variable's nonlinear coefficients add to the bound: what a cell is split by."""
        code, shape = self.code, self.shape
        scores = [code.sum() for _ in range(shape.states)]
        for group in shape.whole.groups:
            if group.size > LOW or group.size == 0:
                continue
            for b, _ in self.each(group):
                total = code.zero
                for p, value in enumerate(self.kept("low", group, b)):
                    size = code.absolute(value)
                    if p:
                        scores[0].add(size)
                    total = code.plus(
                        total, code.times(size, code.constant(0.25)) if group.size + p == 1 else size
                    )
                code.store(total, self.work("weight", code.integer("add", b, str(group.first))))
        centre = shape.whole.groups[0]
        for p, value in enumerate(self.kept("low", centre, "0")):
            if p:
                scores[0].add(code.times(code.absolute(value), code.constant(0.25 if p == 1 else 1.0)))
        masks = code.at(self.pointers["signs"], str(2 * len(shape.longest.monomials)), "i64")
        d = shape.directions
        if d:
            with code.loop(str(len(shape.whole.monomials)), "1") as b:
                weight = code.load(self.work("weight", b))
                for j in range(d):
                    row = code.integer("add", code.integer("mul", b, str(d)), str(j))
                    scores[1 + j].add(code.times(weight, code.number(masks, row)))
        for j, score in enumerate(scores):
            self.output("score", score.get(), j)
