"""Lines of LLVM text, and CasADi's operations as such: the one table.

Every rule follows the meaning of CasADi's own evaluator, NaN and signed zero included; the tests compare them
one by one. Functions of the C library are called lane by lane: the same bits as CasADi, for any number of
lanes.

Sine and cosine are one sequence of operations for one lane and for many, so that all give the same bits. x is reduced
by Cody and Waite's method in three parts, r = x - k·π/2 with |r| ≤ π/4, and the polynomials of fdlibm (k_sin.c,
k_cos.c) give sin r and cos r, of which the quadrant k mod 4 takes one. With fused multiply-adds the parts have all
digits; without, the first two have 33 bits: their products with a k below 2²⁰ are exact. Arguments beyond the reach of
their sum go to the C library.
"""

from __future__ import annotations

import copy
import itertools
import math
import struct
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field

import casadi

from flexhinf.codegen.dataflow import (
    LIBRARY,
    MULTIPLY_ADD,
    MULTIPLY_SUBTRACT,
    SELECT,
    SINGLE,
    SUBTRACT_PRODUCT,
)
from flexhinf.codegen.program import PREFIX

#: Attributes of functions whose result depends on their arguments alone.
PURE = "nounwind willreturn memory(none)"

_UNROLLED = 64  # elements of a guard or of a broadcast copy that are written out; longer ones get a loop


class Lanes:
    """LLVM types of a number in W ≥ 1 lanes.

    `real`, `integer`, `boolean`: Types of a float64, a 64-bit integer and a truth value in every lane. `element`: Type
    of one array element: its size is exactly W numbers, where a vector's may be padded.
    """

    def __init__(self, width: int) -> None:
        self.width = width
        self.real, self.integer, self.boolean = map(self.type, ("double", "i64", "i1"))
        self.element = "double" if width == 1 else f"[{width} x double]"

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
    """Text of a module, collected while functions are written: definitions, declarations, and names to link.

    `definitions`: Function name to text, in the order of writing. `declarations`: Intrinsics and foreign functions.
    `library`: Emitted name of a C library function to its own name. `operations`: Operations in the traced functions, a
    measure of the time to compile. `fused`: Products are fused into sums, for which the target has an instruction.
    `choosing`: To choose between two vectors costs the target less than to compute with both.
    """

    lanes: Lanes
    fused: bool = True
    choosing: bool = True
    definitions: dict[str, str] = field(default_factory=dict)
    declarations: dict[str, str] = field(default_factory=dict)
    library: dict[str, str] = field(default_factory=dict)
    operations: int = 0

    def __str__(self) -> str:
        return "\n".join([*self.declarations.values(), *self.definitions.values(), ""])

    def define(self, name: str, head: str, lines: Sequence[str]) -> None:
        """Add a function: its first line, up to the brace, and its body."""
        self.definitions[name] = "\n".join([head, *lines, "}"])


class Writer:
    """Body of one function: appends lines, hands out names.

    `lanes`: Those of the module by default. `first`, `lines`: Allocations, which belong at the start of the function,
    and the text after them.
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

    def label(self, what: str) -> str:
        """A fresh block label, not yet placed."""
        return f"{what}{next(self._names)}"

    def place(self, label: str, end: str = "") -> None:
        """Start a block here; the one before ends with the line `end`, if that is not written yet."""
        self.lines += [f"  {end}", f"{label}:"] if end else [f"{label}:"]

    def do(self, line: str) -> None:
        """A line without a result."""
        self.lines.append(f"  {line}")

    def let(self, expression: str) -> str:
        """A line with a result; returns its name."""
        name = f"%v{next(self._names)}"
        self.lines.append(f"  {name} = {expression}")
        return name

    def allocate(self, kind: str) -> str:
        """Memory on the stack, once per call of the function, wherever in its text this is requested."""
        name = f"%v{next(self._names)}"
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
        self.place(head, f"br label %{head}")
        turn = self.let(f"load i64, ptr {place}, align 8")
        more = self.let(f"icmp slt i64 {turn}, {end}")
        self.place(inside, f"br i1 {more}, label %{inside}, label %{after}")
        yield turn
        self.do(f"store i64 {self.let(f'add nsw i64 {turn}, 1')}, ptr {place}, align 8")
        self.place(after, f"br label %{head}")

    def turns(self, first: str, end: str, block: int) -> Iterator[tuple[str, int, str]]:
        """A loop over full blocks: first element, length and number of each."""
        with self.loop(end, first) as turn:
            yield self.let(f"mul nsw i64 {turn}, {block}"), block, turn

    def blocks(self, size: int, block: int) -> Iterator[tuple[str, int, str]]:
        """First element, length and number of all blocks, of which the last may be shorter."""
        if size >= block:
            yield from self.turns("0", str(size // block), block)
        if size % block:
            yield str(size - size % block), size % block, str(size // block)

    def elements(self, size: int) -> Iterator[str]:
        """The integers below `size`: one after the other if they are few, else those of a loop."""
        if size > _UNROLLED:
            with self.loop(str(size)) as turn:
                yield turn
        else:
            yield from map(str, range(size))

    def real(self, operation: str, *operands: str | float) -> str:
        """An LLVM operation on floats, such as ``fadd``: names of values, or constants."""
        names = [x if isinstance(x, str) else self.lanes.constant(x) for x in operands]
        return self.let(f"{operation} {self.lanes.real} {', '.join(names)}")

    def whole(self, operation: str, *operands: str | int) -> str:
        """An LLVM operation on 64-bit integers, such as ``xor``: names of values, or constants."""
        names = [x if isinstance(x, str) else self.lanes.whole(x) for x in operands]
        return self.let(f"{operation} {self.lanes.integer} {', '.join(names)}")

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

    def to_float(self, integer: str) -> str:
        """A signed integer of at most 53 bits as a float, exactly."""
        return self.let(f"sitofp {self.lanes.integer} {integer} to {self.lanes.real}")

    def root(self, value: str) -> str:
        """The square root."""
        return self.intrinsic("sqrt", value)

    def intrinsic(self, name: str, *operands: str) -> str:
        """An LLVM intrinsic on floats, such as ``floor``."""
        real = self.lanes.real
        full = f"llvm.{name}.{self.lanes.suffix()}"
        self.module.declarations[full] = f"declare {real} @{full}({', '.join([real] * len(operands))})"
        return self.call(full, *operands)

    def multiply_add(self, a: str, b: str, c: str) -> str:
        """a·b + c, rounded once in a module that fuses."""
        if self.module.fused:
            return self.intrinsic("fma", a, b, c)
        return self.real("fadd", self.real("fmul", a, b), c)

    def load_element(self, pointer: str, element: int | str, shared: bool) -> str:
        """Load one element; a shared one is copied to every lane."""
        kind, size = ("double", "double") if shared else (self.lanes.real, self.lanes.element)
        place = self.let(f"getelementptr {size}, ptr {pointer}, i64 {element}")
        value = self.let(f"load {kind}, ptr {place}, align 8")
        return self.splat(value) if shared else value

    def store_element(self, pointer: str, element: int | str, value: str) -> None:
        """Store one element."""
        place = self.let(f"getelementptr {self.lanes.element}, ptr {pointer}, i64 {element}")
        self.do(f"store {self.lanes.real} {value}, ptr {place}, align 8")

    def larger(self, value: str, other: str) -> str:
        """The value where it is larger than the other, else the other; a NaN is not larger."""
        return self.select(self.compare("ogt", value, other), value, other)

    def any(self, condition: str) -> str:
        """Whether the condition holds in some lane (an i1)."""
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
    module, foreign = writer.module, PREFIX + name
    scalars = ", ".join(["double"] * len(operands))
    module.library[foreign] = name
    module.declarations[foreign] = f"declare double @{foreign}({scalars}) {PURE}"
    if writer.lanes.width == 1:
        return writer.call(foreign, *operands)
    lanewise = f"{foreign}_lanes{writer.lanes.width}"
    if lanewise not in module.definitions:
        inside, result = Writer(module, writer.lanes), "poison"
        real, names = inside.lanes.real, [f"%x{k}" for k in range(len(operands))]
        for lane in range(inside.lanes.width):
            elements = [inside.let(f"extractelement {real} {name}, i64 {lane}") for name in names]
            value = inside.let(f"call double @{foreign}({', '.join(f'double {x}' for x in elements)})")
            result = inside.let(f"insertelement {real} {result}, double {value}, i64 {lane}")
        inside.do(f"ret {real} {result}")
        arguments = ", ".join(f"{real} {name}" for name in names)
        module.define(
            lanewise, f"define internal {real} @{lanewise}({arguments}) noinline {PURE} {{", inside.lines
        )
    return writer.call(lanewise, *operands)


#: π/2 as an unevaluated sum of float64 numbers, and the largest |x| that is reduced with it, of which x·2/π is known to
#: well below 1; with fused multiply-adds (True), and without (False).
HALF_PI = {
    True: tuple(map(float.fromhex, ("0x1.921fb54442d18p+0", "0x1.1a62633145c07p-54", "-0x1.f1976b7ed8fbcp-110"))),
    False: tuple(map(float.fromhex, ("0x1.921fb544p+0", "0x1.0b4611a6p-34", "0x1.3198a2e037073p-69"))),
}  # fmt: skip
REACH = {True: 2.0**30, False: 1e6}
# Adding it to |q| < 2^51 leaves the nearest integer in the low bits of the significand.
ROUNDER = 1.5 * 2.0**52
# sin r = r + r³·S(r²) and cos r = 1 - r²/2 + r⁴·C(r²) on |r| ≤ π/4, highest degree first.
SINE = (
    1.58969099521155010221e-10,
    -2.50507602534068634195e-08,
    2.75573137070700676789e-06,
    -1.98412698298579493134e-04,
    8.33333333332248946124e-03,
    -1.66666666666666324348e-01,
)
COSINE = (
    -1.13596475577881948265e-11,
    2.08757232129817482790e-09,
    -2.75573143513906633035e-07,
    2.48015872894767294178e-05,
    -1.38888888888741095749e-03,
    4.16666666666666019037e-02,
)


#: (writer, name of each operand) → name of the result.
Rule = Callable[..., str]


def is_far(writer: Writer, value: str) -> str:
    """Emit whether x is finite and beyond the reach of the reduction, in each lane."""
    lanes = writer.lanes
    size = writer.intrinsic("fabs", value)
    far = writer.compare("ogt", size, lanes.constant(REACH[writer.module.fused]))
    finite = writer.compare("olt", size, lanes.constant(math.inf))
    return writer.let(f"and {lanes.boolean} {far}, {finite}")


def _turn(name: str, kind: str = "reduced") -> Rule:
    """sin x or cos x by a function of the module; "near" and "alone" are straight lines, for what is not `is_far`."""

    def rule(caller: Writer, value: str) -> str:
        full = f"{PREFIX}{name}_{kind}{caller.lanes.width}"
        if full not in caller.module.definitions:
            writer = Writer(caller.module, caller.lanes)
            lanes, real = writer.lanes, writer.lanes.real
            result = within = _near(writer, "%x", name, kind == "alone")
            if kind == "reduced":  # the C library beyond the reach, behind a branch that is hardly ever taken
                far = is_far(writer, "%x")
                writer.place("beyond", f"br i1 {writer.any(far)}, label %beyond, label %done, !prof !0")
                exact = writer.select(far, library_call(writer, name, "%x"), within)
                writer.place("done", "br label %done")
                result = writer.let(f"phi {lanes.real} [ {within}, %entry ], [ {exact}, %beyond ]")
            writer.do(f"ret {real} {result}")
            head = f"define internal {real} @{full}({real} %x) alwaysinline {PURE} {{\nentry:"
            caller.module.define(full, head, writer.lines)
        return caller.call(full, value)

    return rule


def _near(writer: Writer, x: str, name: str, alone: bool) -> str:
    """The function for |x| within the reach; NaN for NaN and infinities.

    Of the polynomials of the quadrants the right one is computed, if the function is `alone`; or both, which sine and
    cosine of one angle share. The bits are the same.
    """
    lanes = writer.lanes
    size = writer.intrinsic("fabs", x)
    shifted = writer.multiply_add(size, lanes.constant(2.0 / math.pi), lanes.constant(ROUNDER))
    quadrant = writer.bits(shifted)
    turns = writer.real("fneg", writer.real("fsub", shifted, lanes.constant(ROUNDER)))
    remainder = size
    for part in HALF_PI[writer.module.fused]:
        remainder = writer.multiply_add(turns, lanes.constant(part), remainder)
    odd = writer.let(f"icmp ne {lanes.integer} {writer.whole('and', quadrant, 1)}, {lanes.whole(0)}")
    square = writer.real("fmul", remainder, remainder)
    parabola = writer.multiply_add(square, lanes.constant(-0.5), lanes.constant(1.0))

    def total(value: str, *others: str) -> str:
        *coefficients, factor, summand = others
        for coefficient in coefficients:
            value = writer.multiply_add(value, square, coefficient)
        return writer.multiply_add(value, writer.real("fmul", square, factor), summand)

    # Either is a polynomial in r², times r² and a factor, and one number more.
    sin = [*map(lanes.constant, SINE), remainder, remainder]
    cos = [*map(lanes.constant, COSINE), square, parabola]
    at_odd, at_even = (cos, sin) if name == "sin" else (sin, cos)
    if alone:
        result = total(*(writer.select(odd, *pair) for pair in zip(at_odd, at_even)))
    else:
        result = writer.select(odd, total(*at_odd), total(*at_even))
    if name == "sin":
        flip = writer.whole("xor", writer.whole("shl", quadrant, 62), writer.bits(x))
    else:
        flip = writer.whole("shl", writer.whole("add", quadrant, 1), 62)
    sign = writer.whole("and", flip, -(2**63))
    return writer.float(writer.whole("xor", writer.bits(result), sign))


def _number(writer: Writer, condition: str) -> str:
    return writer.select(condition, writer.lanes.constant(1.0), writer.lanes.constant(0.0))


def _truth(writer: Writer, value: str) -> str:
    return writer.compare("une", value, writer.lanes.constant(0.0))  # NaN is true, as in C


def _compared(predicate: str) -> Rule:
    return lambda writer, left, right: _number(writer, writer.compare(predicate, left, right))


def _logical(writer: Writer, name: str, left: str, right: str) -> str:
    both = f"{name} {writer.lanes.boolean} {_truth(writer, left)}, {_truth(writer, right)}"
    return _number(writer, writer.let(both))


def _sign(writer: Writer, value: str) -> str:
    zero = writer.lanes.constant(0.0)
    positive = writer.select(writer.compare("ogt", value, zero), writer.lanes.constant(1.0), value)
    return writer.select(writer.compare("olt", value, zero), writer.lanes.constant(-1.0), positive)


def _extremum(writer: Writer, better: str, left: str, right: str) -> str:
    # a NaN loses, the first operand wins a tie
    beaten, missing = writer.compare(better, right, left), writer.compare("uno", left, left)
    return writer.select(writer.let(f"or {writer.lanes.boolean} {beaten}, {missing}"), right, left)


def _intrinsic(name: str) -> Rule:
    return lambda writer, *operands: writer.intrinsic(name, *operands)


def _library(name: str) -> Rule:
    return lambda writer, *operands: library_call(writer, name, *operands)


OPCODES: dict[int, Rule] = {
    **{code: _library(name) for code, name in LIBRARY.items()},
    **{code: _intrinsic(name) for code, name in SINGLE.items()},
    MULTIPLY_ADD: _intrinsic("fma"),
    MULTIPLY_SUBTRACT: lambda w, a, b, c: w.intrinsic("fma", a, b, w.real("fneg", c)),
    SUBTRACT_PRODUCT: lambda w, a, b, c: w.intrinsic("fma", w.real("fneg", a), b, c),
    SELECT: lambda w, flag, a, b: w.select(_truth(w, flag), a, b),
    casadi.OP_ASSIGN: lambda w, x: x,
    casadi.OP_ADD: lambda w, a, b: w.real("fadd", a, b),
    casadi.OP_SUB: lambda w, a, b: w.real("fsub", a, b),
    casadi.OP_MUL: lambda w, a, b: w.real("fmul", a, b),
    casadi.OP_DIV: lambda w, a, b: w.real("fdiv", a, b),
    casadi.OP_NEG: lambda w, x: w.real("fneg", x),
    casadi.OP_SQ: lambda w, x: w.real("fmul", x, x),
    casadi.OP_TWICE: lambda w, x: w.real("fadd", x, x),
    casadi.OP_INV: lambda w, x: w.real("fdiv", w.lanes.constant(1.0), x),
    casadi.OP_SIGN: _sign,
    casadi.OP_FMIN: lambda w, a, b: _extremum(w, "olt", a, b),
    casadi.OP_FMAX: lambda w, a, b: _extremum(w, "ogt", a, b),
    casadi.OP_LT: _compared("olt"),
    casadi.OP_LE: _compared("ole"),
    casadi.OP_EQ: _compared("oeq"),
    casadi.OP_NE: _compared("une"),
    casadi.OP_NOT: lambda w, x: _number(w, w.compare("oeq", x, w.lanes.constant(0.0))),
    casadi.OP_AND: lambda w, a, b: _logical(w, "and", a, b),
    casadi.OP_OR: lambda w, a, b: _logical(w, "or", a, b),
    casadi.OP_SIN: _turn("sin"),
    casadi.OP_COS: _turn("cos"),
}

_TURNS = {casadi.OP_SIN: "sin", casadi.OP_COS: "cos"}

#: Rules for arguments that are not far, see `is_far`; and for those of which only one of both functions is wanted.
NEAR: dict[int, Rule] = {code: _turn(name, "near") for code, name in _TURNS.items()}
ALONE: dict[int, Rule] = {code: _turn(name, "alone") for code, name in _TURNS.items()}
