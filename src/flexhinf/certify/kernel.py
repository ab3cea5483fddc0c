"""The machine code that bounds V and r on cells: loops over index tables, eight cells a vector.

What it computes, and why its results are bounds, is said in `flexhinf.certify.cells`. Arithmetic may be fused or not:
the allowance for rounding covers both. The text depends on the degrees of the polynomials alone, so the object code
is kept on disk like that of other kernels.

On a face z_f = ±ρ, z_j = ρ t_j of a cube, P = Σ_k ρᵏ P_k(t). A coefficient belongs to a degree k and a monomial tᵝ,
|β| ≤ k. Monomials stand in groups by |β|, those with even exponents only first; the degrees of one monomial stand
together.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cache
from itertools import groupby, product
from typing import NamedTuple

import numpy as np

from flexhinf.codegen.loops import (
    DOUBLE,
    INT,
    LONG,
    VECTOR,
    LoopText,
    LoopVariable,
    NativeFunction,
    Value,
    new_module,
)

LOW = 3  # monomials through this degree are kept as polynomials in ρ; the others only bounded

#: What the kernel is given, in this order: its groups of cells, arrays, and a number. Addresses begin with capitals.
_FIELDS = (
    "first last Faces Inputs Outputs Work =level Value_table Quotient_table Table Segments Lines Links Masks"
)
TASK = tuple(name.lstrip("=").lower() for name in _FIELDS.split())

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
        result = list[tuple[int, int, np.ndarray]]()
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


def kernel_of(shape: CellShape) -> NativeFunction:
    """The function with the fields `TASK`, and the shift that it calls."""
    layouts = (shape.whole, shape.value, *shape.quotients)
    text = LoopText("bound_cells", _FIELDS, module=new_module())
    _shift(LoopText("shift", "Coefficients Segments Lines T first last", True, text.module), layouts)
    _CellKernel(text, shape).write()
    return NativeFunction(text)


def _largest(a: Value, even: bool) -> Value:
    """The largest a s for 0 ≤ s ≤ 1, or for |s| ≤ 1; of NaN, NaN."""
    return a.compare("ole", 0.0).choose(a.text.number(0.0, VECTOR), a) if even else abs(a)


def _moved_by(a: Value, values: list[Value], degree: int) -> list[Value]:
    """The coefficients of P(t + a), by synthetic division."""
    for i in range(degree):
        for p in range(degree - 1, i - 1, -1):
            values[p] = a.text.fused(a, values[p + 1], values[p])
    return values


def _shift(text: LoopText, layouts: Sequence[MonomialLayout]) -> None:
    """P(t + a) by synthetic division, line after line.

    A segment is (variable, length, number of lines, place of the lines); a line has length + 1 places of
    coefficients.
    """
    coefficients, segments, lines, t, first, last = text.fields()
    with text.loop(first, last) as index:
        variable, length, count, start = (segments.load(LONG, index * 4 + i) for i in range(4))
        a = t.row(variable)
        for some in text.cases(length, max(1, *(layout.degrees[-1] for layout in layouts))):
            with text.loop(0, count) as line:
                base = line * (some + 1) + start
                places = [lines.load(INT, base + p) for p in range(some + 1)]
                values = _moved_by(a, [coefficients.row(place) for place in places], some)
                for value, place in zip(values[:some], places):
                    coefficients.set_row(value, place)
    text.finish()


class _CellKernel:
    """The text of the kernel: rows, tables and buffers of a group of cells, and what is done to the polynomials in
    them."""

    def __init__(self, text: LoopText, shape: CellShape) -> None:
        self.text, self.shape = text, shape
        self.top = max(shape.whole.degrees[-1] - 2, shape.value.degrees[-1])  # highest power of ρ
        self.zero = text.number(0.0, VECTOR)

    def constant(self, value: float) -> Value:
        return self.text.number(value, VECTOR)

    def input(self, name: str, index: int = 0) -> Value:
        return self.rows.row(self.shape.inputs[name] + index)

    def output(self, name: str, value: Value, index: int = 0) -> None:
        self.out.set_row(value, self.shape.outputs[name] + index)

    def result(self, name: str) -> Value:
        return self.out.row(self.shape.outputs[name])

    def work(self, name: str, index: Value | int = 0) -> Value:
        """The address of a row of a part of the work buffer."""
        return self.memory.at(VECTOR, index + self.shape.work[name])

    def power(self, which: int, exponent: int) -> Value:
        """inner, outer, middle, half, outer − middle (of the powers), to an exponent."""
        return self.work("powers", which * (self.top + 3) + exponent).row()

    def moved(self, layout: MonomialLayout, table: Value, place: str, number: int) -> None:
        """Coefficients of the face in every lane, re-expanded about the middle of the box of directions."""
        with self.text.loop(0, layout.count) as i:
            self.work(place, i).set_row(table.load(DOUBLE, i).all_lanes())
        self.shift(place, number)

    def shift(self, place: str, number: int) -> None:
        bounds = [self.segments.load(LONG, number + i) for i in range(2)]
        segments = self.segments.at(LONG, len(self.shape.quotients) + 3)
        self.text.call("shift", self.work(place), segments, self.places, self.rows, *bounds)

    def each(self, groups: Sequence[MonomialGroup]) -> Iterator[tuple[MonomialGroup, Value, bool]]:
        """Loops over the monomials of groups: of each first those with even exponents, then the others."""
        for group in groups:
            for start, end, even in ((0, group.even, True), (group.even, group.count, False)):
                if end > start:
                    with self.text.loop(start, end) as b:
                        yield group, b, even

    def coefficients(self, group: MonomialGroup, b: Value, place: str) -> list[Value]:
        scale = self.work("scale", b + group.first).row()
        start, count = b * len(group.degrees) + group.offset, len(group.degrees)
        return [self.work(place, start + i).row() * scale for i in range(count)]

    def low_place(self, place: str, group: MonomialGroup, b: Value, power: int) -> Value:
        return self.work(place, (b + group.first) * (self.top + 1) + power)

    def kept(self, place: str, group: MonomialGroup, b: Value) -> list[Value]:
        return [self.low_place(place, group, b, p).row() for p in range(self.top + 1)]

    def about_middle(
        self, layout: MonomialLayout, place: str, lift: int = 0
    ) -> tuple[LoopVariable, LoopVariable]:
        """V, or with `lift` 2 r/ρ², about the middle of the cell in the cell's own variables.

        The value there is an output, the low coefficients stand in their buffer. Returned are sums of what the others
        can add to it, at most: of those that are not kept, and of the low ones; for V to both sides, and of all.
        """
        low, output = ("low", "centre") if lift else ("low_value", "value")
        highest, tail, fused = layout.degrees[-1] - lift, self.text.sum(), self.text.fused
        for group, b, even in self.each(layout.groups[LOW + 1 :]):
            value, width = self.zero, self.zero
            for k, c in zip(group.degrees, self.coefficients(group, b, place)):
                value = fused(c, self.power(2, k - lift), value)
                width = fused(abs(c), self.power(4, k - lift), width)
            tail.add(_largest(value, even and lift > 0) + width)
            if lift:
                self.work("weight", b + group.first).set_row(abs(value) + width)
        total, middle = self.text.variable(self.zero if lift else tail.get()), self.power(2, 1)
        for group, b, even in self.each(layout.groups[: LOW + 1]):
            by_degree = dict(zip(group.degrees, self.coefficients(group, b, place)))
            values = [by_degree.get(p + lift, self.zero) for p in range(self.top + 1)]
            for p, value in enumerate(_moved_by(middle, values, highest)):
                scaled = value if p == 0 or p > highest else value * self.power(3, p)
                self.low_place(low, group, b, p).set_row(scaled)
                if centre := group.size == 0 and p == 0:
                    self.output(output, scaled)
                if p <= highest and (lift or not centre):
                    total.add(scaled if centre else _largest(scaled, even and p % 2 == 0 and lift > 0))
        return tail, total

    def write(self) -> None:
        """The text of the entry."""
        text = self.text
        first, last, faces, inputs, outputs, self.memory, level, *tables = text.fields()
        value, quotients, whole, self.segments, self.places, self.links, self.masks = tables
        self.level = level.all_lanes()
        with text.loop(first, last) as group:
            self.rows = inputs.at(VECTOR, group * self.shape.inputs["count"])
            self.out = outputs.at(VECTOR, group * self.shape.outputs["count"])
            face = faces.load(LONG, group)
            self._powers()
            self._value(value.at(DOUBLE, face * self.shape.value.count))
            for name in ("upper", "upper_inside"):
                self.output(name, self.constant(float("inf")))
            with text.when(self.result("least_value").compare("ule", self.level).somewhere()):
                every = sum(layout.count for layout in self.shape.quotients)
                self._inequality(
                    quotients.at(DOUBLE, face * every), whole.at(DOUBLE, face * len(self.shape.columns))
                )

    def _powers(self) -> None:
        """Write powers of the radii, and h^β of every monomial as another one times one h, into the work buffer."""
        size = self.top + 3
        for which, name in enumerate(("inner", "outer", "middle", "half")):
            base, value = self.input(name), self.constant(1.0)
            for exponent in range(size):
                self.work("powers", which * size + exponent).set_row(value)
                value = value * base
        for exponent in range(size):
            difference = self.power(1, exponent) - self.power(2, exponent)
            self.work("powers", 4 * size + exponent).set_row(difference)
        self.work("scale").set_row(self.constant(1.0))
        with self.text.loop(1, len(self.shape.longest.monomials)) as b:
            parent, variable = (self.links.load(LONG, b * 2 + i) for i in (0, 1))
            h = self.rows.row(variable + self.shape.inputs["h"])
            self.work("scale", b).set_row(self.work("scale", parent).row() * h)

    # V ------------------------------------------------------------------------------------------
    def _value(self, table: Value) -> None:
        layout, fused = self.shape.value, self.text.fused
        self.moved(layout, table, "value", 0)
        lowest, growth = self.text.sum(), self.text.sum()
        for group, b, even in self.each(layout.groups):
            inner, slope, width = [self.zero] * 3
            for k, c in zip(group.degrees, self.coefficients(group, b, "value")):
                inner = fused(c, self.power(0, k), inner)
                times = self.constant(float(k)) * c
                slope = fused(times, self.power(2, k - 2), slope)
                width = fused(abs(times), self.power(4, k - 2), width)
            if group.size == 0:
                lowest.add(inner)
                self.output("growth_at_centre", slope)
                growth.add(slope - width)
            else:
                down, falls = (-a if even else a for a in (inner, slope))
                lowest.set(lowest.get() - _largest(down, even))
                growth.set(growth.get() - (_largest(falls, even) + width))
        self.output("least_value", lowest.get() - self.input("value_rounding"))
        self.output("growth", growth.get() - self.input("growth_rounding"))
        self.value_tail, total = self.about_middle(layout, "value")
        self.output("value_range", total.get())

    # r ------------------------------------------------------------------------------------------
    def _inequality(self, quotients: Value, table: Value) -> None:
        shape, fused = self.shape, self.text.fused
        allowance, start = self.text.variable(self.input("rounding")), 0
        for j, layout in enumerate(shape.quotients):  # a bound of |Q_j|/ρ² on the cell
            self.moved(layout, quotients.at(DOUBLE, start), "quotient", 1 + j)
            start += layout.count
            bound = self.text.sum()
            for group, b, _ in self.each(layout.groups):
                value = self.zero
                for k, c in zip(group.degrees, self.coefficients(group, b, "quotient")):
                    value = fused(abs(c), self.power(1, k - 2), value)
                bound.add(value)
            error = self.input("error", j) * self.constant(1.000001)
            allowance.add(bound.get() * error)
        self.output("allowance", allowance.get())
        value, before = self.zero, 0  # of A + Σ s_jm Q_j ℓᵐ on the face
        factors = [self.input("s", q) for q in range(len(shape.terms))]
        for group in shape.whole.groups:
            size, places = len(group.degrees), [(part, place - group.offset) for part, place in shape.columns]
            columns = [(part, i) for part, i in places if 0 <= i < size]  # of one monomial
            with self.text.loop(0, group.count) as b:
                source, target = b * len(columns) + before, b * size + group.offset
                for entry, (part, i) in enumerate(columns):
                    number = table.load(DOUBLE, source + entry).all_lanes()
                    value = fused(factors[part - 1], number, value) if part else number
                    self.work("whole", target + i).set_row(value)
            before += len(columns) * group.count
        self.shift("whole", 1 + len(shape.quotients))
        self.tail, total = self.about_middle(shape.whole, "whole", 2)
        upper = total.get() + self.tail.get() + allowance.get()
        self.output("upper", upper)
        lowest, centre, spread = map(self.result, ("least_value", "value", "value_range"))
        undecided = upper.compare("uge", 0.0)
        crossing = undecided & (centre + spread).compare("ogt", self.level)
        with self.text.when((crossing & lowest.compare("ole", self.level)).somewhere()):
            self._multipliers(allowance)
        with self.text.when(undecided.somewhere()):
            self._scores()

    def _multipliers(self, allowance: LoopVariable) -> None:
        """The least bound of F + λ(c − V) with λ a ratio of linear coefficients, one for each variable."""
        shape, text = self.shape, self.text
        best = text.variable(self.constant(float("inf")))
        with text.loop(0, shape.states) as candidate:
            place = candidate.compare("eq", 0).choose(text.number(1), candidate * (self.top + 1))
            slope, growth = (self.work(name, place).row() for name in ("low", "low_value"))
            ratio = slope / growth
            usable = ratio.compare("ogt", 0.0) & ratio.compare("olt", 1e200)
            factor = usable.choose(ratio, 0.0)
            total = text.sum()
            for group, b, even in self.each(shape.whole.groups[: min(LOW, shape.value.degrees[-1]) + 1]):
                for p, (f, v) in enumerate(zip(self.kept("low", group, b), self.kept("low_value", group, b))):
                    value = f - factor * v
                    if group.size == 0 and p == 0:
                        total.add(text.fused(factor, self.level, value))
                    else:
                        total.add(_largest(value, even and p % 2 == 0))
            total.add(self.tail.get() + allowance.get())
            total.add(factor * (self.value_tail.get() + self.input("value_rounding")))
            best.set(best.get().least(total.get()))
        self.output("upper_inside", best.get())

    def _scores(self) -> None:
        """For each variable, how much its nonlinear coefficients add to the bound; a cell is split in the largest."""
        shape, d = self.shape, self.shape.directions
        scores = [self.text.sum() for _ in range(shape.states)]
        centre, *others = shape.whole.groups[: LOW + 1]
        for group, b, _ in self.each((*others, centre)):
            total = self.zero
            for p, value in enumerate(self.kept("low", group, b)):
                linear, size = group.size + p == 1, abs(value)
                size = size * self.constant(0.25) if linear else size
                if p:
                    scores[0].add(size)
                total = total + size
            self.work("weight", b + group.first).set_row(total)
        if d:
            with self.text.loop(1, len(shape.whole.monomials)) as b:
                weight = self.work("weight", b).row()
                for j in range(d):
                    scores[1 + j].add(weight * self.masks.load(DOUBLE, b * d + j).all_lanes())
        for j, score in enumerate(scores):
            self.output("score", score.get(), j)
