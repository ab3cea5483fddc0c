"""The page of a comparison: criterion before verdict, the best rival first, no counts of wins."""

from __future__ import annotations

import dataclasses
import json
import math
import re
from typing import Any

import numpy as np
import pytest
from tests.refusals import unnamed

from flexhinf.design import Comparison
from flexhinf.design.pipeline import ComparedLaw
from flexhinf.pages import comparison_figures, comparison_notes, comparison_page, comparison_verdict
from flexhinf.pages.comparison import METRICS, best_of, cell, metric_table, tuned_laws, unit_of
from flexhinf.pages.files import comparison_numbers
from flexhinf.report import to_json

pytestmark = pytest.mark.ci("tunes four laws")


def with_costs(comparison: Comparison, **costs: float) -> Comparison:
    """The same comparison with other values of the criterion, every limit and requirement kept."""

    def changed(row: ComparedLaw) -> ComparedLaw:
        made = row.tuned or comparison.own.tuned
        assert made is not None
        cost = costs.get(row.name, 10.0)
        tuned = dataclasses.replace(made, kind=row.kind, cost=cost, feasible=True, reason="")
        return ComparedLaw(row.kind, tuned, tuple(line for line in comparison.own.requirements if line.met))

    return dataclasses.replace(comparison, rows=tuple(changed(row) for row in comparison.rows))


def test_every_question_has_its_section(report_comparison: Comparison) -> None:
    page = comparison_page(report_comparison, ["flexhinf", "compare"])
    assert [s.id for s in page.sections] == [
        "criterion",
        "figures",
        "responses",
        "trade-off",
        "frequency",
        "laws",
    ]
    html = page.html()
    assert html.index('class="verdict"') < html.index("Criterion:") < html.index('id="criterion"')
    assert not re.search(r"\bnan\b|\binf\b", re.sub(r"<svg.*?</svg>", "", html, flags=re.DOTALL))
    assert not re.search(r"\bin \d+ of \d+", html)


@pytest.mark.parametrize(
    ("costs", "rival", "outcome"),
    [
        ({"nl-hinf": 1.0, "pid": 0.5, "lqr": 0.8}, "pid", "beats"),
        ({"nl-hinf": 1.0, "pid": 1.5, "lqr": 1.2}, "lqr", "loses"),
        ({"nl-hinf": 1.0, "lqr": 1.01}, "lqr", "difference"),
    ],
)
def test_the_first_sentence_names_the_best_rival_and_who_wins(
    report_comparison: Comparison, costs: dict[str, float], rival: str, outcome: str
) -> None:
    found = with_costs(report_comparison, **costs)
    first = comparison_verdict(found).partition(". ")[0]
    assert unnamed(first, rival, outcome, costs[rival], "nl-hinf", costs["nl-hinf"]) == []
    assert unnamed(first, "beats", "loses", "difference") == [
        word for word in ("beats", "loses", "difference") if word != outcome
    ]
    assert "met" in {status.kind for status in comparison_page(found, ["flexhinf"]).status}


@pytest.mark.parametrize("missing", [("pd",), ("nl-hinf", "design"), ("pd", "nl-hinf", "design")])
def test_what_misses_a_limit_has_its_numbers_and_nothing_is_said_to_be_met(
    report_comparison: Comparison, missing: tuple[str, ...]
) -> None:
    """Old code left a rival out that missed a limit, with every tile of ours alone under a green “met”."""
    whole = with_costs(report_comparison, **{"pd": 2.5, "nl-hinf": 1.0})
    reason = "noise at the motor, rms, of its limit, at most 5 % (--ripple), found 7.7"

    def row(one: ComparedLaw) -> ComparedLaw:
        assert one.tuned is not None
        tuned = dataclasses.replace(one.tuned, feasible=False, reason=reason)
        return dataclasses.replace(one, tuned=tuned) if one.name in missing else one

    rows = tuple(row(one) for one in whole.rows if one.name in ("design", "nl-hinf", "pd"))
    found = dataclasses.replace(whole, rows=rows)
    verdict, page = comparison_verdict(found), comparison_page(found, ["flexhinf", "compare"])
    assert unnamed(verdict, "pd", "2.5", "nl-hinf", "--ripple", "7.7") == []
    assert not {"beats", "loses"} & {*verdict.split()}
    assert "met" not in {status.kind for status in page.status}
    tiles = [(tile.value, tile.note) for tile in page.numbers]
    assert len(tiles) > 3
    assert all(note.startswith("pd") and note.partition(": ")[2] != "–" for _, note in tiles)
    numbers = comparison_numbers(found)
    assert (numbers["ranked"], numbers["best_rival"]) == (False, None if "pd" in missing else "pd")
    law = numbers["laws"][-1]
    assert (law["compared"], law["tuned"]["missed"]) == (True, reason if "pd" in missing else "")
    assert law["figures"]["load_deviation"] > 0.0
    whole_text = page.html().replace("\N{NO-BREAK SPACE}", " ")
    assert whole_text.count(reason) >= 2  # in its row, and in a note
    assert "pd" in next(iter(page.sections)).html()
    assert [note for note in comparison_notes(found) if note.startswith("pd ")] or "pd" not in missing


def test_a_ranking_by_inputs_that_no_motor_limits_says_so_behind_it(
    report_comparison: Comparison, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Noise of 2,547,386 mV and a green “met” were on a page of a robot without limits."""
    found = with_costs(report_comparison, **{"nl-hinf": 1.0, "pd": 2.0})
    noise = next(metric for group in METRICS.values() for metric in group if metric.key == "input_noise")
    assert (unit_of(noise, found), cell(noise, 0.0042, found)) == ("mV", "4.20")
    assert "--peak-effort" not in comparison_verdict(found)
    law = found.row("nl-hinf").evaluation
    assert law is not None
    monkeypatch.setitem(
        vars(law), "metrics", {**law.metrics, "step_peak_input": 9840.0, "input_noise": 2547.386}
    )
    assert (unit_of(noise, found), cell(noise, 2547.386, found)) == ("V", "2547")
    first, _, others = comparison_verdict(found).partition(". ")
    assert unnamed(first, "nl-hinf", "loses") == []
    assert unnamed(others.partition(". To try: --peak-effort")[0], "motor limits", "nl-hinf", 9.84) == []
    assert "--peak-effort" in others
    assert {"risky"} <= {status.kind for status in comparison_page(found, ["flexhinf"]).status} - {"met"}


def test_the_file_is_finite_or_null_and_keeps_its_keys(report_comparison: Comparison) -> None:
    found = json.loads(to_json(comparison_numbers(report_comparison)))
    kept = {
        "version",
        "robot",
        "joints",
        "unit",
        "tune",
        "design",
        "start",
        "goal",
        "load",
        "move_s",
        "drawn",
        "laws",
    }
    assert set(found) >= kept
    assert found["tune"]["criterion"] == report_comparison.criterion.text
    for law, row in zip(found["laws"], report_comparison.rows):
        for key, value in row.metrics.items():
            if value is not None and math.isfinite(value):
                assert law["figures"][key] == value
            else:
                assert law["figures"][key] is None
                assert (key in law["infinite"]) is (value is not None)


def test_every_figure_of_the_evaluations_has_a_label(report_comparison: Comparison) -> None:
    keys = {key for row in report_comparison.compared for key in row.metrics}
    assert keys <= {figure.key for group in METRICS.values() for figure in group}


def test_cells_and_the_best_of_a_row(report_comparison: Comparison) -> None:
    by_key = {figure.key: figure for group in METRICS.values() for figure in group}
    deviation, settling = by_key["load_deviation"], by_key["step_settling_s"]
    assert cell(deviation, 0.0123, report_comparison) == "12.3"
    assert cell(settling, np.inf, report_comparison) == "> 3"
    assert cell(settling, None, report_comparison) == "–"
    assert best_of(deviation, [1.0, 2.0, None]) == (True, False, False)
    assert best_of(by_key["delay_margin_s"], [1.0, 2.0, 2.001]) == (False, True, True)
    assert best_of(deviation, [1.0, 1.0]) == (False, False)
    table = metric_table(report_comparison, report_comparison.compared)
    html = table.html()
    assert "★" not in html
    assert '</strong><br><span class="unit">best</span>' in html
    assert (
        len({column.name for column in table.heads})
        == len(table.heads)
        == 1 + len(report_comparison.compared)
    )


def test_the_same_comparison_gives_the_same_page(report_comparison: Comparison) -> None:
    first, second = (comparison_page(report_comparison, ["flexhinf"]).html() for _ in range(2))
    assert first == second


def test_a_linear_design_is_said_to_be_the_linear_law(report_comparison: Comparison) -> None:
    assert any("degree 2" in note for note in comparison_notes(report_comparison))


def test_a_law_that_could_not_be_made_is_named_with_its_reason(report_comparison: Comparison) -> None:
    lost = ComparedLaw(report_comparison.rows[-1].kind, failure="No gain holds the goal.")
    found = dataclasses.replace(report_comparison, rows=(*report_comparison.rows[:-1], lost))
    assert any(lost.name in note and lost.failure in note for note in comparison_notes(found))
    html = comparison_page(found, ["flexhinf"]).html()
    assert lost.failure in html
    law = comparison_numbers(found)["laws"][-1]
    assert (law["compared"], law["failure"], law["figures"]) == (False, lost.failure, {})


def test_alone_there_is_nothing_to_compare(report_comparison: Comparison) -> None:
    alone = dataclasses.replace(report_comparison, rows=report_comparison.rows[:1])
    assert unnamed(comparison_verdict(alone), "no", "law", "the design") == []
    ids = [section.id for section in comparison_page(alone, ["flexhinf"]).sections]
    assert "trade-off" not in ids


def test_a_law_far_from_the_others_is_seen_in_the_trade_off(
    report_comparison: Comparison, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A thousand times the input for a hundredth of the deviation: every law has its mark within the axes."""
    drawn: list[Any] = []
    monkeypatch.setattr(comparison_figures, "figure_block", lambda _, figure, *texts: drawn.append(figure))
    *laws, last = tuned_laws(report_comparison)
    far = dataclasses.replace(
        last.metrics,
        peak_input=1e3 * last.metrics.peak_input,
        load_deviation=1e-2 * last.metrics.load_deviation,
    )
    comparison_figures.trade_off_figure(report_comparison, [*laws, dataclasses.replace(last, metrics=far)])
    (axes,) = drawn[0].axes
    marks = np.array([line.get_xydata()[0] for line in axes.lines if not line.get_label().startswith("_")])
    assert len(marks) == len(laws) + 1
    for values, (low, high) in zip(marks.T, (axes.get_xlim(), axes.get_ylim())):
        assert low < values.min()
        assert values.max() < high
