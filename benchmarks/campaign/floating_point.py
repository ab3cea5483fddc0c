"""How much floating-point work a step of a program is, and how much this processor could do."""

from __future__ import annotations

import re
import time
from collections import Counter
from collections.abc import Sequence
from functools import reduce
from operator import add

import numpy as np

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
from flexhinf.codegen.emit.function import emit_function, emit_normal
from flexhinf.codegen.emit.writer import Lanes, ModuleText, Writer
from flexhinf.codegen.loops import LANES, VECTOR, LoopText, NativeFunction
from flexhinf.codegen.machine import host
from flexhinf.codegen.program import Step
from flexhinf.polynomial import basis

__all__ = ["Work", "peak", "work_of"]

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
    text = LoopText("peak", "Place")
    (place,) = text.fields()
    x, sums = place.load(VECTOR), [text.variable(place.load(VECTOR, i * LANES)) for i in range(SUMS)]
    with text.loop(0, TURNS):
        for part in sums:
            part.set(text.fused(part.get(), x, x))
    place.store(reduce(add, (part.get() for part in sums)))
    run, numbers = NativeFunction(text), 0.5 / (np.arange(LANES * SUMS) + 2.0)
    best = float("inf")
    for _ in range(7):
        start = time.thread_time()
        run(numbers)
        best = min(best, time.thread_time() - start)
    return SUMS * TURNS / best
