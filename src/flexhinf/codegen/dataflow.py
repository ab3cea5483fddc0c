"""A traced function as operations in single-assignment form, which machine code and C are written from.

Products are fused into the sums that use them. That is decided here, once and visibly, and not left to the compiler
(LLVM's ``contract`` flag): the same text for any number of lanes then gives the same bits, at any optimisation level.
So are three others: several quotients by one number are products with its reciprocal, which costs one division instead
of many; CasADi's two halves of a choice, c·a + (not c)·b, are one operation, as NumPy's `where` (a zero that is chosen
keeps its sign); and a truth value is not made a number and compared again, which changes no bit.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate
from math import copysign
from typing import NamedTuple

import casadi

from flexhinf.codegen.operations import COMPARISONS, OPERATIONS, SELECT, TRUTHS
from flexhinf.codegen.program import Unsupported
from flexhinf.scalars.trace import walk

#: What is no operation: it is read where it is used.
LEAVES = (casadi.OP_CONST, casadi.OP_INPUT)

#: Quotients by one number from which they share its reciprocal, whatever it is.
MANY = 3


class Operation(NamedTuple):
    """One value: a constant, an input element, or an operation on earlier values.

    `code`: CasADi's opcode, or one of ours. `arguments`: Earlier values; for OP_INPUT (argument, element).
    `constant`: Value of an OP_CONST.
    """

    code: int
    arguments: tuple[int, ...]
    constant: float = 0.0

    @property
    def operands(self) -> tuple[int, ...]:
        """The values that it reads."""
        return () if self.code in LEAVES else self.arguments

    def at(self, places: Sequence[int] | Mapping[int, int]) -> Operation:
        """The same on values that stand elsewhere."""
        if self.code in LEAVES:
            return self
        return Operation(self.code, tuple([places[a] for a in self.arguments]))


@dataclass(frozen=True)
class Dataflow:
    """A function as values and outputs.

    `operations`: Value k is the result of operation k; products that were fused away are missing. `outputs`:
    (result, element, value). `size`: operations before products were fused. `ends`: last value of each stage. `stages`:
    (stage, element, value) of what stages end with, if it is used.
    """

    operations: dict[int, Operation]
    outputs: list[tuple[int, int, int]]
    size: int
    ends: tuple[int, ...] = ()
    stages: tuple[tuple[int, int, int], ...] = ()


def read_dataflow(
    function: casadi.Function, supported: Container[int], fused: bool, stages: int = 0
) -> Dataflow:
    """Read the instructions of an SX function.

    `supported`: Opcodes that can be emitted. `fused`: Fuse a product with the one sum that uses it. `stages`: So many
    results, the first ones, are what stages of the function end with. They are no results of its own: they say in
    which order values are computed, and nothing is decided by them. Raises Unsupported: naming the first opcode that is
    not supported.
    """
    shortened = _Shortened()

    def add(code: int, arguments: Sequence[int]) -> int:
        if code not in supported and code != casadi.OP_IF_ELSE_ZERO:
            names = [name for name in dir(casadi) if name.startswith("OP_") and getattr(casadi, name) == code]
            raise Unsupported(
                f"Function '{function.name()}' cannot be compiled.",
                f"the operation {names[0] if names else code} has no machine code here",
            )
        return shortened.add(code, tuple(arguments))

    outputs = list(
        walk(
            function,
            lambda argument, place: shortened.add(casadi.OP_INPUT, (argument, place)),
            lambda constant: shortened.add(casadi.OP_CONST, (), constant),
            add,
        )
    )
    operations, outputs, ends = _without_unused(shortened.operations, outputs, stages)
    operations, outputs, places = _share_reciprocals(operations, outputs)
    last = [0] * stages
    for stage, value in ends:
        last[stage] = max(last[stage], places[value])
    kept, own = (
        dict(enumerate(operations)),
        [(k - stages, element, value) for k, element, value in outputs if k >= stages],
    )
    if fused:
        _fuse(kept, own)
    of_stages = tuple(row for row in outputs if row[0] < stages)
    return Dataflow(kept, own, len(operations), tuple(accumulate(last, max)), of_stages)


def joined(
    flows: Sequence[Dataflow], functions: Sequence[casadi.Function], links: Mapping[int, int]
) -> Dataflow:
    """Functions as one, of whose arguments and results each comes after those of the functions before it.

    `links`: Arguments that are results of earlier functions, and not read.
    """
    operations, written = dict[int, Operation](), dict[tuple[int, int], int]()
    arguments = results = 0
    for flow, function in zip(flows, functions, strict=True):
        places = dict[int, int]()
        for k, operation in flow.operations.items():
            if operation.code == casadi.OP_INPUT:
                argument, element = arguments + operation.arguments[0], operation.arguments[1]
                if argument in links:
                    places[k] = written[links[argument], element]
                    continue
                operation = Operation(casadi.OP_INPUT, (argument, element))
            places[k] = len(operations)
            operations[places[k]] = operation.at(places)
        written |= {(results + result, element): places[value] for result, element, value in flow.outputs}
        arguments, results = arguments + function.n_in(), results + function.n_out()
    return Dataflow(
        operations, [(*place, value) for place, value in written.items()], sum(f.size for f in flows)
    )


class _Shortened:
    """Operations, each once, as the shortest of equal ones: a choice is one operation, and a truth value, 1 or 0, is
    not made a number and compared again.
    """

    def __init__(self) -> None:
        self.operations: list[Operation] = []
        self._places: dict[Operation, int] = {}
        self._zeros: dict[float, int] = {}  # by their sign: they are equal

    def add(self, code: int, arguments: tuple[int, ...], constant: float = 0.0) -> int:
        """The value of an operation on values."""
        if code == casadi.OP_CONST:
            return self._constant(constant)
        if code == casadi.OP_INPUT:
            return self._new(code, arguments)
        if code == casadi.OP_IF_ELSE_ZERO:
            return self._choice(arguments[0], arguments[1], self._constant(0.0))
        if code == casadi.OP_ADD and (halves := self._halves(*arguments)) is not None:
            return self._choice(*halves)
        if code == casadi.OP_NOT and self._code(arguments[0]) == casadi.OP_NOT:
            (inner,) = self.operations[arguments[0]].arguments
            if self.is_truth(inner):
                return inner
        flags = [a for a in arguments if self.is_truth(a)]
        of_truths = OPERATIONS[code].of_truths if code in OPERATIONS else None
        if of_truths is not None and len(flags) == 2:
            return self.add(of_truths, arguments)
        if code in (casadi.OP_AND, casadi.OP_OR) and len(flags) == 2 and arguments[0] == arguments[1]:
            return arguments[0]
        numbers = [self._number(a) for a in arguments if a not in flags]
        chooses = code in COMPARISONS or of_truths is not None
        if chooses and len(flags) == 1 == len(numbers) and (number := numbers[0]) is not None:
            at = [
                OPERATIONS[code].numpy(*(flag if a in flags else number for a in arguments))
                for flag in (0.0, 1.0)
            ]
            if at == [False, True]:
                return flags[0]
            if at == [True, False]:
                return self.add(casadi.OP_NOT, (flags[0],))
        return self._new(code, arguments)

    def is_truth(self, value: int) -> bool:
        """Whether a value is 1 or 0."""
        return self._code(value) in TRUTHS

    def _choice(self, flag: int, yes: int, no: int) -> int:
        """`yes` where the flag is not zero, else `no`."""
        if self._code(flag) == casadi.OP_NOT:
            return self._choice(self.operations[flag].arguments[0], no, yes)
        yes, no = self._where(flag, True, yes), self._where(flag, False, no)
        if yes == no:
            return yes
        if self.is_truth(flag):
            known = self._number(yes), self._number(no)
            if known == (1.0, 0.0):
                return flag
            if known == (0.0, 1.0):
                return self.add(casadi.OP_NOT, (flag,))
            if known[0] == 1.0 and self.is_truth(no):
                return self.add(casadi.OP_OR, (flag, no))
            if known[1] == 0.0 and self.is_truth(yes):
                return self.add(casadi.OP_AND, (flag, yes))
        return self._new(SELECT, (flag, yes, no))

    def _where(self, flag: int, truth: bool, value: int) -> int:
        """What a value is where the flag holds, or does not."""
        operation = self.operations[value]
        if operation.code != SELECT or operation.arguments[0] != flag:
            return value
        return operation.arguments[1 if truth else 2]

    def _halves(self, left: int, right: int) -> tuple[int, int, int] | None:
        """Condition, a and b of a sum that is a where the condition holds, and b elsewhere; None of another."""
        for one, other in ((left, right), (right, left)):
            flag, yes, no = self._parts(one)
            if self._number(no) == 0.0:
                opposite = self._parts(other)
                if flag == opposite[0] and self._number(opposite[1]) == 0.0:
                    return flag, yes, opposite[2]
        return None

    def _parts(self, value: int) -> tuple[int, int, int]:
        """Condition, a and b of a choice; of a truth value 1 and 0."""
        operation = self.operations[value]
        if operation.code == SELECT:
            flag, yes, no = operation.arguments
            return flag, yes, no
        if operation.code == casadi.OP_NOT:
            return operation.arguments[0], self._constant(0.0), self._constant(1.0)
        if operation.code == casadi.OP_AND and self.is_truth(operation.arguments[1]):
            return *operation.arguments, self._constant(0.0)  # type: ignore[return-value]
        return value, self._constant(1.0), self._constant(0.0) if self.is_truth(value) else value

    def _constant(self, value: float) -> int:
        if value == 0.0:
            sign = copysign(1.0, value)
            if sign not in self._zeros:
                self._zeros[sign] = len(self.operations)
                self.operations.append(Operation(casadi.OP_CONST, (), value))
            return self._zeros[sign]
        return self._new(casadi.OP_CONST, (), value)

    def _new(self, code: int, arguments: tuple[int, ...], constant: float = 0.0) -> int:
        operation = Operation(code, arguments, constant)
        if operation not in self._places:
            self._places[operation] = len(self.operations)
            self.operations.append(operation)
        return self._places[operation]

    def _code(self, value: int) -> int:
        return self.operations[value].code

    def _number(self, value: int) -> float | None:
        operation = self.operations[value]
        return operation.constant if operation.code == casadi.OP_CONST else None


def _without_unused(
    operations: list[Operation], outputs: list[tuple[int, int, int]], stages: int
) -> tuple[list[Operation], list[tuple[int, int, int]], list[tuple[int, int]]]:
    """Only what results depend on, and (stage, value) of what stages end with. That is no use: where a result has it in
    another form, the stage ends with the operands."""
    used = {value for k, _, value in outputs if k >= stages}
    for k in reversed(range(len(operations))):
        if k in used:
            used.update(operations[k].operands)
    last: list[int] = []  # used value that each value is, or is made of at last
    for k, op in enumerate(operations):
        last.append(k if k in used else max((last[a] for a in op.operands), default=-1))
    places = {k: place for place, k in enumerate(sorted(used))}
    kept = [operations[k].at(places) for k in sorted(used)]
    ends = [(k, places[last[value]]) for k, _, value in outputs if k < stages and last[value] >= 0]
    return kept, [(k, element, places[value]) for k, element, value in outputs if value in used], ends


def _share_reciprocals(
    operations: list[Operation], outputs: list[tuple[int, int, int]]
) -> tuple[list[Operation], list[tuple[int, int, int]], list[int]]:
    """The same values with one division for all quotients by one number, and the new place of each.

    Only by an argument of the function (a mass, an inertia), by a square root (a pivot of Cholesky's), which may
    have been replaced by zero, and by what divides `MANY` numbers (an inertia): the reciprocal of a number
    that is below 6e-309 is infinite, which a square root other than zero never is, and neither an argument nor an
    inertia should be.
    """
    quotients = Counter(op.arguments[1] for op in operations if op.code == casadi.OP_DIV)

    def shared(divisor: int) -> bool:
        operation = operations[divisor]
        if operation.code == SELECT:  # the root of a pivot, or zero
            _, yes, no = (operations[a] for a in operation.arguments)
            operation = yes if (no.code, no.constant) == (casadi.OP_CONST, 0.0) else no
        return quotients[divisor] >= MANY or operation.code in (casadi.OP_INPUT, casadi.OP_SQRT)

    written: list[Operation] = []
    places: list[int] = []
    reciprocals: dict[int, int] = {}
    for operation in operations:
        divisor = operation.arguments[1] if operation.code == casadi.OP_DIV else -1
        operation = operation.at(places)
        if quotients[divisor] > 1 and shared(divisor):
            if divisor not in reciprocals:
                reciprocals[divisor] = len(written)
                written.append(Operation(casadi.OP_INV, operation.arguments[1:]))
            operation = Operation(casadi.OP_MUL, (operation.arguments[0], reciprocals[divisor]))
        places.append(len(written))
        written.append(operation)
    return written, [(result, element, places[value]) for result, element, value in outputs], places


def _fuse(operations: dict[int, Operation], outputs: list[tuple[int, int, int]]) -> None:
    uses = Counter(value for _, _, value in outputs)
    for operation in operations.values():
        uses.update(operation.operands)

    def factors(value: int) -> tuple[int, ...] | None:
        product = operations.get(value)
        if product is None or uses[value] != 1 or product.code not in OPERATIONS:
            return None
        return tuple([product.arguments[k] for k in OPERATIONS[product.code].factors]) or None

    for k, operation in list(operations.items()):
        if operation.code in LEAVES or (fused := OPERATIONS[operation.code].fused) is None:
            continue
        left, right = operation.arguments
        if (pair := factors(right)) is not None:
            operations[k] = Operation(fused[1], (*pair, left))
            del operations[right]
        elif (pair := factors(left)) is not None:
            operations[k] = Operation(fused[0], (*pair, right))
            del operations[left]
