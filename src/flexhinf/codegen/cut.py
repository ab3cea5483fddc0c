"""Where what is long is cut into functions: the steps of a program, the stages of a trace, and the C of one function.

Said once, in lines of C, for `straight`, `stages`, `c.function` and `c.module`. Whole pieces go together up to `MOST`,
for readers, and for checkers, whose time grows with the square of a function's length. A piece that is too long for one
function is cut where the fewest values are stored for another and loaded. How long the head of a function is, and what
it stores at its end, is known when it is written: `c.function` then cuts with fewer lines until each has `LINES`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import pairwise
from types import MappingProxyType

#: Lines of a function of C at most, with its head and its braces.
LINES = 120

#: Lines of a body at most, under a head of one line.
MOST = LINES - 3

#: Operations of a line, about, where lines are not known yet; one with more counts as several.
DENSE = 4 / 3

#: What another function costs, in values that are stored or loaded.
CALL = 16

NOTHING: Mapping[int, int] = MappingProxyType({})


class Filling:
    """Functions that are filled one after the other.

    `section`: Lines of a function to which a new section of the algorithm is not added. `last`: What uses each value
    last. `most`: Lines of a body.
    """

    def __init__(
        self, section: float = MOST, last: Mapping[int, int] = NOTHING, most: float | None = None
    ) -> None:
        self.section, self.last, self.number, self.size = section, last, 0, 0.0
        self.most = MOST if most is None else most
        self.values = list[int]()

    def add(self, size: float, values: Sequence[int] = (), begins: bool = False, alone: bool = False) -> int:
        """The number of the function of another piece, of so many lines. `values`: Those of the piece, for which alone
        none needs to be stored; `begins`: With a section; `alone`: That is in no function with one before it."""
        here = {*values}
        whole = self.size + size - sum(self.last.get(k) in here for k in self.values)
        if alone or (begins and self.size >= self.section) or (self.size and whole > self.most):
            self.end()
            whole = size
        self.size = whole
        self.values += values
        return self.number

    def end(self) -> None:
        """Begin another function."""
        self.number, self.size, self.values = self.number + 1, 0.0, []


def lines_of(operations: float) -> float:
    """Lines of so many operations, about."""
    return operations / DENSE


def pieces(
    values: Sequence[int],
    sizes: Mapping[int, float],
    reads: Callable[[int], Iterable[int]],
    last: Mapping[int, int],
    most: float | None = None,
) -> Iterator[tuple[Sequence[int], float]]:
    """Where to cut a row of values that is too long for one function: the values of each piece, and its lines.

    `sizes`: Lines of each value, which has another if something behind its piece uses it. `reads`: What each is
    computed of. `last`: What uses each last, of the row or behind it. `most`: Lines of a body.
    """
    most = MOST if most is None else most
    place = {k: at for at, k in enumerate(values)}
    read = [{*reads(k)} for k in values]
    size = [sizes[k] for k in values]
    used = [place.get(last[k], len(values)) if k in last else -1 for k in values]
    whole = 0.0
    for lines, end in zip(reversed(size), reversed(used)):
        whole = whole + lines + (end >= len(values))
    if values and whole <= most:  # a cut stores and loads no fewer values, and costs a call
        yield values, whole
        return
    #: Of the pieces up to each place: values that they store and load, where the last one begins, and its lines.
    best = [(0, 0, 0.0)]
    for stop in range(1, len(values) + 1):
        lines, stores, loads = 0.0, 0, set[int]()
        least, begin, long = math.inf, stop, 0.0
        for start in reversed(range(stop)):
            stored = used[start] >= stop
            lines, stores = lines + size[start] + stored, stores + stored
            if begin < stop and lines > most:
                break
            loads.discard(values[start])
            loads |= read[start]
            cost = best[start][0] + stores + len(loads) + CALL
            if cost <= least:
                least, begin, long = cost, start, lines
        best.append((int(least), begin, long))
    cuts = [len(values)]
    while cuts[-1]:
        cuts.append(best[cuts[-1]][1])
    yield from ((values[start:stop], best[stop][2]) for start, stop in pairwise(cuts[::-1]))
