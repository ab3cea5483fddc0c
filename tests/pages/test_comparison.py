"""The page of a comparison: the criterion before the verdict, every requirement of every law, no counts of wins."""

from __future__ import annotations

import dataclasses
import json
import re

import pytest
from tests.refusals import unnamed

from flexhinf.designs import Comparison
from flexhinf.pages import comparison_page, comparison_verdict
from flexhinf.pages.comparison import comparison_notes, comparison_numbers, ordered_rows
from flexhinf.report import to_json

pytestmark = pytest.mark.ci("designs of three laws")


def test_every_question_has_its_section(report_comparison: Comparison) -> None:
    page = comparison_page(report_comparison, ["flexhinf", "compare"])
    assert [s.id for s in page.sections] == ["criterion", "requirements"]
    html = page.html()
    assert html.index('class="verdict"') < html.index("Criterion:") < html.index('id="criterion"')
    assert not re.search(r"\bnan\b|\binf\b", re.sub(r"<svg.*?</svg>", "", html, flags=re.DOTALL))
    assert not re.search(r"\bin \d+ of \d+", html)
    assert unnamed(html, "figure-laws", "figure-arms", *(row.name for row in report_comparison.rows)) == []
    assert comparison_page(report_comparison, ["flexhinf", "compare"]).html() == html


def test_the_table_joins_requirements_of_all_laws_by_their_names(report_comparison: Comparison) -> None:
    """What two kinds of laws are judged by has one row; what is judged of one alone is a dash for the others."""
    html = (
        comparison_page(report_comparison, [])
        .html()
        .replace("\N{NO-BREAK SPACE}", " ")
        .replace("&nbsp;", " ")
    )
    table = html.partition('id="table-requirements"')[2].partition("</table>")[0]
    names = re.findall(r"<tr[^>]*><t[hd][^>]*>([^<]*)", table)
    assert len(names) == len({*names})
    assert {line.what for row in report_comparison.compared for line in row.requirements} <= {
        name.partition(", ")[0] for name in names
    }


def test_the_file_is_finite_or_null_and_has_every_law(report_comparison: Comparison) -> None:
    numbers = json.loads(to_json(comparison_numbers(report_comparison)))
    assert numbers["order"] == [row.name for row in ordered_rows(report_comparison)]
    for law, row in zip(numbers["laws"], report_comparison.rows, strict=True):
        assert (law["name"], law["met"]) == (row.name, row.met)
        assert [line["what"] for line in law["requirements"]] == [line.what for line in row.requirements]
        assert row.judged is not None
        assert (law["bandwidth"], law["moves"] > 0) == (row.judged.bandwidth, True)


def test_a_law_that_could_not_be_made_is_named_with_its_reason(report_comparison: Comparison) -> None:
    own, *others = report_comparison.rows
    lost = dataclasses.replace(others[-1], judged=None, failure="No gain holds the goal.")
    alone = dataclasses.replace(report_comparison, rows=(own, lost))
    assert unnamed(" ".join(comparison_notes(alone)), lost.name, "No gain holds the goal") == []
    assert "No other" in comparison_verdict(alone)
    assert lost.name in comparison_page(alone, []).html()
    assert alone.summary()["not compared"] == lost.name
