"""A traced function as operations in single-assignment form, which machine code and C are written from.

Products are fused into the sums that use them. That is decided here, once and visibly, and not left to the compiler
(LLVM's ``contract`` flag): the same text for any number of lanes then gives the same bits, at any optimisation level.
So are two others: several quotients by one number are products with its reciprocal, which costs one division instead of
many, and a truth value is not made a number and compared again, which changes no bit.
"""

from __future__ import annotations

import operator
from collections import Counter
from collections.abc import Callable, Container, Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import NamedTuple

import casadi

from flexhinf.codegen.program import Unsupported
from flexhinf.scalars.trace import walk

# Fused operations, numbered beside CasADi's own (which are not negative).
MULTIPLY_ADD = -1  # a·b + c
MULTIPLY_SUBTRACT = -2  # a·b - c
SUBTRACT_PRODUCT = -3  # c - a·b, arguments (a, b, c)

#: Functions of the C library by opcode; and those of them that are single instructions.
LIBRARY: dict[int, str] = {casadi.OP_CONSTPOW: "pow"} | {
    getattr(casadi, f"OP_{name.upper()}"): name
    for name in (
        "tan", "asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh", "asinh", "acosh", "atanh", "exp", "expm1",
        "log", "log1p", "pow", "hypot", "fmod", "remainder", "erf",
    )
}  # fmt: skip
SINGLE: dict[int, str] = {
    getattr(casadi, f"OP_{name.upper()}"): name for name in ("sqrt", "fabs", "floor", "ceil", "copysign")
}

#: Quotients by one number from which they share its reciprocal, whatever it is.
MANY = 3


class Operation(NamedTuple):
    """One value: a constant, an input element, or an operation on earlier values.

    `code`: CasADi's opcode, or a fused operation. `arguments`: Earlier values; for OP_INPUT (argument, element).
    `constant`: Value of an OP_CONST.
    """

    code: int
    arguments: tuple[int, ...]
    constant: float = 0.0

    def on(self, arguments: tuple[int, ...]) -> Operation:
        """The same of other values."""
        return Operation(self.code, arguments, self.constant)


@dataclass(frozen=True)
class Dataflow:
    """A function as values and outputs.

    `operations`: Value k is the result of operation k; products that were fused away are missing. `outputs`:
    (result, element, value). `size`: operations before products were fused. `ends`: last value of each stage.
    """

    operations: dict[int, Operation]
    outputs: list[tuple[int, int, int]]
    size: int
    ends: tuple[int, ...] = ()


def read_dataflow(
    function: casadi.Function, supported: Container[int], fused: bool, stages: int = 0
) -> Dataflow:
    """Read the instructions of an SX function.

    `supported`: Opcodes that can be emitted. `fused`: Fuse a product with the one sum that uses it. `stages`: So many
    results, the first ones, are what stages of the function end with. They are no results of its own: they say in
    which order values are computed, and nothing is decided by them. Raises Unsupported: naming the first opcode that is
    not supported.
    """
    operations: list[Operation] = []

    def add(code: int, arguments: Sequence[int], constant: float = 0.0) -> int:
        if code not in supported and code not in (casadi.OP_CONST, casadi.OP_INPUT):
            names = [name for name in dir(casadi) if name.startswith("OP_") and getattr(casadi, name) == code]
            raise Unsupported(
                f"Function '{function.name()}' cannot be compiled.",
                f"the operation {names[0] if names else code} has no machine code here",
            )
        operations.append(Operation(code, tuple(arguments), constant))
        return len(operations) - 1

    outputs = list(
        walk(
            function,
            lambda *place: add(casadi.OP_INPUT, place),
            lambda constant: add(casadi.OP_CONST, (), constant),
            add,
        )
    )
    operations, outputs = _without_unused(*_without_truths(operations, outputs), stages)
    operations, outputs = _share_reciprocals(operations, outputs)
    last = [max((v for k, _, v in outputs if k == stage), default=0) for stage in range(stages)]
    outputs = [(k - stages, element, value) for k, element, value in outputs if k >= stages]
    kept = dict(enumerate(operations))
    if fused:
        _fuse(kept, outputs)
    return Dataflow(kept, outputs, len(operations), tuple(accumulate(last, max)))


#: Comparisons, whose result is 1 or 0.
_COMPARISONS: dict[int, Callable[[float, float], bool]] = {
    casadi.OP_LT: operator.lt, casadi.OP_LE: operator.le, casadi.OP_EQ: operator.eq, casadi.OP_NE: operator.ne,
}  # fmt: skip
_TRUTHS = {*_COMPARISONS, casadi.OP_NOT, casadi.OP_AND, casadi.OP_OR}


def _without_truths(
    operations: list[Operation], outputs: list[tuple[int, int, int]]
) -> tuple[list[Operation], list[tuple[int, int, int]]]:
    """The same values where a truth value, 1 or 0, is not made a number and compared again: "1 where the flag is not
    0" and "0.5 < flag" are the flag itself, "flag == 0" is its opposite.
    """
    truths: set[int] = set()
    places: list[int] = []

    def constant(value: int) -> float | None:
        return operations[value].constant if operations[value].code == casadi.OP_CONST else None

    def shortened(operation: Operation) -> Operation | int:
        """An equal operation, or the value that equals it."""
        code, arguments = operation.code, operation.arguments
        if code == casadi.OP_IF_ELSE_ZERO and arguments[0] in truths and constant(arguments[1]) == 1.0:
            return arguments[0]
        if code in _COMPARISONS and len(flags := [a for a in arguments if a in truths]) == 1:
            known = [constant(a) for a in arguments if a not in truths]
            if known[0] is not None:
                number = known[0]
                at = [
                    _COMPARISONS[code](*(flag if a in truths else number for a in arguments))
                    for flag in (0.0, 1.0)
                ]
                if at == [False, True]:
                    return flags[0]
                if at == [True, False]:
                    code, arguments = casadi.OP_NOT, (flags[0],)
        if code == casadi.OP_NOT and operations[arguments[0]].code == casadi.OP_NOT:
            (inner,) = operations[arguments[0]].arguments
            if inner in truths:
                return inner
        return Operation(code, arguments, operation.constant)

    for k, operation in enumerate(operations):
        if operation.code != casadi.OP_INPUT:
            operation = operation.on(tuple([places[a] for a in operation.arguments]))
            found = shortened(operation)
            if isinstance(found, int):
                places.append(found)
                continue
            operation = operations[k] = found
            second = operation.arguments[1] if operation.code == casadi.OP_IF_ELSE_ZERO else None
            if operation.code in _TRUTHS or (
                second is not None and (second in truths or constant(second) == 1.0)
            ):
                truths.add(k)
        places.append(k)
    return operations, [(result, element, places[value]) for result, element, value in outputs]


def _without_unused(
    operations: list[Operation], outputs: list[tuple[int, int, int]], stages: int
) -> tuple[list[Operation], list[tuple[int, int, int]]]:
    """Only what results depend on, but for those of stages."""
    used = {value for k, _, value in outputs if k >= stages}
    for k in reversed(range(len(operations))):
        if k in used and operations[k].code != casadi.OP_INPUT:
            used.update(operations[k].arguments)
    places = {k: place for place, k in enumerate(sorted(used))}
    kept = [
        op if op.code == casadi.OP_INPUT else op.on(tuple([places[a] for a in op.arguments]))
        for op in (operations[k] for k in sorted(used))
    ]
    return kept, [(k, element, places[value]) for k, element, value in outputs if value in used]


def _share_reciprocals(
    operations: list[Operation], outputs: list[tuple[int, int, int]]
) -> tuple[list[Operation], list[tuple[int, int, int]]]:
    """The same values with one division for all quotients by one number.

    Only by an argument of the function (a mass, an inertia), by a square root (a pivot of Cholesky's), which may
    have been replaced by zero, and by what divides `MANY` numbers (an inertia): the reciprocal of a number
    that is below 6e-309 is infinite, which a square root other than zero never is, and neither an argument nor an
    inertia should be.
    """
    quotients = Counter(op.arguments[1] for op in operations if op.code == casadi.OP_DIV)

    def shared(divisor: int) -> bool:
        operation = operations[divisor]
        if operation.code == casadi.OP_IF_ELSE_ZERO:
            operation = operations[operation.arguments[1]]
        return quotients[divisor] >= MANY or operation.code in (casadi.OP_INPUT, casadi.OP_SQRT)

    written: list[Operation] = []
    places: list[int] = []
    reciprocals: dict[int, int] = {}
    for operation in operations:
        if operation.code != casadi.OP_INPUT:
            divisor = operation.arguments[1] if operation.code == casadi.OP_DIV else -1
            operation = operation.on(tuple([places[a] for a in operation.arguments]))
            if quotients[divisor] > 1 and shared(divisor):
                if divisor not in reciprocals:
                    reciprocals[divisor] = len(written)
                    written.append(Operation(casadi.OP_INV, operation.arguments[1:]))
                operation = Operation(casadi.OP_MUL, (operation.arguments[0], reciprocals[divisor]))
        places.append(len(written))
        written.append(operation)
    return written, [(result, element, places[value]) for result, element, value in outputs]


def _fuse(operations: dict[int, Operation], outputs: list[tuple[int, int, int]]) -> None:
    uses = Counter(value for _, _, value in outputs)
    for operation in operations.values():
        if operation.code != casadi.OP_INPUT:
            uses.update(operation.arguments)

    def factors(value: int) -> tuple[int, ...] | None:
        product = operations.get(value)
        if product is None or uses[value] != 1 or product.code not in (casadi.OP_MUL, casadi.OP_SQ):
            return None
        return product.arguments * (2 if product.code == casadi.OP_SQ else 1)

    for k, operation in list(operations.items()):
        if operation.code not in (casadi.OP_ADD, casadi.OP_SUB):
            continue
        left, right = operation.arguments
        add = operation.code == casadi.OP_ADD
        if (pair := factors(right)) is not None:
            operations[k] = Operation(MULTIPLY_ADD if add else SUBTRACT_PRODUCT, (*pair, left))
            del operations[right]
        elif (pair := factors(left)) is not None:
            operations[k] = Operation(MULTIPLY_ADD if add else MULTIPLY_SUBTRACT, (*pair, right))
            del operations[left]
