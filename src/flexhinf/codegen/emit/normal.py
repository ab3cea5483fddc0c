"""Normal numbers of a counter, `flexhinf.codegen.noise`, as lines of LLVM in lanes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from flexhinf.codegen.emit.opcodes import PURE, Writer
from flexhinf.codegen.noise import normal
from flexhinf.codegen.program import PREFIX


class Lines:
    """Operations as `flexhinf.codegen.noise.Arrays` has them: names of values, and constants, become a line."""

    def __init__(self, writer: Writer) -> None:
        self.writer, self.lanes = writer, writer.lanes
        self.bits, self.float = writer.bits, writer.float

    def whole(self, name: str, left: str, right: str | int) -> str:
        """An operation on 64-bit integers."""
        return self.writer.whole(name, left, self.lanes.whole(right) if isinstance(right, int) else right)

    def real(self, name: str, *operands: str | float) -> str:
        """An operation on floats."""
        names = [x if isinstance(x, str) else self.lanes.constant(x) for x in operands]
        return self.writer.real(name, *names)

    def number(self, integer: str) -> str:
        """An integer of at most 53 bits as a number, exactly."""
        return self.writer.let(f"sitofp {self.lanes.integer} {integer} to {self.lanes.real}")

    def root(self, number: str) -> str:
        """The square root."""
        return self.writer.intrinsic("sqrt", number)


def emit_normal(caller: Writer, step: str, channel: int, key: Sequence[str]) -> str:
    """Emit a number N(0, 1); returns the name of the result.

    `step`: Name of a 64-bit integer below 2³². `key`: Names of the sample, and of the low and the high word of the
    seed, likewise.
    """
    lanes, full = caller.lanes, f"{PREFIX}normal{caller.lanes.width}"
    whole, real = lanes.integer, lanes.real
    if full not in caller.module.definitions:
        writer = Writer(caller.module, lanes)
        counter: list[Any] = ["%step", "%channel", "%sample", lanes.whole(0)]
        writer.do(f"ret {real} {normal(Lines(writer), counter, ['%low', '%high'])}")
        arguments = ", ".join(f"{whole} %{name}" for name in ("step", "channel", "sample", "low", "high"))
        head = f"define internal {real} @{full}({arguments}) noinline {PURE} {{"
        caller.module.definitions[full] = "\n".join([head, *writer.lines, "}"])
    numbers = ", ".join(f"{whole} {word}" for word in (step, lanes.whole(channel), *key))
    return caller.let(f"call {real} @{full}({numbers})")
