"""A traced function as arrays, for files: its instructions in order, and the same function built from them again."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import casadi as ca
import numpy as np

#: CasADi's operations by number and by name; files hold the names.
NAMES = {getattr(ca, name): name for name in dir(ca) if name.startswith("OP_")}

COLUMNS = ("first", "second", "result", "value")

#: Operations of one and of two numbers that a file may name. CasADi takes any number of an operation here, also of
#: those that are none of scalars.
UNARY = {
    "ASSIGN", "EXP", "LOG", "SQRT", "SQ", "TWICE", "NEG", "SIN", "COS", "TAN", "ASIN", "ACOS", "ATAN", "FLOOR", "CEIL",
    "FABS", "SIGN", "ERF", "ERFINV", "INV", "SINH", "COSH", "TANH", "ASINH", "ACOSH", "ATANH", "NOT", "LOG1P", "EXPM1",
}  # fmt: skip
BINARY = {
    "ADD", "SUB", "MUL", "DIV", "POW", "CONSTPOW", "LT", "LE", "EQ", "NE", "AND", "OR", "FMOD", "REMAINDER",
    "COPYSIGN", "IF_ELSE_ZERO", "FMIN", "FMAX", "ATAN2", "HYPOT",
}  # fmt: skip

#: Most entries of an argument or a result that a file may claim.
LONGEST = 1_000_000

#: Stands for the second operand of a function of one.
ONE_OPERAND = -1


def function_arrays(function: ca.Function) -> dict[str, np.ndarray]:
    """The instructions of a scalar-expanded (SX) function.

    Parameters
    ----------
    function : casadi.Function
        As `trace` makes it: dense columns as arguments and results.

    Returns
    -------
    dict
        ``operation`` (K,) names; ``first``, ``second``, ``result`` (K,) places in a work vector, or, for arguments
        and results, which one and where in it; ``value`` (K,) constants; ``sizes`` of arguments, then of results;
        ``arguments``, how many there are.
    """
    operations, rows = [], []
    for k in range(function.n_instructions()):
        code = function.instruction_id(k)
        read, written = list(function.instruction_input(k)), list(function.instruction_output(k))
        if code == ca.OP_CONST:
            row = (0, 0, written[0], function.instruction_constant(k))
        elif code == ca.OP_INPUT:
            row = (read[0], read[1], written[0], 0.0)
        elif code == ca.OP_OUTPUT:
            row = (written[0], written[1], read[0], 0.0)
        else:
            row = (read[0], read[1] if len(read) > 1 else ONE_OPERAND, written[0], 0.0)
        operations.append(NAMES[code])
        rows.append(row)
    columns = zip(*rows) if rows else ((),) * 4
    arrays: dict[str, Any] = {
        name: np.array(column, dtype=float if name == "value" else np.int64)
        for name, column in zip(COLUMNS, columns)
    }
    sizes = [function.size1_in(k) for k in range(function.n_in())]
    sizes += [function.size1_out(k) for k in range(function.n_out())]
    arrays["operation"] = np.array(operations, dtype=np.str_)
    arrays["sizes"], arrays["arguments"] = np.array(sizes, dtype=np.int64), np.array(function.n_in())
    return arrays


def function_from_arrays(arrays: Mapping[str, np.ndarray], name: str = "stored") -> ca.Function:
    """The function again.

    Raises
    ------
    ValueError, IndexError, KeyError
        If the arrays are no function's.
    """
    count, sizes = int(arrays["arguments"]), [int(size) for size in arrays["sizes"]]
    if not (0 <= count <= len(sizes) and all(0 <= size <= LONGEST for size in sizes)):
        raise ValueError("sizes that no function has")
    if any(
        arrays[column].dtype != np.int64 or (arrays[column] < ONE_OPERAND).any() for column in COLUMNS[:3]
    ):
        raise ValueError("places that no function has")
    arguments = [ca.SX.sym(f"i{k}", size) for k, size in enumerate(sizes[:count])]
    results = [ca.SX.zeros(size) for size in sizes[count:]]
    work: dict[int, ca.SX] = {}
    rows = zip(arrays["operation"].tolist(), *(arrays[column].tolist() for column in COLUMNS), strict=True)
    for operation, first, second, result, value in rows:
        code, kind = getattr(ca, operation, -1), operation.removeprefix("OP_")
        if code == ca.OP_CONST:
            work[result] = ca.SX(value)
        elif code == ca.OP_INPUT:
            work[result] = arguments[first][second]
        elif code == ca.OP_OUTPUT:
            results[first][second] = work[result]
        elif kind in (UNARY if second == ONE_OPERAND else BINARY):
            operands = [work[place] for place in (first, second) if place != ONE_OPERAND]
            work[result] = (ca.SX.unary if second == ONE_OPERAND else ca.SX.binary)(code, *operands)
        else:
            raise ValueError(f"unknown operation {operation!r}")
    return ca.Function(name, arguments, [ca.densify(result) for result in results])
