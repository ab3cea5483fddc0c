"""The page, the JSON and the terminal show the same numbers."""

from __future__ import annotations

import io
import json
import re
from collections.abc import Callable
from html import escape

import pytest
from rich.console import Console

from flexhinf.design.compare import Comparison, comparison_files, comparison_tables, verdict
from flexhinf.design.compare.merits import MERITS
from flexhinf.design.compare.shown import cell
from flexhinf.design.compare.table import lines

COMMAND = ["flexhinf", "compare", "vertical-rig"]

LAW = {
    "name", "what", "compared", "failure", "knob", "tuned", "figures", "infinite", "needs", "specification", "corners",
    "joints",
}  # fmt: skip


@pytest.fixture(scope="module")
def files(rig: Comparison) -> dict[str, str]:
    return comparison_files(rig, COMMAND, ["one line\n   and another"])


def test_the_schema_is_stable(files: dict[str, str], rig: Comparison) -> None:
    found = json.loads(files["comparison.json"])
    assert list(found) == [
        "version", "robot", "joints", "unit", "tune", "design", "start", "goal", "duration_s", "load", "move_s",
        "drawn", "seed", "laws",
    ]  # fmt: skip
    assert found["version"] == 1
    assert [law["name"] for law in found["laws"]] == [row.name for row in rig.rows]
    for law in found["laws"]:
        assert set(law) == LAW
        assert list(law["figures"]) == [merit.key for merit in MERITS]
        assert set(law["joints"]) == {"step", "raw", "load", "move"}
        assert set(law["infinite"]) <= {key for key, value in law["figures"].items() if value is None}


def test_the_same_comparison_gives_the_same_files(files: dict[str, str], rig: Comparison) -> None:
    assert comparison_files(rig, COMMAND, ["one line\n   and another"]) == files


def test_the_page_is_whole(files: dict[str, str], rig: Comparison) -> None:
    html = files["index.html"]
    assert set(files) == {"index.html", "comparison.json"}
    for anchor in ("merits", "figures-of-merit", "figure-laws", "balance", "laws", "settings"):
        assert f'id="{anchor}"' in html
    assert "one line and another" in html
    assert escape(verdict(rig).split(";")[0].replace("nl-hinf", "nl\u2011hinf")) in html
    for row in rig.rows:
        assert row.kind.what.replace("'", "&#x27;") in html
    assert "http" not in re.sub(r'xmlns[:\w]*="[^"]*"', "", html)


def test_every_law_has_its_column_and_the_best_of_a_row_is_marked(
    files: dict[str, str], rig: Comparison
) -> None:
    html = files["index.html"]
    table = html[html.index('id="figures-of-merit"') :].split("</table>")[0]
    head = re.findall(r'<th scope="col" class="number">(.*?)</th>', table)
    assert [name.replace("\u2011", "-") for name in head] == [row.name for row in rig.compared]
    noise = next(merit for merit in MERITS if merit.key == "input_noise")
    line = next(line for line in lines(rig, rig.compared) if line.label == noise.label)
    values = [row.figures[noise.key] or 0.0 for row in rig.compared]
    assert line.best[values.index(min(values))]
    assert f"<strong>★ {line.cells[values.index(min(values))]}</strong>" in table


def test_what_all_are_tuned_to_has_no_best(rig: Comparison) -> None:
    peak = next(line for line in lines(rig, rig.compared) if line.label == "peak input")
    assert not any(peak.best)


def test_words_stand_for_what_has_no_number(rig: Comparison) -> None:
    by_key = {merit.key: merit for merit in MERITS}
    assert cell(by_key["step_settling_s"], float("inf"), rig) == "> 1.5"
    assert cell(by_key["step_overshoot_percent"], float("inf"), rig) == "diverges"
    assert cell(by_key["delay_margin_s"], float("inf"), rig) == "∞"
    assert cell(by_key["damping"], None, rig) == "–"
    assert cell(by_key["load_deviation"], 0.0441, rig) == "44.1"
    assert cell(by_key["delay_margin_s"], 0.00537, rig) == "5.37"
    assert cell(by_key["input_noise"], 0.00076, rig) == "0.760"


@pytest.mark.parametrize("width", [80, 100, 120])
def test_the_terminal_shows_every_law_within_its_width(rig: Comparison, width: int) -> None:
    console = Console(width=width, record=True, file=io.StringIO())
    tables = comparison_tables(rig, width)
    for table in tables:
        console.print(table)
    text = console.export_text()
    assert "…" not in text
    assert max(len(line.rstrip()) for line in text.splitlines()) <= width
    for row in rig.compared:
        assert row.name in text
    assert all(table.columns[1].header == "nl-hinf" for table in tables)


def test_a_comparison_without_tolerances_says_nothing_of_them(made: Callable[..., Comparison]) -> None:
    result = made(["pd"], draws=0)
    labels = [line.label for line in lines(result, result.compared)]
    assert not any("tolerances" in label for label in labels)
    assert json.loads(comparison_files(result, COMMAND)["comparison.json"])["drawn"] == 0
