"""Laws of which designs are made: names, sensors, sources."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from tests.refusals import refused_with

from flexhinf.designs.laws import LAWS, LawKind, law_kind, register, serving
from flexhinf.errors import InvalidInput


@pytest.mark.parametrize(
    ("name", "near"), [("pdd", "pd"), ("flatnes", "flatness"), ("nl-hinf-4", "nl-hinf"), ("xyz", "--laws")]
)
def test_a_name_that_is_not_known_is_refused_with_the_nearest(name: str, near: str) -> None:
    with refused_with(InvalidInput, name, near):
        law_kind(name)


def test_the_names_of_a_refusal_are_those_of_laws() -> None:
    with pytest.raises(InvalidInput) as refused:
        law_kind("nl-hinf-1")
    names = re.findall(r"'([^']+)'", refused.value.found.rpartition(", got ")[0])
    assert set(LAWS) == set(names)


def test_a_law_on_the_motor_side_measures_the_motor() -> None:
    """A PD acts on the encoder of its motor, not through a filter on the link."""
    assert law_kind("pd").sensors == law_kind("pd-gravity").sensors == ("motor_position",)
    for name in ("pid", "torque", "torque-i", "flatness", "flatness-i"):
        assert "motor_position" in law_kind(name).sensors
    for name in ("modal", "nl-hinf", "lqg"):
        assert law_kind(name).sensors == ()


def test_a_law_that_integrates_the_link_s_error_measures_the_link() -> None:
    for name in ("pid", "torque-i", "flatness-i"):
        assert "link_position" in law_kind(name).sensors


def test_a_workspace_has_the_laws_with_gains_at_any_pose() -> None:
    assert {*serving()} - {*serving(pose=False)} == {"nl-hinf"}
    assert "position-drive" not in serving("torque")


def test_a_law_without_gains_is_refused() -> None:
    with refused_with(InvalidInput, "'mine'", "over=LawOver("):
        register(LawKind("mine", "a law of mine", "myself"))


def test_sources_are_in_the_bibliography_or_named() -> None:
    text = Path("docs/references.bib").read_text().lower()
    for name in LAWS:
        year = re.search(r"(1\d{3}|20\d{2})", law_kind(name).source)
        assert year is None or year[1] in text
