"""The verdict on a design, beside whatever is made of the design."""

from __future__ import annotations

import json
import math
from types import SimpleNamespace
from typing import Any

import pytest
from tests.refusals import unnamed

from flexhinf.designs.requirements import REQUIREMENTS
from flexhinf.designs.verdict import UNKNOWN, DesignVerdict, result_row
from flexhinf.pages.campaign import _statuses
from flexhinf.pages.campaign_text import campaign_design, journal_design
from flexhinf.pages.page import design_statuses

LINES = [
    REQUIREMENTS["remaining"].judge(None, 1e-3, 4.41e-3, "with 0 kg of payload", unit="rad"),
    REQUIREMENTS["remaining"].judge(None, 1e-3, 2e-3, "with 1 kg of payload", unit="rad"),
    REQUIREMENTS["corners"].judge(None, 0.0, 44, "all 400 corners"),
    REQUIREMENTS["overshoot"].judge(None, 5.0, 1.0, "the step"),
]
ROWS = [result_row(line) for line in LINES]


def test_what_is_not_met_is_counted_and_named_in_the_units_of_the_design() -> None:
    verdict = DesignVerdict.of(ROWS)
    assert (
        unnamed(verdict.unmet, "3 of 4", "4.41 mrad", "2 mrad", "0 kg", "1 kg", "unstable corners: 44") == []
    )
    degrees = DesignVerdict.of(ROWS, degrees=True).unmet
    assert unnamed(degrees, "0.253°", "0.0573°") == []
    assert "mrad" not in degrees
    assert LINES[0].converted(True).achieved_text == "0.253°"


def test_a_subset_is_called_one() -> None:
    text = DesignVerdict.of(ROWS).beside(["overshoot", "missed deadlines"])
    assert unnamed(text, "a part of", "1 of", "3 kinds", "1 more", "the other 2", "3 of 4") == []
    assert unnamed(DesignVerdict.of(ROWS[3:]).beside(["overshoot"]), "all 1") == []
    assert unnamed(UNKNOWN.beside(["overshoot"]), "not judged", "flexhinf design") == []
    brief = DesignVerdict.of(ROWS).beside(
        ["overshoot"], brief=True
    )  # beside a status that counts what is not met
    assert (unnamed(brief, "a part of") == [], "3 of 4" in brief, UNKNOWN.beside(["overshoot"], True)) == (
        True,
        False,
        "",
    )


@pytest.mark.parametrize("verdict", [UNKNOWN, DesignVerdict.of(ROWS), DesignVerdict.of(ROWS[3:])])
def test_it_is_the_same_after_a_file(verdict: DesignVerdict) -> None:
    assert DesignVerdict.read(json.loads(json.dumps(verdict.numbers))) == verdict
    assert DesignVerdict.read({"requirements": 3, "not_met": []}) == UNKNOWN


@pytest.mark.parametrize(
    ("rows", "kinds"), [(ROWS, ["not met"]), (ROWS[3:], ["met"]), ([], ["met", "not judged"])]
)
def test_a_campaign_without_a_failure_is_green_for_a_design_that_is_met(
    rows: list[dict[str, Any]], kinds: list[str]
) -> None:
    about = {"options": {}, "design": DesignVerdict.of(rows).numbers}
    rule: Any = SimpleNamespace(metric="overshoot_percent")
    judged: Any = SimpleNamespace(
        failures=0, count=1000, requirements=(rule,),
        table=SimpleNamespace(journal=SimpleNamespace(about=about)),
    )  # fmt: skip
    found = _statuses(judged, [], SimpleNamespace(rows=()))  # type: ignore[arg-type]
    assert [status.kind for status in found] == kinds
    text = campaign_design(judged)
    assert (unnamed(text, "a part of", "1 of", "kinds") == []) == bool(rows)
    replayed = journal_design(judged.table.journal)
    assert unnamed(replayed, "design", *(["3 of 4", "corners: 44"] if len(rows) > 1 else [])) == []
    about.pop("options")  # a campaign of something else says nothing of a design
    assert campaign_design(judged) == journal_design(judged.table.journal) == ""


def test_a_page_about_a_design_begins_with_its_verdict() -> None:
    assert design_statuses(DesignVerdict.of(ROWS[3:])) == []
    (status,) = design_statuses(DesignVerdict.of(ROWS))
    assert (status.kind, unnamed(status.text, "3 of 4", "44")) == ("not met", [])


def test_a_line_says_name_place_value_unit_and_limit() -> None:
    line = REQUIREMENTS["remaining"].judge(
        None, 1e-3, 0.00030000000000000003, "the step, nominal robot", unit="rad", joint="wrist", at=0.25
    )
    words = (
        "remaining error",
        "the step, nominal robot",
        "wrist",
        "0.25 s",
        "0.3 mrad",
        "at most 1 mrad",
        "met",
    )
    assert unnamed(str(line), *words) == []
    assert "000" not in str(line)
    assert str(REQUIREMENTS["overshoot"].judge(None, 5.0, math.inf, "")).endswith("NOT MET")
