"""Remarks appear exactly when they should."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from tests.pages.conftest import with_evaluation
from tests.refusals import unnamed

from flexhinf.designs import PoseEvidence
from flexhinf.designs.certification import DesignProof
from flexhinf.numerals import number
from flexhinf.pages import notes, verdict
from flexhinf.pages.design.region import proof_text
from flexhinf.pages.page import remarks

Make = Callable[[str], PoseEvidence]


def with_attenuation(design: PoseEvidence, **parts: object) -> PoseEvidence:
    """The same design with other bounds of its gain."""
    return dataclasses.replace(design, attenuation=dataclasses.replace(design.attenuation, **parts))


def added(design: PoseEvidence, changed: PoseEvidence) -> list[tuple[str, str]]:
    """The remarks that a change brings, each with the anchor of its section."""
    before = remarks(design)
    return [
        (part, text) for part, texts in remarks(changed).items() for text in texts if text not in before[part]
    ]


@pytest.mark.ci("searches weights and noise of a law of degree 4")
@pytest.mark.parametrize(
    ("changes", "names"),
    [
        ({"delay_margin_s": 0.0029}, ["2.9 ms", "--period", "--damping", "--bandwidth"]),
        ({"delay_margin_s": 0.0031}, None),
        ({"stable": False}, ["unstable", "--period", "--torque-noise", "--bandwidth"]),
        ({"stable": False, "delay_margin_s": 0.0}, ["unstable"]),
        ({"input_noise": lambda deviations: deviations}, None),
        ({"input_noise": lambda deviations: 1e5 * deviations}, ["V rms", "--torque-noise"]),
    ],
)
def test_margins_are_judged(report_design: Make, changes: dict[str, Any], names: list[str] | None) -> None:
    changes = dict(changes)
    design = report_design("met")
    delay = changes.pop("delay_margin_s", None)
    found = dataclasses.replace(design.evaluation.margins)
    vars(found).update({**vars(design.evaluation.margins), **changes})
    if delay is not None:
        vars(found)["_delay"] = (delay, 1.0)
    new = added(design, with_evaluation(design, margins=found))
    assert [part for part, _ in new] == ([] if names is None else ["margins"])
    assert names is None or unnamed(new[0][1].replace("`", ""), *names) == []


@pytest.mark.ci("searches weights and noise of a law of degree 4")
def test_a_law_that_rings_and_corners_that_are_unstable_are_named(report_design: Make) -> None:
    for name in ("rings", "met"):
        design = report_design(name)
        ringing = [text for text in remarks(design)["modes"] if "--damping 0.3" in text]
        assert len(ringing) == (name == "rings")
        corners = design.evaluation.corners
        assert corners is not None
        risky = [
            text for text in notes(design) if not unnamed(text, corners.unstable, corners.count, "corners")
        ]
        assert len(risky) == (corners.unstable > 0)


@pytest.mark.ci("searches weights and noise of a law of degree 4")
def test_a_start_outside_the_region_is_named_once(report_design: Make) -> None:
    design = report_design("met")
    outside, inside = (dataclasses.replace(design, inside=value) for value in (False, True))
    assert notes(outside) == notes(inside)
    said = " ".join([verdict(outside), *notes(outside)])
    assert said.count("proved region") == 1
    assert verdict(outside) != verdict(inside)


@pytest.mark.ci("searches weights and noise of a law of degree 4")
def test_a_law_without_a_region_says_why_in_the_verdict(report_design: Make) -> None:
    """Nearly every law about weights of a robot's own has none: old code said so in a note, in the status and here."""
    design = report_design("met")
    nothing = dataclasses.replace(
        design.chosen, level=np.nan, step_amplitude=np.nan, limit="the margin is not definite."
    )
    synthesis = dataclasses.replace(design.synthesis, chosen=nothing, choices=(nothing,))
    changed = dataclasses.replace(design, synthesis=synthesis, inside=False)
    nothing_proved = dataclasses.replace(changed, proof=DesignProof(None, "not tried"))
    assert unnamed(proof_text(nothing_proved), "no region", "the margin is not definite") == []
    found = [text for section in ("region", "step") for text in remarks(changed)[section]]
    assert not any("region" in text for text in found)


@pytest.mark.ci("searches weights and noise of a law of degree 4")
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
        for other in (sampled, changed):
            found = [text for part, text in added(design, other) if part == "region" and "--period" in text]
            assert [unnamed(text, spent, 0.5) for text in found] == [[]] * there


@pytest.mark.ci("searches weights and noise of a law of degree 4")
def test_a_disturbance_beyond_the_level_is_named(report_design: Make) -> None:
    design = report_design("met")
    attained = design.attenuation.attained
    assert attained is not None
    below, beyond = (
        with_attenuation(design, attained=dataclasses.replace(attained, gain=factor * design.gamma))
        for factor in (0.99, 1.01)
    )
    ((part, text),) = added(below, beyond)
    assert part == "region"
    assert unnamed(text, number(1.01 * design.gamma), number(design.gamma)) == []
    assert added(beyond, below) == []
    assert added(below if attained.gain <= design.gamma else beyond, design) == []


def test_a_search_that_failed_says_why(report_design: Make) -> None:
    design = report_design("rings")
    reason = "A joint limit was reached."
    failed = with_attenuation(design, attained=None, failure=reason)
    assert added(design, failed) == [("region", reason)]


def test_the_estimators_start_is_kept_apart_from_the_step(report_design: Make) -> None:
    design = report_design("rings")
    step = design.evaluation.step
    signals = dict(step.run.signals)
    signals["input"] = signals["input"].copy()
    signals["input"][2] = 100.0
    changed = dataclasses.replace(step, run=dataclasses.replace(step.run, signals=signals))
    ((part, text),) = added(design, with_evaluation(design, step=changed))
    assert part == "step"
    assert unnamed(text, "100 V", "estimator") == []


def test_extras_that_the_linear_loop_leaves_out_are_named(report_design: Make) -> None:
    design = report_design("rings")
    s = dataclasses.replace if dataclasses.is_dataclass(design.specification) else None
    changed = (
        s(design.specification, extras=("coulomb_friction",))
        if s
        else design.specification.model_copy(update={"extras": ("coulomb_friction",)})
    )
    setup = dataclasses.replace(design.setup, specification=changed)
    new = [text for part, text in added(design, with_evaluation(design, setup=setup)) if part == "margins"]
    assert [unnamed(text, "coulomb friction") for text in new] == [[]]
