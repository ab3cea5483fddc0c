"""The machine code that bounds V and r on cells: LLVM text of loops over index tables, eight cells a vector.

What it computes, and why its results are bounds, is said in `flexhinf.certify.cells`. Arithmetic may be fused or not:
the allowance for rounding covers both. The text depends on the degrees of the polynomials alone, so the object code
is kept on disk like that of other kernels.
"""

from __future__ import annotations

from flexhinf.certify.kernel_code import (
    LANES,
    LOW,
    POINTERS,
    Group,
    KernelFrame,
    Layout,
    RunningSum,
    Shape,
    finish,
    longest_layout,
    table_size,
    write_shift,
)
from flexhinf.codegen.emit.text import Lanes, ModuleText


def kernel_text(shape: Shape, entry: str) -> tuple[str, str]:
    """LLVM text of the entry and of the shift it calls."""
    module = ModuleText(Lanes(LANES))
    longest = max(
        shape.whole.degrees[-1], shape.value.degrees[-1], *(q.degrees[-1] for q in shape.quotients), 1
    )
    write_shift(module, longest)
    _Kernel(module, shape).write(entry)
    return str(module), entry


class _Kernel(KernelFrame):
    """The entry's text, part by part."""

    def write(self, entry: str) -> None:
        code = self.code
        self.words = {name: code.word("%context", str(i)) for i, name in enumerate(POINTERS)}
        self.pointers = {name: code.let(f"inttoptr i64 {word} to ptr") for name, word in self.words.items()}
        level = code.number(self.pointers["level"], "0")
        with code.loop(self.words["last"], self.words["first"]) as group:
            self.rows = code.at(
                self.pointers["inputs"], code.integer("mul", group, str(self.inputs["count"]))
            )
            self.out = code.at(
                self.pointers["outputs"], code.integer("mul", group, str(self.outputs["count"]))
            )
            self.face = code.word(self.pointers["faces"], group)
            self.level = level
            self._group()
        code.do("ret i64 0")
        finish(code, f"define i64 @{entry}(ptr %context)", entry)

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
        every = code.let(f"call i1 @llvm.vector.reduce.and.v{LANES}i1(<{LANES} x i1> {outside})")
        full = f"llvm.vector.reduce.and.v{LANES}i1"
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

            def body(b: str, even: bool, group: Group = group) -> None:
                found = self.coefficients(group, b, "value")
                inner, slope, width = code.zero(), code.zero(), code.zero()
                high, high_width = code.zero(), code.zero()
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
                        value = found[group.degrees.index(p)] if p in group.degrees else code.zero()
                        self.keep("low_value", group, b, p, value)

            self.each(group, body)
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

            def body(b: str, even: bool, group: Group = group) -> None:
                moved = self.about_middle(self.kept("low_value", group, b), highest)
                for p, value in enumerate(moved):
                    self.keep("low_value", group, b, p, value)
                    if group.size == 0 and p == 0:
                        self.output("value", value)
                    elif p <= highest:
                        total.add(code.absolute(value))

            self.each(group, body)
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
        undecided = code.let(f"xor <{LANES} x i1> {code.compare('olt', upper, code.zero())}, splat (i1 true)")
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

            def body(b: str, even: bool, group: Group = group) -> None:
                value = code.zero()
                for k, c in zip(group.degrees, self.coefficients(group, b, "quotient")):
                    value = code.fused(code.absolute(c), self.power(1, k - 2), value)
                total.add(value)

            self.each(group, body)
        return total.get()

    def _load_whole(self) -> None:
        """A + Σ s_jm Q_j ℓᵐ on the face."""
        code, shape = self.code, self.shape
        factors = [self.input("s", q) for q in range(len(shape.terms))]
        size = table_size(shape)
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

    def _whole_group(self, group: Group, total: RunningSum) -> None:
        code, highest = self.code, self.shape.whole.degrees[-1] - 2

        def high(b: str, even: bool) -> None:
            value, width = code.zero(), code.zero()
            for k, c in zip(group.degrees, self.coefficients(group, b, "whole")):
                value = code.fused(c, self.power(2, k - 2), value)
                width = code.fused(code.absolute(c), self.power(4, k - 2), width)
            self.tail.add(code.plus(code.positive(value) if even else code.absolute(value), width))
            weight = self.work("weight", code.integer("add", b, str(group.first)))
            code.store(code.plus(code.absolute(value), width), weight)

        def low(b: str, even: bool) -> None:
            found = self.coefficients(group, b, "whole")
            values = [
                found[group.degrees.index(p + 2)] if p + 2 in group.degrees else code.zero()
                for p in range(self.top + 1)
            ]
            moved = self.about_middle(values, highest)
            for p, value in enumerate(moved):
                self.keep("low", group, b, p, value)
                if group.size == 0 and p == 0:
                    self.output("centre", value)
                    total.add(value)
                elif p <= highest:
                    total.add(code.positive(value) if even and p % 2 == 0 else code.absolute(value))

        self.each(group, low if group.size <= LOW else high)

    def _multipliers(self, allowance: RunningSum) -> None:
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
                f"and <{LANES} x i1> {code.compare('ogt', ratio, code.zero())}, "
                f"{code.compare('olt', ratio, code.constant(1e200))}"
            )
            factor = code.select(good, ratio, code.zero())
            total = code.sum()
            for group in groups:

                def body(b: str, even: bool, group: Group = group) -> None:
                    pairs = zip(self.kept("low", group, b), self.kept("low_value", group, b))
                    for p, (f, v) in enumerate(pairs):
                        value = code.minus(f, code.times(factor, v))
                        if group.size == 0 and p == 0:
                            total.add(code.fused(factor, self.level, value))
                        else:
                            total.add(code.positive(value) if even and p % 2 == 0 else code.absolute(value))

                self.each(group, body)
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

            def low(b: str, even: bool, group: Group = group) -> None:
                total = code.zero()
                for p, value in enumerate(self.kept("low", group, b)):
                    size = code.absolute(value)
                    if p:
                        scores[0].add(size)
                    total = code.plus(
                        total, code.times(size, code.constant(0.25)) if group.size + p == 1 else size
                    )
                code.store(total, self.work("weight", code.integer("add", b, str(group.first))))

            self.each(group, low)
        centre = shape.whole.groups[0]
        for p, value in enumerate(self.kept("low", centre, "0")):
            if p:
                scores[0].add(code.times(code.absolute(value), code.constant(0.25 if p == 1 else 1.0)))
        masks = code.at(self.pointers["signs"], str(2 * len(longest_layout(shape).monomials)), "i64")
        d = shape.directions
        if d:
            with code.loop(str(len(shape.whole.monomials)), "1") as b:
                weight = code.load(self.work("weight", b))
                for j in range(d):
                    row = code.integer("add", code.integer("mul", b, str(d)), str(j))
                    scores[1 + j].add(code.times(weight, code.number(masks, row)))
        for j, score in enumerate(scores):
            self.output("score", score.get(), j)
