"""Reasons against a start, with their bits, what each of them says, and what to look at.

They stand apart from the controllers, since a compiled one tells them too, and loads without CasADi.
"""

from __future__ import annotations

import enum
from typing import NamedTuple


class StartReason(NamedTuple):
    """What speaks against a start: what it `says`, and what to `look` at."""

    says: str
    look: str


#: What speaks against a start, or is not known there, by name.
STARTS = {
    "missing": StartReason("a reading is not there", "cables, the bus, and the order of the readings"),
    "moves": StartReason("the robot moves", "brakes, and what pushes it; wait until it rests"),
    "out_of_range": StartReason(
        "a joint is beyond its range", "where the arm stands, and zero, sign and unit of its encoder"
    ),
    "twisted": StartReason(
        "motor and link are apart by more than weight and friction twist the spring",
        "the zeros and signs of both encoders, the payload, and what leans on the arm",
    ),
    "not_checked": StartReason(
        "no second reading tells whether the zeros of the encoders are right", "home the arm first"
    ),
}


class Start(enum.IntFlag):
    """What speaks against a start, or is not known there; the exported C has the same numbers.

    Examples
    --------
    >>> import flexhinf as fh
    >>> print(fh.Start.MOVES)
    the robot moves
    """

    MISSING = 1
    MOVES = 2
    OUT_OF_RANGE = 4
    TWISTED = 8
    NOT_CHECKED = 16

    def _texts(self, field: str) -> str:
        return "; ".join(getattr(STARTS[str(bit.name).lower()], field) for bit in Start if bit in self)

    def __str__(self) -> str:
        """What each reason says; `format` and the exported C have the number."""
        return self._texts("says") or "nothing speaks against a start"

    @property
    def look(self) -> str:
        """What to look at, for each reason."""
        return self._texts("look")
