"""CasADi's operations as LLVM operations: the one table.

Every rule follows the meaning of CasADi's own evaluator, NaN and signed zero included; the tests compare them
one by one. Functions of the C library are called lane by lane: the same bits as CasADi, for any number of
lanes.

Sine and cosine: one sequence of operations for one lane and for many, so that all give the same bits.

x is reduced by Cody and Waite's method in three parts with fused multiply-adds, r = x - k·π/2 with |r| ≤ π/4,
and the polynomials of fdlibm (k_sin.c, k_cos.c) give sin r and cos r, of which the quadrant k mod 4 takes
one. Arguments beyond `REACH` go to the C library.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import casadi

from flexhinf.codegen.emit.dataflow import LIBRARY, MULTIPLY_ADD, MULTIPLY_SUBTRACT, SINGLE, SUBTRACT_PRODUCT
from flexhinf.codegen.emit.text import PURE, Writer, library_call
from flexhinf.codegen.program import PREFIX

REACH = 2.0**30
"""Largest |x| that is reduced here: x·2/π is known to well below 1, so that k is the nearest integer."""

# π/2 as an unevaluated sum of three float64 numbers.
HALF_PI = (
    float.fromhex("0x1.921fb54442d18p+0"),
    float.fromhex("0x1.1a62633145c07p-54"),
    float.fromhex("-0x1.f1976b7ed8fbcp-110"),
)
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


Rule = Callable[..., str]
"""(writer, name of each operand) → name of the result."""


def is_far(writer: Writer, value: str) -> str:
    """Emit whether x is finite and beyond `REACH`, in each lane."""
    lanes = writer.lanes
    size = writer.intrinsic("fabs", value)
    far = writer.compare("ogt", size, lanes.constant(REACH))
    finite = writer.compare("olt", size, lanes.constant(math.inf))
    return writer.let(f"and {lanes.boolean} {far}, {finite}")


def _turn(name: str, near: bool = False) -> Rule:
    """sin x or cos x by a function of the module; with `near` a straight line, for what is not `is_far`."""

    def rule(caller: Writer, value: str) -> str:
        full = f"{PREFIX}{name}_{'near' if near else 'reduced'}{caller.lanes.width}"
        if full not in caller.module.definitions:
            writer = Writer(caller.module, caller.lanes)
            lanes, real = writer.lanes, writer.lanes.real
            result = within = _near(writer, "%x", name)
            if not near:  # the C library beyond the reach, behind a branch that is hardly ever taken
                far = is_far(writer, "%x")
                writer.do(f"br i1 {writer.any(far)}, label %beyond, label %done, !prof !0")
                writer.place("beyond")
                exact = writer.select(far, library_call(writer, name, "%x"), within)
                writer.do("br label %done")
                writer.place("done")
                result = writer.let(f"phi {lanes.real} [ {within}, %entry ], [ {exact}, %beyond ]")
            writer.do(f"ret {real} {result}")
            head = f"define internal {real} @{full}({real} %x) alwaysinline {PURE} {{\nentry:"
            caller.module.definitions[full] = "\n".join([head, *writer.lines, "}"])
        return caller.call(full, value)

    return rule


def _near(writer: Writer, value: str, name: str) -> str:
    """The function for |x| ≤ REACH; NaN for NaN and infinities."""
    lanes = writer.lanes
    size = writer.intrinsic("fabs", value)
    shifted = writer.intrinsic("fma", size, lanes.constant(2.0 / math.pi), lanes.constant(ROUNDER))
    quadrant = writer.bits(shifted)
    turns = writer.real("fneg", writer.real("fsub", shifted, lanes.constant(ROUNDER)))
    rest = size
    for part in HALF_PI:
        rest = writer.intrinsic("fma", turns, lanes.constant(part), rest)
    odd = writer.let(
        f"icmp ne {lanes.integer} {writer.whole('and', quadrant, lanes.whole(1))}, {lanes.whole(0)}"
    )
    square = writer.real("fmul", rest, rest)

    def horner(coefficients: tuple[float, ...]) -> str:
        value = lanes.constant(coefficients[0])
        for coefficient in coefficients[1:]:
            value = writer.intrinsic("fma", value, square, lanes.constant(coefficient))
        return value

    cube = writer.real("fmul", square, rest)
    sin = writer.intrinsic("fma", horner(SINE), cube, rest)
    parabola = writer.intrinsic("fma", square, lanes.constant(-0.5), lanes.constant(1.0))
    fourth = writer.real("fmul", square, square)
    cos = writer.intrinsic("fma", horner(COSINE), fourth, parabola)
    if name == "sin":
        result = writer.select(odd, cos, sin)
        flip = writer.whole("xor", writer.whole("shl", quadrant, lanes.whole(62)), writer.bits(value))
    else:
        result = writer.select(odd, sin, cos)
        flip = writer.whole("shl", writer.whole("add", quadrant, lanes.whole(1)), lanes.whole(62))
    sign = writer.whole("and", flip, lanes.whole(-(2**63)))
    return writer.float(writer.whole("xor", writer.bits(result), sign))


def _number(writer: Writer, condition: str) -> str:
    return writer.select(condition, writer.lanes.constant(1.0), writer.lanes.constant(0.0))


def _truth(writer: Writer, value: str) -> str:
    return writer.compare("une", value, writer.lanes.constant(0.0))  # NaN is true, as in C


def _compared(predicate: str) -> Rule:
    return lambda writer, left, right: _number(writer, writer.compare(predicate, left, right))


def _logical(name: str) -> Rule:
    def rule(writer: Writer, left: str, right: str) -> str:
        both = f"{name} {writer.lanes.boolean} {_truth(writer, left)}, {_truth(writer, right)}"
        return _number(writer, writer.let(both))

    return rule


def _sign(writer: Writer, value: str) -> str:
    zero = writer.lanes.constant(0.0)
    positive = writer.select(writer.compare("ogt", value, zero), writer.lanes.constant(1.0), value)
    return writer.select(writer.compare("olt", value, zero), writer.lanes.constant(-1.0), positive)


def _extremum(better: str) -> Rule:
    """fmin, fmax of C: a NaN loses, the first operand wins a tie."""

    def rule(writer: Writer, left: str, right: str) -> str:
        beaten = writer.compare(better, right, left)
        missing = writer.compare("uno", left, left)
        return writer.select(writer.let(f"or {writer.lanes.boolean} {beaten}, {missing}"), right, left)

    return rule


def _instruction(name: str) -> Rule:
    return lambda writer, *operands: writer.real(name, *operands)


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
    casadi.OP_ASSIGN: lambda w, x: x,
    casadi.OP_ADD: _instruction("fadd"),
    casadi.OP_SUB: _instruction("fsub"),
    casadi.OP_MUL: _instruction("fmul"),
    casadi.OP_DIV: _instruction("fdiv"),
    casadi.OP_NEG: _instruction("fneg"),
    casadi.OP_SQ: lambda w, x: w.real("fmul", x, x),
    casadi.OP_TWICE: lambda w, x: w.real("fadd", x, x),
    casadi.OP_INV: lambda w, x: w.real("fdiv", w.lanes.constant(1.0), x),
    casadi.OP_SIGN: _sign,
    casadi.OP_FMIN: _extremum("olt"),
    casadi.OP_FMAX: _extremum("ogt"),
    casadi.OP_LT: _compared("olt"),
    casadi.OP_LE: _compared("ole"),
    casadi.OP_EQ: _compared("oeq"),
    casadi.OP_NE: _compared("une"),
    casadi.OP_NOT: lambda w, x: _number(w, w.compare("oeq", x, w.lanes.constant(0.0))),
    casadi.OP_AND: _logical("and"),
    casadi.OP_OR: _logical("or"),
    casadi.OP_IF_ELSE_ZERO: lambda w, flag, x: w.select(_truth(w, flag), x, w.lanes.constant(0.0)),
    casadi.OP_SIN: _turn("sin"),
    casadi.OP_COS: _turn("cos"),
}

#: Rules for arguments that are not far, see `flexhinf.codegen.emit.opcodes.is_far`.
NEAR: dict[int, Rule] = {casadi.OP_SIN: _turn("sin", near=True), casadi.OP_COS: _turn("cos", near=True)}
