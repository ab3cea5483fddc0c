"""Notes appear exactly when they should."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from flexhinf.design import Design, notes
from flexhinf.design.page import design_page
from flexhinf.design.page.notes import noise_volts, remarks

Make = Callable[[str], Design]


def about(design: Design) -> set[str]:
    """What the notes are about."""
    return {remark.about for remark in remarks(design)}


def with_margins(design: Design, **changes: Any) -> Design:
    """The same design with other margins."""
    return dataclasses.replace(design, margins=dataclasses.replace(design.margins, **changes))


@pytest.mark.parametrize(
    ("changes", "what", "there"),
    [
        ({"delay_margin_s": 0.0029}, "a small delay margin", True),
        ({"delay_margin_s": 0.0031}, "a small delay margin", False),
        ({"peak_sensitivity": 2.01}, "a high peak sensitivity", True),
        ({"peak_sensitivity": 1.99}, "a high peak sensitivity", False),
        ({"stable": False}, "the sampled loop is unstable", True),
        ({"stable": False, "delay_margin_s": 0.0}, "a small delay margin", False),
        ({"noise_to_input": np.array([[1.0]])}, "noise at the motors", False),
        ({"noise_to_input": np.array([[1e5]])}, "noise at the motors", True),
    ],
)
def test_margins_are_judged(page_design: Make, changes: dict[str, Any], what: str, there: bool) -> None:
    assert (what in about(with_margins(page_design("met"), **changes))) is there


def test_the_cause_of_a_high_sensitivity_is_named(page_design: Make) -> None:
    design = with_margins(page_design("met"), peak_sensitivity=3.0)
    (text,) = [note for note in notes(design) if "sensitivity" in note]
    assert "The estimator raises it" in text
    assert "--torque-noise" in text
    state = dataclasses.replace(design.state_margins, peak_sensitivity=2.5)
    (text,) = [
        note for note in notes(dataclasses.replace(design, state_margins=state)) if "sensitivity" in note
    ]
    assert "The estimator raises it" not in text
    assert "the law itself" in text


def test_a_law_that_rings_and_corners_that_are_unstable_are_told(page_design: Make) -> None:
    rings, met = about(page_design("rings")), about(page_design("met"))
    assert "a vibration that rings" in rings
    assert "a vibration that rings" not in met
    tolerances = page_design("rings").tolerances
    assert tolerances is not None
    assert ("corners of the tolerances that are unstable" in rings) is (tolerances.unstable > 0)
    assert tolerances.unstable_anywhere > 0


def test_a_start_outside_the_region_is_told_with_its_integrals(page_design: Make) -> None:
    design = page_design("met")
    assert design.inside is not None
    outside, inside = (dataclasses.replace(design, inside=value) for value in (False, True))
    (text,) = set(notes(outside)) - set(notes(inside))
    assert "with the integrals that the controller chooses" in text
    assert {remark.section for remark in remarks(outside) if remark.text == text} == {"region"}


def test_a_budget_is_noted_only_where_it_could_have_lasted(page_design: Make) -> None:
    design = page_design("met")
    *first, last = design.guarantee.expenses
    for start, spent, there in ((0.5, 0.4, False), (0.5, 0.6, True), (1.1, 0.4, False)):
        budget = dataclasses.replace(
            last.budget, level=1.0, start=start, spent=np.array([0.0, spent]), disturbance=np.zeros(2)
        )
        guarantee = dataclasses.replace(
            design.guarantee, expenses=(*first, dataclasses.replace(last, budget=budget))
        )
        found = about(dataclasses.replace(design, guarantee=guarantee))
        assert ("a budget that does not last" in found) is there


def test_a_disturbance_beyond_the_promise_is_told(page_design: Make) -> None:
    design = page_design("met")
    attained = design.guarantee.attained
    assert attained is not None
    assert ("a disturbance beyond γ" in about(design)) is (attained.gain > design.solution.gamma)
    beyond = dataclasses.replace(attained, gain=1.01 * design.solution.gamma)
    guarantee = dataclasses.replace(design.guarantee, attained=beyond)
    assert "a disturbance beyond γ" in about(dataclasses.replace(design, guarantee=guarantee))


def test_the_estimators_start_is_told_apart_from_the_step(page_design: Make) -> None:
    design = page_design("met")
    what = "a peak input at the estimator's start"
    assert what not in about(design)
    run = design.response.run
    signals = dict(run.signals)
    signals["input"] = signals["input"].copy()
    signals["input"][2] = 100.0
    response = dataclasses.replace(design.response, run=dataclasses.replace(run, signals=signals))
    assert what in about(dataclasses.replace(design, response=response))


@pytest.mark.slow
def test_every_note_stands_once_on_the_page_and_its_subject_at_the_top(page_design: Make) -> None:
    for name in ("met", "rings", "cart", "true state"):
        design = page_design(name)
        page = design_page(design, ["flexhinf"])
        shown = [part.id for part in page.sections]
        top = page.sections[0].html()
        for remark in remarks(design):
            assert remark.section in shown
            assert remark.about.replace("'", "&#x27;") in top
        assert sum(part.html().count('class="note"') for part in page.sections) == len(notes(design))


@pytest.mark.oracle
def test_the_noise_at_the_motor_is_that_of_a_run_at_rest(page_design: Make) -> None:
    design = page_design("met")
    bench, volts = design.bench, noise_volts(design)
    assert volts is not None
    x, u = bench.rest(bench.goal)
    run = bench.loop(bench.controller(bench.goal)).run(
        duration=30.0, noise=bench.noise, initial_state=x, initial_input=u, seed=3
    )
    settled = run.signals["input"][2000:, 0]
    assert settled.std() == pytest.approx(volts[0], rel=0.15)


def test_the_true_state_has_no_noise(page_design: Make) -> None:
    assert noise_volts(page_design("true state")) is None
