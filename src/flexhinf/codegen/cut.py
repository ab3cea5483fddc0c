"""Where what is long is cut into functions: the steps of a program, the stages of a trace, and the C of one function.

Said once, in lines of C, for `straight`, `stages` and `c.function`. Whole pieces go together up to `MOST`, for readers,
and for checkers, whose time grows with the square of a function's length. A piece that is too long for one function is
cut where the fewest values are stored for another and loaded.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import pairwise
from types import MappingProxyType

NOTHING: Mapping[int, int] = MappingProxyType({})

#: Lines of a function at most.
MOST = 120

#: Operations of a line, about, where lines are not known yet; one with more counts as several.
DENSE = 4 / 3

#: Values that are passed on rather than another function begun.
CALL = 16


class Filling:
    """Functions that are filled one after the other.

    `section`: Operations of a function to which a new section of the algorithm is not added. `end`: The value that uses
    each value last.
    """

    def __init__(self, section: float = DENSE * MOST, end: Mapping[int, int] = NOTHING) -> None:
        self.section, self.end_of, self.number, self.size = lines_of(section), end, 0, 0.0
        self.values = list[int]()

    def add(self, size: float, values: Sequence[int] = (), begins: bool = False, alone: bool = False) -> int:
        """The number of the function of another piece, of so many lines. `values`: Of the piece, of which the function
        need not store what the piece is the last to use; `begins`: With a section; `alone`: That is in no function with
        one before it."""
        here = {*values}
        saved = sum(self.end_of.get(k) in here for k in self.values)
        whole = self.size + size - saved
        if alone or (begins and self.size >= self.section) or (self.size and whole > MOST):
            self.end()
            whole = size
        self.size = whole
        self.values += values
        return self.number

    def end(self) -> None:
        """Begin another function."""
        self.number, self.size, self.values = self.number + 1, 0.0, []


def lines_of(operations: float, lines: int = 0) -> float:
    """Lines of so many operations, `lines` of them at least."""
    return max(lines, operations / DENSE)


def pieces(
    values: Sequence[int],
    sizes: Mapping[int, float],
    reads: Callable[[int], Iterable[int]],
    end: Mapping[int, int],
) -> Iterator[tuple[Sequence[int], float]]:
    """Where to cut a row of values that is too long for one function, and the lines of each piece.

    `sizes`: Lines of each; one that a later piece uses has another. `reads`: What each is computed of. `end`: The value
    that uses each last, of the row or another.
    """
    place = {k: at for at, k in enumerate(values)}
    last = [place.get(end[k], len(values)) if k in end else -1 for k in values]
    #: Of the pieces up to each place: what they store and load, where the last one begins, and its lines.
    best = [(0, 0, 0.0)]
    for stop in range(1, len(values) + 1):
        lines, stores, loads, ways = 0.0, 0, set[int](), list[tuple[int, int, float]]()
        for start in reversed(range(stop)):
            passed = last[start] >= stop
            lines, stores = lines + sizes[values[start]] + passed, stores + passed
            if ways and lines > MOST:
                break
            loads.discard(values[start])
            loads.update(reads(values[start]))
            ways.append((best[start][0] + stores + len(loads) + CALL, start, lines))
        best.append(min(ways))
    cuts = [len(values)]
    while cuts[-1]:
        cuts.append(best[cuts[-1]][1])
    yield from ((values[first:stop], best[stop][2]) for first, stop in pairwise(cuts[::-1]))
