"""Functions that are not smooth: they dispatch on the element, or refuse by name.

NumPy's own ``where``, ``sign``, ``clip`` and ``maximum`` compare elements, which a symbol, a truncated
polynomial or an interval cannot answer with yes or no.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np

from flexhinf.errors import InvalidInput
from flexhinf.scalars.symbol import Symbol


def _sx(value: Any) -> ca.SX:
    return value.sx if isinstance(value, Symbol) else ca.SX(float(value))


def _dispatch(name: str, numeric: Callable[..., Any], symbolic: Callable[..., ca.SX]) -> Callable[..., Any]:
    """A function that uses NumPy on numbers and CasADi on symbols, element by element."""

    def one(*elements: Any) -> Any:
        kinds = {type(e) for e in elements if not isinstance(e, (float, int, bool, np.generic))}
        if not kinds:
            return numeric(*elements)
        if kinds == {Symbol}:
            return Symbol(symbolic(*map(_sx, elements)))
        offender = next(kind for kind in kinds if kind is not Symbol)
        method = getattr(offender, f"piecewise_{name}", None)
        if method is not None:
            return method(*elements)
        raise InvalidInput(
            f"The function {name} is not smooth, so it is not defined on {offender.__name__} elements.",
            f"expected numbers or symbols, got {offender.__name__}",
            "a smooth model for the synthesis (tanh instead of sign); piecewise ones in the true plant only",
        )

    def function(*arguments: Any) -> Any:
        if all(np.asarray(a).dtype != object for a in arguments):
            return numeric(*arguments)
        result = np.frompyfunc(one, len(arguments), 1)(*arguments)
        return result

    function.__name__ = name
    return function


where = _dispatch("where", np.where, lambda c, a, b: ca.if_else(c, a, b))
maximum = _dispatch("maximum", np.maximum, ca.fmax)
minimum = _dispatch("minimum", np.minimum, ca.fmin)
sign = _dispatch("sign", np.sign, ca.sign)
absolute = _dispatch("absolute", np.abs, ca.fabs)
clip = _dispatch(
    "clip",
    np.clip,
    lambda x, low, high: ca.if_else(
        x < low, low, ca.if_else(x > high, high, x)
    ),  # NaN stays NaN; fmax drops it
)

where.__doc__ = """``a`` where the condition holds, else ``b``; both branches are evaluated.

A condition on symbols compares elements (``x[0] > 0``), or arrays by ``np.greater(x, y, dtype=object)``:
the operators of NumPy's arrays want yes or no.
"""
maximum.__doc__ = "The larger of two elements."
minimum.__doc__ = "The smaller of two elements."
sign.__doc__ = "−1, 0 or 1."
absolute.__doc__ = "The absolute value."
clip.__doc__ = "``x`` limited to [low, high]."
