"""CasADi's operations as C expressions: the one table, with the meaning of `flexhinf.codegen.emit.opcodes`."""

from __future__ import annotations

from collections.abc import Callable

import casadi

from flexhinf.codegen.c.numbers import Real, constant
from flexhinf.codegen.emit.dataflow import MULTIPLY_ADD, MULTIPLY_SUBTRACT, SUBTRACT_PRODUCT

Rule = Callable[..., str]
"""(type, text of each operand) → expression."""


def _infix(sign: str) -> Rule:
    return lambda real, left, right: f"{left} {sign} {right}"


def _function(name: str) -> Rule:
    return lambda real, *operands: f"{name}{real.suffix}({', '.join(operands)})"


def _truth(sign: str) -> Rule:
    return lambda real, left, right: _number(real, f"{left} {sign} {right}")


def _number(real: Real, condition: str) -> str:
    return f"({condition}) ? {constant(1.0, real)} : {constant(0.0, real)}"


def _set(real: Real, value: str) -> str:
    """Whether a number stands for "true": NaN does, as in C."""
    return f"{value} != {constant(0.0, real)}"


def _logical(sign: str) -> Rule:
    return lambda real, left, right: _number(real, f"({_set(real, left)}) {sign} ({_set(real, right)})")


def _extremum(sign: str) -> Rule:
    """fmin, fmax of C: a NaN loses, the first operand wins a tie."""
    return lambda real, left, right: f"({right} {sign} {left} || isnan({left})) ? {right} : {left}"


def _sign(real: Real, value: str) -> str:
    zero, one = constant(0.0, real), constant(1.0, real)
    return f"({value} < {zero}) ? -{one} : (({value} > {zero}) ? {one} : {value})"


#: Functions of ``<math.h>``, by CasADi's names; those of `WITHOUT_CALL` are single instructions.
FUNCTIONS = (
    "sqrt", "fabs", "floor", "ceil", "copysign", "sin", "cos", "tan", "asin", "acos", "atan", "atan2", "sinh", "cosh",
    "tanh", "asinh", "acosh", "atanh", "exp", "expm1", "log", "log1p", "pow", "hypot", "fmod", "remainder", "erf",
)  # fmt: skip
WITHOUT_CALL = ("fabs", "floor", "ceil", "copysign")

OPERATIONS: dict[int, Rule] = {
    MULTIPLY_ADD: lambda real, left, right, plus: f"FMA({left}, {right}, {plus})",
    MULTIPLY_SUBTRACT: lambda real, left, right, minus: f"FMA({left}, {right}, -{minus})",
    SUBTRACT_PRODUCT: lambda real, left, right, minuend: f"FMA(-{left}, {right}, {minuend})",
    casadi.OP_ASSIGN: lambda real, value: value,
    casadi.OP_ADD: _infix("+"),
    casadi.OP_SUB: _infix("-"),
    casadi.OP_MUL: _infix("*"),
    casadi.OP_DIV: _infix("/"),
    casadi.OP_NEG: lambda real, value: f"-{value}",
    casadi.OP_SQ: lambda real, value: f"{value} * {value}",
    casadi.OP_TWICE: lambda real, value: f"{value} + {value}",
    casadi.OP_INV: lambda real, value: f"{constant(1.0, real)} / {value}",
    casadi.OP_SIGN: _sign,
    casadi.OP_FMIN: _extremum("<"),
    casadi.OP_FMAX: _extremum(">"),
    casadi.OP_LT: _truth("<"),
    casadi.OP_LE: _truth("<="),
    casadi.OP_EQ: _truth("=="),
    casadi.OP_NE: _truth("!="),
    casadi.OP_NOT: lambda real, value: _number(real, f"{value} == {constant(0.0, real)}"),
    casadi.OP_AND: _logical("&&"),
    casadi.OP_OR: _logical("||"),
    casadi.OP_IF_ELSE_ZERO: lambda real, flag, value: (
        f"({_set(real, flag)}) ? {value} : {constant(0.0, real)}"
    ),
    casadi.OP_CONSTPOW: _function("pow"),
    **{getattr(casadi, f"OP_{name.upper()}"): _function(name) for name in FUNCTIONS},
}

#: Operations that call the mathematical library.
LIBRARY = {casadi.OP_CONSTPOW} | {
    getattr(casadi, f"OP_{name.upper()}") for name in FUNCTIONS if name not in WITHOUT_CALL
}
