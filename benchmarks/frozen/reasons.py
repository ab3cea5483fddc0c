"""Reasons why numbers of the present tree are other ones than those of the commit they are compared with.

A law, γ, and the verdict on a requirement have no entry here: they do not change. Each other number that moved by more
than rounding has one, with both values; a reason with values that are no longer found excuses nothing.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

#: The last commit in which a design of one pose and one of a workspace were of two kinds.
BEFORE = "7b6e3c82"

#: Values of a reason are written with three digits or more.
WRITTEN = 1e-3


@dataclass(frozen=True)
class Reason:
    """A number that moved, both values, and why the one that stays is right.

    `design` and `item` are names as `make bench-frozen` prints them, in which * stands for any text. A value is None
    where there is none, as before a requirement was added.
    """

    design: str
    item: str
    before: float | str | None
    after: float | str | None
    why: str

    def covers(self, design: str, item: str, before: float | str | None, after: float | str | None) -> bool:
        """Whether this is the reason of a difference."""
        named = _named(self.design, design) and _named(self.item, item)
        return named and _same(self.before, before) and _same(self.after, after)


def _named(pattern: str, name: str) -> bool:
    return re.fullmatch(re.escape(pattern).replace(r"\*", ".*"), name) is not None


def _same(written: float | str | None, found: float | str | None) -> bool:
    if written is None or found is None or isinstance(written, str) or isinstance(found, str):
        return written == found
    return math.isclose(written, found, rel_tol=WRITTEN) or (math.isnan(written) and math.isnan(found))


REASONS: tuple[Reason, ...] = ()
