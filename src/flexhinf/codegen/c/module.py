"""A program as C functions: those of traced functions, a few for linear algebra, one that runs the steps."""

from __future__ import annotations

import re
from collections.abc import Container, Hashable, Iterable, Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Never

import casadi

from flexhinf.codegen.c import algebra, functions
from flexhinf.codegen.c.algebra import Real, constant
from flexhinf.codegen.c.function import FunctionText
from flexhinf.codegen.c.identifiers import RESERVED, called_names
from flexhinf.codegen.c.layout import block, headed, loop
from flexhinf.codegen.c.parts import Parts
from flexhinf.codegen.c.statements import Statements
from flexhinf.codegen.dataflow import Dataflow, read_dataflow
from flexhinf.codegen.memory import COLUMN, Columns, Slice, overlap, whole
from flexhinf.codegen.naming import Names
from flexhinf.codegen.operations import COSTLY, OPERATIONS, TURNS
from flexhinf.codegen.program import (
    Call,
    Cholesky,
    Copy,
    Guard,
    Householder,
    Map,
    OuterSum,
    Polynomial,
    Program,
    Repeat,
    Residual,
    Stages,
    Step,
    Sweep,
    Unsupported,
    When,
    leaves,
    slices,
)
from flexhinf.scalars import drop_empty
from flexhinf.scalars.trace import instructions

#: The argument of a program with memory for the columns in hand.
ROOM = "columns"

NOTHING: Mapping[str, Never] = MappingProxyType({})

#: The counter of columns, and how many of them are left.
COUNTERS = ("c", "left")

#: How names of the functions of `flexhinf.codegen.c` begin, which none of a model has.
HELPERS = (
    "cholesky",
    "copy",
    "cos",
    "far",
    "finite",
    "gather",
    "pack",
    "polynomials",
    "reflect",
    "residual",
    "scatter",
    "sin",
    "sum",
    "turned",
    "unpack",
)


class Translator:
    """Collects the functions of one or more programs; those that two of them share are written once.

    `prefix`: An identifier; every function's name begins so. `lanes`: Columns of a matrix that a function is evaluated
    for at once, side by side, where there are so many. `taken`: Names that the file around the functions has.
    `elements`: Indices by name of the elements of whole buffers, for functions that are given them; or elements of
    `parts`, names of places in a buffer. `functions`: Name to text, in an order in which C can read it.
    `sizes`: Constants of C by buffer, for what is done to it as a whole. `macros`: Those that the code around the
    functions needs, see `flexhinf.codegen.c.algebra.MACROS`. `calls_library`: Whether a function calls one
    of the C library whose bits are not the same everywhere.
    `room`: Numbers of memory for columns in hand that the programs need of the caller, so that none is on the stack.
    """

    def __init__(
        self,
        prefix: str,
        real: Real,
        lanes: int = 1,
        taken: Iterable[str] = (),
        elements: Mapping[str, Sequence[str]] = NOTHING,
        parts: Mapping[str, str] = NOTHING,
        sizes: Mapping[str, str] = NOTHING,
        macros: Container[str] = (),
    ) -> None:
        self.prefix, self.real, self.lanes = prefix, real, lanes
        self._names = self._scope = Names(RESERVED).within({*algebra.MACROS, *taken})
        self._elements, self._places_of, self._sizes = elements, parts, sizes
        self._macros = macros
        self._numbers: dict[str, int | None] = {}  # of each buffer
        self.functions: dict[str, str] = {}
        self._known: dict[Hashable, str] = {}
        self.calls_library = False
        self.room = 0
        self._taken = 0  # of the room, by what is written now
        self._columns = 0  # of a sweep, side by side; none outside of one
        self._kept: dict[str, int] = {}  # numbers that a function keeps between its loops
        self._codes: Mapping[int, str] = {}
        self._parts: dict[str, Parts] = {}  # of buffers whose parts have names
        self._in_place: dict[Slice, str] = {}  # columns in hand that are where their matrix is
        self._spread: dict[Slice, str] = {}  # names of what all of them share, copied to every lane

    def __str__(self) -> str:
        text = "\n\n".join(self.functions.values()) + "\n"
        used = [macro for word, macro in algebra.MACROS.items() if word in text or word in self._macros]
        return "\n".join([*used, text])

    def add(self, program: Program, name: str, codes: Mapping[int, str] = MappingProxyType({})) -> str:
        """Add ``static int NAME(buffers…)``, which returns the code of the guard that failed, or 0.

        Every buffer is a pointer in the order of the program, work buffers included: the caller gives them, and they
        are not cleared. Where there is `room`, it is the last of them. `codes`: Constants of C for codes of guards.

        Raises Unsupported: A step or an operation for which there is no C here.
        """
        full, self._codes = f"{self.prefix}_{name}", codes
        assert full not in self.functions
        self._names.take(full)
        names = (*(buffer.name for buffer in program.buffers), ROOM, COLUMN, *COUNTERS)
        self._scope = self._names.within(names)
        parts = [Parts(b.name, b.size or 0, b.parts, self._scope) for b in program.buffers if b.parts]
        self._parts = {part.buffer: part for part in parts}
        self._numbers = {buffer.name: buffer.size for buffer in program.buffers}
        steps = list(self._body(program.body, []))
        arguments = {
            buffer.name: f"{'const ' if buffer.role == 'in' else ''}{self.real.written} *{buffer.name}"
            for buffer in program.buffers
        }
        arguments |= {ROOM: f"{self.real.written} *RESTRICT {ROOM}"} if self.room else {}

        def pointers(lines: Sequence[str]) -> list[str]:
            return [line for part in parts for line in part.declared(lines, self.real.written)]

        statements = Statements(full, arguments, pointers, self.functions, self._names)
        self.functions |= statements.texts(steps, str(self._codes.get(0, 0)))
        return full

    # Steps --------------------------------------------------------------------------------------------
    def _body(self, body: Sequence[Step], loops: list[str]) -> Iterator[str]:
        for step in body:
            yield from self._headed(step)
            if isinstance(step, Repeat):
                if isinstance(step.count, str):
                    raise _unsupported(f"a loop of {step.count!r} turns, a number that is given when it runs")
                counter = self._scope.within(loops).allot(f"k{len(loops)}") if step.count > 1 else "0"
                turn = self._body(step.body, [*loops, counter])
                yield from loop(counter, step.count, turn) if step.count > 1 else turn
            elif isinstance(step, When):
                flag, zero = algebra.element(self._at(step.flag, loops)), constant(0.0, self.real)
                head = f"if (!(fabs{self.real.suffix}({flag}) <= {zero})) {{"
                yield from block(head, self._body(step.body, loops))
            elif isinstance(step, Call):
                moving: tuple[bool, ...] = ()
                apart = not any(overlap(read, written) for read in step.inputs for written in step.outputs)
                if self._columns > 1:
                    if not apart:
                        raise _unsupported("a sweep in which a result takes the place of an argument")
                    moving = tuple(piece.buffer == COLUMN or piece in self._spread for piece in step.inputs)
                pieces = (*step.inputs, *step.outputs)
                cut = step.stages is not None
                shared = tuple(self._shared(piece, cut) for piece in pieces) if self._columns <= 1 else ()
                name = self._function(
                    step.function,
                    max(1, self._columns),
                    moving,
                    step.about,
                    apart,
                    step.stages,
                    self._names_of(step),
                    shared,
                )
                starts: dict[Hashable, str] = {}
                for k, piece in enumerate(pieces):
                    place, names = shared[k] if shared else (k, None)
                    starts.setdefault(place, piece.buffer if names else self._at(piece, loops))
                yield f"{name}({', '.join([*starts.values(), *self._rows_of(name)])});"
            elif isinstance(step, Map | Sweep):
                taken = self._taken
                yield from self._map(step, loops) if isinstance(step, Map) else self._sweep(step, loops)
                self._taken = taken  # what it had is free again
            elif isinstance(step, OuterSum):
                yield self._outer_sum(step, loops)
            elif isinstance(step, Polynomial):
                sizes = step.point.size, step.target.size, step.columns
                short = f"polynomials{''.join(f'_{number}' for number in (*sizes, *step.degrees))}"
                name = self._helper(short, "polynomial", **functions.polynomial(*sizes, step.degrees))
                places = [self._at(piece, loops) for piece in (step.point, step.table, step.target)]
                yield f"{name}({', '.join(places)});"
            elif isinstance(step, Cholesky):
                places = self._at(step.source, loops), self._at(step.target, loops)
                if self.lanes == 1 and step.order <= functions.ORDER:
                    short = f"cholesky{step.order}"
                    name = self._helper(
                        short, "small_factor", **functions.small_factor(step.order, self.real)
                    )
                    yield f"{name}({', '.join(places)});"
                else:
                    name = self._helper("cholesky", "factor")
                    yield f"{name}({', '.join(places)}, {step.order});"
            elif isinstance(step, Householder):
                name = self._helper("reflect", "reflections")
                places = self._at(step.source, loops), self._at(step.target, loops)
                sizes = *step.shape, step.count, step.triangle
                yield f"{name}({', '.join([*places, *map(str, sizes)])});"
            elif isinstance(step, Residual):
                name = self._helper("residual", "residual")
                places = [self._at(piece, loops) for piece in (step.rows, step.slope, step.target)]
                yield f"{name}({', '.join(places)}, {step.count}, {step.shape[0]}, {step.shape[1]});"
            elif isinstance(step, Copy):
                source, target = self._at(step.source, loops), self._at(step.target, loops)
                size = self._size(step.source) if self._columns <= 1 else step.source.size * self._columns
                if self._columns and step.source.buffer != COLUMN:  # the same for all columns
                    yield from loop("i", size, [f"({target})[i] = ({source})[i / {self._columns}];"])
                else:
                    near = overlap(step.source, step.target) or step.source.strides or step.target.strides
                    name = self._helper("move", "move") if near else self._helper("copy", "copy")
                    yield f"{name}({source}, {target}, {size});"
            elif isinstance(step, Guard):
                arguments = f"{self._at(step.source, loops)}, {self._size(step.source)}"
                finite = self._helper("finite", "finite") + f"({arguments})"
                code = self._codes.get(step.code, str(step.code))
                yield from block(f"if ({finite} == 0) {{", [f"return {code};"])
            else:
                raise _unsupported("random numbers, which belong to a simulation")

    def _names_of(self, step: Call) -> tuple[str, ...]:
        """Names of arguments and results; one that lies within a buffer of that name is called as the part of it."""
        names = list(step.names)
        for k, (name, piece) in enumerate(zip(names, (*step.inputs, *step.outputs))):
            if name == piece.buffer in self._parts and piece.size != self._numbers[piece.buffer]:
                part = self._parts[piece.buffer].at(piece).split(" + ")[1]
                names[k] = re.sub(rf"^{self.prefix}_(at|p)_".lower(), "", part.lower())
        return tuple(names)

    def _size(self, piece: Slice) -> int | str:
        """The number of elements; of a whole buffer its constant, where it has one."""
        return (
            self._sizes.get(piece.buffer, piece.size)
            if piece.size == self._numbers.get(piece.buffer)
            else piece.size
        )

    def _shared(self, piece: Slice, cut: bool = False) -> tuple[Hashable, tuple[str, ...] | None]:
        """What an argument or a result of a call is in C, equal for equal ones, and what its elements are called there:
        a buffer whose elements have names is one argument, and so is a part whose elements are constants of C.

        `cut`: Of a trace in its stages, where any part will do.
        """
        names = self._elements.get(piece.buffer, ())
        own = tuple(names[piece.offset : piece.offset + piece.size])
        constants = piece.buffer == "data" and all(name.isupper() for name in own)
        fixed = not piece.strides and (cut or constants)
        return (piece.buffer, own) if names and (fixed or piece.size == len(names)) else (piece, None)

    def _headed(self, step: Step) -> list[str]:
        """A comment where something new begins."""
        about = next(filter(None, (parts.about(slices(step)[1]) for parts in self._parts.values())), "")
        return [line for text in about.splitlines() for line in headed(text)]

    def _take(self, name: str, size: int) -> str:
        """The declaration of so many numbers of the room, until what took them gives them back."""
        place, self._taken = self._taken, self._taken + size
        self.room = max(self.room, self._taken)
        return f"{self.real.written} *const {name} = {algebra.ahead(ROOM, place)};"

    def _rows_of(self, name: str) -> list[str]:
        """The argument of a function for what it keeps, behind what is taken of the room; none without."""
        size = self._kept.get(name, 0)
        self.room = max(self.room, self._taken + size)
        return [algebra.ahead(ROOM, self._taken)] * (size > 0)

    def _at(self, piece: Slice, loops: Sequence[str]) -> str:
        for place, text in self._in_place.items():
            if piece.buffer == COLUMN and overlap(piece, place):
                return algebra.ahead(text, piece.offset - place.offset)
        if piece in self._spread:
            return self._spread[piece]
        if piece.shift:
            raise _unsupported(
                f"a place that is shifted by {piece.shift!r}, a number that is given when it runs"
            )
        parts, moves = self._parts.get(piece.buffer), zip(piece.strides, loops, strict=False)
        terms = [parts.at(piece) if parts else algebra.ahead(piece.buffer, piece.offset)]
        terms += [f"{stride} * {loop}" for stride, loop in moves if stride and loop != "0"]
        return " + ".join(terms)

    def _outer_sum(self, step: OuterSum, loops: Sequence[str]) -> str:
        (rows, columns), flags = step.shape, (step.weights is not None, step.plus is not None, step.symmetric)
        if self.lanes == 1 and rows * columns <= functions.FEW:
            letters = "".join(letter for letter, flag in zip("wps", flags) if flag)
            short = f"sum{letters}_{rows}_{columns}"
            sizes = functions.small_sum(rows, columns, step.symmetric)
            name = self._helper(short, "small_sum", weighted=flags[0], added=flags[1], **sizes)
            pieces = [step.left, None if step.symmetric else step.right, step.weights, step.plus, step.target]
            places = [self._at(piece, loops) for piece in pieces if piece is not None]
            return f"{name}({', '.join(places)}, {step.count});"
        apart = step.plus is None or not overlap(step.plus, step.target)
        wide = functions.WIDE if apart and step.shape[1] >= functions.WIDE else 1
        tall = functions.TALL if wide > 1 and step.shape[0] >= functions.TALL else 1
        short = "sum" + "".join(letter for letter, flag in zip("wpsvt", (*flags, wide > 1, tall > 1)) if flag)
        known = dict(zip(("weighted", "added", "symmetric"), flags))
        name = self._helper(short, "sum", **known, tall=tall, wide=wide)
        pieces = [step.left, step.right, step.weights, step.plus, step.target]
        places = [self._at(piece, loops) for piece in pieces if piece is not None]
        return f"{name}({', '.join(places)}, {step.count}, {rows}, {columns});"

    def _map(self, step: Map, loops: list[str]) -> Iterator[str]:
        """Columns are gathered from where they lie, `lanes` at once, and put back; single numbers stay."""
        moving = tuple(isinstance(piece, Columns) for piece in step.inputs)
        codes = {code for code, *_ in instructions(step.function)}
        simple = all(piece.size == 1 for piece in (*step.inputs, *step.outputs) if isinstance(piece, Columns))
        apart = not any(
            overlap(whole(source), result.whole) for source in step.inputs for result in step.outputs
        )
        starts = [self._at(whole(piece), loops) for piece in (*step.inputs, *step.outputs)]
        if self.lanes > 1 and simple and apart and not codes & COSTLY:  # numbers become numbers one by one
            name = self._function(step.function, 0, moving, step.about, names=step.names)
            yield f"{name}({', '.join(starts)}, {step.count});"
            return
        pieces, read = [*step.inputs, *step.outputs], len(step.inputs)
        lanes = self.lanes if step.count >= self.lanes else 1
        shared: tuple[tuple[Hashable, tuple[str, ...] | None], ...] = ()
        if lanes == 1:
            own = [
                (k, None) if isinstance(piece, Columns) else self._shared(piece)
                for k, piece in enumerate(pieces)
            ]
            shared = tuple((place, names) if names else (k, None) for k, (place, names) in enumerate(own))
        name = self._function(
            step.function,
            lanes,
            moving if lanes > 1 else (),
            step.about,
            apart,
            names=step.names,
            shared=shared,
        )
        left = f"const int left = ({step.count} - c < {lanes}) ? {step.count} - c : {lanes};"
        declared, gather, scatter = [left] if lanes > 1 else [], list[str](), list[str]()
        places, inside = list[str](), self._scope.within()
        for k, (piece, start) in enumerate(zip(pieces, starts, strict=True)):
            if not isinstance(piece, Columns):
                named = shared and shared[k][1]
                if not named or piece.buffer not in places:
                    places.append(piece.buffer if named else start)
                continue
            along, across = piece.moves
            if lanes == 1 and (along == 1 or piece.size == 1):
                places.append(f"{start} + {_times('c', across)}")
                continue
            place = inside.allot(f"column{k}")
            places.append(place)
            declared.append(self._take(place, piece.size * lanes))
            (gather if k < read else scatter).append(self._move(piece, start, place, lanes, "left", k < read))
        lines = [*declared, *gather, f"{name}({', '.join(places + self._rows_of(name))});", *scatter]
        yield from block(f"for (int c = 0; c < {step.count}; c += {lanes}) {{", lines)

    def _sweep(self, step: Sweep, loops: list[str]) -> Iterator[str]:
        """Blocks of columns side by side; a column or two that are left over go alone.

        What all columns share is copied to every lane once: a compiler does so in every call, and keeps it in memory.
        """
        first, taken = 0, self._taken
        while first < step.count:
            self._taken = taken
            left = step.count - first
            lanes = self.lanes if left >= self.lanes or left > 2 else 1
            end = step.count - left % lanes if left >= lanes else step.count
            number = str(min(left, lanes))
            inside = self._scope.within()
            spread = _shared(step.body, inside) if lanes > 1 else {}
            copies = [self._take(name, piece.size * lanes) for piece, name in spread.items()]
            memory = self._take(COLUMN, step.size * lanes)
            parts = self._parts[COLUMN] = Parts(COLUMN, step.size, step.parts, inside, lanes)
            self._in_place = {} if lanes > 1 else self._columns_in_place(step, loops)
            lines = self._moves(step.inputs, loops, lanes, number, True)
            self._columns, self._spread = lanes, spread
            lines += self._body(step.body, loops)
            self._columns, self._spread = 0, {}
            lines += self._moves(step.outputs, loops, lanes, number, False)
            lines = [memory, *parts.declared(lines, self.real.written), *lines]
            self._in_place = {}
            for piece, name in spread.items():
                copy = f"{name}[{lanes} * i + l] = ({self._at(piece, loops)})[i];"
                copies += loop("i", piece.size, loop("l", lanes, [copy]))
            turns = block(f"for (int c = {first}; c < {end}; c += {lanes}) {{", lines)
            yield from block("{", [*copies, *turns]) if copies else turns
            first = end

    def _columns_in_place(self, step: Sweep, loops: list[str]) -> dict[Slice, str]:
        """Where the columns of a sweep lie that need not be copied: their elements are neighbours, and no step changes
        one that is read."""
        steps = list(leaves(step.body))
        written = [piece for inner in steps for piece in slices(inner)[1]]
        pairs = [pair for pair in step.inputs if not any(overlap(pair[1], piece) for piece in written)]
        used = [piece for inner in steps for side in slices(inner) for piece in side]
        return {
            place: f"{self._at(columns.whole, loops)} + {_times('c', columns.moves[1])}"
            for columns, place in (*pairs, *step.outputs)
            if columns.moves[0] == 1 and all(_inside(piece, place) for piece in used if overlap(piece, place))
        }

    def _moves(
        self, pairs: Iterable[tuple[Columns, Slice]], loops: list[str], lanes: int, left: str, read: bool
    ) -> list[str]:
        moves = list[str]()
        for columns, place in pairs:
            if place in self._in_place:
                continue
            start = self._at(columns.whole, loops)
            column = self._parts[COLUMN].at(place)
            moves.append(self._move(columns, start, column, lanes, left, read))
        return moves

    def _move(self, columns: Columns, start: str, place: str, lanes: int, left: str, read: bool) -> str:
        """A call that copies a column, or `left` columns side by side, from a matrix at `start` to a place, or back."""
        along, across = columns.moves
        ends = f"{start} + {_times('c', across)}, {place}"
        if lanes == 1:
            name = self._helper("gather" if read else "scatter", "column", read=read)
            return f"{name}({ends}, {columns.size}, {along});"
        short = ("pack" if read else "unpack") + "_rows" * (across == 1)
        name = self._helper(short, "columns", read=read, lanes=lanes, neighbours=across == 1)
        return f"{name}({ends}, {columns.size}, {along}, {across}, {left});"

    # Functions ----------------------------------------------------------------------------------------
    def function(
        self,
        function: casadi.Function,
        *names: str,
        within: Mapping[int, tuple[str, int]] = MappingProxyType({}),
        apart: bool = False,
    ) -> str:
        """Add a traced function without a program; the name of the C function, whose empty arguments are left out.

        `names`: Of the arguments that are left, and of results. `within`: Of arguments that are given as a whole buffer
        whose elements have names: which one, and where the argument begins in it. `apart`: Whether no result takes the
        place of an argument.
        """
        function = drop_empty(function)
        shared: list[tuple[Hashable, tuple[str, ...] | None]] = [
            (k, None) for k in range(function.n_in() + function.n_out())
        ]
        for k, (buffer, begin) in within.items():
            shared[k] = buffer, tuple(self._elements[buffer][begin : begin + function.size1_in(k)])
        return self._function(function, names=names, shared=tuple(shared), apart=apart)

    def _function(
        self,
        function: casadi.Function,
        lanes: int = 1,
        moving: tuple[bool, ...] = (),
        about: str = "",
        apart: bool = False,
        stages: Stages | None = None,
        names: tuple[str, ...] = (),
        shared: tuple[tuple[Hashable, tuple[str, ...] | None], ...] = (),
    ) -> str:
        """Name of a ``static void name(in₀, …, out₀, …)``, which is written at its first use.

        `lanes`: 0 for any number of them, which is then the last argument ``count``: of a function without library
        calls, and with one element in every moving argument and result. For more than one, element e of a moving
        argument or of a result is the row ``[e * lanes + lane]``, and no result may lie where an argument does. For
        one, every store comes after every load, so that results may take the place of arguments, if they are not
        `apart`. `moving`: Which arguments differ from lane to lane. `about`: A comment above it. `names`: Of arguments
        and results; `shared`: see `_shared`. Raises Unsupported: an operation that is not in the table.
        """
        apart = apart and lanes == 1
        same = [place for place, _ in shared]
        elements = tuple(names for _, names in shared)
        key = (function.serialize(), lanes, moving, apart, tuple(map(same.index, same)), elements)
        if key in self._known:
            return self._known[key]
        real, size = self.real, function.n_in()
        stages = stages or Stages(function, ())
        flow = read_dataflow(stages.function, OPERATIONS, True, len(stages.rows))
        codes = {code for code, *_ in instructions(function)}
        self.calls_library |= any(OPERATIONS[code].library for code in codes if code in OPERATIONS)
        calls = {code: self._sine(code) for code in TURNS if code in codes}
        parts = self._parts_of(flow, elements)
        scope = self._names.within(parts)
        called = called_names(names, size, function.n_out(), shared, scope)
        read, written = called[:size], called[size:]
        own_labels = [stage.labels for stage in stages.rows]
        labels = {
            value: own_labels[n][k] for n, k, value in flow.stages if own_labels[n] and own_labels[n][k]
        }
        said = tuple((stage.name, stage.about) for stage in stages.rows)
        moving = moving or (False,) * size

        kept = function.name().startswith(HELPERS)
        name = self._names.allot(f"{self.prefix}_{function.name()}{'_of_model' * kept}")
        writer = FunctionText(
            name,
            flow,
            real,
            lanes,
            moving,
            calls,
            self._row,
            read,
            written,
            scope,
            apart,
            said,
            elements,
            parts,
            labels,
        ).fitted()
        texts = writer.texts
        self._names.take(*texts)
        if lanes > 1 and writer.places:
            self._kept[name] = lanes * (max(writer.places.values()) + 1)
        self.functions |= texts | {name: _headed(about, texts[name])}
        self._known[key] = name
        return name

    def _parts_of(self, flow: Dataflow, elements: Sequence[tuple[str, ...] | None]) -> dict[str, str]:
        """Parts of a buffer of which a function reads elements by the name of the part, and their places."""
        read = (op.arguments for op in flow.operations.values() if op.code == casadi.OP_INPUT)
        named = {
            own[element].partition("[")[0]
            for argument, element in read
            if elements and (own := elements[argument])
        }
        return {part: place for part, place in self._places_of.items() if part in named}

    def _sine(self, code: int) -> str:
        """The name of the sine or the cosine."""
        if self.real.name == "double":
            return self._helper(TURNS[code], "turn", of_cosine=code == casadi.OP_COS)
        turned = self._helper("turned", "turned", far=self._helper("far", "far"))
        return self._helper(TURNS[code], "short_turn", of_cosine=code == casadi.OP_COS, turned=turned)

    def _row(self, codes: tuple[int, ...]) -> str:
        short = "".join(TURNS[code] for code in codes) + "_row"
        ones = {code == casadi.OP_COS: f"{self.prefix}_{TURNS[code]}" for code in codes}
        ones = {of_cosine: ones[of_cosine] for of_cosine in sorted(ones)}
        begins = {of_cosine: ("cosine" if of_cosine else "sine") + "[l] =" for of_cosine in ones}
        return self._helper(short, "turn_row", ones=ones, begins=begins, lanes=self.lanes)

    def _helper(self, short: str, template: str, **values: object) -> str:
        name = f"{self.prefix}_{short}"
        if name not in self.functions:
            self._names.take(name)
            self.functions[name] = functions.function_text(template, name, self.real, **values)
        return name


def _headed(about: str, text: str) -> str:
    """A function under its comment, unless that is one inside."""
    indent = " " * 4
    inside = "\n".join(indent + line for line in headed(about, indent))
    return text if inside and inside in text else "\n".join([*headed(about), text])


def _shared(body: Sequence[Step], names: Names) -> dict[Slice, str]:
    """Names in a scope of the slices that functions read, the same for all columns of a sweep and all turns."""
    found: dict[Slice, str] = {}
    for step in body:
        read = (
            _shared(step.body, names)
            if isinstance(step, Repeat)
            else step.inputs
            if isinstance(step, Call)
            else ()
        )
        for piece in read:
            if piece.buffer != COLUMN and not any(piece.strides) and piece not in found:
                found[piece] = names.allot(f"spread{len(found)}")
    return found


def _inside(piece: Slice, place: Slice) -> bool:
    return place.offset <= piece.offset and piece.offset + piece.size <= place.offset + place.size


def _times(counter: str, stride: int) -> str:
    return counter if stride == 1 else f"{stride} * {counter}"


def _unsupported(what: str) -> Unsupported:
    return Unsupported("The program has no form in C.", f"it has {what}")
