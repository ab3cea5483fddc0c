"""Differences f(x + d) − f(x) of a traced function, without a subtraction of two numbers that are nearly alike.

Operations have rules for the difference of their results in the table of `flexhinf.codegen.operations`. A deviation of
1e-12 from a state of 1e3 then keeps its digits. Where a function has a corner, and where an operation has no rule, both
values are computed and subtracted.
"""

from __future__ import annotations

from collections import Counter
from itertools import count

import casadi as ca

from flexhinf.codegen.operations import row_of
from flexhinf.scalars.deviations import Deviated, product, terms_of
from flexhinf.scalars.trace import built, walk


def difference(function: ca.Function) -> ca.Function:
    """f(x + d) − f(x) of (x, d, *others), for a traced function f of (x, *others) with one result."""
    arguments = [ca.SX.sym(function.name_in(k), function.size1_in(k)) for k in range(function.n_in())]
    deviation = ca.SX.sym("deviation", function.size1_in(0))
    result = ca.SX.zeros(function.size1_out(0))

    def leaf(which: int, element: int) -> Deviated:
        return Deviated(arguments[which][element], None if which else deviation[element])

    uses, order = _uses(function), count()

    def operation(code: int, operands: list[Deviated]) -> Deviated:
        once = uses[next(order)] == 1
        value = built(code, [operand.value for operand in operands])
        if all(operand.moves is None for operand in operands):
            return Deviated(value)
        row = row_of(code)
        if (
            row is not None
            and row.difference is product
            and once
            and all(pair.moves is not None for pair in operands)
        ):
            terms = terms_of(*operands)
            return Deviated(value, terms[0] + terms[1], terms)
        if row is not None and row.difference is not None:
            return Deviated(value, row.difference(*operands))
        if row is not None and len(operands) == 1 and row.linear:
            return Deviated(value, built(code, [operands[0].difference]))
        return Deviated(value, built(code, [operand.moved for operand in operands]) - value)

    for _, element, pair in walk(function, leaf, lambda constant: Deviated(ca.SX(constant)), operation):
        result[element] = pair.difference
    inputs = [arguments[0], deviation, *arguments[1:]]
    return ca.Function(f"{function.name()}_difference", inputs, [ca.densify(result)], {"cse": True})


def _uses(function: ca.Function) -> Counter[int]:
    """How often the result of each operation is used."""
    uses, order = Counter[int](), count()

    def operation(code: int, operands: list[int]) -> int:
        uses.update(operands)
        return next(order)

    for _, _, value in walk(function, lambda which, element: -1, lambda constant: -1, operation):
        uses[value] += 1
    return uses
