"""Where what is long is cut into functions: the steps of a program, the stages of a trace, and the C of one function.

Said once, in operations, for `straight`, `stages` and `c.function`. Whole pieces go together up to `MOST`, for readers,
and for checkers, whose time grows with the square of a function's length. A piece that is too long for one function is
cut where the fewest values are passed on.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterator, Sequence
from itertools import accumulate, pairwise

#: Operations of a function to which another piece is not added.
MOST = 160

#: Parts of a function's length by which a cut may lie elsewhere.
NEAR = 5


class Filling:
    """Functions that are filled one after the other.

    `section`: Operations of a function to which a new section of the algorithm is not added.
    """

    def __init__(self, section: int = MOST) -> None:
        self.section, self.number, self.size = section, 0, 0

    def add(self, size: int, begins: bool = False, alone: bool = False) -> int:
        """The number of the function of another piece, of so many operations. `begins`: With a section; `alone`: That
        is in no function with one before it."""
        if alone or (begins and self.size >= self.section) or (size and self.size + size > MOST):
            self.end()
        self.size += size
        return self.number

    def end(self) -> None:
        """Begin another function."""
        self.number, self.size = self.number + 1, 0


def pieces(sizes: Sequence[int], last: Sequence[int]) -> Iterator[slice]:
    """Where to cut a row of expressions that is too long for one function: pieces of about as many operations.

    `sizes`: Operations of each. `last`: The place at which each is used last.
    """
    before = [0, *accumulate(sizes)]
    count = max(1, -(-before[-1] // MOST))
    cuts = [bisect_left(before, before[-1] * k / count) for k in range(count)] + [len(sizes)]
    ends = sorted((end, place) for place, end in enumerate(last) if end > place)
    away = len(sizes) // count // NEAR

    def passed(cut: int) -> int:
        """Values that are used on both sides."""
        return sum(place < cut for _, place in ends[bisect_left(ends, (cut, -1)) :])

    for k in range(1, count):
        near = range(cuts[k] - away, cuts[k] + away + 1)
        cuts[k] = min(near, key=lambda cut, at=cuts[k]: (passed(cut), abs(cut - at)))
    yield from (slice(*ends) for ends in pairwise(cuts))
