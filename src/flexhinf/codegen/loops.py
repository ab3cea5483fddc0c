"""Functions over arrays written as loops in Python, for machine code: values with operators over one LLVM writer.

For what a `Program` does not say, reads through tables of places: the HJI solver's contractions, the checker's cells.
Memory, comparisons, choices and loops are lines of `emit.writer`, and arithmetic stands in the table of `operations`,
as for programs. The body of a function is written once, by Python that calls the methods of `LoopText`; Python's own
loops unroll. Numbers that change are variables; LLVM keeps them in registers.

    text = Text("scale", "X n")                   # the fields of a task: 64 bits each
    x, n = text.fields()
    with text.loop(0, n) as i:
        x.store(2.0 * x.load(DOUBLE, i), i)
    scale = Function(text)                        # scale(array, its size)

Nothing is checked when such a function runs.
"""

from __future__ import annotations

import ctypes
from collections.abc import Generator, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from typing import TypeAlias

import casadi
import numpy as np

from flexhinf.codegen.emit.writer import Lanes, ModuleText, Writer
from flexhinf.codegen.operations import MULTIPLY_ADD, OPERATIONS

LANES = 8
DOUBLE, VECTOR, LONG, INT = "double", f"<{LANES} x double>", "i64", "i32"
#: What a function is given.
Field: TypeAlias = "np.ndarray | float | np.integer"

_OWN = {VECTOR: 8 * LANES}  # what rows and variables of vectors begin at a multiple of, bytes; 8 for others


@dataclass(frozen=True, eq=False)
class Value:
    """A value of the text: its LLVM type and name."""

    text: LoopText
    kind: str
    name: str

    def __add__(self, other: Value | float) -> Value:
        return self.text.computed(casadi.OP_ADD, self, other)

    def __sub__(self, other: Value | float) -> Value:
        return self.text.computed(casadi.OP_SUB, self, other)

    def __mul__(self, other: Value | float) -> Value:
        return self.text.computed(casadi.OP_MUL, self, other)

    def __truediv__(self, other: Value | float) -> Value:
        return self.text.computed(casadi.OP_DIV, self, other)

    def __neg__(self) -> Value:
        return self.text.computed(casadi.OP_NEG, self)

    def __abs__(self) -> Value:
        return self.text.computed(casadi.OP_FABS, self)

    __radd__, __rmul__ = __add__, __mul__

    def __and__(self, other: Value) -> Value:
        return Value(self.text, self.kind, self._of_condition().joined("and", self.name, other.name))

    def compare(self, relation: str, other: Value | float) -> Value:
        """A condition: of integers "eq", "slt", …, of numbers "olt", …; of a vector one in each lane."""
        writer, right = self.text.writer(self.kind), self.text.number(other, self.kind).name
        compared = writer.compare_whole if self.kind == LONG else writer.compare
        return Value(self.text, writer.lanes.boolean, compared(relation, self.name, right))

    def somewhere(self) -> Value:
        """Whether a condition holds in some lane."""
        return Value(self.text, "i1", self._of_condition().any(self.name))

    def choose(self, this: Value, other: Value | float) -> Value:
        """`this` where the condition holds, else the other one."""
        no = self.text.number(other, this.kind).name
        return Value(self.text, this.kind, self._of_condition().select(self.name, this.name, no, this.kind))

    def least(self, other: Value | int) -> Value:
        """The smaller one of two; of numbers, one that is NaN loses."""
        if self.kind == LONG:
            return self.compare("slt", other).choose(self, other)
        return self.text.computed(casadi.OP_FMIN, self, other)

    def most(self, other: Value | int) -> Value:
        """The larger one of two integers."""
        return self.compare("sgt", other).choose(self, other)

    def at(self, kind: str, index: Value | int) -> Value:
        """The address `index` elements of a kind further on."""
        return Value(self.text, "ptr", self.text.lines.at(kind, self.name, self.text.number(index).name))

    def load(self, kind: str, index: Value | int = 0) -> Value:
        """The element there, an integer as 64 bits. A vector begins at any double: its index counts doubles."""
        writer, where = self.text.lines, self.at(DOUBLE if kind == VECTOR else kind, index)
        if kind == INT:
            return Value(self.text, LONG, writer.let(f"sext i32 {writer.read(INT, where.name, 4)} to i64"))
        return Value(self.text, kind, writer.read(kind, where.name))

    def store(self, value: Value, index: Value | int = 0) -> None:
        """Put a double, a vector or an integer of 64 bits there."""
        where = self.at(DOUBLE if value.kind == VECTOR else value.kind, index)
        self.text.lines.write(value.kind, value.name, where.name)

    def row(self, index: Value | int = 0) -> Value:
        """The vector `index` vectors further on, at a multiple of 64 bytes."""
        return Value(
            self.text, VECTOR, self.text.lines.read(VECTOR, self.at(VECTOR, index).name, _OWN[VECTOR])
        )

    def set_row(self, value: Value, index: Value | int = 0, past_cache: bool = False) -> None:
        """Put a vector there; `past_cache` if it is not read soon."""
        place = self.at(VECTOR, index).name
        self.text.lines.write(VECTOR, value.name, place, _OWN[VECTOR], past_cache)

    def shuffled(self, other: Value, lanes: list[int]) -> Value:
        """The vector of these lanes of both vectors, the second one's from 8 on."""
        return Value(self.text, VECTOR, self.text.writer(VECTOR).shuffled(self.name, other.name, lanes))

    def real(self) -> Value:
        """The double of an integer."""
        return Value(self.text, DOUBLE, self.text.lines.to_float(self.name))

    def all_lanes(self) -> Value:
        """The vector of a double in every lane."""
        return Value(self.text, VECTOR, self.text.writer(VECTOR).splat(self.name))

    def _of_condition(self) -> Writer:
        """The writer of what a condition is one of: of integers and doubles, or of vectors."""
        return self.text.lines if self.kind == "i1" else self.text.writer(VECTOR)


class LoopVariable:
    """A number that changes."""

    def __init__(self, value: Value) -> None:
        self._kind, self._place = value.kind, value.text.room(value.kind)
        self.set(value)

    def get(self) -> Value:
        """Its value now."""
        text, align = self._place.text, _OWN.get(self._kind, 8)
        return Value(text, self._kind, text.lines.read(self._kind, self._place.name, align))

    def set(self, value: Value) -> None:
        """Change it."""
        align = _OWN.get(self._kind, 8)
        self._place.text.lines.write(self._kind, value.name, self._place.name, align)

    def add(self, value: Value) -> None:
        """Add to it."""
        self.set(self.get() + value)


class LoopText:
    """The text of one function, whose only argument is the address of its task: fields of 64 bits each.

    A field is an address if its name begins with a capital, a double if it begins with "=", else an integer. `part`: A
    function for others, whose fields are its arguments, and whose addresses lead to memory of their own. `module`:
    Where functions that call each other stand together. `lines`: The writer of the text.
    """

    def __init__(self, entry: str, fields: str, part: bool = False, module: ModuleText | None = None) -> None:
        self.entry, self._part = entry, part
        self.module = new_module() if module is None else module
        self._kinds = ["ptr" if f[0].isupper() else DOUBLE if f[0] == "=" else LONG for f in fields.split()]
        self.lines = Writer(self.module, Lanes(1))
        self._wide = self.lines.alike(self.module.lanes)

    def writer(self, kind: str) -> Writer:
        """The writer of operations on values of a kind: in lanes, if they are vectors."""
        return self._wide if kind == VECTOR else self.lines

    def computed(self, code: int, *operands: Value | float) -> Value:
        """An operation of the table `operations`, or of integers, on values of one kind; plain numbers are, too."""
        kind = next(value.kind for value in operands if isinstance(value, Value))
        names = [self.number(value, kind).name for value in operands]
        if kind == LONG:
            return Value(self, kind, self.lines.whole(OPERATIONS[code].whole, *names))
        return Value(self, kind, OPERATIONS[code].llvm(self.writer(kind), *names))

    def fused(self, a: Value, b: Value, c: Value) -> Value:
        """a·b + c with one rounding where the processor can."""
        return self.computed(MULTIPLY_ADD, a, b, c) if self.module.fused else a * b + c

    def fields(self) -> list[Value]:
        """What the function is given."""
        if self._part:
            return [Value(self, kind, f"%a{i}") for i, kind in enumerate(self._kinds)]
        task = Value(self, "ptr", "%task")
        return [task.load(kind, i) for i, kind in enumerate(self._kinds)]

    def call(self, entry: str, *values: Value | int) -> None:
        """Call a part, with integers and addresses."""
        arguments = ", ".join(f"{value.kind} {value.name}" for value in map(self.number, values))
        self.lines.do(f"call void @{entry}({arguments})")

    def number(self, value: Value | float, kind: str = LONG) -> Value:
        """A constant, of a vector in every lane; a value is what it is."""
        if isinstance(value, Value):
            return value
        return Value(
            self, kind, str(value) if kind == LONG else self.writer(kind).lanes.constant(float(value))
        )

    def room(self, kind: str, size: int = 1) -> Value:
        """The address of memory that lives as long as the call."""
        return Value(self, "ptr", self.lines.allocate(f"{kind}, i64 {size}"))

    def variable(self, value: Value | int) -> LoopVariable:
        """A number that begins with `value` and changes."""
        return LoopVariable(self.number(value))

    def sum(self) -> LoopVariable:
        """A vector that begins with zeros and changes."""
        return LoopVariable(self.number(0.0, VECTOR))

    @contextmanager
    def loop(self, start: Value | int, stop: Value | int, step: int = 1) -> Generator[Value, None, None]:
        """The lines of the block for start, start + step, … below stop."""
        with self.lines.loop(self.number(stop).name, self.number(start).name, step) as turn:
            yield Value(self, LONG, turn)

    def when(self, condition: Value) -> AbstractContextManager[None]:
        """The lines of the block where the condition holds."""
        return self.lines.when(condition.name)

    def cases(self, number: Value, most: int) -> Iterator[int]:
        """The lines for each case 1, …, most of a number; nothing is done for others."""
        return self.lines.cases(number.name, most)

    def finish(self) -> None:
        """Put the function into its module."""
        arguments, linkage = "ptr %task", ""
        if self._part:
            kinds = ("ptr noalias" if kind == "ptr" else kind for kind in self._kinds)
            arguments, linkage = ", ".join(f"{kind} %a{i}" for i, kind in enumerate(kinds)), "internal "
        body = [*self.lines.first, *self.lines.lines, "  ret void"]
        self.module.define(self.entry, f"define {linkage}void @{self.entry}({arguments}) nounwind {{", body)


def new_module() -> ModuleText:
    """For functions that call each other, on this processor."""
    from flexhinf.codegen import machine

    return ModuleText(Lanes(LANES), machine.host().fused)


class NativeFunction:
    """A function of this process from LLVM text. It is called without the interpreter, so threads run it at a time.

    `source`: Its module is that of all that it calls.
    """

    def __init__(self, source: LoopText) -> None:
        from flexhinf.codegen import machine
        from flexhinf.codegen.compiler import cached

        host, entry = machine.host(), source.entry
        source.finish()
        text = f"!0 = !{{ i32 1 }}\n{source.module}"
        self._code = cached(
            ("loops", text, host.triple, host.cpu, host.features, host.version),
            lambda: machine.assemble(text, 3),
            lambda image: machine.Code(image, entry, {}),
        )
        self._call = ctypes.CFUNCTYPE(None, ctypes.c_void_p)(self._code.address)

    def __call__(self, *values: Field) -> None:
        """Run on arrays, integers and doubles, in the order of the fields."""
        self.run(fields(*values))

    def run(self, *parts: np.ndarray) -> None:
        """Run on what `fields` made of the first fields, of the next ones, and so on."""
        task = np.concatenate(parts)
        self._call(task.ctypes.data)  # reads the task while other threads run: it must outlive the call


def fields(*values: Field) -> np.ndarray:
    """Fields of a task. The arrays must live for as long as it is used."""
    return np.array([_bits(field) for field in values], np.int64)


def _bits(field: Field) -> int:
    if isinstance(field, np.ndarray):
        return field.ctypes.data
    return int(np.float64(field).view(np.int64)) if isinstance(field, float) else int(field)


def wide() -> bool:
    """Whether the processor has the 32 vector registers of AVX-512."""
    from flexhinf.codegen import machine

    return "+avx512f" in machine.host().features.split(",")
