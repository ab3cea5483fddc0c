"""A whole program as one LLVM module: its traced functions, and an entry with the loops, copies and guards.

The entry takes one pointer to the *context*, an array of 64-bit words:

====================  =================================================
words                 content
====================  =================================================
one per buffer        address of the array (of scratch memory for "work")
one per count         number of turns
one per lane          code (written)
one per lane          step (written)
====================  =================================================

and returns the largest code.

Threads of a GPU that make one run together have one more word, the address of memory in which they pass numbers to each
other. Columns, and elements of matrices, are shared among them; what has none of these is done by the first thread.

A traced function is one LLVM function: load, compute, store. Of functions that are mapped over the columns of matrices,
columns are packed into lanes, and unpacked.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Generator, Hashable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import zip_longest

import casadi

from flexhinf.codegen.emit.algebra import Algebra, Operand
from flexhinf.codegen.emit.function import BLOCK, emit_function, emit_normal
from flexhinf.codegen.emit.group import GroupAlgebra
from flexhinf.codegen.emit.reflections import Reflections
from flexhinf.codegen.emit.writer import Lanes, ModuleText, Writer
from flexhinf.codegen.groups import THREAD, Form, column_packing
from flexhinf.codegen.memory import COLUMN, Columns, Slice, overlap, whole
from flexhinf.codegen.program import (
    ENTRY,
    PREFIX,
    Call,
    Cholesky,
    Copy,
    Guard,
    Householder,
    Map,
    Normal,
    OuterSum,
    Polynomial,
    Program,
    Repeat,
    Residual,
    Step,
    Sweep,
    When,
)

#: From which a function may be called and yet be put there: a Map has one for blocks, one for the rest.
_PLACES = 2
_SMALL = 200  # operations of a function that is put where it is called


def emit_module(
    program: Program,
    lanes: int,
    fused: bool = True,
    choosing: bool = True,
    gpu: bool = False,
    form: Form = THREAD,
) -> ModuleText:
    """Write the LLVM module of a program: its text, and the names to link it with.

    `lanes`: W ≥ 1. `fused`: Fuse products into sums. `choosing`, `gpu`: As of `ModuleText`. `form`: Threads of a GPU
    for a run. These three change no bit. Raises Unsupported: A traced function holds an operation that is not in the
    table.
    """
    return _Emitter(program, ModuleText(Lanes(lanes), fused, choosing, gpu, form.group), form).emit()


class _Emitter:
    def __init__(self, program: Program, module: ModuleText, form: Form) -> None:
        self.program, self.module, self.packings = program, module, dict(form.packings)
        self.lanes = self.module.lanes
        self.functions: dict[Hashable, str] = {}
        self.sizes: dict[str, int] = {}
        self.calls: Counter[str] = Counter()
        self.mapped: set[str] = set()
        self.writer = Writer(self.module)
        self.single = self.writer.packs  # a kernel for a single run
        self.algebra = Algebra(self.writer)
        self.scratch = ""  # memory for the columns that a Sweep has in hand

    def emit(self) -> ModuleText:
        writer, width = self.writer, self.lanes.width
        slots = len(self.program.buffers) + len(self.program.counts)
        self.pointers = {
            buffer.name: writer.read("ptr", self._word(k)) for k, buffer in enumerate(self.program.buffers)
        }
        self.turns = {
            count: writer.read("i64", self._word(k))
            for k, count in enumerate(self.program.counts, len(self.program.buffers))
        }
        self.codes, self.steps = self._word(slots), self._word(slots + width)
        if self.module.group > 1:
            writer.thread = writer.let(f"zext i32 {writer.special('tid')} to i64")
            self.algebra = GroupAlgebra(writer, writer.read("ptr", self._word(slots + 2)))
        writer.write(self.lanes.integer, self.lanes.whole(0), self.codes)
        writer.write(self.lanes.integer, self.lanes.whole(-1), self.steps)
        for buffer in self.program.buffers:
            if buffer.role == "work" and buffer.size is not None and buffer.cleared:
                self._clear(self.pointers[buffer.name], buffer.size)
        writer.wait()
        self._body(self.program.body, ())
        writer.place("finish", "br label %finish")
        largest = writer.read(self.lanes.integer, self.codes)
        if width > 1:
            name = f"llvm.vector.reduce.umax.{self.lanes.suffix('i64')}"
            self.module.declarations[name] = f"declare i64 @{name}({self.lanes.integer})"
            largest = writer.let(f"call i64 @{name}({self.lanes.integer} {largest})")
        writer.do(f"ret i64 {largest}")
        kind = ("internal ", " alwaysinline") if self.module.gpu else ("", "")
        head = f"define {kind[0]}i64 @{ENTRY}(ptr %context){kind[1]} {self.module.frame} {{\nentry:"
        self.module.define(ENTRY, head, [*writer.first, *writer.lines])
        # Functions of columns and small ones are put where they are called, if that is a place or two: what a `Map` has
        # in hand then stays in registers; a large function of a `Call` is slower inside of a loop.
        frame = f") {self.module.frame}"
        for name, places in self.calls.items():
            if places <= _PLACES and (name in self.mapped or self.sizes[name] <= _SMALL):
                text = self.module.definitions[name]
                self.module.definitions[name] = text.replace(frame, f") alwaysinline{frame[1:]}", 1)
        self.module.definitions["!0"] = '!0 = !{!"branch_weights", i32 1, i32 1000000}'
        self.module.operations = sum(self.sizes.values())
        return self.module

    def _word(self, k: int) -> str:
        return self.writer.at("i64", "%context", k)

    def _clear(self, place: str, size: int) -> None:
        if self.module.group > 1:
            for k in self.writer.shared_elements(size):
                self.writer.store_element(place, k, self.lanes.constant(0.0))
            return
        name, length = "llvm.memset.p0.i64", 8 * size * self.lanes.width
        self.module.declarations[name] = f"declare void @{name}(ptr, i8, i64, i1)"
        self.writer.do(f"call void @{name}(ptr align 8 {place}, i8 0, i64 {length}, i1 false)")

    def _body(self, body: tuple[Step, ...], turns: tuple[str, ...]) -> None:
        for calls, step in _lines(body):
            match step:
                case Repeat():
                    self._repeat(step, turns)
                case When():
                    self._when(step, turns)
                case Guard():
                    self._guard(step, turns)
                case _:
                    with self._threads(step):
                        self._simple(calls, step, turns)

    @contextmanager
    def _threads(self, step: Step) -> Generator[None, None, None]:
        """Lines of a step for the threads of a group, or for the first one; then they wait for each other. In a sweep
        each has columns of its own."""
        if COLUMN in self.pointers:
            yield
        elif isinstance(step, Call | Householder | Residual) or _overlaps(step):
            with self.writer.alone():
                yield
            self.writer.wait()
        else:
            yield
            self.writer.wait()

    def _simple(self, calls: Sequence[Call], step: Step, turns: tuple[str, ...]) -> None:
        match step:
            case Call():
                self._calls(calls, turns)
            case Map():
                self._map(step, turns)
            case Sweep():
                self._sweep(step, turns)
            case OuterSum():
                self._outer_sum(step, turns)
            case Polynomial():
                self._polynomial(step, turns)
            case Cholesky():
                self._cholesky(step, turns)
            case Copy():
                self._copy(step, turns)
            case Householder():
                self._householder(step, turns)
            case Residual():
                self._residual(step, turns)
            case Normal():
                self._normal(step, turns)
            case _:
                raise TypeError(type(step).__name__)

    def _repeat(self, step: Repeat, turns: tuple[str, ...]) -> None:
        end = self.turns[step.count] if isinstance(step.count, str) else str(step.count)
        with self.writer.loop(end) as turn:
            self._body(step.body, (*turns, turn))

    def _when(self, step: When, turns: tuple[str, ...]) -> None:
        """Skip the body unless a lane's flag is set; NaN sets it."""
        writer, lanes = self.writer, self.lanes
        flag = writer.load_element(self._address(step.flag, turns), "0", self._shared(step.flag))
        wanted = writer.any(writer.compare("une", flag, lanes.constant(0.0)))
        writer.wait()  # the body may write there
        with writer.when(wanted):
            self._body(step.body, turns)

    def _address(self, piece: Slice, turns: tuple[str, ...]) -> str:
        writer = self.writer
        element = str(self._offset(piece))
        if piece.shift:
            element = writer.let(f"add nsw i64 {element}, {self.turns[piece.shift]}")
        for stride, turn in zip(piece.strides, turns, strict=False):
            if stride:
                element = writer.let(f"add nsw i64 {element}, {writer.let(f'mul nsw i64 {turn}, {stride}')}")
        kind = "double" if self._shared(piece) else self.lanes.element
        return writer.at(kind, self.pointers[piece.buffer], element)

    def _offset(self, piece: Slice) -> int:
        packing = self.packings.get(piece.buffer)
        return packing.offset(piece.offset) if packing else piece.offset

    def _shared(self, piece: Slice) -> bool:
        columns = COLUMN in self.pointers and self.single  # in a sweep of a single run, the lanes are columns
        return piece.buffer != COLUMN and (columns or self.program.buffer(piece.buffer).shared)

    def _function(
        self,
        functions: Sequence[casadi.Function],
        lanes: Lanes,
        shared: tuple[bool, ...],
        links: Mapping[int, int] | None = None,
    ) -> str:
        key = (*(f.__hash__() for f in functions), lanes.width, shared, *(links or {}).items())
        if key not in self.functions:
            self.functions[key] = name = f"{PREFIX}function{len(self.functions)}"
            self.sizes[name] = emit_function(self.module, name, functions, lanes, shared, links)
        return self.functions[key]

    def _calls(self, calls: Sequence[Call], turns: tuple[str, ...]) -> None:
        read, written, links = list[Slice](), list[Slice](), dict[int, int]()
        for call in calls:
            results = {piece: k for k, piece in enumerate(written)}  # of one that is written twice, the last
            links |= {k: results[piece] for k, piece in enumerate(call.inputs, len(read)) if piece in results}
            read += call.inputs
            written += call.outputs
        functions = [call.function for call in calls]
        name = self._function(functions, self.lanes, tuple(map(self._shared, read)), links)
        pointers = ", ".join(f"ptr {self._address(piece, turns)}" for piece in (*read, *written))
        self.writer.do(f"call void @{name}({pointers})")
        self.calls[name] += 1

    def _map(self, step: Map, turns: tuple[str, ...]) -> None:
        writer, single = self.writer, self.single
        wide, block = (Lanes(BLOCK), BLOCK) if single else (self.lanes, 1)
        shared = tuple(
            not isinstance(piece, Columns) and (single or self._shared(piece)) for piece in step.inputs
        )
        name = self._function([step.function], wide, shared)
        starts = [self._address(whole(piece), turns) for piece in (*step.inputs, *step.outputs)]
        for first, left, _ in writer.shares(step.count, block):
            pointers, packed = list[str](), list[tuple[str, Columns, str]]()
            for piece, start in zip((*step.inputs, *step.outputs), starts):
                if not isinstance(piece, Columns):
                    pointers.append(start)
                    continue
                columns = self._column(piece, start, first, piece.moves[1])
                place = writer.allocate(f"[{piece.size} x {wide.element}]")
                pointers.append(place)
                packed.append((place, piece, columns))
                if len(pointers) <= len(step.inputs):
                    self._pack(piece, columns, place, wide, left)
            writer.do(f"call void @{name}({', '.join(f'ptr {pointer}' for pointer in pointers)})")
            self.calls[name] += 1
            self.mapped.add(name)
            for place, piece, columns in packed[-len(step.outputs) :]:
                self._unpack(piece, columns, place, wide, left)

    def _column(self, columns: Columns, start: str, index: str, move: int) -> str:
        unit = "double" if self._shared(columns.whole) else self.lanes.element
        offset = self.writer.let(f"mul nsw i64 {index}, {move}")
        return self.writer.at(unit, start, offset)

    def _pack(self, columns: Columns, start: str, packed: str, wide: Lanes, left: int) -> None:
        """Copy `left` neighbouring columns, the first at `start`, to elements of as many lanes at `packed`.

        `wide`: Of the packed elements, whose lanes without a column are zero. In a kernel of several lanes these are
        the kernel's, and a column goes alone.
        """
        writer, shared, (along, across) = self.writer, self._shared(columns.whole), columns.moves
        for element in writer.elements(columns.size):
            place = self._column(columns, start, element, along)
            if self.lanes.width > 1:
                value = writer.load_element(place, 0, shared)
            elif across == 1 or left == 1:
                value = writer.read(Lanes(left).real, place)
                value = _resized(writer, value, left, wide.width)
            else:
                value = "zeroinitializer"
                for lane in range(left):
                    number = writer.at("double", place, lane * across)
                    number = writer.read("double", number)
                    value = writer.let(f"insertelement {wide.real} {value}, double {number}, i64 {lane}")
            kept = writer.at(wide.element, packed, element)
            writer.write(wide.real, value, kept)

    def _unpack(self, columns: Columns, start: str, packed: str, wide: Lanes, left: int) -> None:
        """The inverse of `_pack`."""
        writer, (along, across) = self.writer, columns.moves
        for element in writer.elements(columns.size):
            kept = writer.at(wide.element, packed, element)
            value = writer.read(wide.real, kept)
            place = self._column(columns, start, element, along)
            if self.lanes.width > 1:
                writer.write(wide.real, value, place)
                continue
            if across == 1 or left == 1:
                value = _resized(writer, value, wide.width, left)
                writer.write(Lanes(left).real, value, place)
                continue
            for lane in range(left):
                number = writer.let(f"extractelement {wide.real} {value}, i64 {lane}")
                position = writer.at("double", place, lane * across)
                writer.write("double", number, position)

    def _sweep(self, step: Sweep, turns: tuple[str, ...]) -> None:

        def ends(columns: Columns, place: Slice, first: str, wide: Lanes) -> tuple[str, str]:
            matrix = self._column(columns, self._address(columns.whole, turns), first, columns.moves[1])
            memory = self._scratch(wide)
            return matrix, self.writer.at(wide.element, memory, self._offset(place))

        if self.module.group > 1:
            self.packings[COLUMN] = column_packing(step)
        for first, left, _ in self.writer.shares(step.count, BLOCK if self.single else 1):
            wide = (Lanes(BLOCK) if left > 1 else Lanes(1)) if self.single else self.lanes
            for columns, place in step.inputs:
                matrix, inside = ends(columns, place, first, wide)
                self._pack(columns, matrix, inside, wide, left)
            lanes, writer = self.lanes, self.writer
            self.pointers[COLUMN] = self._scratch(wide)
            self.lanes, self.writer = wide, writer.alike(wide)
            self._body(step.body, turns)
            self.lanes, self.writer = lanes, writer
            del self.pointers[COLUMN]
            for columns, place in step.outputs:
                matrix, inside = ends(columns, place, first, wide)
                self._unpack(columns, matrix, inside, wide, left)

    def _scratch(self, wide: Lanes) -> str:
        if not self.scratch:
            sweeps = [step for step, _ in self.program.steps() if isinstance(step, Sweep)]
            packed = self.module.group > 1
            needed = [column_packing(step).size if packed else step.size for step in sweeps]
            self.scratch = self.writer.allocate(f"[{max(needed)} x {wide.element}]")
        return self.scratch

    def _operand(self, piece: Slice, turns: tuple[str, ...]) -> Operand:
        return Operand(self._address(piece, turns), self._shared(piece))

    def _outer_sum(self, step: OuterSum, turns: tuple[str, ...]) -> None:
        left, right = self._operand(step.left, turns), self._operand(step.right, turns)
        weights, plus = (p and self._operand(p, turns) for p in (step.weights, step.plus))
        operands, target = (left, right, weights, plus), self._address(step.target, turns)
        self.algebra.outer_sum(operands, step.count, step.shape, target, step.symmetric)

    def _polynomial(self, step: Polynomial, turns: tuple[str, ...]) -> None:
        point, table = self._operand(step.point, turns), self._operand(step.table, turns)
        sizes, target = (step.point.size, step.target.size, step.columns), self._address(step.target, turns)
        self.algebra.polynomial(point, table, sizes, step.degrees, target)

    def _cholesky(self, step: Cholesky, turns: tuple[str, ...]) -> None:
        source, target = self._operand(step.source, turns), self._address(step.target, turns)
        self.algebra.cholesky(source, target, step.order)

    def _householder(self, step: Householder, turns: tuple[str, ...]) -> None:
        source, target = self._operand(step.source, turns), self._address(step.target, turns)
        reflections = Reflections(self.writer)
        reflections.householder(source, target, step.shape, step.count, step.triangle)

    def _residual(self, step: Residual, turns: tuple[str, ...]) -> None:
        rows, slope = self._operand(step.rows, turns), self._operand(step.slope, turns)
        target = self._address(step.target, turns)
        Reflections(self.writer).residual(rows, slope, target, step.count, step.shape)

    def _copy(self, step: Copy, turns: tuple[str, ...]) -> None:
        writer = self.writer
        source, target = self._address(step.source, turns), self._address(step.target, turns)
        if self._shared(step.source) and self.lanes.width > 1:
            for element in writer.elements(step.source.size):
                writer.store_element(target, element, writer.load_element(source, element, shared=True))
            return
        if self.module.group > 1 and COLUMN not in self.pointers and not _overlaps(step):
            for element in writer.shared_elements(step.source.size):
                writer.store_element(target, element, writer.load_element(source, element, shared=False))
            return
        name = "llvm.memmove.p0.p0.i64"
        self.module.declarations[name] = f"declare void @{name}(ptr, ptr, i64, i1)"
        size = 8 * step.source.size * self.lanes.width
        writer.do(f"call void @{name}(ptr align 8 {target}, ptr align 8 {source}, i64 {size}, i1 false)")

    def _normal(self, step: Normal, turns: tuple[str, ...]) -> None:
        writer, whole = self.writer, self.lanes.integer

        def integer(piece: Slice, element: int) -> str:
            number = writer.load_element(self._address(piece, turns), element, self._shared(piece))
            return writer.let(f"fptosi {self.lanes.real} {number} to {whole}")

        number, key = integer(step.step, 0), [integer(step.key, k) for k in range(step.key.size)]
        target = self._address(step.target, turns)
        channels = (
            range(step.target.size) if self.module.group == 1 else writer.shared_elements(step.target.size)
        )
        for channel in channels:
            writer.store_element(target, channel, emit_normal(writer, number, channel, key))

    def _guard(self, step: Guard, turns: tuple[str, ...]) -> None:
        """Emit a guard: x − x is NaN if x is not finite, else 0; only then leave the straight path.

        There the lanes that fail for the first time are marked, and the run stops when no lane is left.
        """
        writer, lanes, integer = self.writer, self.lanes, self.lanes.integer
        source, shared = self._address(step.source, turns), self._shared(step.source)
        together = writer.allocate(integer)
        writer.write(integer, lanes.whole(0), together)
        for element in writer.shared_elements(step.source.size):
            number = writer.load_element(source, element, shared)
            bits = writer.bits(writer.real("fsub", number, number))
            so_far = writer.read(integer, together)
            writer.write(integer, writer.whole("or", so_far, bits), together)
        total = writer.float(writer.read(integer, together))
        bad = writer.agreed(writer.compare("uno", total, total))
        failed, go_on = writer.label("failed"), writer.label("on")
        writer.place(failed, f"br i1 {writer.any(bad)}, label %{failed}, label %{go_on}, !prof !0")
        codes = writer.read(integer, self.codes)
        steps = writer.read(integer, self.steps)
        alive = writer.compare_whole("eq", codes, lanes.whole(0))
        fresh = writer.joined("and", bad, alive)
        turn = turns[0] if turns else "0"
        if lanes.width > 1:
            turn = writer.splat(turn, "i64")
        codes = writer.select(fresh, lanes.whole(step.code), codes, integer)
        steps = writer.select(fresh, turn, steps, integer)
        writer.write(integer, codes, self.codes)
        writer.write(integer, steps, self.steps)
        left = writer.any(writer.compare_whole("eq", codes, lanes.whole(0)))
        writer.place(go_on, f"br i1 {left}, label %{go_on}, label %finish")


def _overlaps(step: Step) -> bool:
    """Whether it is a copy to where it may not have read yet."""
    if not isinstance(step, Copy) or step.source.buffer != step.target.buffer:
        return False
    moves = {(piece.strides, piece.shift) for piece in (step.source, step.target)}
    return len(moves) > 1 or overlap(step.source, step.target)


def _lines(body: Sequence[Step]) -> Iterator[tuple[list[Call], Step]]:
    """The steps; calls together with those that join them, unless these read a part of what is written before."""
    calls, written = list[Call](), list[Slice]()
    for step, following in zip_longest(body, body[1:]):
        if isinstance(step, Call):
            calls.append(step)
            written += step.outputs
            if isinstance(following, Call) and following.joins:
                last = [[p for p in written if overlap(p, piece)][-1:] for piece in following.inputs]
                if all(before in ([], [piece]) for before, piece in zip(last, following.inputs, strict=True)):
                    continue
        yield calls, step
        calls, written = [], []


def _resized(writer: Writer, value: str, width: int, wanted: int) -> str:
    """The first lanes of a vector of so many, and zeros for more."""
    if width == wanted:
        return value
    if width == 1:
        return writer.let(f"insertelement {Lanes(wanted).real} zeroinitializer, double {value}, i64 0")
    if wanted == 1:
        return writer.let(f"extractelement {Lanes(width).real} {value}, i64 0")
    places = [min(k, width) for k in range(wanted)]
    return writer.alike(Lanes(width)).shuffled(value, "zeroinitializer", places)
