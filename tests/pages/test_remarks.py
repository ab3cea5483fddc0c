"""Remarks appear exactly when they should."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from flexhinf.design import Design
from flexhinf.design.certification import DesignProof
from flexhinf.pages import notes, verdict
from flexhinf.pages.design.region import proof_text
from flexhinf.pages.page import remarks

Make = Callable[[str], Design]


def about(design: Design) -> str:
    """All remarks."""
    return " ".join(notes(design))


def with_evaluation(design: Design, **parts: object) -> Design:
    """The same design with other parts of its evaluation."""
    evaluation = dataclasses.replace(design.evaluation)
    vars(evaluation).update({**vars(design.evaluation), **parts})
    return dataclasses.replace(design, evaluation=evaluation)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("changes", "what", "there"),
    [
        ({"delay_margin_s": 0.0029}, "2.9 ms of extra delay", True),
        ({"delay_margin_s": 0.0031}, "of extra delay", False),
        ({"stable": False}, "the sampled loop with its estimator is unstable", True),
        ({"stable": False, "delay_margin_s": 0.0}, "of extra delay", False),
        ({"input_noise": lambda deviations: deviations}, "the sensor noise moves an input", False),
        ({"input_noise": lambda deviations: 1e5 * deviations}, "the sensor noise moves an input", True),
    ],
)
def test_margins_are_judged(report_design: Make, changes: dict[str, Any], what: str, there: bool) -> None:
    changes = dict(changes)
    design = report_design("met")
    delay = changes.pop("delay_margin_s", None)
    found = dataclasses.replace(design.evaluation.margins)
    vars(found).update({**vars(design.evaluation.margins), **changes})
    if delay is not None:
        vars(found)["_delay"] = (delay, 1.0)
    assert (what in about(with_evaluation(design, margins=found))) is there


@pytest.mark.slow
def test_a_law_that_rings_and_corners_that_are_unstable_are_named(report_design: Make) -> None:
    assert "its weights hardly act on it" in about(report_design("rings"))
    assert "its weights hardly act on it" not in about(report_design("met"))
    for name in ("rings", "met"):
        corners = report_design(name).evaluation.corners
        assert corners is not None
        assert (
            f"{corners.unstable} of {corners.count} corners of the tolerances are unstable"
            in about(report_design(name))
        ) is (corners.unstable > 0)


@pytest.mark.slow
def test_a_start_outside_the_region_is_named_once(report_design: Make) -> None:
    design = report_design("met")
    outside, inside = (dataclasses.replace(design, inside=value) for value in (False, True))
    assert notes(outside) == notes(inside)
    said = " ".join([verdict(outside), *notes(outside)])
    assert said.count("starts outside the proved region") == 1


def test_a_law_without_a_region_says_why_in_the_verdict(report_design: Make) -> None:
    """Nearly every law about weights of a robot's own has none: old code said so in a note, in the status and here."""
    design = report_design("met")
    nothing = dataclasses.replace(
        design.chosen, level=np.nan, step_amplitude=np.nan, limit="the margin is not definite."
    )
    synthesis = dataclasses.replace(design.synthesis, chosen=nothing, choices=(nothing,))
    changed = dataclasses.replace(design, synthesis=synthesis, inside=False)
    nothing_proved = dataclasses.replace(changed, proof=DesignProof(None, "not tried"))
    assert "the sampled check gives no region (the margin is not definite)" in proof_text(nothing_proved)
    found = [text for section in ("region", "step") for text in remarks(changed)[section]]
    assert not any("region" in text for text in found)


def test_a_budget_is_noted_only_where_it_could_have_been_kept(report_design: Make) -> None:
    design = report_design("met")
    last = report_design("rings").attenuation.budget[-1]
    first = ()
    for start, spent, there in ((0.5, 0.4, False), (0.5, 0.6, True)):
        budget = dataclasses.replace(
            last.budget, level=1.0, start=start, spent=np.array([0.0, spent]), disturbance=np.zeros(2)
        )
        terms = (*first, dataclasses.replace(last, budget=budget))
        sampled = dataclasses.replace(
            design,
            attenuation=dataclasses.replace(design.attenuation, budget=terms),
            proof=DesignProof(None, "not tried"),
        )
        changed = dataclasses.replace(design, proof=dataclasses.replace(design.proof, budget=terms))
        assert ("Nothing follows from the region for this step" in about(sampled)) is there
        assert ("Nothing follows from the region for this step" in about(changed)) is there


def test_a_disturbance_beyond_the_level_is_named(report_design: Make) -> None:
    design = report_design("met")
    attained = design.attenuation.attained
    assert attained is not None
    assert ("The disturbance found attains" in about(design)) is (attained.gain > design.gamma)
    beyond = dataclasses.replace(attained, gain=1.01 * design.gamma)
    changed = dataclasses.replace(design.attenuation, attained=beyond)
    assert "The disturbance found attains" in about(dataclasses.replace(design, attenuation=changed))


def test_a_search_that_failed_says_why(report_design: Make) -> None:
    design = report_design("met")
    failed = dataclasses.replace(design.attenuation, attained=None, failure="A joint limit was reached.")
    assert "A joint limit was reached." in notes(dataclasses.replace(design, attenuation=failed))


def test_the_estimators_start_is_kept_apart_from_the_step(report_design: Make) -> None:
    design = report_design("met")
    what = "while the gain of the estimator is still settling"
    assert what not in about(design)
    step = design.evaluation.step
    signals = dict(step.run.signals)
    signals["input"] = signals["input"].copy()
    signals["input"][2] = 100.0
    changed = dataclasses.replace(step, run=dataclasses.replace(step.run, signals=signals))
    assert what in about(with_evaluation(design, step=changed))


def test_extras_that_the_linear_loop_leaves_out_are_named(report_design: Make) -> None:
    design = report_design("met")
    assert "leaves out coulomb friction" not in about(design)
    s = dataclasses.replace if dataclasses.is_dataclass(design.specification) else None
    changed = (
        s(design.specification, extras=("coulomb_friction",))
        if s
        else design.specification.model_copy(update={"extras": ("coulomb_friction",)})
    )
    setup = dataclasses.replace(design.setup, specification=changed)
    assert "leaves out coulomb friction" in about(with_evaluation(design, setup=setup))
