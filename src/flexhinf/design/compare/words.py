"""What a comparison comes to, computed from its numbers: the verdict, wins and losses, and what must not be missed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from flexhinf.design.compare.asked import asked_words, specification_met
from flexhinf.design.compare.merits import COST, Merit, best, judged, wins
from flexhinf.design.compare.names import REFERENCE
from flexhinf.design.compare.result import Comparison, Row
from flexhinf.design.compare.shown import cell, in_words, unit_of
from flexhinf.report import number

__all__ = ["ORIGINS", "bests", "notes", "opponent", "same", "verdict", "versus"]

#: Where a target is from that the reference does not set.
ORIGINS = {
    "peak_effort": "the limit that was asked for",
    "saturation": "where the input saturates",
    "bandwidth": "as asked for",
}

#: Figures that a sentence names, of those won and of those lost; one of each group.
NAMED = 2


def opponent(comparison: Comparison) -> Row | None:
    """The law of the verdict: the PD, or the first other."""
    return comparison.row("pd") or next(iter(comparison.others), None)


def versus(comparison: Comparison, other: Row) -> tuple[list[Merit], list[Merit]]:
    """Figures in which the reference is better than another law, and worse; the clearest first."""
    mine, found = comparison.first.figures, ([], [])
    for merit in judged(comparison.target.mode):
        sign = wins(merit, mine, other.figures)
        if sign:
            found[sign < 0].append(merit)
    for side in found:
        side.sort(key=lambda merit: -_apart(merit, mine[merit.key], other.figures[merit.key]))
    return found


def _apart(merit: Merit, a: float | None, b: float | None) -> float:
    """How far apart two figures are: the logarithm of their ratio, both no smaller than what counts."""
    assert a is not None
    assert b is not None
    small, large = sorted(max(abs(value), merit.least, 1e-300) for value in (a, b))
    return float(np.log(large) - np.log(small))


def bests(comparison: Comparison) -> dict[str, int]:
    """In how many figures each law is the best, or shares that; most first."""
    count = {row.name: 0 for row in comparison.compared}
    for merit in judged(comparison.target.mode):
        values = [row.figures[merit.key] for row in comparison.compared]
        for row, top in zip(comparison.compared, best(merit, values)):
            count[row.name] += top
    return dict(sorted(count.items(), key=lambda item: -item[1]))


def same(comparison: Comparison) -> str:
    """What the laws have in common with the reference."""
    target = comparison.target
    if target.value is None:
        return "each with its own defaults"
    unit = comparison.reference.unit if target.mode == "peak" else "rad/s"
    what = "peak input of the step" if target.mode == "peak" else "bandwidth of the linearised loop"
    value = f"{number(target.value, 3)} {unit}"
    if target.origin == "reference":
        part = "" if target.share == 1.0 else f", {100 * target.share:.3g} % of the way"
        return f"at the same {what} ({value}{part}, that of {REFERENCE})"
    own = "" if target.own is None else f"; {REFERENCE} itself: {number(target.own, 3)} {unit}"
    return f"tuned to a {what} of {value} ({ORIGINS[target.origin]}{own})"


def verdict(comparison: Comparison) -> str:
    """Against the PD: in how many figures the reference wins and loses, and the clearest of them in numbers."""
    other = opponent(comparison)
    if other is None:
        return f"Nothing but {REFERENCE} could be compared."
    won, lost = versus(comparison, other)
    both = len(judged(comparison.target.mode))
    missed = (
        ""
        if other.tuned is None or other.tuned.met
        else f" ({other.name} gets to {_reached(comparison, other)})"
    )
    text = (
        f"Against {other.name} {same(comparison)}{missed}, {REFERENCE} is better in {len(won)} of {both} figures and "
        f"worse in {len(lost)}.{_asked(comparison, other)}"
    )
    if won:
        text += f" Better: {_named(comparison, other, won)}."
    if lost:
        text += f" Worse: {_named(comparison, other, lost)}."
    return text


def _asked(comparison: Comparison, other: Row) -> str:
    """What of the specification the two laws do not keep."""
    told = []
    for row in (comparison.first, other):
        missed = [met for met in specification_met(comparison, row) if not met.holds]
        if missed:
            words = " and ".join(f"{asked_words(met)} ({met.where})" for met in missed)
            told.append(f"{row.name} does not keep {words}")
    return f" Of what was asked for, {'; '.join(told)}." if told else " Both keep what was asked of the step."


def _named(comparison: Comparison, other: Row, merits: Sequence[Merit]) -> str:
    """The clearest figure of each group, in numbers; cost where there is nothing else."""
    chosen: dict[str, Merit] = {}
    for merit in sorted(merits, key=lambda merit: merit.group == COST):
        chosen.setdefault(merit.group, merit)
    return "; ".join(against(comparison, other, merit) for merit in list(chosen.values())[:NAMED])


def against(comparison: Comparison, other: Row, merit: Merit) -> str:
    """One figure of the reference and of another law."""
    mine, theirs = (cell(merit, row.figures[merit.key], comparison) for row in (comparison.first, other))
    unit = unit_of(merit, comparison)
    return f"{in_words(merit, comparison)} {mine} against {theirs}{' ' + unit if unit else ''}"


def _reached(comparison: Comparison, row: Row) -> str:
    unit = comparison.reference.unit if comparison.target.mode == "peak" else "rad/s"
    return f"{number(row.tuned.response or 0.0, 3) if row.tuned else '–'} {unit}"


def notes(comparison: Comparison) -> list[str]:
    """What the reader must not miss."""
    found, reference = [], comparison.reference
    if comparison.target.share < 1.0:
        found.append(
            f"{REFERENCE} does not survive the step from its start: the laws are tuned on the last "
            f"{100 * comparison.target.share:.3g} % of the way, and run on all of it."
        )
    found += _linear_notes(comparison)
    for row in comparison.rows:
        if row.failure:
            found.append(f"{row.name} was not compared: {row.failure}")
        elif row.tuned is not None and not row.tuned.met:
            reason = row.tuned.reason.replace(".;", ";").rstrip(".")
            found.append(
                f"{row.name} does not reach the target: {_reached(comparison, row)} at best, {reason}."
            )
    chosen = reference.synthesis.chosen
    if chosen.degree == 2 and comparison.row("hinf") is not None:
        found.append(f"The design chose degree 2: {REFERENCE} and hinf are the same law.")
    if reference.specification.via:
        found.append(
            f"{REFERENCE} switches between laws of several poses; its linearised figures are of that at the goal."
        )
    return found


def _linear_notes(comparison: Comparison) -> list[str]:
    """Unstable loops."""
    found = []
    for row in comparison.compared:
        if row.linear is None:
            found.append(f"The loop of {row.name} could not be linearised: {row.linear_failure}")
        elif not row.linear.stable:
            found.append(f"The linearised loop of {row.name} with its estimator is unstable at the goal.")
    first = comparison.first.linear
    if first is not None and first.stable and first.unstable:
        found.append(
            f"With {first.unstable} of {first.corners} corners of the tolerances the loop of {REFERENCE} is unstable: "
            "--preset robust, or --damping, asks for a design that is not."
        )
    return found
