"""A program of which each thread of a GPU runs one plant: LLVM text around the text of one lane.

A thread is told by a *table* of 64-bit words where the numbers of all plants lie:

==============================  ====================================================================================
words                           content
==============================  ====================================================================================
two                             addresses of the codes and of the steps, (N,) each, of `RunStatus` (written)
one per count                   number of turns
`BUFFER` per buffer             address of what is there at the start, and how many elements; how far it is from one
                                element to the next, and from one plant to the next; address of memory for all plants
                                of a buffer without a size, and how many elements of it each has
`RETURNED` per returned buffer  address, (k, N) (written), of the elements at k places; address of these; k
==============================  ====================================================================================

What all plants read stays where it is. Buffers of a size are the thread's own memory. One without, such as a record of
signals, would be too long for that.
"""

from __future__ import annotations

from collections.abc import Sequence

from flexhinf.codegen.emit.module import emit_module
from flexhinf.codegen.emit.writer import Lanes, ModuleText, Writer
from flexhinf.codegen.memory import Buffer
from flexhinf.codegen.program import ENTRY, PREFIX, Program

#: Function of one plant, and the kernel of a GPU that calls it.
PLANT, KERNEL = PREFIX + "plant", PREFIX + "plants"

#: Words of the table before those of counts; of each buffer; and of each that is returned.
HEAD, BUFFER, RETURNED = 2, 6, 3

_KERNEL = f"""
declare i32 @llvm.nvvm.read.ptx.sreg.ctaid.x()
declare i32 @llvm.nvvm.read.ptx.sreg.ntid.x()
declare i32 @llvm.nvvm.read.ptx.sreg.tid.x()
define ptx_kernel void @{KERNEL}(ptr %table, i64 %plants) {{
entry:
  %block = call i32 @llvm.nvvm.read.ptx.sreg.ctaid.x()
  %threads = call i32 @llvm.nvvm.read.ptx.sreg.ntid.x()
  %thread = call i32 @llvm.nvvm.read.ptx.sreg.tid.x()
  %before = mul i32 %block, %threads
  %sum = add i32 %before, %thread
  %plant = zext i32 %sum to i64
  %there = icmp ult i64 %plant, %plants
  br i1 %there, label %work, label %done
work:
  call void @{PLANT}(ptr %table, i64 %plant, i64 %plants)
  br label %done
done:
  ret void
}}
"""


def emit_threads(program: Program, returned: Sequence[str], fused: bool) -> ModuleText:
    """Write the kernel of a program, which calls a function of one plant, ``void plant(table, k, N)``.

    `returned`: Names of buffers of which some elements are returned. `fused`: As for `emit_module`. Raises Unsupported:
    as that.
    """
    module = emit_module(program, 1, fused, gpu=True)
    writer = Writer(module, Lanes(1))
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

    def begun(buffer: Buffer, place: int) -> str:
        if buffer.shared:
            return address(place)
        if buffer.size is None:
            before = writer.whole("mul", word(place + 5), "%plant")
            own = writer.at("double", address(place + 4), before)
        else:
            own = writer.allocate(f"[{buffer.size} x double]")
        if buffer.role in ("in", "state"):
            source = writer.at("double", address(place), writer.whole("mul", word(place + 3), "%plant"))
            along = word(place + 2)
            with writer.loop(word(place + 1)) as k:
                number = writer.read("double", writer.at("double", source, writer.whole("mul", k, along)))
                writer.write("double", number, writer.at("double", own, k))
        return own

    context = writer.allocate(f"[{len(program.buffers) + len(program.counts) + 2} x i64]")
    own = {buffer.name: begun(buffer, places[buffer.name]) for buffer in program.buffers}
    slots = [("ptr", pointer) for pointer in own.values()]
    slots += [("i64", word(HEAD + k)) for k in range(len(program.counts))]
    for k, (kind, value) in enumerate(slots):
        writer.write(kind, value, writer.at("i64", context, k))
    writer.let(f"call i64 @{ENTRY}(ptr {context})")
    for k in range(2):  # code and step
        value = writer.read("i64", writer.at("i64", context, len(slots) + k))
        writer.write("i64", value, writer.at("i64", address(k), "%plant"))
    for k, name in enumerate(returned):
        first = end + RETURNED * k
        target, chosen = address(first), address(first + 1)
        with writer.loop(word(first + 2)) as row:
            element = writer.read("i64", writer.at("i64", chosen, row))
            number = writer.read("double", writer.at("double", own[name], element))
            place = writer.whole("add", writer.whole("mul", row, "%plants"), "%plant")
            writer.write("double", number, writer.at("double", target, place))
    writer.do("ret void")
    head = f"define internal void @{PLANT}(ptr %table, i64 %plant, i64 %plants) nounwind {{\nentry:"
    module.define(PLANT, head, [*writer.first, *writer.lines])
    module.definitions[KERNEL] = _KERNEL
    return module
