"""Values of a traced function as expressions of C.

A value that is used once stands inside the expression that uses it, up to a bounded size; every other has a name. A
truth value is a condition, or a ``bool``, and a number only where one is needed. What a choice chooses between is
computed before it, by a line of its own: a step then takes as long whatever it chooses, and compilers make vectors.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import casadi

from flexhinf.codegen.c.algebra import Real, constant, tolerance
from flexhinf.codegen.dataflow import LEAVES, Dataflow, Operation
from flexhinf.codegen.naming import Names
from flexhinf.codegen.operations import LOGIC, OPERATIONS, SELECT, TRUTHS

NOTHING: Mapping[int, str] = MappingProxyType({})

#: Operations, and about so many characters, of one expression at most.
MOST, WIDEST = 4, 90

#: What names of places in the memory begin with.
OWN = re.compile(r"\w+?_(?=AT_)")


@dataclass(frozen=True)
class Text:
    """An expression; `whole`: it needs no brackets as an operand."""

    bare: str
    whole: bool = False

    def __str__(self) -> str:
        return self.bare if self.whole else f"({self.bare})"

    @property
    def choice(self) -> str:
        """As the condition of a choice."""
        return self.bare if self.bare.isidentifier() else f"({self.bare})"


class Expressions:
    """Which values of a function have a line of their own, and what is written for each.

    `inside`: Where each value is computed; only there it may stand in the expression of another. `read`: Text of an
    element of an argument, (argument, element). `calls`: Names of functions by opcode. `named`: Elements of arguments
    that are used more than once, or chosen, have a line too. `numbers`, `flags`: Text of values that are known in the
    function of C that is being written, as numbers and as conditions. `labels`: What values are called, where nothing
    else is in the scope of that function.
    """

    def __init__(
        self,
        flow: Dataflow,
        inside: Mapping[int, Hashable],
        real: Real,
        read: Callable[[int, int], str],
        calls: Mapping[int, str],
        named: bool = False,
        labels: Mapping[int, str] = NOTHING,
    ) -> None:
        self.flow, self.real, self._read, self._calls, self._labels = flow, real, read, calls, labels
        self.begin({}, Names())
        self._as_number, self._as_flag = Counter[int](), Counter[int]()
        self._plain = set[int]()  # used by an operation that takes a name
        self._lines = named
        for operation in flow.operations.values():
            for place, value in enumerate(operation.operands):
                (self._as_flag if self._is_condition(operation, place) else self._as_number)[value] += 1
                if self._takes_name(operation, place):
                    self._plain.add(value)
        self.results = Counter(value for _, _, value in flow.outputs)
        self.sizes = dict[int, int]()  # operations of each value's expression
        self._within = self._embedded(inside)
        self._used = dict[int, list[tuple[int, bool]]]()  # what was found of each value

    def _takes_name(self, operation: Operation, place: int) -> bool:
        return OPERATIONS[operation.code].named or (operation.code == SELECT and place > 0)

    def _is_condition(self, operation: Operation, place: int) -> bool:
        """Whether an argument of an operation is one, and not a number."""
        selecting = operation.code in LOGIC or (operation.code, place) == (SELECT, 0)
        return selecting and self._is_truth(operation.arguments[place])

    def _is_truth(self, value: int) -> bool:
        return self.flow.operations[value].code in TRUTHS

    def _embedded(self, inside: Mapping[int, Hashable]) -> set[int]:
        """Values that stand in the expression that uses them."""
        found, sizes, widths = set[int](), self.sizes, dict[int, int]()
        for k, operation in self.flow.operations.items():
            if operation.code in LEAVES:
                continue
            size, width = 1, 8 + sum(map(self._width, operation.arguments))
            for value in operation.arguments:
                more = sizes.get(value, MOST)
                uses = self._as_number[value] + self._as_flag[value] + self.results[value]
                if (
                    uses == 1
                    and value not in self._plain
                    and value in sizes
                    and inside[value] == inside[k]
                    and size + more <= MOST
                    and width + widths[value] <= WIDEST
                ):
                    found.add(value)
                    size, width = size + more, width + widths[value]
            sizes[k], widths[k] = size, width
        return found

    def _width(self, value: int) -> int:
        """Characters of a leaf, about; of a place in the memory without the file's own name, which says nothing."""
        operation = self.flow.operations[value]
        return (
            len(OWN.sub("", self._read(*operation.arguments), 1)) if operation.code == casadi.OP_INPUT else 6
        )

    def lines(self, values: Sequence[int]) -> list[int]:
        """Those of the values that are no part of another's expression."""
        return [k for k in values if k not in self._within and self.flow.operations[k].code not in LEAVES]

    def leaves(self, value: int) -> list[int]:
        """Values and elements that the expression of a value is made of."""
        return [k for k, _ in self._uses(value)]

    def _uses(self, value: int) -> list[tuple[int, bool]]:
        """Those, and whether they are used as conditions."""
        if value not in self._used:
            found, operation = list[tuple[int, bool]](), self.flow.operations[value]
            for place, k in enumerate(operation.operands):
                found += self._uses(k) if k in self._within else [(k, self._is_condition(operation, place))]
            self._used[value] = found
        return self._used[value]

    def loads(self, value: int) -> list[int]:
        """Values that are read from memory by a line of their own before that of a value."""
        return [k for k, condition in self._uses(value) if self._is_loaded(k, condition)]

    def _is_loaded(self, value: int, condition: bool) -> bool:
        if self.flow.operations[value].code == casadi.OP_INPUT:
            several = value in self._plain or self._as_number[value] + self.results[value] > 1
            return self._lines and value not in self.numbers and several
        several = condition and self._as_flag[value] > 1
        return several and value not in self.flags and value in self.numbers

    def declared(self, value: int) -> list[str]:
        """Lines that give a value its names."""
        truth, lines = self._is_truth(value), list[str]()
        if truth and self._as_flag[value]:
            condition, name = self.condition(value).bare, self._names.numbered("c")
            lines.append(f"const bool {name} = {condition};")
            self.flags[value] = name
        if value not in self.numbers and (not truth or self._as_number[value] or not lines):
            text, label = self.number(value).bare, self._labels.get(value, "")
            free = label and label not in self._names
            name = self._names.allot(label) if free else self._names.numbered("v")
            lines.append(f"const {self.real.written} {name} = {text};")
            self.numbers[value] = name
        return lines

    def named(self, value: int) -> int:
        """How many lines give a value its names."""
        return 1 + bool(self._is_truth(value) and self._as_flag[value] and self._as_number[value])

    def begin(self, numbers: Mapping[int, str], names: Names) -> None:
        """Write another function: values that are known in it, as numbers, and its scope."""
        self.numbers, self.flags, self._names = dict(numbers), dict[int, str](), names

    def number(self, value: int) -> Text:
        """A value as a number."""
        operation = self.flow.operations[value]
        if value in self.numbers:
            return Text(self.numbers[value], True)
        if operation.code == casadi.OP_CONST:
            text = constant(tolerance(operation.constant, self.real), self.real)
            return Text(text, not text.startswith("-"))
        if operation.code == casadi.OP_INPUT:
            return Text(self._read(*operation.arguments), True)
        if operation.code in TRUTHS:
            return Text(f"{self.condition(value).choice} ? {self._unit} : {self._zero}")
        operands = [
            self.condition(k) if (operation.code, place) == (SELECT, 0) else self.number(k)
            for place, k in enumerate(operation.arguments)
        ]
        if operation.code in self._calls:
            return Text(f"{self._calls[operation.code]}({operands[0].bare})", True)
        row, first = OPERATIONS[operation.code], self.flow.operations[operation.arguments[0]].code
        number = first == casadi.OP_CONST or first in TRUTHS
        text = row.c_of_number if number and row.c_of_number else row.c
        written = text.format(*operands, one=self._unit, zero=self._zero, f=self.real.suffix)
        called = written[0].isalpha() and text.endswith(")")
        return Text(written, called or operation.code == casadi.OP_ASSIGN)

    def _is_zero(self, value: int) -> Text:
        """Whether a value is zero, of which no compiler warns as of ``==``; NaN is not."""
        return Text(f"fabs{self.real.suffix}({self.number(value).bare}) <= {self._zero}")

    def _are_equal(self, first: int, second: int) -> Text:
        """Likewise, whether two values are equal."""
        operation = self.flow.operations[second]
        if operation.code == casadi.OP_CONST and operation.constant == 0.0:
            return self._is_zero(first)
        a, b = self.number(first), self.number(second)
        return Text(f"({a} <= {b}) && ({a} >= {b})")

    def condition(self, value: int) -> Text:
        """Whether a value is not zero."""
        operation = self.flow.operations[value]
        if value in self.flags:
            return Text(self.flags[value], True)
        if operation.code not in TRUTHS or value in self.numbers:
            return Text(f"!{self._is_zero(value)}", True)
        if operation.code in (casadi.OP_EQ, casadi.OP_NE):
            equal = self._are_equal(*operation.arguments)
            return Text(f"!{equal}", True) if operation.code == casadi.OP_NE else equal
        if operation.code not in LOGIC:
            return Text(OPERATIONS[operation.code].c.format(*map(self.number, operation.arguments)))
        if operation.code == casadi.OP_NOT and not self._is_truth(operation.arguments[0]):
            return self._is_zero(operation.arguments[0])
        operands = map(self.condition, operation.arguments)
        return Text(OPERATIONS[operation.code].c.format(*operands), operation.code == casadi.OP_NOT)

    @property
    def _unit(self) -> str:
        return constant(1.0, self.real)

    @property
    def _zero(self) -> str:
        return constant(0.0, self.real)
