"""Lines of LLVM text: types for one lane or many, constants, fresh names, and what the module declares."""

from __future__ import annotations

import copy
import itertools
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from flexhinf.codegen.program import PREFIX

PURE = "nounwind willreturn memory(none)"
"""Attributes of functions whose result depends on their arguments alone."""


@dataclass(frozen=True)
class Lanes:
    """How a number looks in the text when W of them travel together.

    Parameters
    ----------
    width : int
        W ≥ 1.
    """

    width: int

    @property
    def real(self) -> str:
        """Type of a float64 in every lane."""
        return self.type("double")

    @property
    def integer(self) -> str:
        """Type of a 64-bit integer in every lane."""
        return self.type("i64")

    @property
    def boolean(self) -> str:
        """Type of a truth value in every lane."""
        return self.type("i1")

    @property
    def element(self) -> str:
        """Type of one array element: its size is exactly W numbers, where a vector's may be padded."""
        return "double" if self.width == 1 else f"[{self.width} x double]"

    def type(self, scalar: str) -> str:
        """Type of a scalar in every lane."""
        return scalar if self.width == 1 else f"<{self.width} x {scalar}>"

    def suffix(self, scalar: str = "f64") -> str:
        """Suffix of the intrinsics on that scalar in every lane."""
        return scalar if self.width == 1 else f"v{self.width}{scalar}"

    def constant(self, value: float) -> str:
        """The same float64 in every lane, by its bits."""
        return self._splat("double", f"0x{struct.unpack('<Q', struct.pack('<d', value))[0]:016X}")

    def whole(self, value: int) -> str:
        """The same integer in every lane."""
        return self._splat("i64", str(value))

    def _splat(self, scalar: str, value: str) -> str:
        return value if self.width == 1 else f"splat ({scalar} {value})"


@dataclass
class ModuleText:
    """What a module collects while functions are written: definitions, declarations, and names to link.

    Attributes
    ----------
    definitions : dict of str to str
        Function name to text, in the order of writing.
    declarations : dict of str to str
        Intrinsics and foreign functions.
    library : dict of str to str
        Emitted name of a C library function to its own name.
    """

    lanes: Lanes
    definitions: dict[str, str] = field(default_factory=dict)
    declarations: dict[str, str] = field(default_factory=dict)
    library: dict[str, str] = field(default_factory=dict)

    def __str__(self) -> str:
        return "\n".join([*self.declarations.values(), *self.definitions.values(), ""])


class Writer:
    """Body of one function: appends lines, hands out names.

    Parameters
    ----------
    lanes : Lanes, optional
        Those of the module by default.

    Attributes
    ----------
    first, lines : list of str
        What is allocated, which belongs at the start of the function, and the text after it.
    """

    def __init__(self, module: ModuleText, lanes: Lanes | None = None) -> None:
        self.module = module
        self.lanes = module.lanes if lanes is None else lanes
        self.first: list[str] = []
        self.lines: list[str] = []
        self._names = itertools.count(1)

    def alike(self, lanes: Lanes) -> Writer:
        """A writer with other lanes that appends to the same text."""
        other = copy.copy(self)
        other.lanes = lanes
        return other

    def name(self) -> str:
        """A fresh local name."""
        return f"%v{next(self._names)}"

    def label(self, what: str) -> str:
        """A fresh block label, not yet placed."""
        return f"{what}{next(self._names)}"

    def place(self, label: str) -> None:
        """Start a block here."""
        self.lines.append(f"{label}:")

    def do(self, line: str) -> None:
        """A line without a result."""
        self.lines.append(f"  {line}")

    def let(self, expression: str) -> str:
        """A line with a result; returns its name."""
        name = self.name()
        self.lines.append(f"  {name} = {expression}")
        return name

    def allocate(self, kind: str) -> str:
        """Memory on the stack, once per call of the function, wherever in its text this is said."""
        name = self.name()
        self.first.append(f"  {name} = alloca {kind}, align 64")
        return name

    def splat(self, scalar: str, kind: str = "double") -> str:
        """A scalar copied to every lane."""
        if self.lanes.width == 1:
            return scalar
        vector = self.lanes.type(kind)
        first = self.let(f"insertelement {vector} poison, {kind} {scalar}, i64 0")
        mask = f"<{self.lanes.width} x i32> zeroinitializer"
        return self.let(f"shufflevector {vector} {first}, {vector} poison, {mask}")

    @contextmanager
    def loop(self, end: str, first: str = "0") -> Iterator[str]:
        """A loop over the integers from `first` to `end`; the turn lives in memory until LLVM promotes it."""
        place = self.allocate("i64")
        head, inside, after = self.label("head"), self.label("turn"), self.label("after")
        self.do(f"store i64 {first}, ptr {place}, align 8")
        self.do(f"br label %{head}")
        self.place(head)
        turn = self.let(f"load i64, ptr {place}, align 8")
        more = self.let(f"icmp slt i64 {turn}, {end}")
        self.do(f"br i1 {more}, label %{inside}, label %{after}")
        self.place(inside)
        yield turn
        self.do(f"store i64 {self.let(f'add nsw i64 {turn}, 1')}, ptr {place}, align 8")
        self.do(f"br label %{head}")
        self.place(after)

    def real(self, operation: str, *operands: str) -> str:
        """An LLVM operation on floats, such as ``fadd``."""
        return self.let(f"{operation} {self.lanes.real} {', '.join(operands)}")

    def whole(self, operation: str, *operands: str) -> str:
        """An LLVM operation on 64-bit integers, such as ``xor``."""
        return self.let(f"{operation} {self.lanes.integer} {', '.join(operands)}")

    def compare(self, predicate: str, left: str, right: str) -> str:
        """Truth value of an LLVM comparison of floats, such as ``olt``."""
        return self.let(f"fcmp {predicate} {self.lanes.real} {left}, {right}")

    def select(self, condition: str, yes: str, no: str) -> str:
        """`yes` where the condition holds, else `no`."""
        real = self.lanes.real
        return self.let(f"select {self.lanes.boolean} {condition}, {real} {yes}, {real} {no}")

    def bits(self, value: str) -> str:
        """The bits of a float."""
        return self.let(f"bitcast {self.lanes.real} {value} to {self.lanes.integer}")

    def float(self, bits: str) -> str:
        """The float of these bits."""
        return self.let(f"bitcast {self.lanes.integer} {bits} to {self.lanes.real}")

    def intrinsic(self, name: str, *operands: str) -> str:
        """An LLVM intrinsic on floats, such as ``floor``."""
        real = self.lanes.real
        full = f"llvm.{name}.{self.lanes.suffix()}"
        self.module.declarations[full] = f"declare {real} @{full}({', '.join([real] * len(operands))})"
        return self.call(full, *operands)

    def any(self, condition: str) -> str:
        """Does the condition hold in some lane (an i1)?"""
        if self.lanes.width == 1:
            return condition
        full = f"llvm.vector.reduce.or.{self.lanes.suffix('i1')}"
        self.module.declarations[full] = f"declare i1 @{full}({self.lanes.boolean})"
        return self.let(f"call i1 @{full}({self.lanes.boolean} {condition})")

    def call(self, function: str, *operands: str) -> str:
        """Call a function from floats to a float."""
        real = self.lanes.real
        return self.let(f"call {real} @{function}({', '.join(f'{real} {operand}' for operand in operands)})")


def library_call(writer: Writer, name: str, *operands: str) -> str:
    """Emit a call of the C function `name` in every lane; returns the name of the result.

    The function is linked under our own prefix, so that LLVM takes it for an unknown function and does not
    replace it by something that depends on the number of lanes.
    """
    module = writer.module
    foreign = PREFIX + name
    scalars = ", ".join(["double"] * len(operands))
    module.library[foreign] = name
    module.declarations[foreign] = f"declare double @{foreign}({scalars}) {PURE}"
    if writer.lanes.width == 1:
        return writer.call(foreign, *operands)
    lanewise = f"{foreign}_lanes{writer.lanes.width}"
    if lanewise not in module.definitions:
        module.definitions[lanewise] = _lanewise(writer, foreign, lanewise, len(operands))
    return writer.call(lanewise, *operands)


def _lanewise(caller: Writer, foreign: str, lanewise: str, arity: int) -> str:
    writer = Writer(caller.module, caller.lanes)
    real = writer.lanes.real
    operands = [f"%x{k}" for k in range(arity)]
    result = "poison"
    for lane in range(writer.lanes.width):
        scalars = [writer.let(f"extractelement {real} {operand}, i64 {lane}") for operand in operands]
        value = writer.let(f"call double @{foreign}({', '.join(f'double {scalar}' for scalar in scalars)})")
        result = writer.let(f"insertelement {real} {result}, double {value}, i64 {lane}")
    writer.do(f"ret {real} {result}")
    arguments = ", ".join(f"{real} {operand}" for operand in operands)
    head = f"define internal {real} @{lanewise}({arguments}) noinline {PURE} {{"
    return "\n".join([head, *writer.lines, "}"])
