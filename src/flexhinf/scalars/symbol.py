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

__all__ = ["Symbol"]


def _lift(value: Any) -> ca.SX | None:
    """The SX of a Symbol or of a real number; None for anything else (NumPy then broadcasts)."""
    if isinstance(value, Symbol):
        return value.sx
    if isinstance(value, (Real, np.bool_)):
        return ca.SX(float(value))
    return None


def _unary(function: Any) -> Any:
    def method(self: Symbol) -> Symbol:
        return Symbol(function(self.sx))

    return method


def _binary(function: Any) -> Any:
    def method(self: Symbol, other: Any) -> Any:
        right = _lift(other)
        return NotImplemented if right is None else Symbol(function(self.sx, right))

    return method


def _reflected(function: Any) -> Any:
    def method(self: Symbol, other: Any) -> Any:
        left = _lift(other)
        return NotImplemented if left is None else Symbol(function(left, self.sx))

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

    __add__, __radd__ = _binary(lambda a, b: a + b), _reflected(lambda a, b: a + b)
    __sub__, __rsub__ = _binary(lambda a, b: a - b), _reflected(lambda a, b: a - b)
    __mul__, __rmul__ = _binary(lambda a, b: a * b), _reflected(lambda a, b: a * b)
    __truediv__, __rtruediv__ = _binary(lambda a, b: a / b), _reflected(lambda a, b: a / b)
    __pow__, __rpow__ = _binary(lambda a, b: a**b), _reflected(lambda a, b: a**b)
    __neg__, __abs__ = _unary(lambda a: -a), _unary(ca.fabs)
    __lt__, __le__ = _binary(lambda a, b: a < b), _binary(lambda a, b: a <= b)
    __gt__, __ge__ = _binary(lambda a, b: a > b), _binary(lambda a, b: a >= b)
    __eq__ = _binary(lambda a, b: a == b)  # type: ignore[assignment]
    __ne__ = _binary(lambda a, b: a != b)  # type: ignore[assignment]
    __and__, __or__ = _binary(ca.logic_and), _binary(ca.logic_or)
    __invert__ = _unary(ca.logic_not)

    def __pos__(self) -> Symbol:
        return self

    # NumPy's ufuncs on object arrays call the method of the same name.
    sin, cos, tan = _unary(ca.sin), _unary(ca.cos), _unary(ca.tan)
    arcsin, arccos, arctan = _unary(ca.asin), _unary(ca.acos), _unary(ca.atan)
    sinh, cosh, tanh = _unary(ca.sinh), _unary(ca.cosh), _unary(ca.tanh)
    arcsinh, arccosh, arctanh = _unary(ca.asinh), _unary(ca.acosh), _unary(ca.atanh)
    exp, log, sqrt = _unary(ca.exp), _unary(ca.log), _unary(ca.sqrt)
    expm1, log1p = _unary(ca.expm1), _unary(ca.log1p)
    __floor__, __ceil__ = _unary(ca.floor), _unary(ca.ceil)  # np.floor and np.ceil go through the math module
    arctan2, hypot = _binary(ca.atan2), _binary(ca.hypot)

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
