"""A traced function as C functions: for one column of numbers, or for several side by side.

For several, every number is a row of LANES numbers, and the text is a few loops over the lanes which a compiler turns
into vector instructions. Where the function calls the mathematical library, which has no vectors, the loops are cut:
what later loops need of earlier ones is kept in rows.

A long text is several functions, cut as `flexhinf.codegen.cut` says, at the stages of the function where these are
known. What later ones need of earlier ones is kept in an array.
"""

from __future__ import annotations

import re
from bisect import bisect_left
from collections import Counter
from collections.abc import Callable, Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import count, groupby

import casadi

from flexhinf.codegen.c import algebra
from flexhinf.codegen.c.algebra import Real
from flexhinf.codegen.c.expression import Expressions
from flexhinf.codegen.c.identifiers import ROWS
from flexhinf.codegen.c.layout import block, headed, length, loop
from flexhinf.codegen.cut import LINES, MOST, Filling, lines_of, pieces
from flexhinf.codegen.dataflow import LEAVES, Dataflow
from flexhinf.codegen.naming import Names
from flexhinf.codegen.operations import COSTLY, OPERATIONS

#: Arrays of a long text without stages begin so.
TERMS = "terms"

#: Operations of a loop over the lanes after which results that share none begin another: what a compiler loads before
#: a loop, because it is the same in all lanes, then fits into registers. A longer function is not put into its caller,
#: whose stack would grow by what each of them needs, and neither is one that keeps arrays.
LONG = 48

#: Factors of a product that is called by their places.
FACTORS = 6

#: Equal neighbours among results that are written one by one.
FEW = 4

#: Values of one loop over the lanes that share some, at most, where functions have as many lines as they may.
MANY = 120

#: Lines more that the heads of parts have, about, for the arrays that are passed from one to another.
PASSED = 2

#: Lines of a body with which a function is cut at last: with fewer, what passes numbers on is most of it.
FEWEST = 24

#: Some of a function's outputs, as `Dataflow` has them.
Results = list[tuple[int, int, int]]


#: Some of a function's lines under the stage that they are of.
Stage = tuple[int, list[int]]


@dataclass(frozen=True, eq=False)
class FunctionText:
    """The text of ``static void NAME(arguments…, results…)``.

    `lanes`: 0 for any number of them, which is then the last argument ``count``. `moving`: Which arguments differ from
    lane to lane. `calls`: Names of functions by opcode. `rows`: Name of the function of rows for some opcodes.
    `arguments`, `results`: Their names. `apart`: No result is in the memory of an argument. `stages`: Name and comment
    of each stage. `elements`: Of each argument and result, the indices of its elements or elements of `parts`, names of
    places in an argument; None where they are 0, 1, … `labels`: What values are called. `most`: Lines of a body that is
    cut. `names`: The scope of the function, in which its arguments, results and places have theirs.
    """

    name: str
    flow: Dataflow
    real: Real
    lanes: int
    moving: tuple[bool, ...]
    calls: Mapping[int, str]
    rows: Callable[[tuple[int, ...]], str]
    arguments: tuple[str, ...]
    results: tuple[str, ...]
    names: Names
    apart: bool
    stages: tuple[tuple[str, str], ...] = ()
    elements: tuple[Sequence[str] | None, ...] = ()
    parts: Mapping[str, str] = field(default_factory=dict[str, str])
    labels: Mapping[int, str] = field(default_factory=dict[int, str])
    most: int = MOST

    def fitted(self) -> FunctionText:
        """The same, cut so that each function has `LINES` at most, with its head and what it stores at its end."""
        head = self._head(self.name, self._called, [])[0]
        best = tried = self._cut(MOST + 1 - length(head))
        fewer = 0
        while tried.longest > LINES and tried.most > FEWEST:
            fewer = max(tried.longest - LINES, 2 * fewer * (tried is not best))
            tried = tried._cut(max(FEWEST, tried.most - fewer))
            best = min(best, tried, key=lambda text: text.longest)
        return best

    def _cut(self, most: int) -> FunctionText:
        """The same, cut so that a body has so many lines; what does not depend on them is not made again."""
        if most == self.most:
            return self
        other, known = replace(self, most=most), vars(self)
        vars(other).update({name: known[name] for name in ("_stage_of", "_expressions") if name in known})
        return other

    @cached_property
    def longest(self) -> int:
        """Lines of the longest function."""
        return max(map(length, self.texts.values()))

    @cached_property
    def texts(self) -> dict[str, str]:
        """Functions by name, in an order in which C can read them; the last is the one that is called."""
        parts = {
            name: self._named_parts(lines)
            for name, lines in (self._single_parts() if self.lanes == 1 else self._several_parts())
        }
        if len(parts) == 1:
            texts, lines = dict[str, str](), next(iter(parts.values()))
        else:
            texts, lines = dict[str, str](), list[str]()
            known = dict.fromkeys([*self.arguments, *self.results, *self._arrays, *self._called])
            for name, text in parts.items():
                own = [word for word in known if _uses(text, word)]
                texts[name] = self._text(name, own, text)
                lines.append(f"{name}({', '.join(own)});")
            lines = self._named_parts(self._joined(lines))
        lines += [f"(void){word};" for word in dict.fromkeys(self.arguments) if not _uses(lines, word)]
        texts[self.name] = self._text(self.name, self._called, lines)
        return texts

    @cached_property
    def _called(self) -> list[str]:
        """What the function is called with."""
        last = [*(["count"] if self.lanes == 0 else []), *([ROWS] if self.lanes > 1 and self.places else [])]
        return [*dict.fromkeys([*self.arguments, *self.results]), *last]

    def _text(self, name: str, arguments: list[str], lines: list[str]) -> str:
        head, begin = self._head(name, arguments, lines)
        return "\n".join(block(f"{head}\n{{", begin + lines))

    def _head(self, name: str, arguments: list[str], lines: list[str]) -> tuple[str, list[str]]:
        """The head of a function of these lines, and what it begins with."""
        called = name == self.name
        keeps = called and bool(self._arrays)
        apart = "NOINLINE " if keeps or sum(map(_operations, lines)) > LONG else ""
        mark = "RESTRICT " if self.lanes != 1 or self.apart or not called else ""
        declared, begin, written = list[str](), list[str](), (*self.results, *self._arrays, ROWS)
        names = self._inside.within()
        for word in arguments:
            changed = word in written and (called or _changes(lines, word))
            kind = f"{'' if changed else 'const '}{self.real.written} *{mark}"
            rows = re.compile(rf"\b{word}(\[[^\]]*\bl\]| \+ \d+;)")  # whose memory is `ALIGNED`
            of_rows = self.lanes > 1 and any(map(rows.search, lines))
            whole = names.allot(f"{word}_of_rows") if of_rows else word
            if of_rows:
                pointer = f"{'' if changed else 'const '}{self.real.written} *"
                begin.append(f"{pointer}const {word} = ALIGNED({pointer}, {whole});")
            declared.append("int count" if word == "count" else f"{kind}{whole}")
        return f"static {apart}void {name}({', '.join(declared)})", begin

    def _element(self, argument: int, element: int) -> str:
        if self.lanes != 1 and self.moving[argument]:
            return f"{self.arguments[argument]}[{self._row(element)}]"
        return self._place(argument, element)

    def _result(self, result: int, element: int) -> str:
        return self._place(len(self.arguments) + result, element)

    def _place(self, k: int, element: int) -> str:
        """An element of an argument, or of a result behind them."""
        names = self.elements[k] if self.elements else None
        name = str(element if names is None else names[element])
        return name if name.endswith("]") else f"{(*self.arguments, *self.results)[k]}[{name}]"

    def _named_parts(self, lines: list[str]) -> list[str]:
        """Lines after those that name the parts of arguments that they use."""
        kind = f"const {self.real.written} *const"
        return [
            *(f"{kind} {part} = {place};" for part, place in self.parts.items() if _uses(lines, part)),
            *lines,
        ]

    @cached_property
    def _inside(self) -> Names:
        """The scope of every part."""
        return self.names.within(self._arrays)

    # One column ---------------------------------------------------------------------------------------
    def _single_parts(self) -> Iterator[tuple[str, list[str]]]:
        names, alone = self.names.within(), len(self._parts) == 1
        for name, part in zip(self._part_names, self._parts, strict=True):
            yield self.name if alone else names.allot(f"{self.name}_{name}"), list(self._part(part, alone))

    @cached_property
    def _part_names(self) -> list[str]:
        """What each part is called: as the stage with most of its lines, of several stages."""
        names, found = Names(), list[str]()
        for part in self._parts:
            stage = max(part, key=lambda piece: len(piece[1]), default=(0, list[int]()))[0]
            several = len(self.stages) > 1
            name = ("end" if stage >= len(self.stages) else self.stages[stage][0]) if several else "part"
            found.append(names.allot(name) if several else names.numbered(name, "_"))
        return found

    @cached_property
    def _stage_of(self) -> dict[int, int]:
        """The stage of each value."""
        values = [k for k, op in self.flow.operations.items() if op.code not in LEAVES]
        return {k: bisect_left(self.flow.ends, k) for k in values}

    @cached_property
    def _expressions(self) -> Expressions:
        labels = {**self._monomials, **self.labels}
        return Expressions(self.flow, self._stage_of, self.real, self._element, self.calls, labels=labels)

    @cached_property
    def _monomials(self) -> dict[int, str]:
        """Names of products of elements of one argument, such as ``x_0_0_2`` of x[0]*x[0]*x[2]."""
        known, names = dict[int, tuple[int, tuple[int, ...]]](), dict[int, str]()
        for k, operation in self.flow.operations.items():
            if operation.code == casadi.OP_INPUT and not (
                self.elements and self.elements[operation.arguments[0]]
            ):
                known[k] = operation.arguments[0], operation.arguments[1:]
            elif operation.operands and (places := OPERATIONS[operation.code].factors):
                factors = [known.get(operation.arguments[place], (-1, ())) for place in places]
                (one, first), (other, second) = factors
                if one == other >= 0 and len(first) + len(second) <= FACTORS:
                    known[k] = one, tuple(sorted(first + second))
                    names[k] = "_".join([self.arguments[one], *map(str, known[k][1])])
        return names

    @cached_property
    def _parts(self) -> list[list[Stage]]:
        """Lines of each function, stage by stage."""
        stages, text, results = (
            self._stage_of,
            self._expressions,
            {value for _, _, value in self.flow.outputs},
        )
        lines = text.lines(list(stages))
        last = {value: k for k in lines for value in text.leaves(k)}
        sizes = {k: text.named(k) + (k in results and k in last) for k in lines}
        if self.apart:  # results are written where they are computed
            last = {k: user for k, user in last.items() if k not in results}
        else:
            last |= dict.fromkeys(results, -1)
        most = self.most if sum(sizes.values()) <= self.most else self.most - PASSED
        parts, filling = dict[int, list[Stage]](), Filling(last=last, most=most)
        for stage, own in groupby(lines, stages.__getitem__):
            for piece, size in pieces([*own], sizes, text.leaves, last, most):
                parts.setdefault(filling.add(size, piece), []).append((stage, list(piece)))
        return list(parts.values()) or [[]]

    @cached_property
    def _part_of(self) -> dict[int, int]:
        return {k: place for place, part in enumerate(self._parts) for _, own in part for k in own}

    @cached_property
    def _arrays(self) -> dict[str, int]:
        """Arrays for what parts of a long text compute for later ones, by their names, and their sizes."""
        sizes = dict[str, int]()
        for place in self._passed.values():
            name, _, number = place.rstrip("]").partition("[")
            sizes[name] = max(sizes.get(name, 0), int(number) + 1)
        return sizes

    @cached_property
    def _kept(self) -> dict[int, str]:
        """Where the values are that a part of the text computes for later ones, or as results."""
        part_of = self._part_of
        places: dict[int, str] = {}
        for result, element, value in self.flow.outputs:
            if value in part_of and self.apart:
                places.setdefault(value, self._result(result, element))
        return places | self._passed

    @cached_property
    def _passed(self) -> dict[int, str]:
        """Of values that are no results, or not written where they are computed."""
        part_of, results = self._part_of, {value for _, _, value in self.flow.outputs}
        if self.lanes != 1 or len(self._parts) == 1:
            return {}
        last = dict(part_of)
        for k, part in part_of.items():
            for value in self._expressions.leaves(k):
                last[value] = max(part, last.get(value, 0))
        passed = [k for k, part in part_of.items() if k not in results and last[k] > part]
        passed += [k for k in part_of if k in results and not self.apart]
        last |= {k: len(self._parts) for k in passed if k in results}
        ends = [
            max((last[k] for k in passed if part_of[k] == part), default=-1)
            for part in range(len(self._parts))
        ]
        arrays, sizes, places = self._array_names(ends), Counter[int](), dict[int, str]()
        for k in sorted(passed):
            part = part_of[k]
            sizes[part] += 1
            places[k] = f"{arrays[part]}[{sizes[part] - 1}]"
        return places

    def _array_names(self, ends: Sequence[int]) -> list[str]:
        """The array of each part, which is needed up to the end of another part: of the name of the stage, or where
        there are none, one that is free again."""
        names = self.names.within()
        if self.stages:
            return [names.allot(f"of_{name}") for name in self._part_names]
        free, found, every = list[int](), list[str](), list[str]()
        for part, end in enumerate(ends):
            place = next((place for place, until in enumerate(free) if until < part), len(free))
            free[place : place + 1] = [end]
            every += [names.numbered(TERMS, "_")] * (place == len(every))
            found.append(every[place])
        return found

    def _part(self, part: list[Stage], alone: bool) -> Iterator[str]:
        text, places = self._expressions, self._kept
        here = {k for _, own in part for k in own}
        text.begin({k: place for k, place in places.items() if k not in here}, self._inside.within())
        used = {value for k in here for value in text.leaves(k)}
        before = ""
        for stage, own in part:
            about = self.stages[stage][1] if stage < len(self.stages) else ""
            yield from headed(about) if about != before else []
            before = about
            for k in own:
                for value in text.loads(k):
                    yield from text.declared(value)
                if k in used or k not in places:
                    yield from text.declared(k)
                if k in places:
                    yield f"{places[k]} = {text.number(k).bare};"
        if alone:
            yield from self._stored(places)

    def _stored(self, places: Mapping[int, str]) -> Iterator[str]:
        """Results that are not written where they are computed; equal neighbours, and neighbours of one argument, by a
        loop."""
        text, stores = self._expressions, list[tuple[str, str, bool]]()
        for result, element, value in sorted(self.flow.outputs):
            place, is_read = (
                self._result(result, element),
                self.flow.operations[value].code == casadi.OP_INPUT,
            )
            if places.get(value) == place:
                continue
            if is_read and not self.apart and value not in text.numbers:
                yield from text.declared(value)
            stores.append((place, text.number(value).bare, is_read and self.apart))
        for is_long, runs in groupby(_neighbours(stores, False), lambda run: len(run) > FEW):
            for run in runs if is_long else _neighbours((store for own in runs for store in own), True):
                (first, written, _), (_, last, _) = run[0], run[-1]
                if len(run) > FEW:
                    line = f"{_turning(first)} = {written if written == last else _turning(written)};"
                    yield from loop("i", len(run), [line])
                else:
                    yield from (f"{place} = {number};" for place, number, _ in run)

    def _joined(self, lines: list[str]) -> list[str]:
        """Calls of the parts; where results are not written by them, they are at the end."""
        if self.lanes != 1:
            return lines
        places, text = self._kept, self._expressions
        text.begin(places, self._inside.within())
        declared = [f"{self.real.written} {name}[{size}];" for name, size in self._arrays.items()]
        return [*declared, *lines, *self._stored(places)]

    # Several columns ----------------------------------------------------------------------------------
    def _several_parts(self) -> Iterator[tuple[str, list[str]]]:
        parts, filling = dict[int, list[str]](), Filling(most=self.most)
        for lines in filter(None, self.several()):
            size = sum(max(1.0, lines_of(_operations(line))) for line in lines)
            parts.setdefault(filling.add(size), []).extend(lines)
        names, alone = self.names.within(), len(parts) == 1
        for lines in parts.values():
            yield self.name if alone else names.numbered(f"{self.name}_part", "_"), lines

    @cached_property
    def _loops(self) -> dict[int, list[tuple[list[int], Results]]]:
        """Values and results of the loops of each level, without the values that are calls."""
        operations, levels = self.flow.operations, self._levels
        return {
            level: list(
                self._apart(
                    [k for k in operations if levels.get(k) == level and operations[k].code not in COSTLY],
                    [row for row in self.flow.outputs if self._written(row[2]) == level],
                )
            )
            for level in range(max(levels.values(), default=0) + 1)
        }

    @cached_property
    def _lane_expressions(self) -> Expressions:
        inside: dict[int, tuple[int, int]] = {k: (level, -1) for k, level in self._levels.items()}
        for level, loops in self._loops.items():
            inside |= {k: (level, number) for number, (values, _) in enumerate(loops) for k in values}
        inside = {
            k: place if self.flow.operations[k].code not in COSTLY else (-1, k)
            for k, place in inside.items()
            if k >= 0
        }
        return Expressions(self.flow, inside, self.real, self._element, self.calls, True)

    def several(self) -> Iterator[list[str]]:
        """Loops over the lanes, cut where the library is called; one call may be of all lanes at once."""
        operations, levels = self.flow.operations, self._levels
        kept = self.places
        for level, loops in self._loops.items():
            called = [k for k in operations if levels.get(k) == level and operations[k].code in COSTLY]
            rows = [k for k in called if self._is_of_rows(k)]
            for values, results in loops:
                yield list(self._loop(values, kept, results))
            yield list(self._loop([k for k in called if k not in set(rows)], kept, []))
            # a sine and a cosine of one argument are one call
            of: dict[int, dict[int, int]] = {}  # argument → operation → value
            for k in rows:
                of.setdefault(operations[k].arguments[0], {})[operations[k].code] = k
            for argument, values in of.items():
                source = operations[argument]
                if source.code == casadi.OP_INPUT and self.moving[source.arguments[0]]:
                    k, element = source.arguments
                    place = algebra.ahead(self.arguments[k], element * self.lanes)
                else:
                    place = algebra.ahead(ROWS, kept[argument] * self.lanes)
                places = [algebra.ahead(ROWS, kept[values[code]] * self.lanes) for code in sorted(values)]
                yield [f"{self.rows(tuple(sorted(values)))}({', '.join([place, *places])});"]

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
        text, here, lines = self._lane_expressions, set(values), list[str]()
        rows = {k: f"{ROWS}[{self._row(place)}]" for k, place in self.places.items()}
        text.begin({k: row for k, row in rows.items() if k not in here}, self._inside.within())
        own = text.lines(values)
        used = {value for k in own for value in text.leaves(k)} | {value for _, _, value in results}
        for k in own:
            for element in text.loads(k):
                lines += text.declared(element)
            if k in used or k not in self.places:
                lines += text.declared(k)
            if k in kept:
                lines.append(f"{rows[k]} = {text.number(k).bare};")
        lines += [
            f"{self.results[result]}[{self._row(element)}] = {text.number(value).bare};"
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
                    levels[argument] + (operations[argument].code in COSTLY)
                    for argument in operation.arguments
                    if argument in levels
                ]
                levels[k] = max(before, default=0)
        part = dict.fromkeys(levels, 0)
        for level in set(levels.values()) if self.lanes else ():
            here = [k for k in levels if levels[k] == level and operations[k].code not in COSTLY]
            for group in self._groups(here):
                parts = -(-len(group) // max(1, MANY * self.most // MOST))
                part |= {k: place * parts // len(group) for place, k in enumerate(group)}
            last = max((part[k] for k in here), default=0)
            part |= {k: last for k in levels if levels[k] == level and operations[k].code in COSTLY}
        order = {pair: place for place, pair in enumerate(sorted({(levels[k], part[k]) for k in levels}))}
        levels = {k: order[levels[k], part[k]] for k in levels}
        results = [value for _, _, value in self.flow.outputs]
        end = max((levels.get(value, 0) for value in results), default=0)
        if any(levels.get(value) == end and operations[value].code in COSTLY for value in results):
            levels[-1] = max(levels.values()) + 1  # a loop for the results alone
        return levels

    def _written(self, value: int) -> int:
        """The loop that writes a value as a result: that which computes it, or the last one."""
        levels = self._levels
        here = value in levels and self.flow.operations[value].code not in COSTLY
        return levels[value] if here else max(levels.values(), default=0)

    @cached_property
    def places(self) -> dict[int, int]:
        """Row of each value that a loop keeps for a later one; a row is free again after the last use."""
        operations, levels = self.flow.operations, self._levels
        uses = [(value, self._written(value), False) for _, _, value in self.flow.outputs]
        for k in levels.keys() & operations.keys():
            uses += [(a, levels[k], operations[k].code in COSTLY) for a in operations[k].arguments]
        kept, last = set[int](), dict[int, int]()
        for value, level, called in uses:
            if value in levels:
                last[value] = max(level, last.get(value, 0))
                if levels[value] != level or (operations[value].code in COSTLY) != called:
                    kept.add(value)
        rows: list[int] = []  # the level after which each is free
        places = dict[int, int]()
        for k in sorted(kept, key=lambda k: (levels[k], k)):
            place = next((row for row, level in enumerate(rows) if level < levels[k]), len(rows))
            rows[place : place + 1] = [last[k]]
            places[k] = place
        return places


def _element_of(text: str) -> tuple[str, int]:
    """What an element of an array begins with, and the number that it ends with: ``x[AT + 2]`` is ``x[AT + ``, 2."""
    found = re.fullmatch(r"(\w+\[(?:\w+ \+ )?)(\d+)\]", text)
    return (found[1], int(found[2])) if found else (text[:-1] + " + ", 0)


def _turning(text: str) -> str:
    """The element of an array behind another one, in a loop over ``i``."""
    begin, number = _element_of(text)
    return f"{begin}{f'{number} + ' * (number > 0)}i]"


def _neighbours(
    stores: Iterable[tuple[str, str, bool]], moving: bool
) -> Iterator[list[tuple[str, str, bool]]]:
    """Where something is written, what, and whether that is an element of an argument: neighbours with equal values, or
    if `moving`, with neighbours among the elements of one."""
    turns = count()

    def key(store: tuple[str, str, bool]) -> tuple[object, ...]:
        (place, written, is_element), turn = store, next(turns)
        (begin, number), (source, element) = _element_of(place), _element_of(written)
        return begin, number - turn, (source, element - turn) if moving and is_element else written

    return (list(run) for _, run in groupby(stores, key))


def _uses(lines: Iterable[str], word: str) -> bool:
    return any(re.search(rf"\b{word}\b", line) for line in lines if not line.startswith(("/*", " *")))


def _changes(lines: Iterable[str], word: str) -> bool:
    """Whether an element of an array is written, by itself or by a function of rows."""
    return any(re.search(rf"^\s*{word}\[[^\]]*\] = |_row\(.*, {word}\b", line) for line in lines)


def _operations(line: str) -> int:
    """Operations of a line, about, with what it reads and writes."""
    return len(re.findall(r" [-+*/<?] |FMA\(| [<>=!]= |\w\[", line)) or 1
