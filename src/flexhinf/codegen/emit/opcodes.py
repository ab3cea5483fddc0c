"""CasADi's operations as LLVM operations: the one table.

Every rule follows the meaning of CasADi's own evaluator, NaN and signed zero included; the tests compare them
one by one. Functions of the C library are called lane by lane: the same bits as CasADi, for any number of
lanes.
"""

from __future__ import annotations

from collections.abc import Callable

import casadi

from flexhinf.codegen.emit.dataflow import MULTIPLY_ADD, MULTIPLY_SUBTRACT, SUBTRACT_PRODUCT
from flexhinf.codegen.emit.text import Writer, library_call
from flexhinf.codegen.emit.trigonometry import cosine, near_cosine, near_sine, sine

Rule = Callable[..., str]
"""(writer, name of each operand) → name of the result."""


def _operation(name: str) -> Rule:
    return lambda writer, *operands: writer.real(name, *operands)


def _intrinsic(name: str) -> Rule:
    return lambda writer, *operands: writer.intrinsic(name, *operands)


def _library(name: str) -> Rule:
    return lambda writer, *operands: library_call(writer, name, *operands)


def _comparison(predicate: str) -> Rule:
    return lambda writer, left, right: _number(writer, writer.compare(predicate, left, right))


def _number(writer: Writer, condition: str) -> str:
    return writer.select(condition, writer.lanes.constant(1.0), writer.lanes.constant(0.0))


def _truth(writer: Writer, value: str) -> str:
    return writer.compare("une", value, writer.lanes.constant(0.0))  # NaN is true, as in C


def _logical(name: str) -> Rule:
    def rule(writer: Writer, left: str, right: str) -> str:
        both = f"{name} {writer.lanes.boolean} {_truth(writer, left)}, {_truth(writer, right)}"
        return _number(writer, writer.let(both))

    return rule


def _not(writer: Writer, value: str) -> str:
    return _number(writer, writer.compare("oeq", value, writer.lanes.constant(0.0)))


def _if_else_zero(writer: Writer, condition: str, value: str) -> str:
    return writer.select(_truth(writer, condition), value, writer.lanes.constant(0.0))


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


def _multiply_subtract(writer: Writer, left: str, right: str, subtrahend: str) -> str:
    return writer.intrinsic("fma", left, right, writer.real("fneg", subtrahend))


def _subtract_product(writer: Writer, left: str, right: str, minuend: str) -> str:
    return writer.intrinsic("fma", writer.real("fneg", left), right, minuend)


OPCODES: dict[int, Rule] = {
    MULTIPLY_ADD: _intrinsic("fma"),
    MULTIPLY_SUBTRACT: _multiply_subtract,
    SUBTRACT_PRODUCT: _subtract_product,
    casadi.OP_ASSIGN: lambda writer, value: value,
    casadi.OP_ADD: _operation("fadd"),
    casadi.OP_SUB: _operation("fsub"),
    casadi.OP_MUL: _operation("fmul"),
    casadi.OP_DIV: _operation("fdiv"),
    casadi.OP_NEG: _operation("fneg"),
    casadi.OP_SQ: lambda writer, value: writer.real("fmul", value, value),
    casadi.OP_TWICE: lambda writer, value: writer.real("fadd", value, value),
    casadi.OP_INV: lambda writer, value: writer.real("fdiv", writer.lanes.constant(1.0), value),
    casadi.OP_SQRT: _intrinsic("sqrt"),
    casadi.OP_FABS: _intrinsic("fabs"),
    casadi.OP_FLOOR: _intrinsic("floor"),
    casadi.OP_CEIL: _intrinsic("ceil"),
    casadi.OP_COPYSIGN: _intrinsic("copysign"),
    casadi.OP_SIGN: _sign,
    casadi.OP_FMIN: _extremum("olt"),
    casadi.OP_FMAX: _extremum("ogt"),
    casadi.OP_LT: _comparison("olt"),
    casadi.OP_LE: _comparison("ole"),
    casadi.OP_EQ: _comparison("oeq"),
    casadi.OP_NE: _comparison("une"),
    casadi.OP_NOT: _not,
    casadi.OP_AND: _logical("and"),
    casadi.OP_OR: _logical("or"),
    casadi.OP_IF_ELSE_ZERO: _if_else_zero,
    casadi.OP_SIN: sine,
    casadi.OP_COS: cosine,
    casadi.OP_TAN: _library("tan"),
    casadi.OP_ASIN: _library("asin"),
    casadi.OP_ACOS: _library("acos"),
    casadi.OP_ATAN: _library("atan"),
    casadi.OP_ATAN2: _library("atan2"),
    casadi.OP_SINH: _library("sinh"),
    casadi.OP_COSH: _library("cosh"),
    casadi.OP_TANH: _library("tanh"),
    casadi.OP_ASINH: _library("asinh"),
    casadi.OP_ACOSH: _library("acosh"),
    casadi.OP_ATANH: _library("atanh"),
    casadi.OP_EXP: _library("exp"),
    casadi.OP_EXPM1: _library("expm1"),
    casadi.OP_LOG: _library("log"),
    casadi.OP_LOG1P: _library("log1p"),
    casadi.OP_POW: _library("pow"),
    casadi.OP_CONSTPOW: _library("pow"),
    casadi.OP_HYPOT: _library("hypot"),
    casadi.OP_FMOD: _library("fmod"),
    casadi.OP_REMAINDER: _library("remainder"),
    casadi.OP_ERF: _library("erf"),
}

#: Rules for arguments that are not far, see `flexhinf.codegen.emit.trigonometry.is_far`.
NEAR: dict[int, Rule] = {casadi.OP_SIN: near_sine, casadi.OP_COS: near_cosine}
