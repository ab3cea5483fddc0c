"""What a kernel runs: steps over named flat arrays, validated as a whole.

A program is data. It says nothing about machine code, lanes or threads, so that the compiler and the
interpreter read the very same text.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import get_args

from flexhinf.codegen.memory import Buffer, Slice, check_identifier
from flexhinf.codegen.steps import Repeat, Simple, Step, When, slices
from flexhinf.errors import FlexhinfError, InvalidInput

#: Every emitted name begins so: a function called `step` once bound to a symbol of the C library. ENTRY runs all.
PREFIX = "flexhinf_"
ENTRY = PREFIX + "run"


@dataclass(frozen=True, eq=False)
class Program:
    """Steps over buffers, validated as a whole.

    Parameters
    ----------
    name : str
        An identifier.
    counts : tuple of str
        Names of the run-time integers that `Repeat` and shifted slices use.

    Raises
    ------
    InvalidInput
        Duplicate names, unknown buffers or counts, a write to an "in" buffer, a slice outside of a sized
        buffer, or strides whose number is not the depth of the loop.
    """

    name: str
    buffers: tuple[Buffer, ...]
    body: tuple[Step, ...]
    counts: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for field in ("buffers", "body", "counts"):
            object.__setattr__(self, field, tuple(getattr(self, field)))
        check_identifier(self.name, "program")
        for count in self.counts:
            check_identifier(count, "count")
        names = [*(buffer.name for buffer in self.buffers), *self.counts]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise InvalidInput(
                f"Program '{self.name}' uses a name twice.",
                f"every buffer and count needs its own name, got twice: {', '.join(twice)}",
                "rename one of them",
            )
        for step, loops in self.steps():
            self._check_step(step, len(loops))

    def buffer(self, name: str) -> Buffer:
        """The buffer of that name (KeyError when there is none)."""
        for buffer in self.buffers:
            if buffer.name == name:
                return buffer
        raise KeyError(name)

    def steps(self) -> Iterator[tuple[Step, tuple[str | int, ...]]]:
        """Every step with the counts of its enclosing loops, outermost first; what has a body before it."""
        stack: list[tuple[Step, tuple[str | int, ...]]] = [(step, ()) for step in reversed(self.body)]
        while stack:
            step, loops = stack.pop()
            yield step, loops
            if isinstance(step, Repeat):
                stack.extend((inner, (*loops, step.count)) for inner in reversed(step.body))
            elif isinstance(step, When):
                stack.extend((inner, loops) for inner in reversed(step.body))

    def _check_step(self, step: Step, depth: int) -> None:
        if isinstance(step, Repeat):
            if isinstance(step.count, str) and step.count not in self.counts:
                raise InvalidInput(
                    f"Program '{self.name}' repeats by an unknown count.",
                    f"expected one of {list(self.counts)}, got {step.count!r}",
                    f"add {step.count!r} to counts",
                )
            return
        if not isinstance(step, Simple | When):
            raise InvalidInput(
                f"Program '{self.name}' holds something that is no step.",
                f"expected {', '.join(kind.__name__ for kind in get_args(Step))}, got {type(step).__name__}",
                "wrap a casadi.Function in Call",
            )
        read, written = slices(step)
        for piece in (*read, *written):
            self._check_slice(piece, depth)
        for piece in written:
            if self.buffer(piece.buffer).role == "in":
                raise InvalidInput(
                    f"Program '{self.name}' writes to an input.",
                    f"{piece} is written, but buffer '{piece.buffer}' has the role 'in'",
                    "the role 'state' (read and written), 'out' or 'work'",
                )

    def _check_slice(self, piece: Slice, depth: int) -> None:
        names = [buffer.name for buffer in self.buffers]
        if piece.buffer not in names:
            raise InvalidInput(
                f"Program '{self.name}' uses an unknown buffer.",
                f"expected one of {names}, got {piece.buffer!r}",
                "declare the buffer, or correct the name",
            )
        if piece.strides and len(piece.strides) != depth:
            raise InvalidInput(
                f"A slice of '{piece.buffer}' has the wrong number of strides.",
                f"expected one per enclosing Repeat ({depth}), outermost first, got {piece.strides}",
                "strides of that length, with 0 for the loops that do not move it, or ()",
            )
        if piece.shift and piece.shift not in self.counts:
            raise InvalidInput(
                f"A slice of '{piece.buffer}' is shifted by an unknown count.",
                f"expected one of {list(self.counts)}, got {piece.shift!r}",
                f"add {piece.shift!r} to counts",
            )
        size = self.buffer(piece.buffer).size
        if size is not None and not any(piece.strides) and piece.offset + piece.size > size:
            raise InvalidInput(
                f"A slice leaves buffer '{piece.buffer}'.",
                f"{piece} ends at {piece.offset + piece.size}, the buffer has {size} elements",
                "a smaller offset or size, or a larger buffer",
            )


class Unsupported(FlexhinfError):
    """A traced function needs something for which no machine code can be made."""

    def __init__(self, what: str, found: str) -> None:
        super().__init__(what, found, "flexhinf.codegen.interpret runs the program on CasADi's evaluator")
