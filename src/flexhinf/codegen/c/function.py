"""A traced function as C functions: for one column of numbers, or for several side by side.

For several, every number is a row of LANES numbers, and the text is a few loops over the lanes which a compiler turns
into vector instructions. Where the function calls the mathematical library, which has no vectors, the loops are cut:
what later loops need of earlier ones is kept in rows.

A long text is cut into functions of at most `LONGEST` values, at the stages of the function where these are known, for
readers, and for checkers, whose time grows with the square of a function's length. What later ones need of earlier ones
is kept in an array.
"""

from __future__ import annotations

import re
from bisect import bisect_left
from collections.abc import Callable, Container, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from textwrap import wrap

import casadi

from flexhinf.codegen.c import algebra
from flexhinf.codegen.c.algebra import Real, comment, constant
from flexhinf.codegen.dataflow import (
    LIBRARY,
    MULTIPLY_ADD,
    MULTIPLY_SUBTRACT,
    SINGLE,
    SUBTRACT_PRODUCT,
    Dataflow,
)

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

#: The last argument of a function that keeps rows between its loops, in memory of the caller.
ROWS = "rows"

#: Operations of a loop over the lanes after which results that share none begin another: what a compiler loads before
#: a loop, because it is the same in all lanes, then fits into registers. A longer function is not put into its caller,
#: whose stack would grow by what each of them needs.
LONG = 48

#: What is no line of the text: it is read where it is used.
LEAVES = (casadi.OP_CONST, casadi.OP_INPUT)

#: The array for what later parts of a long text need of earlier ones.
KEPT = "kept"

#: Values of one column, or lines for several, that one function of C computes at most.
LONGEST = 120

#: The same of one that hardly chooses: checkers are quicker there, and compilers make vectors of what lies apart.
PLAINEST = 600


def block(head: str, lines: Iterable[str]) -> list[str]:
    """Lines of C after a head that ends with a brace, and the other brace."""
    return [head, *(INDENT + line for line in lines), "}"]


def loop(counter: str, end: int | str, lines: Iterable[str]) -> list[str]:
    """Lines of C for every `counter` from 0 to `end`."""
    return block(f"for (int {counter} = 0; {counter} < {end}; ++{counter}) {{", lines)


#: Some of a function's outputs, as `Dataflow` has them.
Results = list[tuple[int, int, int]]


#: Characters of a line.
WIDTH = 120

#: Some of a function's values under what they are of.
Stage = tuple[str, list[int]]


def folded(text: str) -> str:
    """Lines of code of at most `WIDTH` characters, cut at commas; comments and directives as they are."""
    lines = []
    for line in text.split("\n"):
        more = len(line) - len(line.lstrip()) + 8
        while (
            len(line) > WIDTH
            and not re.match(r"\s*(#|/?\*)", line)
            and (cut := line.rfind(", ", more, WIDTH)) > 0
        ):
            lines.append(line[: cut + 1])
            line = " " * more + line[cut + 2 :]
        lines.append(line)
    return "\n".join(lines)


def headed(about: str, indent: str = "") -> list[str]:
    """A comment: the first sentence of a docstring, without what it refers to."""
    sentence = re.split(r"(?<!Eq)\. ", " ".join(about.split("\n\n")[0].split()))[0]
    sentence = sentence.partition("; see ")[0].partition(", see ")[0].rstrip(".")
    lines = wrap(comment(sentence).replace("`", ""), 114 - len(indent))
    return f"/* {(chr(10) + ' * ').join(lines)} */".splitlines() if lines else []


@dataclass(frozen=True, eq=False)
class FunctionText:
    """The text of ``static void NAME(in₀, …, out₀, …)``.

    `lanes`: 0 for any number of them, which is then the last argument ``count``. `moving`: Which arguments differ from
    lane to lane. `calls`: Names of functions by opcode. `rows`: Name of the function of rows for some opcodes.
    `counts`: Arguments and results. `apart`: No result is in the memory of an argument. `stages`: What each stage
    computes.
    """

    name: str
    flow: Dataflow
    real: Real
    lanes: int
    moving: tuple[bool, ...]
    calls: Mapping[int, str]
    rows: Callable[[tuple[int, ...]], str]
    counts: tuple[int, int]
    apart: bool
    stages: tuple[str, ...] = ()

    def texts(self) -> dict[str, str]:
        """Functions by name, in an order in which C can read them; the last is the one that is called."""
        arguments, results = ([f"{kind}{k}" for k in range(n)] for kind, n in zip(("in", "out"), self.counts))
        names = [*arguments, *results]
        last = [*(["count"] if self.lanes == 0 else []), *([ROWS] if self.lanes > 1 and self.places else [])]
        parts = dict(self._single_parts() if self.lanes == 1 else self._several_parts())
        if len(parts) == 1:
            texts, lines = dict[str, str](), next(iter(parts.values()))
        else:
            texts, lines = {}, []
            for name, text in parts.items():
                own = [word for word in [*names, KEPT, *last] if _uses(text, word)]
                texts[name] = self._text(name, own, text)
                lines.append(f"{name}({', '.join(own)});")
            lines = self._joined(lines)
        lines += [f"(void){word};" for word in arguments if not _uses(lines, word)]
        texts[self.name] = self._text(self.name, [*names, *last], lines)
        return texts

    def _text(self, name: str, arguments: list[str], lines: list[str]) -> str:
        apart = "NOINLINE " if len(lines) > LONG else ""
        mark, declared = "RESTRICT " if self.lanes != 1 or name != self.name else "", list[str]()
        begin = list[str]()
        for word in arguments:
            changed = word == ROWS or (
                not word.startswith("in") and (name == self.name or _changes(lines, word))
            )
            kind = f"{'' if changed else 'const '}{self.real.name} *{mark}"
            rows = re.compile(rf"\b{word}(\[[^\]]*\bl\]| \+ \d+;)")  # whose memory is `ALIGNED`
            of_rows = self.lanes > 1 and any(map(rows.search, lines))
            if of_rows:
                pointer = f"{'' if changed else 'const '}{self.real.name} *"
                begin.append(f"{pointer}const {word} = ALIGNED({pointer}, {word}_of_rows);")
            declared.append("int count" if word == "count" else f"{kind}{word}{'_of_rows' * of_rows}")
        return "\n".join(block(f"static {apart}void {name}({', '.join(declared)})\n{{", begin + lines))

    # One column ---------------------------------------------------------------------------------------
    def _single_parts(self) -> Iterator[tuple[str, list[str]]]:
        parts = self._parts
        if len(parts) == 1:
            yield self.name, list(self.single())
            return
        for number, part in enumerate(parts, start=1):
            yield f"{self.name}_{number}", list(self._part(part))

    @cached_property
    def _parts(self) -> list[list[Stage]]:
        """Values of each function, stage by stage."""
        operations = self.flow.operations
        values = [k for k, op in operations.items() if op.code not in LEAVES]
        ends = [bisect_left(values, end + 1) for end in self.flow.ends]
        # behind every fourth result, so that compilers make vectors of neighbours
        fourth = [bisect_left(values, k + 1) for _, element, k in self.flow.outputs if element % 4 == 3]
        choices = sum("?" in OPERATIONS[operations[k].code] for k in values)
        longest = LONGEST if self.stages or 20 * choices > len(values) else PLAINEST
        groups: list[Stage] = []
        for about, (first, end) in zip([*self.stages, ""], pairwise([0, *ends, len(values)])):
            pieces = -(-(end - first) // longest)
            cuts = [first + (end - first) * k // pieces for k in range(pieces + 1)] if pieces else []
            for k in range(1, pieces):
                near = min(fourth, key=lambda place, cut=cuts[k]: abs(place - cut), default=0)
                cuts[k] = near if abs(near - cuts[k]) <= longest // 4 else cuts[k]
            groups += [(about, values[a:b]) for a, b in pairwise(cuts)]
        parts: list[list[Stage]] = []
        for about, group in groups:
            if not parts or sum(len(own) for _, own in parts[-1]) + len(group) > longest:
                parts.append([])
            parts[-1].append((about, group))
        return parts or [[]]

    @cached_property
    def _kept(self) -> tuple[dict[int, str], int]:
        """Where the values are that a part of the text computes for later ones, and the numbers of memory for it."""
        part_of = {k: place for place, part in enumerate(self._parts) for _, own in part for k in own}
        last = {k: part_of[k] for k in part_of}
        for k, part in part_of.items():
            for argument in self.flow.operations[k].arguments:
                last[argument] = max(part, last.get(argument, 0))
        places: dict[int, str] = {}
        for result, element, value in self.flow.outputs:
            if value in part_of and self.apart:
                places.setdefault(value, f"out{result}[{element}]")
            elif value in part_of:
                last[value] = len(self._parts)
        free: list[int] = []  # the part after which each number of the memory is free
        for k, part in part_of.items():
            if k not in places and last[k] > part:
                place = next((place for place, end in enumerate(free) if end < part), len(free))
                free[place : place + 1] = [last[k]]
                places[k] = f"{KEPT}[{place}]"
        return places, len(free)

    def _part(self, part: list[Stage]) -> Iterator[str]:
        here, loaded, places, before = {k for _, own in part for k in own}, set[int](), self._kept[0], ""
        for about, own in part:
            yield from headed(about) if about != before else []
            before = about
            for k in own:
                for argument in self.flow.operations[k].arguments:
                    code = self.flow.operations[argument].code
                    if argument not in here | loaded and code != casadi.OP_CONST:
                        loaded.add(argument)
                        value = (
                            self._expression(argument, "v", set())
                            if code == casadi.OP_INPUT
                            else places[argument]
                        )
                        yield f"const {self.real.name} v{argument} = {value};"
                yield f"const {self.real.name} v{k} = {self._expression(k, 'v', set())};"
                if k in places:
                    yield f"{places[k]} = v{k};"

    def _joined(self, lines: list[str]) -> list[str]:
        """Calls of the parts; where results are not written by them, they are at the end."""
        if self.lanes != 1:
            return lines
        places, size = self._kept
        declared = [f"{self.real.name} {KEPT}[{size}];"] if size else []
        for result, element, value in self.flow.outputs:
            code, place = self.flow.operations[value].code, f"out{result}[{element}]"
            text = (
                self._operand(value, "v", set()) if code == casadi.OP_CONST
                else self._expression(value, "v", set()) if code == casadi.OP_INPUT
                else places[value]
            )  # fmt: skip
            if text != place:
                lines.append(f"{place} = {text};")
        return declared + lines

    # Several columns ----------------------------------------------------------------------------------
    def _several_parts(self) -> Iterator[tuple[str, list[str]]]:
        parts: list[list[str]] = [[]]
        for lines in filter(None, self.several()):
            if parts[-1] and len(parts[-1]) + len(lines) > LONGEST:
                parts.append([])
            parts[-1] += lines
        for number, lines in enumerate(parts, start=1):
            declared = []
            for k, place in sorted(self.places.items()):
                if _uses(lines, f"w{k}"):
                    kind = f"{'' if _changes(lines, f'w{k}') else 'const '}{self.real.name} *const"
                    declared.append(f"{kind} w{k} = {algebra.ahead(ROWS, place * self.lanes)};")
            yield self.name if len(parts) == 1 else f"{self.name}_{number}", [*declared, *lines]

    def single(self) -> Iterator[str]:
        """Lines for one column."""
        for k, operation in self.flow.operations.items():
            if operation.code != casadi.OP_CONST:
                yield f"const {self.real.name} v{k} = {self._expression(k, 'v', set())};"
        for result, element, value in self.flow.outputs:
            yield f"out{result}[{element}] = {self._operand(value, 'v', set())};"

    def several(self) -> Iterator[list[str]]:
        """Loops over the lanes, cut where the library is called; one call may be of all lanes at once."""
        operations, levels = self.flow.operations, self._levels
        kept = self.places
        for level in range(max(levels.values(), default=0) + 1):
            here = [k for k in operations if levels.get(k) == level]
            called = [k for k in here if operations[k].code in CALLS]
            rows = [k for k in called if self._is_of_rows(k)]
            for values, results in self._apart(
                [k for k in here if k not in set(called)],
                [row for row in self.flow.outputs if self._written(row[2]) == level],
            ):
                yield list(self._loop(values, kept, results))
            yield list(self._loop([k for k in called if k not in set(rows)], kept, []))
            # a sine and a cosine of one argument are one call
            of: dict[int, dict[int, int]] = {}  # argument → operation → value
            for k in rows:
                of.setdefault(operations[k].arguments[0], {})[operations[k].code] = k
            for argument, values in of.items():
                source, place = operations[argument], f"w{argument}"
                if source.code == casadi.OP_INPUT and self.moving[source.arguments[0]]:
                    k, element = source.arguments
                    place = f"in{k} + {element * self.lanes}" if element else f"in{k}"
                places = "".join(f", w{values[code]}" for code in sorted(values))
                yield [f"{self.rows(tuple(sorted(values)))}({place}{places});"]

    def _is_of_rows(self, k: int) -> bool:
        operation = self.flow.operations[k]
        source = self.flow.operations[operation.arguments[0]]
        moves = self.moving[source.arguments[0]] if source.code == casadi.OP_INPUT else True
        return operation.code in self.calls and moves and source.code != casadi.OP_CONST

    def _apart(self, values: list[int], results: Results) -> Iterator[tuple[list[int], Results]]:
        """Values and results of one loop after the other: those that share no value may be in two."""
        own, loops = set(values), [list[int]()]
        for members in self._groups(values):
            if len(loops[-1]) + len(members) > LONG and loops[-1]:
                loops.append([])
            loops[-1] += members
        for k, members in enumerate(loops):
            here = set(members)
            at_end = k + 1 == len(loops)
            yield sorted(here), [row for row in results if row[2] in here or (at_end and row[2] not in own)]

    def _groups(self, values: list[int]) -> Iterable[list[int]]:
        """Values that share none with those of another group."""
        group = {
            k: k for k in values
        }  # value → another of its group, and so on to the first, which is itself

        def first(k: int) -> int:
            while group[k] != k:
                k = group[k]
            return k

        for k in values:
            for argument in self.flow.operations[k].arguments:
                if argument in group:
                    group[first(argument)] = first(k)
        together: dict[int, list[int]] = {}
        for k in values:
            together.setdefault(first(k), []).append(k)
        return together.values()

    def _loop(self, values: list[int], kept: Container[int], results: Results) -> Iterator[str]:
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
        load(tuple(value for _, _, value in results))
        lines += [
            f"out{result}[{self._row(element)}] = {self._operand(value, 'w', here | loaded)};"
            for result, element, value in results
        ]
        if lines:
            yield from loop("l", self.lanes or "count", lines)

    def _row(self, element: int) -> str:
        return f"{element * self.lanes} + l" if element else "l"

    @cached_property
    def _levels(self) -> dict[int, int]:
        """The loop of each operation: after every library call that it depends on; long ones are several."""
        operations, levels = self.flow.operations, dict[int, int]()
        for k, operation in operations.items():
            if operation.code not in LEAVES:
                before = [
                    levels[argument] + (operations[argument].code in CALLS)
                    for argument in operation.arguments
                    if argument in levels
                ]
                levels[k] = max(before, default=0)
        part = dict.fromkeys(levels, 0)
        for level in set(levels.values()) if self.lanes else ():
            here = [k for k in levels if levels[k] == level and operations[k].code not in CALLS]
            for group in self._groups(here):
                parts = -(-len(group) // LONGEST)
                part |= {k: place * parts // len(group) for place, k in enumerate(group)}
            last = max((part[k] for k in here), default=0)
            part |= {k: last for k in levels if levels[k] == level and operations[k].code in CALLS}
        order = {pair: place for place, pair in enumerate(sorted({(levels[k], part[k]) for k in levels}))}
        levels = {k: order[levels[k], part[k]] for k in levels}
        results = [value for _, _, value in self.flow.outputs]
        end = max((levels.get(value, 0) for value in results), default=0)
        if any(levels.get(value) == end and operations[value].code in CALLS for value in results):
            levels[-1] = max(levels.values()) + 1  # a loop for the results alone
        return levels

    def _written(self, value: int) -> int:
        """The loop that writes a value as a result: that which computes it, or the last one."""
        levels = self._levels
        here = value in levels and self.flow.operations[value].code not in CALLS
        return levels[value] if here else max(levels.values(), default=0)

    @cached_property
    def places(self) -> dict[int, int]:
        """Row of each value that a loop keeps for a later one; a row is free again after the last use."""
        operations, levels = self.flow.operations, self._levels
        uses = [(value, self._written(value), False) for _, _, value in self.flow.outputs]
        for k in levels.keys() & operations.keys():
            uses += [(a, levels[k], operations[k].code in CALLS) for a in operations[k].arguments]
        kept, last = set(), {}
        for value, level, called in uses:
            if value in levels:
                last[value] = max(level, last.get(value, 0))
                if levels[value] != level or (operations[value].code in CALLS) != called:
                    kept.add(value)
        rows: list[int] = []  # the level after which each is free
        places = {}
        for k in sorted(kept, key=lambda k: (levels[k], k)):
            place = next((row for row, level in enumerate(rows) if level < levels[k]), len(rows))
            rows[place : place + 1] = [last[k]]
            places[k] = place
        return places

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
        text = OPERATIONS[operation.code]
        if self.flow.operations[operation.arguments[0]].code == casadi.OP_CONST:
            text = text.replace(" || isnan({0})", "")  # a constant is a number
        return text.format(*operands, one=unit, zero=zero, f=self.real.suffix)


def _uses(lines: Iterable[str], word: str) -> bool:
    return any(re.search(rf"\b{word}\b", line) for line in lines)


def _changes(lines: Iterable[str], word: str) -> bool:
    """Whether an element of an array is written, by itself or by a function of rows."""
    return any(re.search(rf"^\s*{word}\[[^\]]*\] = |_row\(.*, {word}\b", line) for line in lines)
