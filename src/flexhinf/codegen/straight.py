"""A program with fewer, longer functions: neighbouring small steps become one traced function.

A composed program calls a function for every small piece and keeps each result in memory: little text, but more
loads, stores and calls than arithmetic. Here neighbouring calls, copies, short sums and maps of a few columns are
traced as one function. What only they read stays in registers, and the memory that is left is moved together. Loops,
conditions and what is large stay steps of their own, and so does a larger function that is called from several places.
"""

from __future__ import annotations

import operator
from collections import Counter
from collections.abc import Callable, Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import fields, replace
from functools import reduce
from itertools import groupby
from typing import TypeVar, cast

import casadi

from flexhinf.arrays import Elements
from flexhinf.codegen.compose import SCRATCH
from flexhinf.codegen.cut import Filling, lines_of
from flexhinf.codegen.memory import COLUMN, Buffer, BufferPart, Columns, Slice, overlap
from flexhinf.codegen.naming import distinct
from flexhinf.codegen.program import (
    Call,
    Cholesky,
    Copy,
    Map,
    OuterSum,
    Program,
    Repeat,
    Step,
    Sweep,
    TracedStage,
    When,
    slices,
)
from flexhinf.codegen.stages import staged_call
from flexhinf.scalars import cholesky, trace
from flexhinf.scalars.trace import instructions, opcodes

#: Operations of a function up to which every call of it is written out; a larger one only where it is called once.
SMALL = 48

#: Products of a sum, operations of a map, and elements of a copy that are written out.
SHORT = 64

#: Order of a Cholesky factor that is written out.
ORDER = 2

#: Lines of a function to which a new section of the algorithm is not added.
SECTION = 18

#: The stage of sums of products, which has no name.
SUMS = "sums"

#: One number of a buffer.
Place = tuple[str, int]


#: A kind of step.
Of = TypeVar("Of", bound=Step)


def straightened(program: Program, tolerance: float) -> Program:
    """The same program in longer functions; its steps have slices without strides and shifts, and one lane.

    `tolerance`: A pivot below so many times what it is made of, times n, counts as zero.
    """
    return _Straight(program, tolerance).program()


class _Straight:
    def __init__(self, whole: Program, tolerance: float) -> None:
        self.whole, self.tolerance = whole, tolerance
        self.work = {buffer.name for buffer in whole.buffers if buffer.role == "work"} | {COLUMN}
        self.parts = {(buffer.name, part.offset): part for buffer in whole.buffers for part in buffer.parts}
        self.calls = Counter(hash(step.function) for step in _all(whole.body) if isinstance(step, Call))
        self.factors, self.needs = dict[int, casadi.Function](), dict[int, list[tuple[int, int]]]()

    def program(self) -> Program:
        """The program with its memory moved together."""
        body = self._body(self.whole.body, set())
        return _compact(self.whole, body, self.parts)

    # What a step reads and writes ---------------------------------------------------------------------
    def _reads(self, body: Sequence[Step]) -> set[Place]:
        """Numbers of work buffers that steps read, of a column in hand too; of a function those that it needs."""
        found: set[Place] = set()
        for step in body:
            if isinstance(step, Repeat | When):
                found |= self._reads(step.body)
            places = [_places(piece) for piece in slices(step)[0]]
            if isinstance(step, Call):
                places = [[places[k][element] for k, element in self._needs(step.function)]]
            found.update(place for some in places for place in some if place[0] in self.work)
        return found

    def _needs(self, function: casadi.Function) -> list[tuple[int, int]]:
        """Arguments and places in them that a function reads."""
        key = hash(function)
        if key not in self.needs:
            read = (where for code, where, *_ in instructions(function) if code == casadi.OP_INPUT)
            self.needs[key] = [(argument, element) for argument, element in read]
        return self.needs[key]

    def _live(self, body: Sequence[Step], end: set[Place]) -> list[set[Place]]:
        """Numbers of work buffers that are read later, before each step, and at the end."""
        live = [end]
        for step in reversed(body):
            written = {place for piece in slices(step)[1] for place in _places(piece)}
            live.append((live[-1] - written) | self._reads([step]))
        return live[::-1]

    # Steps --------------------------------------------------------------------------------------------
    def _body(self, body: Sequence[Step], end: set[Place]) -> tuple[Step, ...]:
        body = [self._factor(step) if isinstance(step, Cholesky) else step for step in body]
        live, done, group = self._live(body, end), list[Step](), list[Step]()
        filling, number = Filling(SECTION), 0
        for k, step in enumerate(body):
            if self._joins(step):
                if number != (number := filling.add(lines_of(_size(step)), begins=bool(self._about(step)))):
                    done += self._joined(group, live[k])
                    group = []
                group.append(step)
                continue
            if isinstance(step, Copy) and not any(_meet(step, other) for other in group):
                done.append(step)
                continue
            done += self._joined(group, live[k])
            done.append(self._alone(step, live[k + 1]))
            group = []
            filling.end()
        return (*done, *self._joined(group, live[-1]))

    def _factor(self, step: Cholesky) -> Step:
        """A factor of a small matrix as the call of a function."""
        n = step.order
        if n > ORDER:
            return step
        if n not in self.factors:

            def factor(matrix: Elements) -> Elements:
                return cholesky(matrix.reshape(n, n), self.tolerance).T.ravel()

            self.factors[n] = trace(factor, n * n, name="factor")
        function = self.factors[n]
        self.calls[hash(function)] += 1
        return Call(function, (step.source,), (step.target,), "L of L L^T, column by column")

    def _joins(self, step: Step) -> bool:
        if isinstance(step, Call):
            size = _operations(step.function)
            return size <= SMALL or self.calls[hash(step.function)] == 1
        if isinstance(step, Map):
            return step.count * _operations(step.function) <= SHORT
        if isinstance(step, OuterSum):
            return step.count * step.target.size <= SHORT * (1 + step.symmetric)
        return isinstance(step, Copy) and step.source.size <= SHORT

    def _alone(self, step: Step, live: set[Place]) -> Step:
        if isinstance(step, Repeat):
            return replace(step, body=self._body(step.body, live | self._reads([step])))
        if isinstance(step, When):
            return replace(step, body=self._body(step.body, live))
        return self._swept(step) if isinstance(step, Sweep) else step

    def _swept(self, step: Sweep) -> Step:
        """A sweep; one whose steps became one function is a map."""
        self.parts |= {(COLUMN, part.offset): part for part in step.parts}
        body = self._body(step.body, {place for _, piece in step.outputs for place in _places(piece)})
        if len(body) == 1 and isinstance(call := body[0], Call):
            ends = {piece: columns for columns, piece in (*step.inputs, *step.outputs)}
            pieces = [[ends.get(piece, piece) for piece in side] for side in (call.inputs, call.outputs)]
            inside = [piece for side in pieces for piece in side if isinstance(piece, Slice)]
            if COLUMN not in {piece.buffer for piece in inside} and len(call.outputs) == len(step.outputs):
                return Map(call.function, tuple(pieces[0]), tuple(pieces[1]), call.about, call.names)  # type: ignore[arg-type]
        return replace(step, body=body)

    def _joined(self, group: Sequence[Step], live: set[Place]) -> Iterator[Step]:
        if len(group) < 2 or all(isinstance(step, Copy) for step in group):
            yield from group
            return
        text, sections = _Text(self), list[str]()
        for step in group:
            about = self._about(step)
            sections += [about] * bool(about)
            text.add(step, about)
        if call := text.call(lambda place: place[0] not in self.work or place in live):
            for place in ((piece.buffer, piece.offset) for piece in call.outputs):
                if sections and place in self.parts:
                    self.parts[place] = replace(self.parts[place], about="\n".join(sections))
                    break
            yield call

    def _about(self, step: Step) -> str:
        """What begins with a step."""
        begins = [self.parts.get((piece.buffer, piece.offset)) for piece in slices(step)[1]]
        return next((part.about for part in begins if part and part.about), "")

    def label(self, place: Place) -> str:
        """What a number is called: the part of its buffer, if it has some that are moved, or the buffer."""
        if place[0] not in self.work:
            return place[0]
        before = [p for (buffer, at), p in self.parts.items() if buffer == place[0] and at <= place[1]]
        return before[-1].name.lower() if before else place[0]

    def element(self, place: Place) -> str:
        """What a number of a part is called; nothing outside of the buffers that are moved."""
        first = max((at for buffer, at in self.parts if buffer == place[0] and at <= place[1]), default=0)
        return f"{self.label(place)}_{place[1] - first}" if place[0] in self.work else ""

    def pieces(self, places: Iterable[Place]) -> Iterator[Slice]:
        """Neighbours in memory of one label."""
        for _, run in groupby(
            enumerate(sorted(places)), lambda pair: (self.label(pair[1]), pair[1][1] - pair[0])
        ):
            (_, (buffer, first)), *others = run
            yield Slice(buffer, first, 1 + len(others))

    def read(self, places: Iterable[Place], written: Container[str]) -> Iterator[Slice]:
        """Slices with what is read: whole buffers of what the program is given, if nothing of them is written."""
        moved = [place for place in places if place[0] in self.work or place[0] in written]
        yield from self.pieces(moved)
        for name in dict.fromkeys(
            buffer for buffer, _ in places if buffer not in self.work and buffer not in written
        ):
            size = self.whole.buffer(name).size
            yield Slice(name, 0, size or 1 + max(k for buffer, k in places if buffer == name))


class _Text:
    """Steps in a row as expressions of the numbers that were there before."""

    def __init__(self, memory: _Straight) -> None:
        self._memory = memory
        self.before: dict[Place, casadi.SX] = {}  # what is read from memory
        self.now: dict[Place, casadi.SX] = {}  # what has changed
        self.stages: list[tuple[TracedStage, list[casadi.SX]]] = []

    def add(self, step: Step, about: str) -> None:
        """Evaluate one more step; `about`: what begins with it, or nothing."""
        if isinstance(step, Copy):
            self._write(step.target, self._read(step.source))
        elif isinstance(step, Call | Map):
            for c in range(1 if isinstance(step, Call) else step.count):
                read, written = (
                    [_column(piece, c) if isinstance(piece, Columns) else _places(piece) for piece in pieces]
                    for pieces in (step.inputs, step.outputs)
                )
                arguments = [[*map(self._value, places)] for places in read]
                self._evaluate(step.function, arguments, written, step.about or about)
        else:
            assert isinstance(step, OuterSum)
            total = _sum(step, self._read)
            self._write(step.target, total)
            self._keep(SUMS, about or "Sums of products", total, _places(step.target))

    def call(self, wanted: Callable[[Place], bool]) -> Call | None:
        """One function of what is read, with the results that are wanted; None without any."""
        memory = self._memory
        changed = [p for p, value in self.now.items() if wanted(p) and not self._is_before(p, value)]
        if not changed:
            return None
        written = [*memory.pieces(changed)]
        stages, ends = zip(*self.stages, strict=True)
        numbers = [self.now[place] for place in changed] + [each for values in ends for each in values]
        used = {symbol.name() for symbol in casadi.symvar(casadi.vertcat(*numbers))}
        before = [place for place, symbol in self.before.items() if symbol.name() in used]
        read = [*memory.read(before, {buffer for buffer, _ in changed})]
        inputs = [casadi.vertcat(*map(self._value_before, _places(piece))) for piece in read]
        outputs = [[self.now[place] for place in _places(piece)] for piece in written]
        name = max(self.stages, key=lambda stage: len(stage[1]))[0].name
        name = memory.label((written[0].buffer, written[0].offset)) if name == SUMS else name
        called = _labels([*read, *written], memory)
        return staged_call(name, inputs, outputs, stages, ends, (read, written), called)

    def _evaluate(
        self,
        function: casadi.Function,
        arguments: Iterable[list[casadi.SX]],
        written: Sequence[Sequence[Place]],
        about: str,
    ) -> None:
        results = function.call([casadi.vertcat(*values) for values in arguments])
        flat = [[result[k] for k in range(result.numel())] for result in results]
        for places, values in zip(written, flat, strict=True):
            self.now |= dict(zip(places, values, strict=True))
        numbers = [value for values in flat for value in values]
        self._keep(function.name(), about, numbers, [place for places in written for place in places])

    def _keep(self, name: str, about: str, values: list[casadi.SX], places: Iterable[Place]) -> None:
        labels = tuple(map(self._memory.element, places))
        self.stages.append((TracedStage(name, about, labels=labels), values))

    def _value_before(self, place: Place) -> casadi.SX:
        if place not in self.before:
            self.before[place] = casadi.SX.sym(f"{place[0]}_{place[1]}")
        return self.before[place]

    def _value(self, place: Place) -> casadi.SX:
        return self.now[place] if place in self.now else self._value_before(place)

    def _read(self, piece: Slice) -> list[casadi.SX]:
        return [self._value(place) for place in _places(piece)]

    def _write(self, piece: Slice, values: Sequence[casadi.SX]) -> None:
        self.now |= dict(zip(_places(piece), values, strict=True))

    def _is_before(self, place: Place, value: casadi.SX) -> bool:
        return place in self.before and casadi.is_equal(value, self.before[place])


def _labels(pieces: Sequence[Slice], memory: _Straight) -> tuple[str, ...]:
    """A name for each piece, each another."""
    return tuple(distinct(memory.label((piece.buffer, piece.offset)) for piece in pieces))


def _sum(step: OuterSum, read: Callable[[Slice], list[casadi.SX]]) -> list[casadi.SX]:
    """The target of a sum of outer products, in the order of its loops."""
    (rows, columns), count = step.shape, step.count
    left, right = casadi.vertcat(*read(step.left)), casadi.vertcat(*read(step.right))
    left, right = left.reshape((rows, count)), right.reshape((columns, count))
    if step.weights is not None:
        left = left * casadi.repmat(casadi.vertcat(*read(step.weights)).T, rows, 1)
    products = (
        casadi.repmat(left[:, k], 1, columns) * casadi.repmat(right[:, k].T, rows, 1) for k in range(count)
    )
    total = reduce(operator.add, products)
    if step.plus is not None:
        total = total + casadi.vertcat(*read(step.plus)).reshape((columns, rows)).T
    total = casadi.triu2symm(casadi.triu(total)) if step.symmetric else total
    numbers = casadi.densify(total).T
    return [numbers[k] for k in range(numbers.numel())]


def _operations(function: casadi.Function) -> int:
    return sum(1 for _ in opcodes(function))


def _size(step: Step) -> int:
    """Operations of a step that joins others."""
    if isinstance(step, Call | Map):
        return getattr(step, "count", 1) * _operations(step.function)
    return step.count * step.target.size if isinstance(step, OuterSum) else 0


def _meet(copy: Copy, step: Step) -> bool:
    """Whether a copy cannot be made before a step that comes before it."""
    read, written = slices(step)
    moved = any(overlap(copy.target, piece) for piece in (*read, *written))
    return moved or any(overlap(copy.source, piece) for piece in written)


def _all(body: Sequence[Step]) -> Iterator[Step]:
    for step in body:
        yield step
        if isinstance(step, Repeat | When | Sweep):
            yield from _all(step.body)


def _places(piece: Slice) -> list[Place]:
    return [(piece.buffer, k) for k in range(piece.offset, piece.offset + piece.size)]


def _column(piece: Columns, c: int) -> list[Place]:
    along, across = piece.moves
    return [(piece.whole.buffer, piece.whole.offset + along * k + across * c) for k in range(piece.size)]


# Memory ---------------------------------------------------------------------------------------------
def _compact(whole: Program, body: tuple[Step, ...], named: Mapping[Place, BufferPart]) -> Program:
    """The steps with the memory between them moved together, without what no step uses any more; parts have names."""
    free = {buffer.name for buffer in whole.buffers if buffer.name == SCRATCH}
    used = {
        place
        for step in _all(body)
        for side in slices(step)
        for piece in side
        if piece.buffer in free
        for place in _places(piece)
    }
    moved = {place: (place[0], k) for k, place in enumerate(sorted(used))}

    def at(piece: Slice) -> Slice:
        return replace(piece, offset=moved[piece.buffer, piece.offset][1]) if piece.buffer in free else piece

    def parts(buffer: Buffer) -> tuple[BufferPart, ...]:
        own = [named[buffer.name, part.offset] for part in buffer.parts]
        if buffer.name not in free:
            return tuple(own)
        ends = [*(part.offset for part in own[1:]), buffer.size or 0]
        used_of = [
            next(
                (moved[place][1] for k in range(part.offset, end) if (place := (buffer.name, k)) in moved),
                None,
            )
            for part, end in zip(own, ends)
        ]
        return tuple(replace(part, offset=first) for part, first in zip(own, used_of) if first is not None)

    buffers = tuple(
        replace(buffer, size=len(moved) if buffer.name in free else buffer.size, parts=parts(buffer))
        for buffer in whole.buffers
        if buffer.name not in free or moved
    )
    return replace(whole, buffers=buffers, body=tuple(_moved(step, at) for step in body))


def _moved(step: Of, at: Callable[[Slice], Slice]) -> Of:
    """A step with every slice at its new place."""

    def new(value: object) -> object:
        if isinstance(value, Slice):
            return at(value)
        if isinstance(value, Columns):
            return replace(value, whole=at(value.whole))
        if isinstance(value, Step):
            return _moved(value, at)
        return tuple(map(new, cast("tuple[object, ...]", value))) if isinstance(value, tuple) else value

    return replace(step, **{field.name: new(getattr(step, field.name)) for field in fields(step)})
