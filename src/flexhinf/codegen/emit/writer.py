"""Lines of LLVM text, and the types of a number in its lanes.

Functions of the C library are called lane by lane: the same bits as CasADi, for any number of lanes.
"""

from __future__ import annotations

import copy
import itertools
import struct
from collections.abc import Generator, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field

from flexhinf.codegen.program import PREFIX

#: Attributes of functions whose result depends on their arguments alone.
PURE = "nounwind willreturn memory(none)"

_UNROLLED = 64  # elements of a guard or of a broadcast copy that are written out; longer ones get a loop


class Lanes:
    """LLVM types of a number in W ≥ 1 lanes.

    `real`, `integer`, `boolean`: Types of a float64, a 64-bit integer and a truth value in every lane. `element`: Type
    of one array element: its size is exactly W numbers, where a vector's may be padded.
    """

    def __init__(self, width: int) -> None:
        self.width = width
        self.real, self.integer, self.boolean = map(self.type, ("double", "i64", "i1"))
        self.element = "double" if width == 1 else f"[{width} x double]"

    def type(self, scalar: str) -> str:
        """Type of a scalar in every lane."""
        return scalar if self.width == 1 else f"<{self.width} x {scalar}>"

    def suffix(self, scalar: str = "f64") -> str:
        """Suffix of the intrinsics on that scalar in every lane."""
        return scalar if self.width == 1 else f"v{self.width}{scalar}"

    def constant(self, value: float) -> str:
        """The same float64 in every lane, by its bits."""
        return self._splat("double", f"0x{struct.unpack('<Q', struct.pack('<d', value))[0]:016X}")

    def whole(self, value: int) -> str:
        """The same integer in every lane."""
        return self._splat("i64", str(value))

    def _splat(self, scalar: str, value: str) -> str:
        return value if self.width == 1 else f"splat ({scalar} {value})"


@dataclass
class ModuleText:
    """Text of a module, collected while functions are written: definitions, declarations, and names to link.

    `definitions`: Function name to text, in the order of writing. `declarations`: Intrinsics and foreign functions.
    `library`: Emitted name of a C library function to its own name. `operations`: Operations in the traced functions, a
    measure of the time to compile. `fused`: Products are fused into sums, for which the target has an instruction.
    `choosing`: To choose between two vectors costs the target less than to compute with both. `gpu`: For a thread of a
    GPU, which has no vectors in which neighbours of a run could travel together, and no stack to align; the entry is a
    part of a larger function. `group`: Threads of a GPU that make one run together.
    """

    lanes: Lanes
    fused: bool = True
    choosing: bool = True
    gpu: bool = False
    group: int = 1
    definitions: dict[str, str] = field(default_factory=dict[str, str])
    declarations: dict[str, str] = field(default_factory=dict[str, str])
    library: dict[str, str] = field(default_factory=dict[str, str])
    operations: int = 0

    @property
    def frame(self) -> str:
        """Attributes of functions of steps. Vectors on the stack lie in one line of the cache each: those of eight
        lanes took up to twice as long across two."""
        if self.gpu:
            return "nounwind" if self.group == 1 else "nounwind convergent"
        return 'nounwind "stackrealign"'

    def __str__(self) -> str:
        return "\n".join([*self.declarations.values(), *self.definitions.values(), ""])

    def define(self, name: str, head: str, lines: Sequence[str]) -> None:
        """Add a function: its first line, up to the brace, and its body."""
        self.definitions[name] = "\n".join([head, *lines, "}"])


class Writer:
    """Body of one function: appends lines, hands out names.

    `lanes`: Those of the module by default. `first`, `lines`: Allocations, which belong at the start of the function,
    and the text after them. `thread`: Number of the thread in its group.
    """

    def __init__(self, module: ModuleText, lanes: Lanes | None = None) -> None:
        self.module = module
        self.lanes = module.lanes if lanes is None else lanes
        self.first: list[str] = []
        self.lines: list[str] = []
        self.thread = "0"
        self._names = itertools.count(1)

    @property
    def packs(self) -> bool:
        """Whether neighbours travel together in the lanes of a vector: in a kernel for a single run."""
        return self.lanes.width == 1 and not self.module.gpu

    def alike(self, lanes: Lanes) -> Writer:
        """A writer with other lanes that appends to the same text."""
        other = copy.copy(self)
        other.lanes = lanes
        return other

    def label(self, what: str) -> str:
        """A fresh block label, not yet placed."""
        return f"{what}{next(self._names)}"

    def place(self, label: str, end: str = "") -> None:
        """Start a block here; the one before ends with the line `end`, if that is not written yet."""
        self.lines += [f"  {end}", f"{label}:"] if end else [f"{label}:"]

    def do(self, line: str) -> None:
        """A line without a result."""
        self.lines.append(f"  {line}")

    def let(self, expression: str) -> str:
        """A line with a result; returns its name."""
        name = f"%v{next(self._names)}"
        self.lines.append(f"  {name} = {expression}")
        return name

    def allocate(self, kind: str) -> str:
        """Memory on the stack, once per call of the function, wherever in its text this is requested."""
        name = f"%v{next(self._names)}"
        self.first.append(f"  {name} = alloca {kind}, align 64")
        return name

    def splat(self, scalar: str, kind: str = "double") -> str:
        """A scalar copied to every lane."""
        if self.lanes.width == 1:
            return scalar
        vector = self.lanes.type(kind)
        first = self.let(f"insertelement {vector} poison, {kind} {scalar}, i64 0")
        mask = f"<{self.lanes.width} x i32> zeroinitializer"
        return self.let(f"shufflevector {vector} {first}, {vector} poison, {mask}")

    def at(self, kind: str, pointer: str, index: int | str) -> str:
        """The address `index` elements of a kind further on."""
        return self.let(f"getelementptr {kind}, ptr {pointer}, i64 {index}")

    def read(self, kind: str, place: str, align: int = 8) -> str:
        """What stands at an address that is a multiple of so many bytes."""
        return self.let(f"load {kind}, ptr {place}, align {align}")

    def write(
        self, kind: str, value: int | str, place: str, align: int = 8, past_cache: bool = False
    ) -> None:
        """Put a value there; `past_cache`, in a module with such a note !0, if it is not read soon."""
        self.do(f"store {kind} {value}, ptr {place}, align {align}{', !nontemporal !0' * past_cache}")

    @contextmanager
    def loop(self, end: str, first: str = "0", step: int = 1) -> Generator[str, None, None]:
        """A loop over first, first + step, … below `end`; the turn lives in memory until LLVM promotes it."""
        place = self.allocate("i64")
        head, inside, after = self.label("head"), self.label("turn"), self.label("after")
        self.write("i64", first, place)
        self.place(head, f"br label %{head}")
        turn = self.read("i64", place)
        more = self.let(f"icmp slt i64 {turn}, {end}")
        self.place(inside, f"br i1 {more}, label %{inside}, label %{after}")
        yield turn
        self.do(f"store i64 {self.let(f'add nsw i64 {turn}, {step}')}, ptr {place}, align 8")
        self.place(after, f"br label %{head}")

    @contextmanager
    def when(self, condition: str) -> Generator[None, None, None]:
        """Lines for where a condition (an i1) holds."""
        inside, after = self.label("when"), self.label("after")
        self.place(inside, f"br i1 {condition}, label %{inside}, label %{after}")
        yield
        self.place(after, f"br label %{after}")

    def special(self, name: str) -> str:
        """A register of a GPU, such as the number of a thread in its block: an i32."""
        full = f"llvm.nvvm.read.ptx.sreg.{name}.x"
        self.module.declarations[full] = f"declare i32 @{full}()"
        return self.let(f"call i32 @{full}()")

    # Threads of a group, of which each takes some turns ---------------------------------------------------
    def part(self, end: int | str) -> AbstractContextManager[str]:
        """A loop over what this thread takes of the integers below `end`: its number, a group further, and so on."""
        return self.loop(str(end), self.thread, self.module.group)

    def shares(self, size: int, block: int) -> Iterator[tuple[str, int, str]]:
        """As `blocks`; in a group blocks of one, of which this thread takes some."""
        return self.blocks(size, block) if self.module.group == 1 else self.singly(size)

    def singly(self, end: int | str) -> Iterator[tuple[str, int, str]]:
        """What this thread takes of the integers below `end`, as blocks of one."""
        with self.part(end) as turn:
            yield turn, 1, turn

    def wait(self) -> None:
        """Let the threads of a group wait for each other; what one wrote before, all read then."""
        if self.module.group > 1:
            name = "llvm.nvvm.bar.warp.sync"
            self.module.declarations[name] = f"declare void @{name}(i32) convergent nounwind"
            self.do(f"call void @{name}(i32 -1)")

    @contextmanager
    def alone(self) -> Generator[None, None, None]:
        """Lines for the first thread of a group."""
        if self.module.group == 1:
            yield
        else:
            with self.when(self.let(f"icmp eq i64 {self.thread}, 0")):
                yield

    def agreed(self, condition: str) -> str:
        """Whether a condition (an i1) holds in some thread of a group."""
        if self.module.group == 1:
            return condition
        name = "llvm.nvvm.vote.any.sync"
        self.module.declarations[name] = f"declare i1 @{name}(i32, i1) convergent nounwind"
        found = self.let(f"call i1 @{name}(i32 -1, i1 {condition})")
        self.wait()
        return found

    def cases(self, number: str, most: int) -> Iterator[int]:
        """The lines for each case 1, …, most of an integer; nothing is done for others."""
        done = self.label("done")
        labels = {case: self.label("case") for case in range(1, most + 1)}
        cases = " ".join(f"i64 {case}, label %{label}" for case, label in labels.items())
        self.do(f"switch i64 {number}, label %{done} [ {cases} ]")
        for case, label in labels.items():
            self.place(label)
            yield case
            self.do(f"br label %{done}")
        self.place(done)

    def turns(self, first: str, end: str, block: int) -> Iterator[tuple[str, int, str]]:
        """A loop over full blocks: first element, length and number of each."""
        with self.loop(end, first) as turn:
            yield self.let(f"mul nsw i64 {turn}, {block}"), block, turn

    def blocks(self, size: int, block: int) -> Iterator[tuple[str, int, str]]:
        """First element, length and number of all blocks, of which the last may be shorter."""
        if size >= block:
            yield from self.turns("0", str(size // block), block)
        if size % block:
            yield str(size - size % block), size % block, str(size // block)

    def elements(self, size: int) -> Iterator[str]:
        """The integers below `size`: one after the other if they are few, else those of a loop."""
        if size > _UNROLLED:
            with self.loop(str(size)) as turn:
                yield turn
        else:
            yield from map(str, range(size))

    def shared_elements(self, size: int) -> Iterator[str]:
        """As `elements`; in a group those that this thread takes."""
        return self.elements(size) if self.module.group == 1 else (turn for turn, *_ in self.singly(size))

    def real(self, operation: str, *operands: str | float) -> str:
        """An LLVM operation on floats, such as ``fadd``: names of values, or constants."""
        names = [x if isinstance(x, str) else self.lanes.constant(x) for x in operands]
        return self.let(f"{operation} {self.lanes.real} {', '.join(names)}")

    def whole(self, operation: str, *operands: str | int) -> str:
        """An LLVM operation on 64-bit integers, such as ``xor``: names of values, or constants."""
        names = [x if isinstance(x, str) else self.lanes.whole(x) for x in operands]
        return self.let(f"{operation} {self.lanes.integer} {', '.join(names)}")

    def compare(self, predicate: str, left: str, right: str) -> str:
        """Truth value of an LLVM comparison of floats, such as ``olt``."""
        return self.let(f"fcmp {predicate} {self.lanes.real} {left}, {right}")

    def compare_whole(self, predicate: str, left: str, right: str) -> str:
        """Truth value of an LLVM comparison of 64-bit integers, such as ``slt``."""
        return self.let(f"icmp {predicate} {self.lanes.integer} {left}, {right}")

    def joined(self, operation: str, left: str, right: str) -> str:
        """``and`` or ``or`` of two truth values."""
        return self.let(f"{operation} {self.lanes.boolean} {left}, {right}")

    def select(self, condition: str, yes: str, no: str, kind: str = "") -> str:
        """`yes` where the condition holds, else `no`: floats, or values of another kind."""
        kind = kind or self.lanes.real
        return self.let(f"select {self.lanes.boolean} {condition}, {kind} {yes}, {kind} {no}")

    def shuffled(self, value: str, other: str, places: Sequence[int]) -> str:
        """The floats at these places of two vectors, the second one's behind those of the first."""
        real, mask = self.lanes.real, ", ".join(f"i32 {place}" for place in places)
        return self.let(f"shufflevector {real} {value}, {real} {other}, <{len(places)} x i32> <{mask}>")

    def bits(self, value: str) -> str:
        """The bits of a float."""
        return self.let(f"bitcast {self.lanes.real} {value} to {self.lanes.integer}")

    def float(self, bits: str) -> str:
        """The float of these bits."""
        return self.let(f"bitcast {self.lanes.integer} {bits} to {self.lanes.real}")

    def to_float(self, integer: str) -> str:
        """A signed integer of at most 53 bits as a float, exactly."""
        return self.let(f"sitofp {self.lanes.integer} {integer} to {self.lanes.real}")

    def root(self, value: str) -> str:
        """The square root."""
        return self.intrinsic("sqrt", value)

    def intrinsic(self, name: str, *operands: str) -> str:
        """An LLVM intrinsic on floats, such as ``floor``."""
        real = self.lanes.real
        full = f"llvm.{name}.{self.lanes.suffix()}"
        self.module.declarations[full] = f"declare {real} @{full}({', '.join([real] * len(operands))})"
        return self.call(full, *operands)

    def multiply_add(self, a: str, b: str, c: str) -> str:
        """a·b + c, rounded once in a module that fuses."""
        if self.module.fused:
            return self.intrinsic("fma", a, b, c)
        return self.real("fadd", self.real("fmul", a, b), c)

    def load_element(self, pointer: str, element: int | str, shared: bool) -> str:
        """Load one element; a shared one is copied to every lane."""
        kind, size = ("double", "double") if shared else (self.lanes.real, self.lanes.element)
        place = self.at(size, pointer, element)
        value = self.read(kind, place)
        return self.splat(value) if shared else value

    def store_element(self, pointer: str, element: int | str, value: str) -> None:
        """Store one element."""
        place = self.at(self.lanes.element, pointer, element)
        self.write(self.lanes.real, value, place)

    def larger(self, value: str, other: str) -> str:
        """The value where it is larger than the other, else the other; a NaN is not larger."""
        return self.select(self.compare("ogt", value, other), value, other)

    def any(self, condition: str) -> str:
        """Whether the condition holds in some lane (an i1)."""
        if self.lanes.width == 1:
            return condition
        full = f"llvm.vector.reduce.or.{self.lanes.suffix('i1')}"
        self.module.declarations[full] = f"declare i1 @{full}({self.lanes.boolean})"
        return self.let(f"call i1 @{full}({self.lanes.boolean} {condition})")

    def call(self, function: str, *operands: str) -> str:
        """Call a function from floats to a float."""
        real = self.lanes.real
        return self.let(f"call {real} @{function}({', '.join(f'{real} {operand}' for operand in operands)})")

    def library(self, name: str, *operands: str) -> str:
        """Emit a call of the C function `name` in every lane; returns the name of the result.

        The function is linked under our own prefix, so that LLVM takes it for an unknown function and does not
        replace it by something that depends on the number of lanes.
        """
        module, foreign = self.module, PREFIX + name
        scalars = ", ".join(["double"] * len(operands))
        module.library[foreign] = name
        module.declarations[foreign] = f"declare double @{foreign}({scalars}) {PURE}"
        return self.lanewise(foreign, *operands)

    def lanewise(self, foreign: str, *operands: str) -> str:
        """Call a function of one lane in every lane; returns the name of the result."""
        module = self.module
        if self.lanes.width == 1:
            return self.call(foreign, *operands)
        lanewise = f"{foreign}_lanes{self.lanes.width}"
        if lanewise not in module.definitions:
            inside, result = Writer(module, self.lanes), "poison"
            real, names = inside.lanes.real, [f"%x{k}" for k in range(len(operands))]
            for lane in range(inside.lanes.width):
                elements = [inside.let(f"extractelement {real} {name}, i64 {lane}") for name in names]
                value = inside.let(f"call double @{foreign}({', '.join(f'double {x}' for x in elements)})")
                result = inside.let(f"insertelement {real} {result}, double {value}, i64 {lane}")
            inside.do(f"ret {real} {result}")
            arguments = ", ".join(f"{real} {name}" for name in names)
            module.define(
                lanewise, f"define internal {real} @{lanewise}({arguments}) noinline {PURE} {{", inside.lines
            )
        return self.call(lanewise, *operands)

    def number(self, condition: str) -> str:
        """A truth value as 1 or 0."""
        return self.select(condition, self.lanes.constant(1.0), self.lanes.constant(0.0))

    def truth(self, value: str) -> str:
        """Whether a number is not 0; NaN is true, as in C."""
        return self.compare("une", value, self.lanes.constant(0.0))
