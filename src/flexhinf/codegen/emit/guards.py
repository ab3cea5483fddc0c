"""Guards: a run, or a lane of it, ends where a number is not finite."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import reduce

from flexhinf.codegen.emit.algebra import Algebra
from flexhinf.codegen.emit.function import load
from flexhinf.codegen.emit.text import Writer
from flexhinf.codegen.steps import Guard

_SUMS = 4  # of a guard, as many as the latency of an addition asks for


@dataclass(frozen=True)
class Guards:
    """Emits guards.

    Parameters
    ----------
    each : callable
        (turns, body): a loop, or its turns written out if they are few.
    codes, steps : str
        Where the code of each lane, and the step at which it failed, are kept; a label ``finish`` ends the run.
    """

    writer: Writer
    each: Callable[[int, Callable[[str], None]], None]
    algebra: Algebra
    codes: str
    steps: str

    def guard(self, source: str, shared: bool, step: Guard, turn: str) -> None:
        """Σ 0·x, which is NaN if some x is not finite: leave the straight path only then."""
        writer, lanes = self.writer, self.writer.lanes
        zero = lanes.constant(0.0)
        sums = [writer.allocate(lanes.real) for _ in range(min(_SUMS, step.source.size))]
        for place in sums:
            writer.do(f"store {lanes.real} {zero}, ptr {place}, align 8")

        def test(element: str) -> None:
            place = sums[int(element) % len(sums) if element.isdecimal() else 0]
            so_far = writer.let(f"load {lanes.real}, ptr {place}, align 8")
            value = load(writer, source, element, shared)
            total = self.algebra.multiply_add(writer, value, zero, so_far)
            writer.do(f"store {lanes.real} {total}, ptr {place}, align 8")

        self.each(step.source.size, test)
        parts = [writer.let(f"load {lanes.real}, ptr {place}, align 8") for place in sums]
        total = reduce(lambda a, b: writer.real("fadd", a, b), parts)
        bad = writer.compare("uno", total, zero)
        failed, go_on = writer.label("failed"), writer.label("on")
        writer.do(f"br i1 {writer.any(bad)}, label %{failed}, label %{go_on}, !prof !0")
        writer.place(failed)
        self._record(bad, step.code, turn, go_on)
        writer.place(go_on)

    def largest_code(self) -> str:
        """Of all lanes, at the end."""
        lanes = self.writer.lanes
        codes = self.writer.let(f"load {lanes.integer}, ptr {self.codes}, align 8")
        if lanes.width == 1:
            return codes
        name = f"llvm.vector.reduce.umax.{lanes.suffix('i64')}"
        self.writer.module.declarations[name] = f"declare i64 @{name}({lanes.integer})"
        return self.writer.let(f"call i64 @{name}({lanes.integer} {codes})")

    def _record(self, bad: str, code: int, turn: str, go_on: str) -> None:
        """Mark the lanes that fail for the first time; stop when no lane is left."""
        writer, lanes = self.writer, self.writer.lanes
        integer, boolean = lanes.integer, lanes.boolean
        codes = writer.let(f"load {integer}, ptr {self.codes}, align 8")
        steps = writer.let(f"load {integer}, ptr {self.steps}, align 8")
        alive = writer.let(f"icmp eq {integer} {codes}, {lanes.whole(0)}")
        fresh = writer.let(f"and {boolean} {bad}, {alive}")
        if lanes.width > 1:
            turn = writer.splat(turn, "i64")
        codes = writer.let(f"select {boolean} {fresh}, {integer} {lanes.whole(code)}, {integer} {codes}")
        steps = writer.let(f"select {boolean} {fresh}, {integer} {turn}, {integer} {steps}")
        writer.do(f"store {integer} {codes}, ptr {self.codes}, align 8")
        writer.do(f"store {integer} {steps}, ptr {self.steps}, align 8")
        left = writer.any(writer.let(f"icmp eq {integer} {codes}, {lanes.whole(0)}"))
        writer.do(f"br i1 {left}, label %{go_on}, label %finish")
