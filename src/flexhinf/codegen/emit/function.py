"""One traced function as one LLVM function: load, compute, store."""

from __future__ import annotations

import casadi

from flexhinf.codegen.emit.dataflow import read_dataflow
from flexhinf.codegen.emit.opcodes import OPCODES
from flexhinf.codegen.emit.text import Lanes, ModuleText, Writer


def emit_function(
    module: ModuleText,
    name: str,
    function: casadi.Function,
    lanes: Lanes,
    shared: tuple[bool, ...],
    fused: bool,
) -> int:
    """Add ``void name(in₀, …, out₀, …)`` over pointers to the module.

    Parameters
    ----------
    module : ModuleText
    name : str
    function : casadi.Function
    lanes : Lanes
        Numbers that travel together in one element.
    shared : tuple of bool
        Which arguments hold one number for all lanes.
    fused : bool
        The target has a fused multiply-add.

    Returns
    -------
    int
        Number of operations.

    Raises
    ------
    Unsupported
        An operation that is not in the table.

    Notes
    -----
    Every store comes after every load, so a result may overwrite an argument; the pointers carry no
    ``noalias``.
    """
    flow = read_dataflow(function, OPCODES, fused)
    writer = Writer(module, lanes)
    values: list[str] = []
    for operation in flow.operations:
        if operation is None:
            values.append("")
        elif operation.code == casadi.OP_CONST:
            values.append(lanes.constant(operation.constant))
        elif operation.code == casadi.OP_INPUT:
            argument, element = operation.arguments
            values.append(load(writer, f"%in{argument}", element, shared[argument]))
        else:
            operands = [values[argument] for argument in operation.arguments]
            values.append(OPCODES[operation.code](writer, *operands))
    for result, element, value in flow.outputs:
        store(writer, f"%out{result}", element, values[value])
    pointers = [f"ptr %in{k}" for k in range(function.n_in())]
    pointers += [f"ptr %out{k}" for k in range(function.n_out())]
    head = f"define internal void @{name}({', '.join(pointers)}) nounwind {{"
    module.definitions[name] = "\n".join([head, *writer.lines, "  ret void", "}"])
    return len(flow.operations)


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
