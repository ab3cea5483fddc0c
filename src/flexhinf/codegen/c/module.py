"""A program as C functions: one for each traced function, a few for linear algebra, one that runs the steps."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import casadi

from flexhinf.codegen.c import algebra
from flexhinf.codegen.c.functions import CALLS, SINES, Real, block, constant, function_text, loop
from flexhinf.codegen.memory import COLUMN, Columns, Slice, overlap, whole
from flexhinf.codegen.program import (
    Call,
    Cholesky,
    Copy,
    Guard,
    Map,
    OuterSum,
    Polynomial,
    Program,
    Repeat,
    Step,
    Sweep,
    Unsupported,
    When,
)
from flexhinf.scalars import drop_empty
from flexhinf.scalars.trace import instructions

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence


class Translator:
    """Collects the functions of one or more programs; those that two of them share are written once.

    `prefix`: An identifier; every function's name begins so. `lanes`: Columns of a matrix that a function is evaluated
    for at once, side by side, where there are so many. `functions`: Name to text, in an order in which C can read it.
    """

    def __init__(self, prefix: str, real: Real, lanes: int = 1) -> None:
        self.prefix, self.real, self.lanes = prefix, real, lanes
        self.functions: dict[str, str] = {}
        self._names: dict[tuple[Any, ...], str] = {}
        self._columns = 0  # of a sweep, side by side; none outside of one
        self._spread: dict[Slice, str] = {}  # names of what all of them share, copied to every lane

    def __str__(self) -> str:
        return "\n\n".join(self.functions.values()) + "\n"

    def add(self, program: Program, name: str) -> str:
        """Add ``static int NAME(buffers…)``, which returns the code of the guard that failed, or 0.

        Every buffer is a pointer in the order of the program, work buffers included: the caller gives them, and they
        are not cleared.

        Raises Unsupported: A step or an operation for which there is no C here.
        """
        full = f"{self.prefix}_{name}"
        body = [*self._body(program.body, []), "return 0;"]
        arguments = [
            f"{'const ' if buffer.role == 'in' else ''}{self.real.name} *{buffer.name}"
            for buffer in program.buffers
        ]
        self.functions[full] = "\n".join(block(f"static int {full}({', '.join(arguments)})\n{{", body))
        return full

    # Steps --------------------------------------------------------------------------------------------
    def _body(self, body: Sequence[Step], loops: list[str]) -> Iterator[str]:
        for step in body:
            if isinstance(step, Repeat):
                if isinstance(step.count, str):
                    raise _unsupported(f"a loop of {step.count!r} turns, a number that is given when it runs")
                counter = f"k{len(loops)}"
                yield from loop(counter, step.count, self._body(step.body, [*loops, counter]))
            elif isinstance(step, When):
                head = f"if (*({self._at(step.flag, loops)}) != {constant(0.0, self.real)}) {{"
                yield from block(head, self._body(step.body, loops))
            elif isinstance(step, Call):
                moving: tuple[bool, ...] = ()
                if self._columns > 1:
                    if any(overlap(read, written) for read in step.inputs for written in step.outputs):
                        raise _unsupported("a sweep in which a result takes the place of an argument")
                    moving = tuple(piece.buffer == COLUMN or piece in self._spread for piece in step.inputs)
                name = self._function(step.function, max(1, self._columns), moving)
                places = [self._at(piece, loops) for piece in (*step.inputs, *step.outputs)]
                yield f"{name}({', '.join(places)});"
            elif isinstance(step, Map):
                yield from self._map(step, loops)
            elif isinstance(step, Sweep):
                yield from self._sweep(step, loops)
            elif isinstance(step, OuterSum):
                yield self._outer_sum(step, loops)
            elif isinstance(step, Polynomial):
                sizes = step.point.size, step.target.size, step.columns
                short = f"polynomials{''.join(f'_{number}' for number in (*sizes, *step.degrees))}"
                name = self._helper(short, algebra.polynomial, *sizes, step.degrees)
                places = [self._at(piece, loops) for piece in (step.point, step.table, step.target)]
                yield f"{name}({', '.join(places)});"
            elif isinstance(step, Cholesky):
                name = self._helper("cholesky", algebra.cholesky, self.real)
                places = self._at(step.source, loops), self._at(step.target, loops)
                yield f"{name}({', '.join(places)}, {step.order});"
            elif isinstance(step, Copy):
                source, target = self._at(step.source, loops), self._at(step.target, loops)
                size = step.source.size * max(1, self._columns)
                if self._columns and step.source.buffer != COLUMN:  # the same for all columns
                    yield from loop("i", size, [f"({target})[i] = ({source})[i / {self._columns}];"])
                else:
                    yield f"{self._helper('copy', algebra.copy)}({source}, {target}, {size});"
            elif isinstance(step, Guard):
                finite = f"{self._helper('finite', algebra.finite)}({self._at(step.source, loops)}, {step.source.size})"
                yield from block(f"if (!{finite}) {{", [f"return {step.code};"])
            else:
                raise _unsupported("random numbers, which belong to a simulation")

    def _at(self, piece: Slice, loops: Sequence[str]) -> str:
        if piece.buffer == COLUMN:
            return f"column + {piece.offset * self._columns}"
        if piece in self._spread:
            return self._spread[piece]
        if piece.shift:
            raise _unsupported(
                f"a place that is shifted by {piece.shift!r}, a number that is given when it runs"
            )
        terms = [piece.buffer] + ([str(piece.offset)] if piece.offset else [])
        terms += [f"{stride} * {loop}" for stride, loop in zip(piece.strides, loops, strict=False) if stride]
        return " + ".join(terms)

    def _outer_sum(self, step: OuterSum, loops: Sequence[str]) -> str:
        apart = step.plus is None or not overlap(step.plus, step.target)
        wide = algebra.WIDE if apart and step.shape[1] >= algebra.WIDE else 1
        tall = algebra.TALL if wide > 1 and step.shape[0] >= algebra.TALL else 1
        flags = step.weights is not None, step.plus is not None, step.symmetric
        short = "sum" + "".join(letter for letter, flag in zip("wpsvt", (*flags, wide > 1, tall > 1)) if flag)
        name = self._helper(short, algebra.outer_sum, *flags, tall, wide)
        pieces = [step.left, step.right, step.weights, step.plus, step.target]
        places = [self._at(piece, loops) for piece in pieces if piece is not None]
        return f"{name}({', '.join(places)}, {step.count}, {step.shape[0]}, {step.shape[1]});"

    def _map(self, step: Map, loops: list[str]) -> Iterator[str]:
        """Columns are gathered from where they lie, `lanes` at once, and put back; single numbers stay."""
        moving = tuple(isinstance(piece, Columns) for piece in step.inputs)
        codes = {code for code, *_ in instructions(step.function)}
        simple = all(piece.size == 1 for piece in (*step.inputs, *step.outputs) if isinstance(piece, Columns))
        apart = not any(
            overlap(whole(source), result.whole) for source in step.inputs for result in step.outputs
        )
        starts = [self._at(whole(piece), loops) for piece in (*step.inputs, *step.outputs)]
        if self.lanes > 1 and simple and apart and not codes & CALLS:  # numbers become numbers one by one
            yield f"{self._function(step.function, 0, moving)}({', '.join(starts)}, {step.count});"
            return
        pieces, read = [*step.inputs, *step.outputs], len(step.inputs)
        lanes = self.lanes if step.count >= self.lanes else 1
        name = self._function(step.function, lanes, moving if lanes > 1 else ())
        declared, gather, scatter, places = [], [], [], []
        if lanes > 1:
            declared.append(f"const int left = ({step.count} - c < {lanes}) ? {step.count} - c : {lanes};")
        for k, (piece, start) in enumerate(zip(pieces, starts, strict=True)):
            if not isinstance(piece, Columns):
                places.append(start)
                continue
            along, across = piece.moves
            column, place = f"{start} + {_times('c', across)}", f"column{k}"
            if lanes == 1 and (along == 1 or piece.size == 1):
                places.append(column)
                continue
            places.append(place)
            declared.append(f"{self.real.name} {place}[{piece.size * lanes}];")
            line = self._move(piece, start, place, lanes, "left", k < read)
            (gather if k < read else scatter).append(line)
        lines = [*declared, *gather, f"{name}({', '.join(places)});", *scatter]
        yield from block(f"for (int c = 0; c < {step.count}; c += {lanes}) {{", lines)

    def _sweep(self, step: Sweep, loops: list[str]) -> Iterator[str]:
        """Blocks of columns side by side; a column or two that are left over go alone.

        What all columns share is copied to every lane once: a compiler does so in every call, and keeps it in memory.
        """
        first = 0
        while first < step.count:
            left = step.count - first
            lanes = self.lanes if left >= self.lanes or left > 2 else 1
            end = step.count - left % lanes if left >= lanes else step.count
            number = str(min(left, lanes))
            lines = [f"{self.real.name} column[{step.size * lanes}];"]
            for columns, place in step.inputs:
                start, inside = self._at(columns.whole, loops), f"column + {place.offset * lanes}"
                lines.append(self._move(columns, start, inside, lanes, number, True))
            spread = _shared(step.body) if lanes > 1 else {}
            self._columns, self._spread = lanes, spread
            lines += self._body(step.body, loops)
            self._columns, self._spread = 0, {}
            for columns, place in step.outputs:
                start, inside = self._at(columns.whole, loops), f"column + {place.offset * lanes}"
                lines.append(self._move(columns, start, inside, lanes, number, False))
            copies = [f"{self.real.name} {name}[{piece.size * lanes}];" for piece, name in spread.items()]
            for piece, name in spread.items():
                copy = f"{name}[{lanes} * i + l] = ({self._at(piece, loops)})[i];"
                copies += loop("i", piece.size, loop("l", lanes, [copy]))
            yield from block(
                "{", [*copies, *block(f"for (int c = {first}; c < {end}; c += {lanes}) {{", lines)]
            )
            first = end

    def _move(self, columns: Columns, start: str, place: str, lanes: int, left: str, read: bool) -> str:
        """A call that copies a column, or `left` columns side by side, from a matrix at `start` to a place, or back."""
        along, across = columns.moves
        ends = f"{start} + {_times('c', across)}, {place}"
        if lanes == 1:
            name = self._helper("gather" if read else "scatter", algebra.column, read)
            return f"{name}({ends}, {columns.size}, {along});"
        name = self._helper("pack" if read else "unpack", algebra.columns, read, lanes)
        return f"{name}({ends}, {columns.size}, {along}, {across}, {left});"

    # Functions ----------------------------------------------------------------------------------------
    def function(self, function: casadi.Function) -> str:
        """Add a traced function without a program; the name of the C function, whose empty arguments are left out."""
        return self._function(drop_empty(function))

    def _function(self, function: casadi.Function, lanes: int = 1, moving: tuple[bool, ...] = ()) -> str:
        """Name of the C function, which is written at its first use."""
        key = (function.serialize(), lanes, moving)
        if key not in self._names:
            name = f"{self.prefix}_{function.name()}{len(self._names)}"
            used = {code for code, *_ in instructions(function)}
            calls = {}  # sine and cosine of our own, where they are used; a float build calls the library
            for code, short in SINES.items():
                if code in used and self.real.name == "double":
                    calls[code] = self._helper(short, algebra.function, code == casadi.OP_COS, self.real)
            rows = self._row if lanes > 1 else None
            self.functions[name] = function_text(name, function, self.real, lanes, moving, calls, rows)
            self._names[key] = name
        return self._names[key]

    def _row(self, codes: tuple[int, ...]) -> str:
        short = "".join(SINES[code] for code in codes) + "_row"
        ones = {code == casadi.OP_COS: f"{self.prefix}_{SINES[code]}" for code in codes}
        return self._helper(short, algebra.row_function, ones, self.real, self.lanes)

    def _helper(self, short: str, make: Callable[..., str], *arguments: Any) -> str:
        """Name of a function of `flexhinf.codegen.c.algebra`, which is written at its first use."""
        name = f"{self.prefix}_{short}"
        if name not in self.functions:
            real, text = self.real, make(name, *arguments)
            for mark, meant in (
                ("{R}", real.name), ("{0}", constant(0.0, real)), ("{1}", constant(1.0, real)),
                ("{fabs}", f"fabs{real.suffix}"), ("{sqrt}", f"sqrt{real.suffix}"),
            ):  # fmt: skip
                text = text.replace(mark, meant)
            self.functions[name] = text
        return name


def _shared(body: Sequence[Step]) -> dict[Slice, str]:
    """Names of the slices that functions read and that are the same for all columns of a sweep and all turns."""
    names: dict[Slice, str] = {}
    for step in body:
        if isinstance(step, Repeat):
            inner = [piece for piece in _shared(step.body) if not any(piece.strides)]
        elif isinstance(step, Call):
            inner = [piece for piece in step.inputs if piece.buffer != COLUMN and not any(piece.strides)]
        else:
            inner = []
        for piece in inner:
            names.setdefault(piece, f"spread{len(names)}")
    return names


def _times(counter: str, stride: int) -> str:
    return counter if stride == 1 else f"{stride} * {counter}"


def _unsupported(what: str) -> Unsupported:
    return Unsupported("The program has no form in C.", f"it has {what}")
