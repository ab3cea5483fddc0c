"""Laws are called by name."""

from __future__ import annotations

import pytest

from flexhinf.design.compare.names import DEFAULT_LAWS, REFERENCE, degree_of, kind_of, law_names
from flexhinf.errors import InvalidInput


def test_the_reference_is_first_and_every_law_is_there_once() -> None:
    assert law_names(["pd", "nl-hinf", "lqr", "pd"]) == (REFERENCE, "pd", "lqr")
    assert law_names(["pd"]) == (REFERENCE, "pd")
    assert law_names() == law_names([]) == DEFAULT_LAWS
    assert DEFAULT_LAWS[0] == REFERENCE


@pytest.mark.parametrize(("name", "near"), [("hinv", "hinf"), ("gravity-lqr", "lqr-gravity"), ("PD", "pd")])
def test_an_unknown_name_is_told_the_nearest(name: str, near: str) -> None:
    with pytest.raises(InvalidInput) as error:
        law_names(["pd", name])
    what, found, advice = str(error.value).splitlines()
    assert repr(name) in what
    assert "lqr-gravity" in found
    assert near in advice


@pytest.mark.parametrize(
    ("name", "degree"), [("nl-hinf-2", 2), ("nl-hinf-12", 12), ("nl-hinf", None), ("pd", None)]
)
def test_a_degree_is_part_of_a_name(name: str, degree: int | None) -> None:
    assert degree_of(name) == degree
    assert kind_of(name).name == name


@pytest.mark.parametrize("name", ["nl-hinf-1", "nl-hinf-13", "nl-hinf-", "nl-hinf-x"])
def test_degrees_out_of_reach_are_no_names(name: str) -> None:
    with pytest.raises(InvalidInput, match="nl-hinf-2"):
        kind_of(name)
