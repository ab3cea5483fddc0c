"""The rule by which a row of docs/limits.md is judged."""

from __future__ import annotations

from typing import Any

from benchmarks.limits.cells import MISSING
from benchmarks.limits.rows import PRODUCT

__all__ = ["LEAST", "judged", "missed", "said"]

#: A rival is beaten where our number is at most this times its own, or below 2 mrad; the speed, of its limit.
TIMES, LEAST, SPEED = 1.2, 2e-3, 1.2
#: Motors hold an arm at rest everywhere on its way where its weight needs at most this of their limits.
HELD = 0.9


def judged(row: dict[str, dict[str, Any]]) -> str:
    """Whether a trial keeps the rule: where the motors hold the arm, not farther than 1.2 times PD or 2 mrad, and at
    most 1.2 times the speed limit, or than PD's; else not worse than PD, with a status."""
    if "pd" not in row:
        return MISSING
    if row[PRODUCT]["lost"]:
        return "lost"
    return said(missed(row))


def said(missed: list[str]) -> str:
    """What a reader is told of the parts of a rule that are missed."""
    return f"missed: {', '.join(missed)}" if missed else "kept"


def missed(row: dict[str, dict[str, Any]]) -> list[str]:
    """Parts of the rule that are missed."""
    own, pd = row[PRODUCT], row["pd"]
    if pd["lost"]:
        return []
    far = own["beyond"] <= max(TIMES * pd["beyond"], LEAST)
    fast = own["speed"] <= SPEED or (own["hold"] > HELD and own["speed"] <= pd["speed"] and own["status"] > 0)
    return [text for text, good in (("beyond", far), ("speed", fast)) if not good]
