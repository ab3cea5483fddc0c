"""Programs of kernels: steps over named flat arrays, validated as a whole.

A program is data. It says nothing about machine code, lanes or threads, so that the compiler, the
exported C and the tests' interpreter read the very same text.

Steps of a kernel: traced functions, linear algebra, copies and guards over slices, inside loops.
"""

# Steps are checked whose types nobody else checks.
# pyright: reportUnnecessaryIsInstance=false

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple, TypeAlias, get_args

from flexhinf.codegen.memory import (
    COLUMN,
    Buffer,
    BufferPart,
    Cholesky,
    Columns,
    Householder,
    OuterSum,
    Polynomial,
    Residual,
    Slice,
    check_function,
    check_identifier,
    misfit,
    overlap,
    whole,
)
from flexhinf.errors import FlexhinfError
from flexhinf.validation import is_integer, one_of, unknown_name

if TYPE_CHECKING:
    import casadi


class TracedStage(NamedTuple):
    """What a part of a traced function is called and computes.

    `results`: The name of each result, its size, and its place among results of that name. `begins`: Whether a section
    of an algorithm begins with it. `turn`: The name of the loop whose turn begins with it, or nothing. `labels`: What
    the elements that it ends with are called, or nothing.
    """

    name: str
    about: str
    results: tuple[tuple[str, int, int], ...] = ()
    begins: bool = False
    turn: str = ""
    labels: tuple[str, ...] = ()

    def result(self, element: int) -> tuple[str, int]:
        """The name of an element of what it gives, and the place among elements of that name."""
        for name, size, place in self.results:
            if element < size:
                return name, place + element
            element -= size
        raise IndexError(element)


@dataclass(frozen=True, eq=False)
class Stages:
    """A traced function in parts that are computed one after the other.

    `function`: The same function, with what each stage ends with as results before its own.
    """

    function: casadi.Function
    rows: tuple[TracedStage, ...]


@dataclass(frozen=True, eq=False)
class Call:
    """Evaluate a traced function; all inputs are read before any output is written, so in-place is safe.

    `function`: An SX function whose arguments and results are dense. `inputs`, `outputs`: One per argument and per
    result, of the same number of elements. For exported C: `about`, what it computes; `names`, those of arguments, then
    of results, as far as they have some; `stages`, what it computes one after the other, where it is long. `joins`:
    Machine code may compute it together with the call before it, in one straight line, to the same bits: what waits for
    a sine there does not keep this waiting.
    """

    function: casadi.Function
    inputs: tuple[Slice, ...]
    outputs: tuple[Slice, ...]
    about: str = ""
    names: tuple[str, ...] = ()
    stages: Stages | None = None
    joins: bool = False

    def __post_init__(self) -> None:
        check_function(self.function, self.inputs, self.outputs)


@dataclass(frozen=True, eq=False)
class Map:
    """Evaluate a traced function on every column of matrices, in any order: several at once where that is faster.

    `function`: As for `Call`. `inputs`: A slice is the same for all columns. `outputs`: May be the very columns of an
    input (in place), but overlap no input otherwise. Raises InvalidInput: as `Call`; columns of different numbers, no
    columns, or results that overlap arguments.
    """

    function: casadi.Function
    inputs: tuple[Slice | Columns, ...]
    outputs: tuple[Columns, ...]
    about: str = ""
    names: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        check_function(self.function, self.inputs, self.outputs)
        counts = {piece.count for piece in (*self.inputs, *self.outputs) if isinstance(piece, Columns)}
        if len(counts) != 1 or not all(isinstance(piece, Columns) for piece in self.outputs):
            raise misfit(
                f"Function '{self.function.name()}' is not mapped over the columns of matrices.",
                "results in Columns, and one number of columns",
                sorted(counts),
            )
        for result in self.outputs:
            for piece in self.inputs:
                if piece != result and overlap(whole(piece), result.whole):
                    raise misfit(
                        f"Function '{self.function.name()}' would overwrite arguments of other columns.",
                        f"a result apart from argument {piece}, or exactly there",
                        result,
                    )

    @property
    def count(self) -> int:
        """Number of columns."""
        return self.outputs[0].count


@dataclass(frozen=True)
class Copy:
    """Copy one slice onto another of the same size (they may overlap)."""

    source: Slice
    target: Slice

    def __post_init__(self) -> None:
        if self.source.size != self.target.size:
            raise misfit("A copy joins slices of different sizes.", f"the size of {self.source}", self.target)


@dataclass(frozen=True)
class Normal:
    """Independent N(0, 1) numbers, one per channel: `flexhinf.codegen.noise.normal_numbers` of a step and a key.

    The step, (1,), and the key, (3,), are integers below 2³². The key is the sample, and the low and the high word of
    the seed.
    """

    step: Slice
    key: Slice
    target: Slice

    def __post_init__(self) -> None:
        if (self.step.size, self.key.size) != (1, 3):
            raise misfit(
                "The counter of normal numbers has another size.",
                "a step (1,) and a key (3,)",
                f"{self.step} and {self.key}",
            )


@dataclass(frozen=True)
class Guard:
    """Stop unless every element is finite.

    `code`: Positive; becomes the `RunStatus.code`, beside the index of the outermost loop (0 outside of loops).
    """

    source: Slice
    code: int

    def __post_init__(self) -> None:
        if not is_integer(self.code) or self.code < 1:
            raise misfit(
                f"The guard of {self.source} has no usable code.",
                "an integer ≥ 1 (0 means that all is well)",
                repr(self.code),
            )


@dataclass(frozen=True, eq=False)
class Repeat:
    """Run `body` as many times as the count.

    `count`: Name of a count of the program, given when it runs; or a fixed number. Raises InvalidInput: A fixed number
    below 1.
    """

    count: str | int
    body: tuple[Step, ...]

    def __post_init__(self) -> None:
        if not isinstance(self.count, str) and (not is_integer(self.count) or self.count < 1):
            raise misfit(
                "A loop has no usable count.",
                "the name of a count of the program, or an integer >= 1",
                repr(self.count),
            )


@dataclass(frozen=True, eq=False)
class When:
    """Run `body` where a flag is not zero; it may be left out elsewhere, and is if the flag is zero in every lane.

    In a lane whose flag is zero beside one whose flag is not, the body runs in vain: what it writes must not matter
    then. Its reader selects by the flag.

    `flag`: One number. Raises InvalidInput: if the flag is not one number, or there is a guard in the body, which
    would stop lanes in vain.
    """

    flag: Slice
    body: tuple[Step, ...]

    def __post_init__(self) -> None:
        if self.flag.size != 1 or any(isinstance(step, Guard) for step in self.body):
            raise misfit(
                "A condition is not one number, or has a guard inside.",
                "a slice of size 1; the guard after it",
                f"{self.flag}, {self.body}",
            )


@dataclass(frozen=True, eq=False)
class Sweep:
    """Run steps on every column of matrices, in any order, several at once; a column has memory of its own meanwhile.

    `body`: They write to the buffer `COLUMN`, which is the column's memory, and may read others, the same for all
    columns. `inputs`, `outputs`: tuple of (Columns, Slice), columns of a matrix, and where each is before or after the
    steps, in a memory of `size` numbers, whose `parts` have names. Raises InvalidInput: other steps, columns of
    different numbers, sizes that do not fit, or writing elsewhere.
    """

    body: tuple[Step, ...]
    inputs: tuple[tuple[Columns, Slice], ...]
    outputs: tuple[tuple[Columns, Slice], ...]
    size: int
    parts: tuple[BufferPart, ...] = ()

    def __post_init__(self) -> None:
        pairs, steps = (*self.inputs, *self.outputs), list(leaves(self.body))
        known = all(isinstance(step, Call | Copy) for step in steps)
        inside = [place for _, place in pairs]
        for step in steps if known else ():
            read, written = slices(step)
            inside += [*written, *(piece for piece in read if piece.buffer == COLUMN)]
        fits = (
            known
            and all(p.buffer == COLUMN and not p.strides and p.offset + p.size <= self.size for p in inside)
            and all(columns.size == place.size for columns, place in pairs)
        )
        if not (fits and self.outputs and len({columns.count for columns, _ in pairs}) == 1):
            raise misfit(
                "A sweep over columns does not fit.",
                f"calls, copies and fixed loops writing to '{COLUMN}' ({self.size}), columns of one count",
                f"{self.inputs} and {self.outputs}",
            )

    @property
    def count(self) -> int:
        """Number of columns."""
        return self.outputs[0][0].count


Simple: TypeAlias = (
    Call | Map | Sweep | OuterSum | Polynomial | Cholesky | Householder | Residual | Copy | Normal | Guard
)
Step: TypeAlias = Simple | Repeat | When


def leaves(body: Sequence[Step]) -> Iterator[Step]:
    """The steps of a body and of its loops of a fixed count, without those loops."""
    for step in body:
        if isinstance(step, Repeat) and not isinstance(step.count, str):
            yield from leaves(step.body)
        else:
            yield step


def slices(step: Step) -> tuple[tuple[Slice, ...], tuple[Slice, ...]]:
    """The slices that a step reads, and those that it writes; of a loop that runs as often as it is told, none."""
    if isinstance(step, Call | Map):
        return tuple(map(whole, step.inputs)), tuple(map(whole, step.outputs))
    if isinstance(step, Sweep):
        inside = [piece for leaf in leaves(step.body) for piece in slices(leaf)[0] if piece.buffer != COLUMN]
        columns = [tuple(matrix.whole for matrix, _ in pairs) for pairs in (step.inputs, step.outputs)]
        return (*columns[0], *inside), columns[1]
    read, written = (
        [piece for piece in (getattr(step, name) for name in names) if piece is not None]
        for names in _PIECES[type(step)]
    )
    return tuple(read), tuple(written)


#: What other steps read and write, by the names of their fields.
_PIECES: dict[type, tuple[tuple[str, ...], tuple[str, ...]]] = {
    OuterSum: (("left", "right", "weights", "plus"), ("target",)),
    Polynomial: (("point", "table"), ("target",)),
    Cholesky: (("source",), ("target",)),
    Householder: (("source",), ("target",)),
    Residual: (("rows", "slope"), ("target",)),
    Copy: (("source",), ("target",)),
    Normal: (("step", "key"), ("target",)),
    Guard: (("source",), ()),
    When: (("flag",), ()),
    Repeat: ((), ()),
}


#: Every emitted name begins so: a function called `step` once bound to a symbol of the C library. ENTRY runs all.
PREFIX = "flexhinf_"
ENTRY = PREFIX + "run"


@dataclass(frozen=True, eq=False)
class Program:
    """Steps over buffers, validated as a whole.

    `name`: An identifier. `counts`: Names of the run-time integers that `Repeat` and shifted slices use. Raises
    InvalidInput: duplicate names, unknown buffers or counts, a write to an "in" buffer, a slice outside of a sized
    buffer, or strides whose number is not the depth of the loop.
    """

    name: str
    buffers: tuple[Buffer, ...]
    body: tuple[Step, ...]
    counts: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        check_identifier(self.name, "program")
        for count in self.counts:
            check_identifier(count, "count")
        names = [*(buffer.name for buffer in self.buffers), *self.counts]
        if twice := sorted({name for name in names if names.count(name) > 1}):
            raise misfit(
                f"Program '{self.name}' uses a name twice.",
                "a name of its own for every buffer and count",
                f"twice: {', '.join(twice)}",
            )
        for step, loops in self.steps():
            self._check_step(step, len(loops))

    def buffer(self, name: str) -> Buffer:
        """The buffer of that name (KeyError when there is none)."""
        return {buffer.name: buffer for buffer in self.buffers}[name]

    def steps(self) -> Iterator[tuple[Step, tuple[str | int, ...]]]:
        """Every step with the counts of its enclosing loops, outermost first; a step with a body comes before it."""
        stack: list[tuple[Step, tuple[str | int, ...]]] = [(step, ()) for step in reversed(self.body)]
        while stack:
            step, loops = stack.pop()
            yield step, loops
            if isinstance(step, Repeat):
                stack.extend((inner, (*loops, step.count)) for inner in reversed(step.body))
            elif isinstance(step, When):
                stack.extend((inner, loops) for inner in reversed(step.body))

    @cached_property
    def pieces(self) -> tuple[tuple[Slice, tuple[str | int, ...]], ...]:
        """What the steps read and write, each once, with the counts of its enclosing loops."""
        steps = ((step, loops) for step, loops in self.steps() if not isinstance(step, Repeat))
        every = ((piece, loops) for step, loops in steps for some in slices(step) for piece in some)
        return tuple(dict.fromkeys(every))

    def _check_step(self, step: Step, depth: int) -> None:
        name, buffers = f"Program '{self.name}'", {buffer.name: buffer for buffer in self.buffers}
        if isinstance(step, Repeat):
            if isinstance(step.count, str) and step.count not in self.counts:
                raise unknown_name(f"{name} repeats by an unknown count.", step.count, self.counts)
            return
        if not isinstance(step, Simple | When):
            raise misfit(
                f"{name} holds something that is no step.",
                ", ".join(kind.__name__ for kind in get_args(Step)),
                type(step).__name__,
            )
        read, written = slices(step)
        for piece in (*read, *written):
            one_of(f"{name} uses an unknown buffer.", piece.buffer, buffers)
            if piece.strides and len(piece.strides) != depth:
                raise misfit(
                    f"A slice of {name} has the wrong number of strides.",
                    f"one per enclosing Repeat ({depth}), outermost first, 0 for those that do not move it",
                    piece.strides,
                )
            if piece.shift and piece.shift not in self.counts:
                raise unknown_name(
                    f"A slice of {name} is shifted by an unknown count.", piece.shift, self.counts
                )
            size = buffers[piece.buffer].size
            if size is not None and not any(piece.strides) and piece.offset + piece.size > size:
                raise misfit(f"A slice of {name} leaves its buffer.", f"an end up to {size}", piece)
        for piece in written:
            if buffers[piece.buffer].role == "in":
                raise misfit(f"{name} writes to an input.", "a buffer of the role state, out or work", piece)


class Unsupported(FlexhinfError):
    """A traced function needs something for which no machine code can be made."""

    def __init__(
        self, what: str, found: str, hint: str = "operations of NumPy and `flexhinf.scalars`"
    ) -> None:
        super().__init__(what, found, hint)
