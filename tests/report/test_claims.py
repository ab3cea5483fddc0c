"""Claims: four verdicts, each with a word, a sign and a colour."""

from __future__ import annotations

import re
from dataclasses import replace

import pytest
from tests.refusals import refused_with, unnamed

from flexhinf import report
from flexhinf.errors import InvalidInput


@pytest.mark.parametrize(
    ("verdict", "sign"), [("holds", "✓"), ("fails", "✗"), ("ties", "≈"), ("not judged", "○")]
)
def test_a_verdict_is_told_by_more_than_its_colour(verdict: str, sign: str) -> None:
    html = report.Claims([report.JudgedClaim("c", "t", verdict, "e")]).html()  # type: ignore[arg-type]
    assert f'class="badge {verdict.replace(" ", "-")}"' in html
    assert sign in html
    assert f"</span> {verdict}</span>" in html


def test_what_fails_comes_first_and_the_criterion_before_the_verdict() -> None:
    claims = [
        report.JudgedClaim("a", "A.", "holds", "1 < 2", criterion="at most 2"),
        report.JudgedClaim("b", "B.", "fails", "3 > 2", ("table-b",), "at most 2"),
    ]
    html = report.Claims(claims).html()
    assert html.index("B.") < html.index("A.")
    table = report.Table(("x",), [(1,)], "numbers", "table-b")
    evidence = replace(claims[1], blocks=(table,))
    parts = [
        evidence.html().index(text) for text in ("B.", "at most 2", "</span> fails", "3 &gt; 2", "numbers")
    ]
    assert parts == sorted(parts)
    assert evidence.ids() == ("claim-b", "table-b")


def test_another_verdict_is_refused() -> None:
    with refused_with(InvalidInput, "holds", "'maybe'"):
        report.JudgedClaim("c", "t", "maybe", "e")  # type: ignore[arg-type]


def test_what_the_metrics_hold() -> None:
    claim = report.JudgedClaim("c", "t", "fails", "e", ("figure-09",))
    assert claim.as_dict() == {
        "id": "c",
        "text": "t",
        "verdict": "fails",
        "evidence": "e",
    }


def test_the_summary_counts() -> None:
    verdicts = ["holds", "holds", "holds", "fails", "fails", "not judged", "not judged"]
    claims = [report.JudgedClaim(f"c{index}", "t", verdict, "e") for index, verdict in enumerate(verdicts)]  # type: ignore[arg-type]
    assert re.findall(r"\d+", report.summary(claims)) == ["7", "3", "2", "2"]
    assert re.findall(r"\d+", report.summary([])) == []
    assert unnamed(report.summary([]), "no", "claim") == []
