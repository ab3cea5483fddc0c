"""Writing the kernel's text: sizes, vectors in memory, loops, running sums, and the shift of polynomials.

Polynomials on the faces of cubes, z_f = ±ρ and the other z_j = ρ t_j, as tables for the kernel of `cells.py`.

On a face P = Σ_k ρᵏ P_k(t). A coefficient belongs to a degree k and a monomial tᵝ, |β| ≤ k. Monomials stand in groups
by |β|, those with even exponents only first; the degrees of one monomial stand together.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache

import numpy as np

from flexhinf.certify.inequality import Rational
from flexhinf.certify.problem_to_claim import nearest_double
from flexhinf.codegen.emit.text import ModuleText, Writer


@dataclass(frozen=True)
class Group:
    """The monomials of one |β| of a polynomial.

    Attributes
    ----------
    first, count, even : int
        Number of the first monomial, how many, and how many have even exponents only.
    degrees : tuple of int
        Those degrees k ≥ |β| that the polynomial has.
    offset : int
        Place of the first coefficient; coefficient (monomial, degree) stands at offset + monomial · degrees + degree.
    """

    size: int
    first: int
    count: int
    even: int
    degrees: tuple[int, ...]
    offset: int


@cache
def monomials_of(directions: int, highest: int) -> tuple[tuple[int, ...], ...]:
    """Exponents of the monomials in t through degree `highest`."""
    every: list[tuple[int, ...]] = [()]
    for _ in range(directions):
        every = [(*head, e) for head in every for e in range(highest + 1 - sum(head))]
    return tuple(sorted(every, key=lambda beta: (sum(beta), any(e % 2 for e in beta), beta)))


class Layout:
    """Where the coefficients of a polynomial with these degrees stand.

    Parameters
    ----------
    directions : int
        Number of the t_j, n − 1.
    degrees : sequence of int
        Degrees k of the polynomial in z, ascending.
    """

    def __init__(self, directions: int, degrees: Sequence[int]) -> None:
        self.directions, self.degrees = directions, tuple(degrees)
        self.monomials = monomials_of(directions, max(self.degrees))
        sizes = np.array([sum(beta) for beta in self.monomials])
        even = np.array([not any(e % 2 for e in beta) for beta in self.monomials])
        self.groups: list[Group] = []
        self.place: dict[tuple[int, tuple[int, ...]], int] = {}
        offset = 0
        for size in range(max(self.degrees) + 1):
            chosen = np.flatnonzero(sizes == size)
            if not len(chosen):
                continue
            kept = tuple(k for k in self.degrees if k >= size)
            first, count = int(chosen[0]), len(chosen)
            self.groups.append(Group(size, first, count, int(even[chosen].sum()), kept, offset))
            for b in chosen:
                for i, k in enumerate(kept):
                    self.place[k, self.monomials[b]] = offset + (int(b) - first) * len(kept) + i
            offset += count * len(kept)
        self.count = offset


def shift_lines(layout: Layout) -> list[tuple[int, int, np.ndarray]]:
    """Lines of coefficients along which t_j is shifted, by degree, variable and length.

    Returns
    -------
    list of (variable, length, places (lines, length + 1))
    """
    result = []
    for k in layout.degrees:
        for j in range(layout.directions):
            by_length: dict[int, list[list[int]]] = {}
            for others in monomials_of(layout.directions - 1, k):
                length = k - sum(others)
                betas = [(*others[:j], p, *others[j:]) for p in range(length + 1)]
                if length > 0:
                    by_length.setdefault(length, []).append([layout.place[k, beta] for beta in betas])
            result += [(j, length, np.array(lines)) for length, lines in sorted(by_length.items())]
    return result


def face_table(terms: Rational, layout: Layout, faces: Sequence[tuple[int, int]]) -> np.ndarray:
    """Coefficients (faces, count) of a polynomial on faces (variable, sign), rounded to doubles."""
    table = np.zeros((len(faces), layout.count))
    values = {key: nearest_double(value) for key, value in terms.items() if sum(key) in layout.degrees}
    for row, (variable, sign) in zip(table, faces):
        for key, value in values.items():
            beta = key[:variable] + key[variable + 1 :]
            row[layout.place[sum(key), beta]] = value if sign > 0 or key[variable] % 2 == 0 else -value
    return table


def monomial_links(monomials: Sequence[tuple[int, ...]], directions: int) -> np.ndarray:
    """For each monomial another one times one variable that it is; then which variables it has, as doubles."""
    place = {beta: b for b, beta in enumerate(monomials)}
    links = np.zeros((len(monomials), 2), dtype=np.int64)
    for b, beta in enumerate(monomials[1:], 1):
        j = next(j for j, e in enumerate(beta) if e)
        links[b] = place[(*beta[:j], beta[j] - 1, *beta[j + 1 :])], j
    masks = (np.array(monomials).reshape(len(monomials), directions) > 0).astype(float)
    return np.concatenate([links.ravel(), masks.ravel().view(np.int64)])


def degrees_of(terms: Rational) -> tuple[int, ...]:
    """The degrees of a polynomial's terms, ascending."""
    return tuple(sorted({sum(key) for key in terms}))


def sums_on_faces(table: np.ndarray, layout: Layout) -> np.ndarray:
    """Sums of absolute coefficients (faces, highest degree + 1)."""
    sums = np.zeros((len(table), layout.degrees[-1] + 1))
    for group in layout.groups:
        part = table[:, group.offset : group.offset + group.count * len(group.degrees)]
        sums[:, list(group.degrees)] += np.abs(part).reshape(len(table), group.count, -1).sum(1)
    return sums * (1 + 1e-12)


def sums_by_degree(terms: Rational, highest: int) -> np.ndarray:
    """Sums of absolute coefficients by degree, (highest + 1,)."""
    sums = np.zeros(highest + 1)
    for key, value in terms.items():
        sums[sum(key)] += abs(nearest_double(value))
    return sums * (1 + 1e-12)


LANES = 8
LOW = 3  # monomials through this degree are kept as polynomials in ρ; the others only bounded
VECTOR = f"<{LANES} x double>"

#: What the kernel's argument points to, in this order: 64-bit words.
POINTERS = (
    "first", "last", "faces", "inputs", "outputs", "work", "level", "value_table", "quotient_table", "table",
    "segments", "lines", "signs",
)  # fmt: skip


@dataclass(frozen=True)
class Shape:
    """Sizes that the text depends on.

    Attributes
    ----------
    value : Layout
        Of V.
    quotients : tuple of Layout
        Of the factors Q_j.
    whole : Layout
        Of r, all quotients multiplied out.
    terms : tuple of tuple of int
        For every quotient and power of ℓ, the degrees of Q_j ℓᵐ.
    """

    states: int
    value: Layout
    quotients: tuple[Layout, ...]
    whole: Layout
    terms: tuple[tuple[int, ...], ...]

    @property
    def directions(self) -> int:
        """Number of the t_j."""
        return self.states - 1

    @property
    def input_rows(self) -> dict[str, int]:
        """First row of each input of a group of cells, and their number."""
        d, j = self.directions, len(self.quotients)
        names = ["t"] * d + ["h"] * d + ["inner", "outer", "middle", "half"]
        names += ["value_rounding", "growth_rounding", "rounding"] + ["error"] * j + ["s"] * len(self.terms)
        rows = {name: names.index(name) for name in dict.fromkeys(names)}
        return rows | {"count": len(names)}

    @property
    def output_rows(self) -> dict[str, int]:
        """Row of each result."""
        names = (
            "least_value", "growth", "upper", "upper_inside", "centre", "allowance", "value", "value_range",
            "growth_at_centre", "score",
        )  # fmt: skip
        return {name: i for i, name in enumerate(names)} | {"count": len(names) - 1 + self.states}

    def work_places(self) -> dict[str, int]:
        """Places in the work buffer, in vectors."""
        highest = max(self.whole.degrees[-1], self.value.degrees[-1])
        monomials = len(max((self.whole, self.value), key=lambda layout: layout.degrees[-1]).monomials)
        low = sum(group.count for group in self.whole.groups if group.size <= LOW)
        sizes = {
            "value": self.value.count, "quotient": max((q.count for q in self.quotients), default=0),
            "whole": self.whole.count, "scale": monomials, "weight": monomials,
            "low": low * (highest + 1), "low_value": low * (highest + 1), "powers": 6 * (highest + 3),
            "slopes": self.states,
        }  # fmt: skip
        places, total = {}, 0
        for name, size in sizes.items():
            places[name] = total
            total += size
        return places | {"count": total}


class KernelCode(Writer):
    """Writing helpers: vectors in memory, loops, running sums."""

    def zero(self) -> str:
        """0 in every lane."""
        return "zeroinitializer"

    def at(self, base: str, index: str, kind: str = VECTOR) -> str:
        """The address of an element."""
        return self.let(f"getelementptr inbounds {kind}, ptr {base}, i64 {index}")

    def load(self, pointer: str) -> str:
        """A vector from memory."""
        return self.let(f"load {VECTOR}, ptr {pointer}, align 64")

    def store(self, value: str, pointer: str) -> None:
        """A vector to memory."""
        self.do(f"store {VECTOR} {value}, ptr {pointer}, align 64")

    def number(self, base: str, index: str) -> str:
        """One double of a table in every lane."""
        return self.splat(self.let(f"load double, ptr {self.at(base, index, 'double')}, align 8"))

    def word(self, base: str, index: str) -> str:
        """A 64-bit integer of a table."""
        return self.let(f"load i64, ptr {self.at(base, index, 'i64')}, align 8")

    def plus(self, a: str, b: str) -> str:
        """a + b."""
        return self.real("fadd", a, b)

    def minus(self, a: str, b: str) -> str:
        """a − b."""
        return self.real("fsub", a, b)

    def times(self, a: str, b: str) -> str:
        """a b."""
        return self.real("fmul", a, b)

    def fused(self, a: str, b: str, c: str) -> str:
        """a b + c, fused where the processor can."""
        return self.intrinsic("fmuladd", a, b, c)

    def absolute(self, a: str) -> str:
        """|a|."""
        return self.intrinsic("fabs", a)

    def negative(self, a: str) -> str:
        """−a."""
        return self.let(f"fneg {VECTOR} {a}")

    def positive(self, a: str) -> str:
        """max(a, 0); of NaN, NaN."""
        return self.select(self.compare("ole", a, self.zero()), self.zero(), a)

    def constant(self, value: float) -> str:
        """A number in every lane."""
        return self.lanes.constant(value)

    def integer(self, operation: str, a: str, b: str) -> str:
        """An operation on 64-bit integers."""
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
        """Text that runs if an i1 holds."""
        yes, end = self.label("yes"), self.label("end")
        self.do(f"br i1 {condition}, label %{yes}, label %{end}")
        self.place(yes)
        yield
        self.do(f"br label %{end}")
        self.place(end)

    def sum(self, start: str = "zeroinitializer") -> RunningSum:
        """A running sum."""
        total = RunningSum(self, self.allocate(VECTOR))
        total.put(start)
        return total


@dataclass
class RunningSum:
    """A vector on the stack that is added to."""

    code: KernelCode
    place: str

    def get(self) -> str:
        """The sum so far."""
        return self.code.load(self.place)

    def put(self, value: str) -> None:
        """Another value instead."""
        self.code.store(value, self.place)

    def add(self, value: str) -> None:
        """Add a vector."""
        self.put(self.code.plus(self.get(), value))

    def take(self, value: str) -> None:
        """Subtract a vector."""
        self.put(self.code.minus(self.get(), value))


_ATTRIBUTES = 'nounwind "min-legal-vector-width"="512" "prefer-vector-width"="512"'


def finish(code: KernelCode, head: str, name: str) -> None:
    """Put a function that is written into the module."""
    code.module.definitions[name] = "\n".join([f"{head} {_ATTRIBUTES} {{", *code.first, *code.lines, "}"])


def write_shift(module: ModuleText, longest: int) -> None:
    """shift(coefficients, segments, lines, t, first, last): P(t + a) by synthetic division, line after line.

    A segment is (variable, length, number of lines, place of the lines); a line has length + 1 places of coefficients.
    """
    code = KernelCode(module)
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
    finish(code, f"define internal void @shift({arguments}, i64 %first, i64 %last) noinline", "shift")


def longest_layout(shape: Shape) -> Layout:
    """The layout with the most monomials."""
    return max((shape.whole, shape.value), key=lambda layout: layout.degrees[-1])


def table_size(shape: Shape) -> int:
    """Doubles of r's table for one face."""
    return sum(
        group.count * sum(1 + sum(k in degrees for degrees in shape.terms) for k in group.degrees)
        for group in shape.whole.groups
    )


class KernelFrame:
    """Rows, tables and buffers of a group of cells, and what is done to polynomials in them."""

    pointers: dict[str, str]
    rows: str
    out: str

    def __init__(self, module: ModuleText, shape: Shape) -> None:
        self.shape, self.code = shape, KernelCode(module)
        self.inputs, self.outputs, self.places = shape.input_rows, shape.output_rows, shape.work_places()
        self.low_count = [group.count for group in shape.whole.groups if group.size <= LOW]
        self.top = max(shape.whole.degrees[-1] - 2, shape.value.degrees[-1])  # highest power of ρ

    def input(self, name: str, index: int = 0) -> str:
        """An input of the group."""
        return self.code.load(self.code.at(self.rows, str(self.inputs[name] + index)))

    def output(self, name: str, value: str, index: int = 0) -> None:
        """A result of the group."""
        self.code.store(value, self.code.at(self.out, str(self.outputs[name] + index)))

    def work(self, name: str, index: str = "0") -> str:
        """An address in the work buffer."""
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
        code = self.code
        layout = max((self.shape.whole, self.shape.value), key=lambda layout: layout.degrees[-1])
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

    def each(self, group: Group, body: Callable[[str, bool], None], even_first: bool = True) -> None:
        """A loop over the monomials of a group: those with even exponents, then the others."""
        parts = [(0, group.even, True), (group.even, group.count, False)]
        for start, end, even in parts:
            if end > start:
                with self.code.loop(str(end), str(start)) as b:
                    body(b, even)

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
        """All of them for one monomial."""
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


def aligned(count: int) -> np.ndarray:
    """Zeros that start at a multiple of 64 bytes."""
    raw = np.zeros(count + 8)
    offset = (-raw.ctypes.data % 64) // 8
    return raw[offset : offset + count]
