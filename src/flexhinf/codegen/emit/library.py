"""Functions of the C mathematical library, called lane by lane."""

from __future__ import annotations

from flexhinf.codegen.emit.text import PURE, Writer
from flexhinf.codegen.program import PREFIX


def library_call(writer: Writer, name: str, *operands: str) -> str:
    """Emit a call of the C function `name` in every lane; returns the name of the result.

    The function is linked under our own prefix, so that LLVM takes it for an unknown function and does not
    replace it by something that depends on the number of lanes.
    """
    module = writer.module
    foreign = PREFIX + name
    scalars = ", ".join(["double"] * len(operands))
    module.library[foreign] = name
    module.declarations[foreign] = f"declare double @{foreign}({scalars}) {PURE}"
    if writer.lanes.width == 1:
        return writer.call(foreign, *operands)
    lanewise = f"{foreign}_lanes{writer.lanes.width}"
    if lanewise not in module.definitions:
        module.definitions[lanewise] = _lanewise(writer, foreign, lanewise, len(operands))
    return writer.call(lanewise, *operands)


def _lanewise(caller: Writer, foreign: str, lanewise: str, arity: int) -> str:
    writer = Writer(caller.module, caller.lanes)
    real = writer.lanes.real
    operands = [f"%x{k}" for k in range(arity)]
    result = "poison"
    for lane in range(writer.lanes.width):
        scalars = [writer.let(f"extractelement {real} {operand}, i64 {lane}") for operand in operands]
        value = writer.let(f"call double @{foreign}({', '.join(f'double {scalar}' for scalar in scalars)})")
        result = writer.let(f"insertelement {real} {result}, double {value}, i64 {lane}")
    writer.do(f"ret {real} {result}")
    arguments = ", ".join(f"{real} {operand}" for operand in operands)
    head = f"define internal {real} @{lanewise}({arguments}) noinline {PURE} {{"
    return "\n".join([head, *writer.lines, "}"])
