"""How far some work is, by the names of its steps, and how long it will go on."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate


class Steps:
    """Work whose steps are known about as they come.

    Parameters
    ----------
    known : sequence of pairs
        Of each step how its name begins or ends, and what part of the work it is, relative to the others.
    """

    def __init__(self, known: Sequence[tuple[str, float]]) -> None:
        self.known = [*known]
        self._ends = [0.0, *accumulate(part for _, part in self.known)]
        self._place = 0

    @property
    def total(self) -> float:
        """All parts together."""
        return self._ends[-1]

    def begin(self, text: str) -> float:
        """Begin a step by its name; the parts that are done then.

        One that comes early, as others before it are not needed, moves there. One that is not known changes nothing.
        """
        for k in range(self._place, len(self.known)):
            if text.startswith(self.known[k][0]) or text.endswith(self.known[k][0]):
                self._place = k + 1
                break
        return self._ends[max(self._place - 1, 0)]


def time_left(share: float, at: float, now: float) -> str:
    """How long some work will go on, of which a share was done `at` so many seconds, `now` later; "" if unknown."""
    if not 0.0 < share < 1.0:
        return ""
    left = max(at / share - now, 0.0)
    return (
        f"about {5 * max(round(left / 5.0), 1)} s left"
        if left < 90.0
        else f"about {left / 60.0:.0f} min left"
    )
