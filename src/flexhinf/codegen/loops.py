"""Functions over arrays written as loops in Python, for machine code: LLVM text, its linking, its call.

For what a `Program` cannot say, reads through tables of places. The body of a function is written once, by Python that
calls the methods of `Text`; Python's own loops unroll. Numbers that change are variables; LLVM keeps them in registers.

    text = Text("scale", "x n")                   # the fields of a task: 64 bits each
    x, n = text.fields()
    with text.loop(0, n) as i:
        x.store(2.0 * x.load(DOUBLE, i), i)
    scale = Function(text)                        # scale(array, its size)

Nothing is checked when such a function runs.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np

LANES = 8
DOUBLE, VECTOR, LONG, INT, SHORT = "double", f"<{LANES} x double>", "i64", "i32", "i16"
_FUSED = {DOUBLE: "f64", VECTOR: f"v{LANES}f64"}
_COMMON = "!0 = !{ i32 1 }\n" + "".join(
    f"declare {kind} @llvm.fmuladd.{suffix}({kind}, {kind}, {kind})\n" for kind, suffix in _FUSED.items()
)


@dataclass(frozen=True, eq=False)
class Value:
    """A value of the text: its LLVM type and name."""

    text: Text
    kind: str
    name: str

    def _with(self, operation: str, other: Value | float) -> Value:
        operation = (
            {"add": "fadd", "sub": "fsub", "mul": "fmul", "sdiv": "fdiv"}[operation]
            if self.kind != LONG
            else operation
        )
        return self.text.line(self.kind, f"{operation} {self.kind} {self.name}, {self.text.name(other)}")

    def __add__(self, other: Value | float) -> Value:
        return self._with("add", other)

    def __sub__(self, other: Value | float) -> Value:
        return self._with("sub", other)

    def __mul__(self, other: Value | float) -> Value:
        return self._with("mul", other)

    def __truediv__(self, other: Value | float) -> Value:
        return self._with("sdiv", other)

    def compare(self, relation: str, other: Value | float) -> Value:
        """A condition of integers: "eq", "slt", …"""
        return self.text.line("i1", f"icmp {relation} {self.kind} {self.name}, {self.text.name(other)}")

    def choose(self, this: Value, other: Value) -> Value:
        """`this` where the condition holds, else the other one."""
        kinds = f"{this.kind} {this.name}, {other.kind} {other.name}"
        return self.text.line(this.kind, f"select i1 {self.name}, {kinds}")

    def least(self, other: Value | int, relation: str = "slt") -> Value:
        """The smaller one of two integers."""
        less = self.compare(relation, other)
        return less.choose(self, other if isinstance(other, Value) else self.text.number(other))

    def most(self, other: Value | int) -> Value:
        """The larger one of two integers."""
        return self.least(other, "sgt")

    def at(self, kind: str, index: Value | int) -> Value:
        """The address `index` elements of a kind further on."""
        return self.text.line("ptr", f"getelementptr {kind}, ptr {self.name}, i64 {self.text.name(index)}")

    def load(self, kind: str, index: Value | int = 0) -> Value:
        """The element there, an integer as 64 bits. A vector begins at any double: its index counts doubles."""
        where = self.at(DOUBLE if kind == VECTOR else kind, index)
        value = self.text.line(
            kind, f"load {kind}, ptr {where.name}, align {8 if kind == VECTOR else _size(kind)}"
        )
        return self.text.line(LONG, f"sext {kind} {value.name} to i64") if kind in (INT, SHORT) else value

    def store(self, value: Value, index: Value | int = 0) -> None:
        """Put a double, a vector or an integer of 64 bits there."""
        where = self.at(DOUBLE if value.kind == VECTOR else value.kind, index)
        self.text.put(f"store {value.kind} {value.name}, ptr {where.name}, align 8")

    def stream(self, value: Value, index: Value | int = 0) -> None:
        """Put a vector `index` vectors further on, at a multiple of 64 bytes, past the cache."""
        self.text.put(
            f"store {VECTOR} {value.name}, ptr {self.at(VECTOR, index).name}, align 64, !nontemporal !0"
        )

    def shuffled(self, other: Value, lanes: list[int]) -> Value:
        """The vector of these lanes of both vectors, the second one's from 8 on."""
        mask = ", ".join(f"i32 {lane}" for lane in lanes)
        both = f"{VECTOR} {self.name}, {VECTOR} {other.name}"
        return self.text.line(VECTOR, f"shufflevector {both}, <{LANES} x i32> <{mask}>")

    def real(self) -> Value:
        """The double of an integer."""
        return self.text.line(DOUBLE, f"sitofp i64 {self.name} to double")

    def all_lanes(self) -> Value:
        """The vector of a double in every lane."""
        one = self.text.line(VECTOR, f"insertelement {VECTOR} poison, double {self.name}, i64 0")
        zeros = f"<{LANES} x i32> zeroinitializer"
        return self.text.line(VECTOR, f"shufflevector {VECTOR} {one.name}, {VECTOR} poison, {zeros}")


class Variable:
    """A number that changes."""

    def __init__(self, value: Value) -> None:
        self._text, self._kind = value.text, value.kind
        self._place = value.text.room(value.kind)
        self.set(value)

    def get(self) -> Value:
        """Its value now."""
        return self._text.line(self._kind, f"load {self._kind}, ptr {self._place.name}")

    def set(self, value: Value) -> None:
        """Change it."""
        self._text.put(f"store {self._kind} {value.name}, ptr {self._place.name}")


class Text:
    """The text of one function, whose only argument is the address of its task: fields of 64 bits each.

    A field is an address if its name begins with a capital, a double if it begins with "=", else an integer. A `part`
    is a function for others: its fields are its arguments. `parts`: The text of those that this one calls.
    """

    def __init__(self, entry: str, fields: str, part: bool = False, parts: str = "") -> None:
        self.entry, self._part, self._parts = entry, part, parts
        self._kinds = ["ptr" if f[0].isupper() else DOUBLE if f[0] == "=" else LONG for f in fields.split()]
        self._head: list[str] = []
        self._lines: list[str] = ["br label %body", "body:"]
        self._named = 0

    def name(self, value: Value | float) -> str:
        """How a value is written in the text."""
        return value.name if isinstance(value, Value) else repr(value)

    def put(self, line: str) -> None:
        """One line."""
        self._lines.append(line)

    def line(self, kind: str, text: str) -> Value:
        """One line that has a value."""
        value = self._new(kind)
        self.put(f"{value.name} = {text}")
        return value

    def _new(self, kind: str) -> Value:
        self._named += 1
        return Value(self, kind, f"%v{self._named}")

    def fields(self) -> list[Value]:
        """What the function is given."""
        if self._part:
            return [Value(self, kind, f"%a{i}") for i, kind in enumerate(self._kinds)]
        task = Value(self, "ptr", "%task")
        return [task.at(LONG, i).load(kind) for i, kind in enumerate(self._kinds)]

    def call(self, entry: str, *values: Value | int) -> None:
        """Call a part, with integers and addresses."""
        kinds = (value.kind if isinstance(value, Value) else LONG for value in values)
        arguments = ", ".join(f"{kind} {self.name(value)}" for kind, value in zip(kinds, values, strict=True))
        self.put(f"call void @{entry}({arguments})")

    def number(self, value: float, kind: str = LONG) -> Value:
        """A constant; a vector may only be of zeros."""
        return Value(self, kind, "zeroinitializer" if kind == VECTOR else repr(value))

    def room(self, kind: str, size: int = 1) -> Value:
        """The address of memory that lives as long as the call."""
        place = self._new("ptr")
        self._head.append(f"{place.name} = alloca {kind}, i64 {size}, align 64")
        return place

    def variable(self, value: Value | int) -> Variable:
        """A number that begins with `value` and changes."""
        return Variable(value if isinstance(value, Value) else self.number(value))

    def fused(self, a: Value, b: Value, c: Value) -> Value:
        """a·b + c with one rounding where the processor can."""
        kind = c.kind
        return self.line(
            kind,
            f"call {kind} @llvm.fmuladd.{_FUSED[kind]}({kind} {a.name}, {kind} {b.name}, {kind} {c.name})",
        )

    @contextmanager
    def loop(self, start: Value | int, stop: Value | int, step: int = 1) -> Iterator[Value]:
        """The lines of the block for start, start + step, … below stop."""
        index, label = self.variable(start), self._label()
        self.put(f"br label %{label}.test")
        self.put(f"{label}.test:")
        value = index.get()
        more = value.compare("slt", stop)
        self.put(f"br i1 {more.name}, label %{label}.do, label %{label}.end")
        self.put(f"{label}.do:")
        yield value
        index.set(value + step)
        self.put(f"br label %{label}.test")
        self.put(f"{label}.end:")

    @contextmanager
    def when(self, condition: Value) -> Iterator[None]:
        """The lines of the block where the condition holds."""
        label = self._label()
        self.put(f"br i1 {condition.name}, label %{label}.do, label %{label}.end")
        self.put(f"{label}.do:")
        yield
        self.put(f"br label %{label}.end")
        self.put(f"{label}.end:")

    def _label(self) -> str:
        self._named += 1
        return f"l{self._named}"

    def finish(self) -> str:
        """The function and its parts."""
        lines = (line if line.endswith(":") else f"  {line}" for line in [*self._head, *self._lines])
        arguments = (
            ", ".join(f"{kind} %a{i}" for i, kind in enumerate(self._kinds)) if self._part else "ptr %task"
        )
        linkage = "internal " if self._part else ""
        return (
            f"{self._parts}\ndefine {linkage}void @{self.entry}({arguments}) {{\nentry:\n"
            + "\n".join(lines)
            + "\n  ret void\n}\n"
        )


def _size(kind: str) -> int:
    return {SHORT: 2, INT: 4}.get(kind, 8)


class Function:
    """A function of this process from LLVM text. It is called without the interpreter, so threads run it at a time."""

    def __init__(self, source: Text) -> None:
        from flexhinf.codegen import machine
        from flexhinf.codegen.compiler import cached

        host, entry = machine.host(), source.entry
        text = _COMMON + source.finish()
        self._code = cached(
            ("loops", text, host.triple, host.cpu, host.features, host.version),
            lambda: machine.assemble(text, 3),
            lambda image: machine.Code(image, entry, {}),
        )
        self._call = ctypes.CFUNCTYPE(None, ctypes.c_void_p)(self._code.address)

    def __call__(self, *values: Any) -> None:
        """Run on arrays, integers and doubles, in the order of the fields."""
        self.run(fields(*values))

    def run(self, *parts: np.ndarray) -> None:
        """Run on what `fields` made of the first fields, of the next ones, and so on."""
        task = np.concatenate(parts)
        self._call(task.ctypes.data)  # reads the task while other threads run: it must outlive the call


def fields(*values: Any) -> np.ndarray:
    """Fields of a task. The arrays must live for as long as it is used."""
    return np.array([_bits(field) for field in values], np.int64)


def _bits(field: Any) -> int:
    if isinstance(field, np.ndarray):
        return field.ctypes.data
    return int(np.float64(field).view(np.int64)) if isinstance(field, float) else int(field)


def wide() -> bool:
    """Whether the processor has the 32 vector registers of AVX-512."""
    from flexhinf.codegen import machine

    return "+avx512f" in machine.host().features.split(",")
