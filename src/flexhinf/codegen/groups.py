"""How many threads of a GPU make one run of a program, and where its numbers lie.

A program of few numbers has a thread for each run, whose numbers are in registers and in memory of its own. One with
more has a warp. Its threads take the columns and the elements of matrices, the first one does what has none, and the
numbers of the run lie in memory that all of them read. That is used again: the steps of a program write each
intermediate result to a place of its own, and what is not read any more leaves its place to others. Slices with
elements in common stay together, as a *block*.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import accumulate

import numpy as np

from flexhinf.codegen.emit.algebra import TOGETHER
from flexhinf.codegen.memory import COLUMN, Cholesky, Polynomial, Slice
from flexhinf.codegen.program import Program, Repeat, Step, Sweep, When, slices

#: Threads of a warp, which wait for each other at little cost.
WARP = 32

#: Numbers of a run from which on it has a warp. It is an estimate, for a card with 50 MB of cache, 132 processors and
#: 256 threads on each: with more than 200 numbers a thread they leave the cache, and from some thousands on each
#: operation waits for the card's memory.
LARGE = 4_096

#: Numbers of a run that the memory of a warp has room for on every card of compute capability 7.5 or newer: 64 KiB.
SHARED = 8_192


@dataclass(frozen=True)
class Packing:
    """New places of the blocks of one buffer.

    `begins`: First elements of the blocks, ascending. `places`: Where they lie now. `size`: Elements in all.
    """

    begins: Sequence[int]
    places: Sequence[int]
    size: int

    def offset(self, old: int) -> int:
        """Where an element lies now."""
        block = bisect_right(self.begins, old) - 1
        return old - self.begins[block] + self.places[block]


@dataclass(frozen=True)
class Form:
    """Threads of a GPU for a run, and its memory if they are several.

    `group`: Threads of a run. `packings`: Of work buffers, by name. `places`: First elements, in the memory of the
    threads, of buffers that have a size and are not shared by all runs; then that of what they pass to each other.
    `size`: Numbers of that memory. `apart`: It is too large for a warp's own, and lies in that of the card.
    """

    group: int = 1
    packings: Mapping[str, Packing] = field(default_factory=dict[str, Packing])
    places: Mapping[str, int] = field(default_factory=dict[str, int])
    size: int = 0
    apart: bool = False

    @property
    def shared_bytes(self) -> int:
        """Bytes of a warp's own memory."""
        return 0 if self.apart else 8 * self.size


#: A thread for each run.
THREAD = Form()

#: The name of the place of what the threads pass to each other; no buffer is called so.
WORKSPACE = ""


def form_of(program: Program) -> Form:
    """The form for a program, by its size."""
    own = {buffer.name: buffer.size for buffer in program.buffers if buffer.size and not buffer.shared}
    if sum(own.values()) < LARGE:
        return THREAD
    found = packings(program)
    own |= {name: packing.size for name, packing in found.items()}
    ends = [0, *accumulate(own.values())]
    size = ends[-1] + max((_passed(step) for step, _ in program.steps()), default=0)
    return Form(WARP, found, dict(zip((*own, WORKSPACE), ends)), size, size > SHARED)


def _passed(step: Step) -> int:
    """Numbers that the threads pass to each other in a step."""
    match step:
        case Cholesky():
            return step.order
        case Polynomial():
            return step.point.size * TOGETHER
        case _:
            return 0


def packings(program: Program) -> dict[str, Packing]:
    """Those of the work buffers that need not be cleared, and that no slice moves along."""
    touched = list(_touched(program.body, ()))
    found = dict[str, Packing]()
    for buffer in program.buffers:
        own = [touch for touch in touched if touch.piece.buffer == buffer.name]
        still = all(not any(touch.piece.strides) and not touch.piece.shift for touch in own)
        if buffer.role == "work" and not buffer.cleared and own and still:
            found[buffer.name] = _packed(own)
    return found


def column_packing(step: Sweep) -> Packing:
    """That of the memory of a column, which each thread has."""
    begun = [_Touch(piece, True, -1, ()) for _, piece in step.inputs]
    touched = [touch for touch in _touched(step.body, ()) if touch.piece.buffer == COLUMN]
    ends = [_Touch(piece, False, _length(step), ()) for _, piece in step.outputs]
    return _packed([*begun, *touched, *ends])


@dataclass(frozen=True)
class _Touch:
    """A slice that a step reads or writes.

    `time`: Number of the step. `loops`: First and last number of the steps in each loop around it.
    """

    piece: Slice
    written: bool
    time: int
    loops: tuple[tuple[int, int], ...]


def _touched(body: Sequence[Step], loops: tuple[tuple[int, int], ...], time: int = 0) -> Iterator[_Touch]:
    """What the steps touch, one step after the other; what one reads comes before what it writes."""
    for step in body:
        read, written = slices(step)
        for pieces, writes in ((read, False), (written, True)):
            yield from (_Touch(piece, writes, time, loops) for piece in pieces)
        end = time + _length(step)
        if isinstance(step, Repeat):
            yield from _touched(step.body, (*loops, (time, end - 1)), time + 1)
        elif isinstance(step, When):
            yield from _touched(step.body, loops, time + 1)
        time = end


def _length(step: Step) -> int:
    return 1 + (sum(map(_length, step.body)) if isinstance(step, Repeat | When | Sweep) else 0)


def _packed(touched: Sequence[_Touch]) -> Packing:
    """Large blocks first, each to the first place that is free as long as it is needed."""
    ends: list[list[int]] = []
    for piece in sorted((touch.piece for touch in touched), key=lambda piece: piece.offset):
        if ends and piece.offset < ends[-1][1]:
            ends[-1][1] = max(ends[-1][1], piece.offset + piece.size)
        else:
            ends.append([piece.offset, piece.offset + piece.size])
    begins = [begin for begin, _ in ends]
    members: list[list[_Touch]] = [[] for _ in ends]
    for touch in touched:
        members[bisect_right(begins, touch.piece.offset) - 1].append(touch)
    sizes = [end - begin for begin, end in ends]
    needed = [_needed(begin, end, own) for (begin, end), own in zip(ends, members)]
    places = [0] * len(ends)
    placed: list[int] = []
    for block in sorted(range(len(ends)), key=lambda block: -sizes[block]):
        first, last = needed[block]
        others = [other for other in placed if needed[other][0] <= last and first <= needed[other][1]]
        for other in sorted(others, key=lambda other: places[other]):
            if places[block] + sizes[block] <= places[other]:
                break
            places[block] = max(places[block], places[other] + sizes[other])
        placed.append(block)
    return Packing(begins, places, max(place + size for place, size in zip(places, sizes)))


def _needed(begin: int, end: int, touched: Sequence[_Touch]) -> tuple[int, int]:
    """The first and the last step during which the block from `begin` to `end` holds something that is read.

    A loop needs it all the time if it is touched elsewhere, too, or if a turn reads what one before has written.
    """
    first, last = touched[0].time, touched[-1].time
    written, from_before = np.zeros(end - begin, dtype=bool), False
    for touch in touched:
        part = written[touch.piece.offset - begin :][: touch.piece.size]
        from_before = from_before or not (touch.written or part.all())
        part[:] |= touch.written
    for loop in {loop for touch in touched for loop in touch.loops}:
        if from_before or any(loop not in touch.loops for touch in touched):
            first, last = min(first, loop[0]), max(last, loop[1])
    return first, last
