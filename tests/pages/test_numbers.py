"""design.json: the numbers of the page, finite or null."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from typing import Any

import jsonschema
import numpy as np
import pytest

from flexhinf.designs import PoseEvidence, numbers_schema
from flexhinf.designs.result import judged_by
from flexhinf.pages.files import design_numbers
from flexhinf.report import to_json

Make = Callable[[str], PoseEvidence]


def numbers(design: PoseEvidence) -> dict[str, Any]:
    """As they are read back."""
    return json.loads(to_json(design_numbers(judged_by(design))))


def leaves(value: Any) -> list[Any]:
    """All that is no list and no object."""
    if isinstance(value, dict):
        return [leaf for entry in value.values() for leaf in leaves(entry)]
    return [leaf for entry in value for leaf in leaves(entry)] if isinstance(value, list) else [value]


@pytest.mark.parametrize(
    "name",
    [
        pytest.param("rings", marks=pytest.mark.ci("a design more")),
        "true state",
        pytest.param("met", marks=pytest.mark.ci("a law of degree 4")),
    ],
)
def test_every_number_is_finite_or_null(report_design: Make, name: str) -> None:
    found = numbers(report_design(name))
    jsonschema.validate(found, numbers_schema())
    assert all(math.isfinite(leaf) for leaf in leaves(found) if isinstance(leaf, float))


@pytest.mark.ci("searches weights and noise of a law of degree 4")
def test_the_file_has_what_was_found(report_design: Make) -> None:
    design = report_design("met")
    whole, e = numbers(design), design.evaluation
    found, runs = whole["facts"], {run["name"]: run for run in whole["runs"]}
    assert whole["met"] is design.met
    assert [line["found"] for line in whole["requirements"]] == [line.found for line in design.requirements]
    assert found["weights"]["wanted"] == {"bandwidth": [3.0], "damping": 0.2}
    assert sum(one["used"] for one in found["weights"]["tries"]) == 1
    assert sum(one["used"] for one in found["estimator_noise"]["tried"]) == 1
    assert whole["loops"][0]["numbers"]["peak_sensitivity"] == e.margins.peak_sensitivity
    assert whole["loops"][0]["numbers"]["gain_margins"] == e.margins.gain_margins[0].tolist()
    samples = e.step_samples
    assert samples is not None
    assert found["draws"]["settling_time_s"] == pytest.approx(samples.settling.tolist())
    held = design.setup.equilibrium(design.goal)[1]
    assert found["inputs"]["equilibrium at the goal"] == pytest.approx(abs(held[0]))
    assert found["inputs"]["step, nominal robot"] == np.abs(e.step.inputs).max()
    assert found["budget"] == []  # the step starts outside the region
    assert runs["load"]["joints"][0]["load"] == e.load_response.load[0]
    assert found["corners"][0]["form"] == "as designed"
    assert max(found["frequency_response"]["sensitivity"]) == pytest.approx(
        e.margins.peak_sensitivity, rel=0.02
    )
