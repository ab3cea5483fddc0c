"""A scalar CasADi expression that lives safely inside NumPy object arrays.

``casadi.SX`` is itself array-like, which confuses NumPy inside object arrays; `Symbol` is the thin
wrapper which makes slicing, ``@``, ``np.outer`` and ``np.sin`` work. What is not listed here raises: it
never guesses.
"""

from __future__ import annotations

from numbers import Real
from typing import Any

import casadi as ca
import numpy as np

from flexhinf.errors import InvalidInput


def _lift(value: Any) -> ca.SX | None:
    """The SX of a Symbol or of a real number; None for anything else (NumPy then broadcasts)."""
    if isinstance(value, Symbol):
        return value.sx
    if isinstance(value, (Real, np.bool_)):
        return ca.SX(float(value))
    return None


# `SX.unary` and `SX.binary` build the same nodes as the operators and functions of CasADi, which look for the type of
# their arguments first and take ten times as long.
def _unary(operation: int) -> Any:
    def method(self: Symbol) -> Symbol:
        return Symbol(ca.SX.unary(operation, self.sx))

    return method


def _binary(operation: int) -> Any:
    def method(self: Symbol, other: Any) -> Any:
        right = _lift(other)
        return NotImplemented if right is None else Symbol(ca.SX.binary(operation, self.sx, right))

    return method


def _reflected(operation: int) -> Any:
    def method(self: Symbol, other: Any) -> Any:
        left = _lift(other)
        return NotImplemented if left is None else Symbol(ca.SX.binary(operation, left, self.sx))

    return method


class Symbol:
    """One scalar symbolic expression.

    Parameters
    ----------
    sx : casadi.SX
        A 1 × 1 expression.
    """

    __slots__ = ("sx",)
    __hash__ = None  # type: ignore[assignment]  # == builds an expression, so a Symbol cannot be a key

    def __init__(self, sx: ca.SX) -> None:
        self.sx = sx

    __add__, __radd__ = _binary(ca.OP_ADD), _reflected(ca.OP_ADD)
    __sub__, __rsub__ = _binary(ca.OP_SUB), _reflected(ca.OP_SUB)
    __mul__, __rmul__ = _binary(ca.OP_MUL), _reflected(ca.OP_MUL)
    __truediv__, __rtruediv__ = _binary(ca.OP_DIV), _reflected(ca.OP_DIV)
    __pow__, __rpow__ = _binary(ca.OP_POW), _reflected(ca.OP_POW)
    __neg__, __abs__ = _unary(ca.OP_NEG), _unary(ca.OP_FABS)
    __lt__, __le__ = _binary(ca.OP_LT), _binary(ca.OP_LE)
    __gt__, __ge__ = _reflected(ca.OP_LT), _reflected(ca.OP_LE)  # a > b is b < a
    __eq__ = _binary(ca.OP_EQ)  # type: ignore[assignment]
    __ne__ = _binary(ca.OP_NE)  # type: ignore[assignment]
    __and__, __or__ = _binary(ca.OP_AND), _binary(ca.OP_OR)
    __invert__ = _unary(ca.OP_NOT)

    def __pos__(self) -> Symbol:
        return self

    # NumPy's ufuncs on object arrays call the method of the same name.
    sin, cos, tan = _unary(ca.OP_SIN), _unary(ca.OP_COS), _unary(ca.OP_TAN)
    arcsin, arccos, arctan = _unary(ca.OP_ASIN), _unary(ca.OP_ACOS), _unary(ca.OP_ATAN)
    sinh, cosh, tanh = _unary(ca.OP_SINH), _unary(ca.OP_COSH), _unary(ca.OP_TANH)
    arcsinh, arccosh, arctanh = _unary(ca.OP_ASINH), _unary(ca.OP_ACOSH), _unary(ca.OP_ATANH)
    exp, log, sqrt = _unary(ca.OP_EXP), _unary(ca.OP_LOG), _unary(ca.OP_SQRT)
    expm1, log1p = _unary(ca.OP_EXPM1), _unary(ca.OP_LOG1P)
    __floor__, __ceil__ = (
        _unary(ca.OP_FLOOR),
        _unary(ca.OP_CEIL),
    )  # np.floor and np.ceil go through the math module
    arctan2, hypot = _binary(ca.OP_ATAN2), _binary(ca.OP_HYPOT)

    def log10(self) -> Symbol:
        """Decimal logarithm."""
        return Symbol(ca.log(self.sx) / np.log(10.0))

    def conjugate(self) -> Symbol:
        """The symbol itself: it is real."""
        return self

    def __bool__(self) -> bool:
        raise InvalidInput(
            "A symbolic expression has no truth value, so `if`, `max`, `np.where` cannot branch on it.",
            f"expected arithmetic or a function of flexhinf.scalars, got a branch on {self!r}",
            "flexhinf.scalars.where, maximum, minimum, clip, sign or absolute; to compare whole arrays, "
            "np.greater(x, y, dtype=object)",
        )

    def __float__(self) -> float:
        if self.sx.is_constant():
            return float(self.sx)
        raise InvalidInput(
            "A symbolic expression is not a number.",
            f"expected arithmetic on the element, got float({self!r}) (math.sin and float arrays do that)",
            "np.sin instead of math.sin; np.array([...]) of the elements instead of filling a float array",
        )

    def __repr__(self) -> str:
        text = str(self.sx)
        return f"Symbol({text if len(text) < 60 else text[:57] + '...'})"
