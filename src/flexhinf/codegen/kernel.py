"""What a program becomes: something to run on arrays.

Arrays and counts, checked once against a program before a kernel touches memory.
"""

from __future__ import annotations

import operator
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations
from typing import Protocol

import numpy as np

from flexhinf.codegen.memory import Buffer
from flexhinf.codegen.program import Program, Repeat, slices
from flexhinf.errors import InvalidInput


def check_lanes(program: Program, lanes: int) -> None:
    """Refuse a number of lanes that is no positive integer."""
    if isinstance(lanes, bool) or not isinstance(lanes, int) or lanes < 1:
        raise InvalidInput(
            f"Program '{program.name}' cannot run on these lanes.",
            f"expected an integer ≥ 1, got {lanes!r}",
            "1 for a single run, 8 for many",
        )


def check_arrays(program: Program, arrays: Mapping[str, np.ndarray], lanes: int) -> dict[str, np.ndarray]:
    """The arrays of the program's buffers, in its order.

    `arrays`: One C-contiguous float64 array per buffer that is not "work". With one lane any shape of `size` elements
    is taken (a trajectory may be given as (steps, n)); with W lanes the last axis of a buffer that is not shared is
    the lane, so its shape is (size, W) or (…, W). Returns the same array objects. Raises InvalidInput: missing or
    unknown name; wrong type, dtype, layout or number of elements; a read-only array to be written; a written array
    that shares memory with another one.
    """
    expected = {buffer.name: buffer for buffer in program.buffers if buffer.role != "work"}
    if set(arrays) != set(expected):
        missing = sorted(set(expected) - set(arrays))
        unknown = sorted(set(arrays) - set(expected))
        raise InvalidInput(
            f"The arrays do not match the buffers of '{program.name}'.",
            f"expected {sorted(expected)}; missing {missing}, not known {unknown}",
            "one array per buffer that is not 'work' (the kernel makes those itself)",
        )
    for name, buffer in expected.items():
        width = 1 if buffer.shared else lanes
        if found := _misfit(arrays[name], buffer, width):
            elements = "any number of" if buffer.size is None else str(buffer.size)
            wanted = f" with a last axis of {lanes} lanes" if width > 1 else ""
            raise InvalidInput(
                f"The array for buffer '{name}' of '{program.name}' cannot be used.",
                f"expected a C-contiguous float64 array of {elements} elements{wanted}, got {found}",
                "numpy.ascontiguousarray(…, dtype=float)",
            )
    for first, second in combinations(expected.values(), 2):
        written = first.role != "in" or second.role != "in"
        if written and np.may_share_memory(arrays[first.name], arrays[second.name]):
            raise InvalidInput(
                f"Two buffers of '{program.name}' lie in the same memory.",
                f"the arrays for '{first.name}' and '{second.name}' overlap, and one of them is written",
                "a copy, or one buffer with the role 'state' for both",
            )
    return {name: arrays[name] for name in expected}


def _misfit(array: object, buffer: Buffer, width: int) -> str:
    """What an array is that a buffer of so many lanes cannot take; empty for one that fits."""
    if not isinstance(array, np.ndarray):
        return type(array).__name__
    found = f"{array.dtype} of shape {array.shape}"
    if not array.flags.c_contiguous:
        return f"{found}, not contiguous"
    if not (array.flags.writeable or buffer.role == "in"):
        return f"{found}, read-only, but the program writes to it"
    fits = array.size % width == 0 and buffer.size in (None, array.size // width)
    fits = fits and (width == 1 or (array.ndim >= 2 and array.shape[-1] == width))
    usable = array.dtype == np.float64 and array.dtype.isnative and array.flags.aligned
    return "" if fits and usable else found


def check_counts(program: Program, counts: Mapping[str, int]) -> dict[str, int]:
    """The counts of the program, in its order.

    Raises InvalidInput: missing or unknown name, or a value that is not an integer ≥ 0.
    """
    if set(counts) != set(program.counts):
        raise InvalidInput(
            f"The counts do not match those of '{program.name}'.",
            f"expected {sorted(program.counts)}, got {sorted(counts)}",
            "counts={name: number of turns}",
        )
    checked = {}
    for name in program.counts:
        try:
            value = operator.index(counts[name])
        except TypeError:
            value = -1
        if value < 0:
            raise InvalidInput(
                f"Count '{name}' of '{program.name}' is not usable.",
                f"expected an integer ≥ 0, got {counts[name]!r}",
                "the number of turns of the loop",
            )
        checked[name] = value
    return checked


def check_reach(program: Program, lengths: Mapping[str, int], counts: Mapping[str, int]) -> None:
    """Every slice stays inside its buffer for these counts.

    `lengths`: Elements per lane of every buffer, work included. `counts`: As returned by `check_counts`. Raises
    InvalidInput: A slice would leave its buffer; the message says by how much.
    """
    for step, loops in program.steps():
        turns = [counts[count] if isinstance(count, str) else count for count in loops]
        if isinstance(step, Repeat) or 0 in turns:
            continue
        read, written = slices(step)
        for piece in (*read, *written):
            moves = [stride * (turn - 1) for stride, turn in zip(piece.strides, turns, strict=False)]
            start = piece.offset + (counts[piece.shift] if piece.shift else 0)
            first = start + sum(move for move in moves if move < 0)
            end = start + piece.size + sum(move for move in moves if move > 0)
            if first < 0 or end > lengths[piece.buffer]:
                raise InvalidInput(
                    f"A slice leaves buffer '{piece.buffer}' of '{program.name}'.",
                    f"{piece} with counts {dict(counts)} reaches elements {first} to {end}, "
                    f"the array has {lengths[piece.buffer]} (per lane)",
                    "a longer array or a smaller count",
                )


@dataclass(frozen=True, eq=False)
class Status:
    """How a run ended.

    `code`: 0, or the code of the first `Guard` that failed; an array (lanes,) when the kernel has several.
    `step`: index of the outermost loop at that moment (0 outside of loops); -1 where the code is 0.
    """

    code: int | np.ndarray
    step: int | np.ndarray

    @property
    def fine(self) -> bool:
        """No guard failed, in any lane."""
        return not np.any(self.code)


class BoundKernel(Protocol):
    """A kernel with its arrays: the real-time path, nothing left to check."""

    def __call__(self) -> int:
        """Run; the largest code over the lanes, 0 when all is well."""
        ...

    @property
    def status(self) -> Status:
        """Status of the last call."""
        ...


class Kernel(ABC):
    """A program ready to run on one or more lanes.

    `lanes`: W; with W > 1 every buffer that is not shared has the lane as its last (fastest) axis.

    With one lane a run stops at the guard that fails. With several, the lane that failed is marked and its
    numbers mean nothing from there on, while the others go on undisturbed; the run stops when all have
    failed.
    """

    def __init__(self, program: Program, lanes: int) -> None:
        self.program = program
        self.lanes = lanes

    def run(self, arrays: Mapping[str, np.ndarray], counts: Mapping[str, int] | None = None) -> Status:
        """Check the arrays, run once, and say how it ended.

        `arrays`: One C-contiguous float64 array per buffer that is not "work"; "out" and "state" are written in place.
        `counts`: Turns of every loop of the program. Raises InvalidInput: arrays or counts that do not fit the
        program.
        """
        bound = self.bind(arrays, counts)
        bound()
        return bound.status

    def bind(
        self, arrays: Mapping[str, np.ndarray], counts: Mapping[str, int] | None = None, short: bool = False
    ) -> BoundKernel:
        """Check the arrays once; return a callable without arguments that runs on them and returns the code.

        `arrays`, `counts`: As for `run`. `short`: A call takes microseconds: other Python threads wait for it, where
        otherwise they go on meanwhile. Giving up the interpreter's lock costs 50 ns, and up to its switching interval
        (5 ms) to get it back. Raises InvalidInput: arrays or counts that do not fit the program.
        """
        checked = check_arrays(self.program, arrays, self.lanes)
        turns = check_counts(self.program, counts or {})
        lengths = {}
        for buffer in self.program.buffers:
            if buffer.role == "work":
                lengths[buffer.name] = buffer.size or 0
            else:
                lengths[buffer.name] = checked[buffer.name].size // (1 if buffer.shared else self.lanes)
        check_reach(self.program, lengths, turns)
        return self._bind(checked, turns, short)

    @abstractmethod
    def _bind(self, arrays: dict[str, np.ndarray], counts: dict[str, int], short: bool) -> BoundKernel:
        """Bind checked arrays and counts."""
