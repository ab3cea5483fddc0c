"""A traced function as a C function, for one column of numbers or for several side by side.

For several, every number is a row of LANES numbers, and the text is a few loops over the lanes which a compiler turns
into vector instructions. Where the function calls the mathematical library, which has no vectors, the loops are cut:
what later loops need of earlier ones is kept in rows.

The two floating-point types of C as text: constants, and the names of the mathematical functions.

CasADi's operations as C expressions: the one table, with the meaning of `flexhinf.codegen.emit.opcodes`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Literal

import casadi
import numpy as np

from flexhinf.codegen.emit.dataflow import (
    LIBRARY,
    MULTIPLY_ADD,
    MULTIPLY_SUBTRACT,
    SINGLE,
    SUBTRACT_PRODUCT,
    Dataflow,
    read_dataflow,
)
from flexhinf.errors import InvalidInput


class Real:
    """``double`` or ``float``: the end of constants and of the names of ``<math.h>``, bytes, and the distance from 1 to
    the next number. Nothing is computed in double in a float build."""

    def __init__(self, name: Literal["double", "float"]) -> None:
        self.name = name
        self.suffix, self.bytes = ("", 8) if name == "double" else ("f", 4)
        self.epsilon = float(np.finfo(np.float64 if name == "double" else np.float32).eps)


def constant(value: float, real: Real) -> str:
    """A number as C writes it; read back, it is the nearest one of this type.

    Raises InvalidInput: if it is NaN, or lies beyond the type.
    """
    if math.isinf(value):
        huge = f"HUGE_VAL{real.suffix.upper()}"
        return huge if value > 0.0 else f"-{huge}"
    with np.errstate(over="ignore", under="ignore"):
        number = float(value) if real.name == "double" else np.float32(value)
    if not np.isfinite(number) or (value != 0.0 and number == 0.0):
        raise InvalidInput(
            f"A number does not fit C's type {real.name}.",
            f"expected magnitudes from 1e-45 to 3e38, or 0, got {value:g}",
            "the type double, or other units",
        )
    text = repr(float(number)) if real.name == "double" else np.format_float_scientific(number, trim="-")
    if "." not in text and "e" not in text:
        text += ".0"
    return text + real.suffix


#: Functions that are written here instead of called where numbers are double; and functions of two numbers.
SINES = {casadi.OP_SIN: "sin", casadi.OP_COS: "cos"}
OF_TWO = (
    casadi.OP_ATAN2, casadi.OP_POW, casadi.OP_CONSTPOW, casadi.OP_HYPOT, casadi.OP_FMOD, casadi.OP_REMAINDER,
    casadi.OP_COPYSIGN,
)  # fmt: skip

#: Expressions of operands {0}, {1}, … and of {one} and {zero}; {f} ends the names of functions of the type.
OPERATIONS: dict[int, str] = {
    **{code: f"{name}{{f}}({{0}})" for code, name in {**LIBRARY, **SINGLE, **SINES}.items()},
    **{code: f"{LIBRARY.get(code, 'copysign')}{{f}}({{0}}, {{1}})" for code in OF_TWO},
    MULTIPLY_ADD: "FMA({0}, {1}, {2})",
    MULTIPLY_SUBTRACT: "FMA({0}, {1}, -{2})",
    SUBTRACT_PRODUCT: "FMA(-{0}, {1}, {2})",
    casadi.OP_ASSIGN: "{0}",
    casadi.OP_ADD: "{0} + {1}",
    casadi.OP_SUB: "{0} - {1}",
    casadi.OP_MUL: "{0} * {1}",
    casadi.OP_DIV: "{0} / {1}",
    casadi.OP_NEG: "-{0}",
    casadi.OP_SQ: "{0} * {0}",
    casadi.OP_TWICE: "{0} + {0}",
    casadi.OP_INV: "{one} / {0}",
    casadi.OP_SIGN: "({0} < {zero}) ? -{one} : (({0} > {zero}) ? {one} : {0})",
    # fmin, fmax of C: a NaN loses, the first operand wins a tie
    casadi.OP_FMIN: "({1} < {0} || isnan({0})) ? {1} : {0}",
    casadi.OP_FMAX: "({1} > {0} || isnan({0})) ? {1} : {0}",
    casadi.OP_LT: "({0} < {1}) ? {one} : {zero}",
    casadi.OP_LE: "({0} <= {1}) ? {one} : {zero}",
    casadi.OP_EQ: "({0} == {1}) ? {one} : {zero}",
    casadi.OP_NE: "({0} != {1}) ? {one} : {zero}",
    casadi.OP_NOT: "({0} == {zero}) ? {one} : {zero}",
    # NaN stands for "true", as in C
    casadi.OP_AND: "(({0} != {zero}) && ({1} != {zero})) ? {one} : {zero}",
    casadi.OP_OR: "(({0} != {zero}) || ({1} != {zero})) ? {one} : {zero}",
    casadi.OP_IF_ELSE_ZERO: "({0} != {zero}) ? {1} : {zero}",
}

#: Operations that call the mathematical library; the others are single instructions.
CALLS = {*LIBRARY, *SINES, casadi.OP_SQRT}


INDENT = "    "


def block(head: str, lines: Iterable[str]) -> list[str]:
    """Lines of C after a head that ends with a brace, and the other brace."""
    return [head, *(INDENT + line for line in lines), "}"]


def loop(counter: str, end: int | str, lines: Iterable[str]) -> list[str]:
    """Lines of C for every `counter` from 0 to `end`."""
    return block(f"for (int {counter} = 0; {counter} < {end}; ++{counter}) {{", lines)


def function_text(
    name: str,
    function: casadi.Function,
    real: Real,
    lanes: int = 1,
    moving: tuple[bool, ...] = (),
    calls: Mapping[int, str] | None = None,
    rows: Callable[[tuple[int, ...]], str] | None = None,
) -> str:
    """The definition of ``static void name(in₀, …, out₀, …)``.

    `lanes`: 0 for any number of them, which is then the last argument ``count``: of a function without library calls,
    and with one element in every moving argument and result. For more than one, element e of a moving argument or of a
    result is the row ``[e * lanes + lane]``, and no result may lie where an argument does. For one, every store comes
    after every load, so that results may take the place of arguments. `moving`: Which arguments differ from lane to
    lane. `calls`: Names of our own C functions for an operation, by CasADi's opcode. `rows`: The name of such a
    function of all lanes, (x, out…), for the opcodes of its results in ascending order. Raises Unsupported: an
    operation that is not in the table.
    """
    flow = read_dataflow(function, OPERATIONS, fused=True)
    writer = _Function(flow, real, lanes, moving or (False,) * function.n_in(), calls or {}, rows)
    restrict = "restrict " if lanes != 1 else ""
    arguments = [f"const {real.name} *{restrict}in{k}" for k in range(function.n_in())]
    arguments += [f"{real.name} *{restrict}out{k}" for k in range(function.n_out())]
    arguments += ["int count"] * (lanes == 0)
    used = {op.arguments[0] for op in flow.operations.values() if op.code == casadi.OP_INPUT}
    unused = [f"{INDENT}(void)in{k};" for k in range(function.n_in()) if k not in used]
    body = writer.single() if lanes == 1 else writer.several()
    return "\n".join([f"static void {name}({', '.join(arguments)})", "{", *body, *unused, "}"])


@dataclass(frozen=True, eq=False)
class _Function:
    flow: Dataflow
    real: Real
    lanes: int
    moving: tuple[bool, ...]
    calls: Mapping[int, str]
    rows: Callable[[tuple[int, ...]], str] | None

    def single(self) -> Iterator[str]:
        needed = self._needed()
        for k, operation in self.flow.operations.items():
            if k in needed and operation.code != casadi.OP_CONST:
                yield f"{INDENT}const {self.real.name} v{k} = {self._expression(k, 'v', set())};"
        for result, element, value in self.flow.outputs:
            yield f"{INDENT}out{result}[{element}] = {self._operand(value, 'v', set())};"

    def several(self) -> Iterator[str]:
        """Loops over the lanes, cut where the library is called; one call may be of all lanes at once."""
        operations, levels, needed = self.flow.operations, self._levels(), self._needed()
        last = max(levels.values(), default=0)
        kept = self._kept(levels, needed)
        for k in sorted(kept):
            yield f"{INDENT}{self.real.name} w{k}[{self.lanes}];"
        for level in range(last + 1):
            here = [k for k in sorted(needed) if levels.get(k) == level]
            called = [k for k in here if operations[k].code in CALLS]
            rows = [k for k in called if self._is_of_rows(k)]
            yield from self._loop([k for k in here if k not in set(called)], kept, level == last)
            yield from self._loop([k for k in called if k not in set(rows)], kept, False)
            # a sine and a cosine of one argument are one call
            of: dict[int, dict[int, int]] = {}  # argument → operation → value
            for k in rows:
                of.setdefault(operations[k].arguments[0], {})[operations[k].code] = k
            for argument, values in of.items():
                assert self.rows is not None
                source, place = operations[argument], f"w{argument}"
                if source.code == casadi.OP_INPUT and self.moving[source.arguments[0]]:
                    k, element = source.arguments
                    place = f"in{k} + {element * self.lanes}" if element else f"in{k}"
                places = "".join(f", w{values[code]}" for code in sorted(values))
                yield f"{INDENT}{self.rows(tuple(sorted(values)))}({place}{places});"

    def _is_of_rows(self, k: int) -> bool:
        """Whether one call computes the value for all lanes: its argument moves."""
        operation = self.flow.operations[k]
        source = self.flow.operations[operation.arguments[0]]
        held = source.code == casadi.OP_INPUT and not self.moving[source.arguments[0]]
        known = self.rows is not None and operation.code in self.calls
        return known and not held and source.code != casadi.OP_CONST

    def _loop(self, values: list[int], kept: set[int], last: bool) -> Iterator[str]:
        """One loop: its values, those of them that are kept, and at the end the results."""
        here, lines, loaded = set(values), [], set()

        def load(arguments: tuple[int, ...]) -> None:
            for k in arguments:
                if self.flow.operations[k].code == casadi.OP_INPUT and k not in loaded:
                    loaded.add(k)
                    lines.append(f"const {self.real.name} v{k} = {self._expression(k, 'v', set())};")

        for k in values:
            load(self.flow.operations[k].arguments)
            lines.append(f"const {self.real.name} v{k} = {self._expression(k, 'w', here | loaded)};")
            if k in kept:
                lines.append(f"w{k}[l] = v{k};")
        if last:
            load(tuple(value for _, _, value in self.flow.outputs))
            lines += [
                f"out{result}[{self._row(element)}] = {self._operand(value, 'w', here | loaded)};"
                for result, element, value in self.flow.outputs
            ]
        if lines:
            yield from (INDENT + line for line in loop("l", self.lanes or "count", lines))

    def _row(self, element: int) -> str:
        return f"{element * self.lanes} + l" if element else "l"

    def _levels(self) -> dict[int, int]:
        """The loop of each operation: after every library call that it depends on."""
        operations, levels = self.flow.operations, {}
        for k, operation in operations.items():
            if operation.code not in (casadi.OP_CONST, casadi.OP_INPUT):
                before = [
                    levels[argument] + (operations[argument].code in CALLS)
                    for argument in operation.arguments
                    if argument in levels
                ]
                levels[k] = max(before, default=0)
        results = [value for _, _, value in self.flow.outputs]
        end = max((levels.get(value, 0) for value in results), default=0)
        if any(levels.get(value) == end and operations[value].code in CALLS for value in results):
            levels[-1] = max(levels.values()) + 1  # a loop for the results alone
        return levels

    def _kept(self, levels: dict[int, int], needed: set[int]) -> set[int]:
        """Values that another loop needs."""
        operations = self.flow.operations
        uses = [(value, max(levels.values(), default=0), False) for _, _, value in self.flow.outputs]
        for k in needed & levels.keys():
            uses += [(a, levels[k], operations[k].code in CALLS) for a in operations[k].arguments]
        return {
            value
            for value, level, called in uses
            if value in levels and (levels[value] != level or (operations[value].code in CALLS) != called)
        }

    def _needed(self) -> set[int]:
        needed: set[int] = set()
        stack = [value for _, _, value in self.flow.outputs]
        while stack:
            value = stack.pop()
            operation = self.flow.operations[value]
            if value not in needed:
                needed.add(value)
                stack.extend(operation.arguments if operation.code != casadi.OP_INPUT else ())
        return needed

    def _operand(self, value: int, row: str, here: set[int]) -> str:
        operation = self.flow.operations[value]
        if operation.code == casadi.OP_CONST:
            text = constant(operation.constant, self.real)
            return f"({text})" if text.startswith("-") else text
        return f"w{value}[l]" if row == "w" and value not in here else f"v{value}"

    def _expression(self, value: int, row: str, here: set[int]) -> str:
        operation = self.flow.operations[value]
        if operation.code == casadi.OP_INPUT:
            argument, element = operation.arguments
            several = self.lanes != 1 and self.moving[argument]
            return f"in{argument}[{self._row(element) if several else element}]"
        operands = [self._operand(argument, row, here) for argument in operation.arguments]
        if operation.code in self.calls:
            return f"{self.calls[operation.code]}({operands[0]})"
        unit, zero = constant(1.0, self.real), constant(0.0, self.real)
        return OPERATIONS[operation.code].format(*operands, one=unit, zero=zero, f=self.real.suffix)
