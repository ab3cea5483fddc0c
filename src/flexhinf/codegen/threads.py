"""A program of which each thread of a GPU runs one plant, or each warp: LLVM text around the text of one lane.

A thread is told by a *table* of 64-bit words where the numbers of all plants lie:

==============================  ====================================================================================
words                           content
==============================  ====================================================================================
two                             addresses of the codes and of the steps, (N,) each, of `RunStatus` (written)
one                             address of the memory of all plants for what is too large for that of a warp
one per count                   number of turns
`BUFFER` per buffer             address of what is there at the start, and how many elements; how far it is from one
                                element to the next, and from one plant to the next; address of memory for all plants
                                of a buffer without a size, and how many elements of it each has
`RETURNED` per returned buffer  address, (k, N) (written), of the elements at k places; address of these; k
==============================  ====================================================================================

What all plants read stays where it is. Buffers of a size are the thread's own memory, or that of the warp, see
`flexhinf.codegen.groups`. One without, such as a record of signals, would be too long for that.
"""

from __future__ import annotations

from collections.abc import Sequence

from flexhinf.codegen.emit.module import emit_module
from flexhinf.codegen.emit.writer import Lanes, ModuleText, Writer
from flexhinf.codegen.groups import WORKSPACE, Form
from flexhinf.codegen.memory import Buffer
from flexhinf.codegen.program import ENTRY, PREFIX, Program

#: Function of one plant, and the kernel of a GPU that calls it.
PLANT, KERNEL = PREFIX + "plant", PREFIX + "plants"

#: Words of the table before those of counts; of each buffer; and of each that is returned.
HEAD, BUFFER, RETURNED = 3, 6, 3

#: Memory of a warp.
MEMORY = PREFIX + "memory"


def emit_threads(program: Program, returned: Sequence[str], fused: bool, form: Form) -> ModuleText:
    """Write the kernel of a program, which calls a function of one plant, ``void plant(table, k, N)``.

    `returned`: Names of buffers of which some elements are returned. `fused`, `form`: As for `emit_module`. Raises
    Unsupported: as that.
    """
    module = emit_module(program, 1, fused, gpu=True, form=form)
    writer = Writer(module, Lanes(1))
    if form.group > 1:
        writer.thread = writer.let(f"zext i32 {writer.special('tid')} to i64")
    places = {
        buffer.name: HEAD + len(program.counts) + BUFFER * k for k, buffer in enumerate(program.buffers)
    }
    end = HEAD + len(program.counts) + BUFFER * len(program.buffers)

    def word(k: int) -> str:
        return writer.read("i64", writer.at("i64", "%table", k))

    def address(k: int) -> str:
        """What lies in the memory of the GPU, known as such."""
        pointer = writer.read("ptr addrspace(1)", writer.at("i64", "%table", k))
        return writer.let(f"addrspacecast ptr addrspace(1) {pointer} to ptr")

    def memory() -> str:
        if form.apart:
            return writer.at("double", address(2), writer.whole("mul", "%plant", form.size))
        module.declarations[MEMORY] = f"@{MEMORY} = external addrspace(3) global [0 x double], align 16"
        return writer.let(f"addrspacecast ptr addrspace(3) @{MEMORY} to ptr")

    together = memory() if form.group > 1 else ""

    def begun(buffer: Buffer, place: int) -> str:
        if buffer.shared:
            return address(place)
        if buffer.size is None:
            before = writer.whole("mul", word(place + 5), "%plant")
            own = writer.at("double", address(place + 4), before)
        elif together:
            own = writer.at("double", together, form.places[buffer.name])
        else:
            own = writer.allocate(f"[{buffer.size} x double]")
        if buffer.role in ("in", "state"):
            source = writer.at("double", address(place), writer.whole("mul", word(place + 3), "%plant"))
            along = word(place + 2)
            with writer.part(word(place + 1)) as k:
                number = writer.read("double", writer.at("double", source, writer.whole("mul", k, along)))
                writer.write("double", number, writer.at("double", own, k))
        return own

    context = writer.allocate(f"[{len(program.buffers) + len(program.counts) + 3} x i64]")
    own = {buffer.name: begun(buffer, places[buffer.name]) for buffer in program.buffers}
    slots = [("ptr", pointer) for pointer in own.values()]
    slots += [("i64", word(HEAD + k)) for k in range(len(program.counts))]
    for k, (kind, value) in enumerate(slots):
        writer.write(kind, value, writer.at("i64", context, k))
    if together:
        passed = writer.at("double", together, form.places[WORKSPACE])
        writer.write("ptr", passed, writer.at("i64", context, len(slots) + 2))
    writer.let(f"call i64 @{ENTRY}(ptr {context})")
    with writer.alone():
        for k in range(2):  # code and step
            value = writer.read("i64", writer.at("i64", context, len(slots) + k))
            writer.write("i64", value, writer.at("i64", address(k), "%plant"))
    for k, name in enumerate(returned):
        first = end + RETURNED * k
        target, chosen = address(first), address(first + 1)
        with writer.part(word(first + 2)) as row:
            element = writer.read("i64", writer.at("i64", chosen, row))
            number = writer.read("double", writer.at("double", own[name], element))
            place = writer.whole("add", writer.whole("mul", row, "%plants"), "%plant")
            writer.write("double", number, writer.at("double", target, place))
    writer.do("ret void")
    head = f"define internal void @{PLANT}(ptr %table, i64 %plant, i64 %plants) {module.frame} {{\nentry:"
    module.define(PLANT, head, [*writer.first, *writer.lines])
    _emit_kernel(module)
    return module


def _emit_kernel(module: ModuleText) -> None:
    """Write the kernel: the plant of each thread, if there are so many."""
    writer = Writer(module, Lanes(1))
    block, threads, thread = map(writer.special, ("ctaid", "ntid", "tid"))
    number = writer.let(f"add i32 {writer.let(f'mul i32 {block}, {threads}')}, {thread}")
    plant = writer.let(f"zext i32 {writer.let(f'udiv i32 {number}, {module.group}')} to i64")
    with writer.when(writer.let(f"icmp ult i64 {plant}, %plants")):
        writer.do(f"call void @{PLANT}(ptr %table, i64 {plant}, i64 %plants)")
    writer.do("ret void")
    head = f"define ptx_kernel void @{KERNEL}(ptr %table, i64 %plants) {module.frame} {{\nentry:"
    module.define(KERNEL, head, [*writer.first, *writer.lines])
