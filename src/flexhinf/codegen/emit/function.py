"""One traced function as one LLVM function: load, compute, store."""

from __future__ import annotations

import casadi

from flexhinf.codegen.emit.dataflow import read_dataflow
from flexhinf.codegen.emit.opcodes import OPCODES
from flexhinf.codegen.emit.text import ModuleText, Writer


def emit_function(
    module: ModuleText, name: str, function: casadi.Function, shared: tuple[bool, ...], fused: bool
) -> int:
    """Add ``void name(in₀, …, out₀, …)`` over pointers to the module.

    Parameters
    ----------
    module : ModuleText
    name : str
    function : casadi.Function
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
    writer = Writer(module)
    lanes = writer.lanes
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
        place = writer.let(f"getelementptr {lanes.real}, ptr %out{result}, i64 {element}")
        writer.do(f"store {lanes.real} {values[value]}, ptr {place}, align 8")
    pointers = [f"ptr %in{k}" for k in range(function.n_in())]
    pointers += [f"ptr %out{k}" for k in range(function.n_out())]
    head = f"define internal void @{name}({', '.join(pointers)}) nounwind {{"
    module.definitions[name] = "\n".join([head, *writer.lines, "  ret void", "}"])
    return len(flow.operations)


def load(writer: Writer, pointer: str, element: int | str, shared: bool) -> str:
    """Load one element; a shared one is copied to every lane."""
    lanes = writer.lanes
    kind = "double" if shared else lanes.real
    place = writer.let(f"getelementptr {kind}, ptr {pointer}, i64 {element}")
    value = writer.let(f"load {kind}, ptr {place}, align 8")
    if not shared or lanes.width == 1:
        return value
    first = writer.let(f"insertelement {lanes.real} poison, double {value}, i64 0")
    mask = f"<{lanes.width} x i32> zeroinitializer"
    return writer.let(f"shufflevector {lanes.real} {first}, {lanes.real} poison, {mask}")
