"""Verdict and notes follow the numbers: a bad law loses, and a good one wins against the reference."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from flexhinf.design.compare import Comparison, makers, notes, verdict
from flexhinf.design.compare.merits import MERITS, judged, wins
from flexhinf.design.compare.words import bests, versus


@pytest.fixture(scope="module")
def against_a_bad_one(made: Callable[..., Comparison]) -> Comparison:
    """A PD whose rotor is not damped at all: what it is tuned to does not help."""
    patch = pytest.MonkeyPatch()
    plain: Any = makers.MotorPD.tuned

    def undamped(problem: Any, bandwidth: float, damping: float, integral: str | None = None) -> Any:
        law = plain(problem, bandwidth, damping, integral)
        return replace(law, derivative=0.0 * law.derivative)

    patch.setattr(makers.MotorPD, "tuned", staticmethod(undamped))
    result = made(["pd"])
    patch.undo()
    return result


def test_a_deliberately_bad_law_loses(against_a_bad_one: Comparison) -> None:
    bad = against_a_bad_one.row("pd")
    assert bad is not None
    won, lost = versus(against_a_bad_one, bad)
    keys = {merit.key for merit in won}
    assert {"step_settling_s", "damping", "load_deviation"} <= keys
    assert len(won) > len(lost)
    assert bests(against_a_bad_one)["nl-hinf"] > bests(against_a_bad_one)["pd"]


def test_the_verdict_has_the_counts_and_the_numbers(against_a_bad_one: Comparison) -> None:
    bad = against_a_bad_one.row("pd")
    assert bad is not None
    won, lost = versus(against_a_bad_one, bad)
    text = verdict(against_a_bad_one)
    every = len(judged("peak"))
    assert f"better in {len(won)} of {every} figures and worse in {len(lost)}" in text
    assert "Against pd at the same peak input of the step" in text
    assert " against " in text.split("Better:")[1]


def test_the_reference_is_told_to_lose_where_it_does(rig: Comparison) -> None:
    mine = rig.first.figures
    for row in rig.others:
        won, lost = versus(rig, row)
        for merit in MERITS:
            sign = wins(merit, mine, row.figures) if merit in judged("peak") else 0
            assert (merit in won) == (sign > 0)
            assert (merit in lost) == (sign < 0)
    flatness = rig.row("flatness")
    assert flatness is not None
    assert "input_noise" in {merit.key for merit in versus(rig, flatness)[1]}


def test_notes_say_what_was_missed(rig: Comparison) -> None:
    row = rig.row("pd")
    assert row is not None
    assert row.tuned is not None
    missed = replace(
        row, tuned=replace(row.tuned, met=False, response=0.4, reason="the knob is at its bound 3")
    )
    lost = replace(
        row, kind=replace(row.kind, name="flatness"), tuned=None, runs=None, failure="It does not fit."
    )
    short = replace(rig, target=replace(rig.target, share=0.5), rows=(rig.first, missed, lost))
    text = "\n".join(notes(short))
    assert "pd does not reach the target: 0.4 N·m at best, the knob is at its bound 3." in text
    assert "flatness was not compared: It does not fit." in text
    assert "50 % of the way" in text
    assert "(pd gets to 0.4 N·m)" in verdict(short)


def test_degree_two_is_the_linear_law_and_said_to_be(made: Callable[..., Comparison]) -> None:
    result = made(["hinf"], degrees=(2,), draws=0)
    assert any("the same law" in text for text in notes(result))
    a, b = result.rows
    assert a.figures == b.figures


def test_examples_are_drawn_from_what_is_counted(rig: Comparison) -> None:
    """Where the reference is worse in nothing but its cost, the cost is the example."""
    row = rig.row("pd")
    assert row is not None
    copy = replace(row)
    figures = {**rig.first.figures, "operations": 1.0, "load_deviation": 1.0}
    copy.__dict__["figures"] = figures
    text = verdict(replace(rig, rows=(rig.first, copy)))
    assert "worse in 1." in text
    assert "Worse: operations per sample" in text
    assert not text.endswith(": .")
    copy.__dict__["figures"] = rig.first.figures
    text = verdict(replace(rig, rows=(rig.first, copy)))
    assert "better in 0" in text
    assert "Better:" not in text
    assert "Worse:" not in text


def test_alone_there_is_nothing_to_say(rig: Comparison) -> None:
    alone = replace(rig, rows=(rig.first,))
    assert verdict(alone) == "Nothing but nl-hinf could be compared."
