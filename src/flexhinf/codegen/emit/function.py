"""One traced function as one LLVM function: load, compute, store.

Functions mapped over the columns of matrices: columns are packed into lanes, and unpacked.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce

import casadi

from flexhinf.codegen.emit.dataflow import Dataflow, read_dataflow
from flexhinf.codegen.emit.opcodes import NEAR, OPCODES, Lanes, ModuleText, Writer, is_far

BLOCK = 8
"""Columns of a `Map` that travel together in the lanes of a kernel for a single run."""


@dataclass(frozen=True)
class Packer:
    """Copies neighbouring columns of a matrix into elements of as many lanes, and back.

    `wide`: Of the packed elements; in a kernel of several lanes these are the kernel's, and a column goes alone.
    `left`: Columns; lanes without one are zero.
    """

    writer: Writer
    wide: Lanes
    left: int

    def pack(self, source: str, shared: bool, rows: int, moves: tuple[int, int], target: str) -> None:
        """From the first of these columns at `source` to `rows` elements at `target`; see `Columns.moves`.

        `shared`: One number serves all lanes of the kernel.
        """
        writer, wide = self.writer, self.wide
        unit = "double" if shared else writer.lanes.element
        for element in writer.each(rows):
            place = self._place(source, element, moves[0], unit)
            if writer.lanes.width > 1:
                value = load(writer, place, 0, shared)
            elif self._neighbours(moves):
                value = writer.let(f"load {wide.real}, ptr {place}, align 8")
            else:
                value = "zeroinitializer"
                for lane in range(self.left):
                    number = writer.let(f"getelementptr double, ptr {place}, i64 {lane * moves[1]}")
                    number = writer.let(f"load double, ptr {number}, align 8")
                    value = writer.let(f"insertelement {wide.real} {value}, double {number}, i64 {lane}")
            kept = writer.let(f"getelementptr {wide.element}, ptr {target}, i64 {element}")
            writer.do(f"store {wide.real} {value}, ptr {kept}, align 8")

    def unpack(self, source: str, rows: int, moves: tuple[int, int], target: str) -> None:
        """The inverse: from `rows` elements at `source` to the first of these columns at `target`."""
        writer, wide = self.writer, self.wide
        for element in writer.each(rows):
            kept = writer.let(f"getelementptr {wide.element}, ptr {source}, i64 {element}")
            value = writer.let(f"load {wide.real}, ptr {kept}, align 8")
            place = self._place(target, element, moves[0], writer.lanes.element)
            if writer.lanes.width > 1 or self._neighbours(moves):
                writer.do(f"store {wide.real} {value}, ptr {place}, align 8")
                continue
            for lane in range(self.left):
                number = writer.let(f"extractelement {wide.real} {value}, i64 {lane}")
                position = writer.let(f"getelementptr double, ptr {place}, i64 {lane * moves[1]}")
                writer.do(f"store double {number}, ptr {position}, align 8")

    def _neighbours(self, moves: tuple[int, int]) -> bool:
        return self.left == self.wide.width and (moves[1] == 1 or self.left == 1)

    def _place(self, matrix: str, element: str, move: int, unit: str) -> str:
        offset = self.writer.let(f"mul nsw i64 {element}, {move}")
        return self.writer.let(f"getelementptr {unit}, ptr {matrix}, i64 {offset}")


def emit_function(
    module: ModuleText,
    name: str,
    function: casadi.Function,
    lanes: Lanes,
    shared: tuple[bool, ...],
    fused: bool,
) -> int:
    """Add ``void name(in₀, …, out₀, …)`` over pointers to the module.

    `lanes`: Numbers that travel together in one element. `shared`: Which arguments hold one number for all lanes.
    `fused`: The target has a fused multiply-add. Returns number of operations. Raises Unsupported: an operation that
    is not in the table.

    Every store comes after every load, so a result may overwrite an argument; the pointers carry no
    ``noalias``.

    With several lanes a function that has sines is written twice. The first is a straight line without the C library's
    sines, whose calls would cut it in pieces and spill its registers (a fifth of the instructions of the paper's arm).
    If an angle turns out to be too far for it, all is done again by the second. The bits are the same.
    """
    flow = read_dataflow(function, OPCODES, fused)
    far = ""
    if lanes.width > 1 and any(operation.code in NEAR for operation in flow.operations.values()):
        far = f"{name}_far"
        _define(module, far, function, flow, lanes, shared, "noinline optnone cold ")
    _define(module, name, function, flow, lanes, shared, far=far)
    return flow.size


def _define(
    module: ModuleText,
    name: str,
    function: casadi.Function,
    flow: Dataflow,
    lanes: Lanes,
    shared: tuple[bool, ...],
    attributes: str = "",
    far: str = "",
) -> None:
    """Write the function; with `far`, as a straight line that calls the function `far` where an angle is large."""
    writer, values, angles = Writer(module, lanes), dict[int, str](), list[str]()
    for k, operation in flow.operations.items():
        if operation.code == casadi.OP_CONST:
            values[k] = lanes.constant(operation.constant)
        elif operation.code == casadi.OP_INPUT:
            argument, element = operation.arguments
            values[k] = load(writer, f"%in{argument}", element, shared[argument])
        else:
            operands = [values[argument] for argument in operation.arguments]
            near = bool(far) and operation.code in NEAR
            values[k] = (NEAR if near else OPCODES)[operation.code](writer, *operands)
            angles += operands if near else []
    pointers = [f"ptr %in{k}" for k in range(function.n_in())]
    pointers += [f"ptr %out{k}" for k in range(function.n_out())]
    if far:  # before anything is stored: a result may overwrite an argument
        beyond = [is_far(writer, angle) for angle in dict.fromkeys(angles)]
        some = reduce(lambda a, b: writer.let(f"or {lanes.boolean} {a}, {b}"), beyond)
        writer.place("far", f"br i1 {writer.any(some)}, label %far, label %near, !prof !0")
        writer.do(f"call void @{far}({', '.join(pointers)})")
        writer.place("near", "ret void")
    for result, element, value in flow.outputs:
        store(writer, f"%out{result}", element, values[value])
    head = f"define internal void @{name}({', '.join(pointers)}) {attributes}nounwind {{"
    module.definitions[name] = "\n".join([head, *writer.lines, "  ret void", "}"])


def load(writer: Writer, pointer: str, element: int | str, shared: bool) -> str:
    """Load one element; a shared one is copied to every lane."""
    lanes = writer.lanes
    kind, size = ("double", "double") if shared else (lanes.real, lanes.element)
    place = writer.let(f"getelementptr {size}, ptr {pointer}, i64 {element}")
    value = writer.let(f"load {kind}, ptr {place}, align 8")
    return writer.splat(value) if shared else value


def store(writer: Writer, pointer: str, element: int | str, value: str) -> None:
    """Store one element."""
    lanes = writer.lanes
    place = writer.let(f"getelementptr {lanes.element}, ptr {pointer}, i64 {element}")
    writer.do(f"store {lanes.real} {value}, ptr {place}, align 8")
