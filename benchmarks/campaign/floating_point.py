"""How much floating-point work a step of a program is, and how much this processor could do."""

from __future__ import annotations

import ctypes
import re
import time
from collections import Counter
from collections.abc import Sequence

from flexhinf.codegen import (
    Call,
    Cholesky,
    Guard,
    Map,
    Normal,
    OuterSum,
    Polynomial,
    Program,
    Repeat,
    Sweep,
    When,
)
from flexhinf.codegen.emit.module import emit_function, emit_normal
from flexhinf.codegen.emit.writer import Lanes, ModuleText, Writer
from flexhinf.codegen.machine import Code, assemble, host
from flexhinf.codegen.program import Step
from flexhinf.polynomial import basis

__all__ = ["Work", "peak", "work_of"]

LANES = 8
#: Sums that go on side by side: more than the latency of a fused multiply-add times those that begin in a cycle.
SUMS, TURNS = 24, 2_000_000

#: What is counted in LLVM text: fused multiply-adds are two operations in one instruction.
ARITHMETIC = re.compile(r"= (?:(fadd|fsub|fmul|fdiv) |call \S+(?: x \S+)? @llvm\.(fma|sqrt)\.)")
CALLED = re.compile(r"call \S+(?: x \S+)? @(flexhinf_\w+)\(")


class Work(Counter):
    """Instructions by kind: fadd, fsub, fmul, fdiv, sqrt, fma."""

    @property
    def instructions(self) -> int:
        """All of them."""
        return sum(self.values())

    @property
    def operations(self) -> int:
        """A fused multiply-add counts twice."""
        return self.instructions + self["fma"]

    def times(self, count: float) -> Work:
        """So often."""
        return Work({kind: count * number for kind, number in self.items()})


def work_of(program: Program, counts: dict[str, int]) -> Work:
    """Of one turn of the outermost loop, for each lane; the other loops turn as `counts` say."""
    total: Work = Work()
    for step in program.body:
        assert isinstance(step, Repeat)
        total.update(_body_work(step.body, counts))
    return Work(total)


def _body_work(body: Sequence[Step], counts: dict[str, int]) -> Work:
    total: Work = Work()
    for step in body:
        if isinstance(step, Repeat):
            turns = counts[step.count] if isinstance(step.count, str) else step.count
            total.update(_body_work(step.body, counts).times(turns))
        elif isinstance(step, When):
            total.update(_body_work(step.body, counts))
        elif isinstance(step, Sweep):
            total.update(_body_work(step.body, counts).times(step.count))
        else:
            total.update(_step_work(step))
    return total


def _step_work(step: Step) -> Work:
    if isinstance(step, Call | Map):
        return _function_work(step.function).times(step.count if isinstance(step, Map) else 1)
    if isinstance(step, OuterSum):
        rows, columns = step.shape
        cells = rows * (rows + 1) // 2 if step.symmetric else rows * columns
        return Work(fma=step.count * cells, fmul=step.count * rows if step.weights else 0)
    if isinstance(step, Polynomial):
        sums = sum(basis.count(step.point.size, k + 1) for k in range(step.degrees[-1]))
        return Work(fma=step.target.size * sums)
    if isinstance(step, Cholesky):
        n = step.order
        return Work(fma=n * (n - 1) * (n + 1) // 6, fmul=n * (n - 1) // 2, fdiv=n, sqrt=n)
    if isinstance(step, Normal):
        module = ModuleText(Lanes(LANES))
        emit_normal(Writer(module), "%step", 0, ["%sample", "%low", "%high"])
        return _text_work(module, next(iter(module.definitions))).times(step.target.size)
    return Work(fsub=step.source.size if isinstance(step, Guard) else 0)


def _function_work(function) -> Work:
    module = ModuleText(Lanes(LANES), host().fused, host().choosing)
    emit_function(module, "counted", [function], Lanes(LANES), (False,) * function.n_in())
    return _text_work(module, "counted")


def _text_work(module: ModuleText, name: str) -> Work:
    found: Work = Work()
    text = module.definitions[name].split("\nfar:")[0] + module.definitions[name].partition("\nnear:")[2]
    for line in text.splitlines():
        if match := ARITHMETIC.search(line):
            found[match[1] or match[2]] += 1
        elif (match := CALLED.search(line)) and match[1] in module.definitions:
            found.update(_text_work(module, match[1]))
    return found


def peak() -> float:
    """Fused multiply-adds a second of one thread, each of `LANES` numbers in a register (or several): measured."""
    vector = f"<{LANES} x double>"
    sums = range(SUMS)
    lines = [
        f"declare {vector} @llvm.fma.v{LANES}f64({vector}, {vector}, {vector})",
        f"define void @flexhinf_peak(ptr %place) {{\nentry:\n  %x = load {vector}, ptr %place, align 8",
        *(f"  %p{i} = getelementptr {vector}, ptr %place, i64 {i}" for i in sums),
        *(f"  %x{i} = load {vector}, ptr %p{i}, align 8" for i in sums),
        "  br label %turn\nturn:\n  %k = phi i64 [ 0, %entry ], [ %next, %turn ]",
        *(f"  %s{i} = phi {vector} [ %x{i}, %entry ], [ %t{i}, %turn ]" for i in sums),
        *(
            f"  %t{i} = call {vector} @llvm.fma.v{LANES}f64({vector} %s{i}, {vector} %x, {vector} %x)"
            for i in sums
        ),
        f"  %next = add i64 %k, 1\n  %more = icmp slt i64 %next, {TURNS}",
        "  br i1 %more, label %turn, label %done\ndone:",
    ]
    total = "%t0"
    for i in sums[1:]:
        lines.append(f"  %u{i} = fadd {vector} {total}, %t{i}")
        total = f"%u{i}"
    lines += [f"  store {vector} {total}, ptr %place, align 8", "  ret void\n}"]
    code = Code(assemble("\n".join(lines), 3), "flexhinf_peak", {})
    run, place = (
        ctypes.CFUNCTYPE(None, ctypes.c_void_p)(code.address),
        (ctypes.c_double * (LANES * SUMS))(*(0.5 / (k + 2) for k in range(LANES * SUMS))),
    )
    best = float("inf")
    for _ in range(7):
        start = time.thread_time()
        run(ctypes.addressof(place))
        best = min(best, time.thread_time() - start)
    return SUMS * TURNS / best
