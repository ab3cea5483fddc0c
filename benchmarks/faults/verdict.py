"""What is said of one run: the rule, stated before anything is measured.

A fault is noticed within 50 ms, or before 0.1 rad of wrong motion. From then on the arm goes no further than the ideal
stop, whose drives are off and brakes closed at that very instant, by more than a tenth and the way of a sample. In the
end its drives are off, or it rests. An unnoticed fault is harmless where the arm leaves its path by less than 0.05 rad
and rests at its goal in the end; it is borne where there are less than 0.1 rad of wrong motion, and rest in the end.
What the sensors of an arm cannot show, or show late, is said with its reason.

Wrong motion of a joint is how far it moves away from its command, by its own motion, while its distance from the
command has changed by more than 0.01 rad since the fault; at most that change. A joint that stands, lags behind or
comes back makes none.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

__all__ = ["FAILURES", "HARM", "VERDICTS", "judged", "judged_harmless", "ran_away"]

#: s; rad; share of the ideal stop's way; rad, of which readings of a plant at rest differ.
SOON, WRONG, BEYOND, SLACK = 0.05, 0.1, 1.1, 1e-3
#: Harmless is what stays below this, rad, and rests in the end, rad/s.
HARM, RESTS = 0.05, 0.05
#: An arm trembles below this speed, rad/s: dry friction, or a drive too strong, makes small swings.
TREMBLES = 0.3
#: An arm that nobody stops has run away beyond these: rad of wrong motion, or some and so many times its speed limit.
AWAY, FAST = 0.3, 1.5

VERDICTS = {
    "kept": "noticed in time, and stopped as an ideal stop would",
    "harmless": "unnoticed, and the arm stays on its path",
    "stands": "unnoticed; the arm stands off its goal, held or braked, without wrong motion",
    "borne": "unnoticed, with less than 0.1 rad of wrong motion, and at rest in the end",
    "trembles": "unnoticed, with less than 0.1 rad of wrong motion, but some speed in the end, below 0.3 rad/s",
    "hidden": "unnoticed or noticed late, and the sensors of this arm cannot show it",
    "slow": "noticed later than 50 ms and 0.1 rad, for a reason that is listed",
    "unnoticed": "unnoticed, with wrong motion",
    "away": "unnoticed, and run away: over 0.3 rad of wrong motion, or 1.5 times a speed limit",
    "late": "noticed later than 50 ms and 0.1 rad",
    "far": "noticed in time, and further than 1.1 of an ideal stop",
    "moving": "noticed, and moves on with power",
    "early": "stopped before the fault came",
}
FAILURES = ("away", "unnoticed", "late", "far", "moving", "early")


def ran_away(row: Mapping[str, Any]) -> bool:
    """Whether the arm went where nobody wanted it."""
    return row["wrong"] > AWAY or (row["wrong"] > HARM and row["speed"] > FAST)


def judged(row: Mapping[str, Any]) -> str:
    """One of `VERDICTS`."""
    if not row["noticed"]:
        if row["wrong"] <= HARM and row["moving"] <= RESTS:
            return "harmless" if row["end"] <= HARM else "stands"
        if row["wrong"] <= WRONG and row["moving"] <= TREMBLES:
            return "borne" if row["moving"] <= RESTS else "trembles"
        if row["hidden"]:
            return "hidden"
        return "away" if ran_away(row) else "unnoticed"
    if row["early"]:
        return "early"
    if row["when"] > SOON and row["wrong_at_notice"] > WRONG:
        return "hidden" if row["hidden"] else "slow" if row["slow"] else "late"
    if row["furthest"] > BEYOND * row["ideal"] + row["step"] + SLACK:
        return "far"
    return "moving" if row["power"] and row["moving"] > RESTS else "kept"


def judged_harmless(row: Mapping[str, Any]) -> bool:
    """Whether nothing stopped an arm that nothing may stop."""
    return not row["noticed"]
