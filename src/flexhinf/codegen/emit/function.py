"""Traced functions in LLVM: load, compute, store; and the numbers of the noise."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from functools import partial, reduce

import casadi

from flexhinf.codegen.dataflow import Dataflow, joined, read_dataflow
from flexhinf.codegen.emit.sines import REACH, is_far
from flexhinf.codegen.emit.writer import PURE, Lanes, ModuleText, Writer
from flexhinf.codegen.noise import normal
from flexhinf.codegen.operations import OPERATIONS, TURNS
from flexhinf.codegen.program import PREFIX

#: Columns of a `Map`, and angles, that travel together in the lanes of a kernel for a single run.
BLOCK = 8


def emit_function(
    module: ModuleText,
    name: str,
    functions: Sequence[casadi.Function],
    lanes: Lanes,
    shared: tuple[bool, ...],
    links: Mapping[int, int] | None = None,
) -> int:
    """Add ``void name(in₀, …, out₀, …)`` over pointers to the module: a function, or several as a straight line.

    `lanes`: Numbers that travel together in one element. `shared`: Which arguments hold one number for all lanes.
    `links`: As for `flexhinf.codegen.dataflow.joined`. Returns number of operations. Raises Unsupported: an operation
    that is not in the table.

    Every store comes after every load, so a result may overwrite an argument; the pointers carry no
    ``noalias``.

    A function that has sines is written twice. The first is a straight line without the reduction of far angles, whose
    calls would cut it in pieces and spill its registers (a fifth of the instructions of the paper's arm). If an angle
    turns out to be too far for it, all is done again by the second. The bits are the same.
    """
    flows = [read_dataflow(function, OPERATIONS, module.fused) for function in functions]
    flow, far = joined(flows, functions, links or {}), ""
    pointers = ", ".join(
        [
            *(f"ptr %in{k}" for k in range(sum(function.n_in() for function in functions))),
            *(f"ptr %out{k}" for k in range(sum(function.n_out() for function in functions))),
        ]
    )
    if any(operation.code in TURNS for operation in flow.operations.values()):
        far = f"{name}_far"
        rarely = "noinline cold " if module.gpu else "noinline optnone cold "
        _define(module, far, pointers, flow, lanes, shared, rarely)
    _define(module, name, pointers, flow, lanes, shared, far=far)
    return flow.size


def _rule(code: int, near: bool, alone: bool) -> Callable[..., str]:
    """How an operation is written; `near`: its argument is not far; `alone`: sine and cosine are not both wanted."""
    kind = OPERATIONS[code]
    return (near and (kind.alone if alone else kind.near)) or kind.llvm


def _define(
    module: ModuleText,
    name: str,
    pointers: str,
    flow: Dataflow,
    lanes: Lanes,
    shared: tuple[bool, ...],
    attributes: str = "",
    far: str = "",
) -> None:
    """Write the function; with `far`, as a straight line that calls the function `far` where an angle is large."""
    writer, values, beyond = Writer(module, lanes), dict[int, str](), list[str]()
    wanted = Counter(op.arguments[0] for op in flow.operations.values() if op.code in TURNS)
    largest, together = lanes.constant(0.0), writer.packs
    for straight, turns in _rounds(flow) if far and together else [(list(flow.operations), [])]:
        for k in straight:
            operation = flow.operations[k]
            if operation.code == casadi.OP_CONST:
                values[k] = lanes.constant(operation.constant)
            elif operation.code == casadi.OP_INPUT:
                argument, element = operation.arguments
                values[k] = writer.load_element(f"%in{argument}", element, shared[argument])
            else:
                operands = [values[argument] for argument in operation.arguments]
                lone = module.choosing and operation.code in TURNS and wanted[operation.arguments[0]] == 1
                values[k] = _rule(operation.code, bool(far), lone)(writer, *operands)
                if far and operation.code in TURNS:  # at once, so that no angle is kept for it
                    largest = writer.larger(writer.intrinsic("fabs", operands[0]), largest)
        beyond += _emit_turns(writer, flow, turns, values)
    if far and not together:
        beyond = [writer.compare("ogt", largest, lanes.constant(REACH[module.fused]))]
    if far:  # before anything is stored: a result may overwrite an argument
        some = reduce(partial(writer.joined, "or"), beyond)
        writer.place("far", f"br i1 {writer.any(some)}, label %far, label %near, !prof !0")
        writer.do(f"call void @{far}({pointers})")
        writer.place("near", "ret void")
    for result, element, value in flow.outputs:
        writer.store_element(f"%out{result}", element, values[value])
    writer.do("ret void")
    module.define(
        name, f"define internal void @{name}({pointers}) {attributes}{module.frame} {{", writer.lines
    )


def _rounds(flow: Dataflow) -> list[tuple[list[int], list[int]]]:
    """Values by the number of sines and cosines that they wait for, one after the other: first what is neither, then
    the sines and cosines, which need not wait for each other."""
    depths, rounds = dict[int, int](), list[tuple[list[int], list[int]]]()
    for k, operation in flow.operations.items():
        before = (depths[a] + (flow.operations[a].code in TURNS) for a in operation.operands)
        depths[k] = max(before, default=0)
        if depths[k] == len(rounds):
            rounds.append(([], []))
        rounds[depths[k]][operation.code in TURNS].append(k)
    return rounds


def _emit_turns(writer: Writer, flow: Dataflow, turns: Sequence[int], values: dict[int, str]) -> list[str]:
    """Emit sines and cosines that do not wait for each other, `BLOCK` angles in the lanes of one vector: in one run the
    sigma points of a stage, say. Adds them to the values; returns whether angles are too far for them, of each vector.
    """
    beyond, angles = list[str](), list(dict.fromkeys(flow.operations[k].arguments[0] for k in turns))
    both = not writer.module.choosing or len({flow.operations[k].code for k in turns}) > 1
    for first in range(0, len(angles), BLOCK):
        some = angles[first : first + BLOCK]
        wide = writer.alike(Lanes(1 << (len(some) - 1).bit_length()))
        width, real, packed = wide.lanes.width, wide.lanes.real, values[some[0]]
        if width > 1:
            packed = "poison"
            for lane in range(width):  # what is left over repeats the last angle
                angle = values[some[min(lane, len(some) - 1)]]
                packed = writer.let(f"insertelement {real} {packed}, double {angle}, i64 {lane}")
        beyond.append(wide.any(is_far(wide, packed)))
        found = dict[int, str]()
        for k in turns:
            code, (angle,) = flow.operations[k].code, flow.operations[k].arguments
            if angle not in some:
                continue
            if code not in found:
                found[code] = _rule(code, True, not both)(wide, packed)
            values[k] = found[code]
            if width > 1:
                values[k] = writer.let(f"extractelement {real} {found[code]}, i64 {some.index(angle)}")
    return beyond


def emit_normal(caller: Writer, step: str, channel: int | str, key: Sequence[str]) -> str:
    """Emit a number N(0, 1) of `flexhinf.codegen.noise`; returns the name of the result.

    `step`: Name of a 64-bit integer below 2³². `channel`: Likewise, or a number. `key`: Names of
    the sample, and of the low and the high word of the seed, likewise.
    """
    lanes, full = caller.lanes, f"{PREFIX}normal{caller.lanes.width}"
    channel = lanes.whole(channel) if isinstance(channel, int) else channel
    whole, real = lanes.integer, lanes.real
    if full not in caller.module.definitions:
        writer = Writer(caller.module, lanes)
        counter = ["%step", "%channel", "%sample", lanes.whole(0)]
        writer.do(f"ret {real} {normal(writer, counter, ['%low', '%high'])}")
        arguments = ", ".join(f"{whole} %{name}" for name in ("step", "channel", "sample", "low", "high"))
        caller.module.define(
            full, f"define internal {real} @{full}({arguments}) noinline {PURE} {{", writer.lines
        )
    numbers = ", ".join(f"{whole} {word}" for word in (step, channel, *key))
    return caller.let(f"call {real} @{full}({numbers})")
