"""Every law judged by what the specification asks of the step: overshoot, and the limit of the input if there is one.

The same lines as ``flexhinf design`` has, and the same width within which a limit is kept
(`flexhinf.design.met.CLOSE`).
"""

from __future__ import annotations

from flexhinf.design.compare.result import Comparison, Row
from flexhinf.design.met import Met, step_met
from flexhinf.report import number

__all__ = ["NOMINAL", "WITHIN", "asked_label", "asked_words", "specification_met"]

#: Where a line was looked at.
NOMINAL, WITHIN = "nominal robot", "within the tolerances"


def specification_met(comparison: Comparison, row: Row) -> list[Met]:
    """Lines of one law: the nominal step first, then the worst of the robots within their tolerances.

    Of the same length and order for all laws that were compared; none for one that was not.
    """
    if row.runs is None:
        return []
    s, unit = comparison.reference.specification, comparison.reference.unit
    found = step_met(s, row.runs.step, unit, NOMINAL)
    if row.drawn is not None:
        found.append(Met("overshoot", s.overshoot, float(row.drawn.overshoot.max()), "%", True, WITHIN))
        if s.peak_effort is not None:
            found.append(Met("peak input", s.peak_effort, float(row.drawn.peak.max()), unit, True, WITHIN))
    return found


def asked_label(met: Met, short: bool) -> str:
    """A line of the table."""
    if met.where == NOMINAL:
        return asked_words(met)
    return f"{asked_words(met)}, worst{'' if short else f' {met.where}'}"


def asked_words(met: Met) -> str:
    """What was asked for, wherever it was looked at."""
    return f"{met.what} ≤ {number(met.asked, 3)} {met.unit}"
