"""The terminal says the same within 80 columns, and results are short in a terminal."""

from __future__ import annotations

import io
from collections.abc import Callable

import pytest
from rich.console import Console

from flexhinf.designs import Comparison, PoseEvidence
from flexhinf.designs.result import judged_by
from flexhinf.pages import comparison_details, design_tables, verdict

Make = Callable[[str], PoseEvidence]


def printed(tables: list) -> str:
    """All tables, as wide as they come."""
    stream = io.StringIO()
    for table in tables:
        Console(file=stream, width=80).print(table)
    return stream.getvalue()


@pytest.mark.parametrize(
    "name",
    [
        "rings",
        "true state",
        *(pytest.param(name, marks=pytest.mark.ci("a design each")) for name in ("met", "robust", "cart")),
    ],
)
def test_eighty_columns_are_enough(report_design: Make, name: str) -> None:
    text = printed(design_tables(report_design(name)))
    assert max(len(line) for line in text.splitlines()) <= 80
    assert "…" not in text


@pytest.mark.ci("searches weights and noise of a law of degree 4")
def test_the_requirements_come_first(report_design: Make) -> None:
    design = report_design("met")
    text = printed(design_tables(design))
    titles = [str(table.title) for table in design_tables(design)]
    words = (
        "requirements",
        "Inputs",
        "16 robots",
        "Margins",
        "Oscillations",
        "Corners",
        "weights",
        "Noise",
        "Region",
    )
    places = [next(k for k, title in enumerate(titles) if word in title) for word in words]
    assert places == sorted(set(places))
    assert not any("budget" in title for title in titles)  # the step starts outside
    assert ("NOT MET" in text) is not design.met
    assert "mainly" not in text  # there is one joint
    first = verdict(design).partition(".")[0]
    assert design.status.line.startswith(first)


@pytest.mark.ci("designs of three laws")
def test_a_comparison_fits_into_eighty_columns(report_comparison: Comparison) -> None:
    text = printed(comparison_details(report_comparison)[0])
    assert max(len(line) for line in text.splitlines()) <= 80
    assert "…" not in text
    for row in report_comparison.compared:
        assert row.name in text


@pytest.mark.ci("designs of three laws")
def test_results_are_short_in_a_terminal(report_design: Make, report_comparison: Comparison) -> None:
    for result in (judged_by(report_design("met")), report_comparison):
        assert len(repr(result)) < 300
        assert result._repr_html_().startswith("<table>")
    assert "requirements: met" in repr(judged_by(report_design("met")))
