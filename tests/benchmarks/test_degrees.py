"""The study of degrees: a small part of it is computed again, and the page says what the rule does."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

import pytest

from flexhinf.designs.synthesis.by_step import GAIN

NUMBER = re.compile(r"\d+(?:\.\d+)?")


@pytest.fixture
def module(repository: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.syspath_prepend(str(repository))
    import benchmarks.degrees

    yield benchmarks.degrees
    for name in [name for name in sys.modules if name.partition(".")[0] == "benchmarks"]:
        del sys.modules[name]


def page_rows(repository: Path) -> list[list[str]]:
    lines = (repository / "docs" / "degrees.md").read_text(encoding="utf-8").splitlines()
    table = [line.strip("|").split("|") for line in lines if line.startswith("| ")]
    return [[cell.strip() for cell in row] for row in table if len(row) == 6][1:]


def test_a_nonlinear_law_that_the_rule_uses_pays_on_the_page(repository: Path) -> None:
    rows = page_rows(repository)
    assert len(rows) == 24
    used = {row[0]: row[2 if row[5] == "cubic" else 3] for row in rows if row[5] in ("cubic", "quintic")}
    assert len(used) == 5
    for cell in used.values():
        settling, cost, _ = (float(number) for number in NUMBER.findall(cell))
        assert settling <= 0.8
        assert cost <= 1.0 - GAIN


@pytest.mark.nightly(
    "designs with several degrees; tests/benchmarks/test_workspace_rows.py goes on with quick rows"
)
def test_two_cases_are_computed_again_and_go_on_where_they_were_interrupted(
    module: Any, repository: Path, tmp_path: Path
) -> None:
    cases = [case for case in module.CASES if case.row == "one link, to 90°" and case.value in (120.0, 0.2)]
    assert [case.factor for case in cases] == ["step", "pose", "gravity"]
    file = tmp_path / "degrees.jsonl"
    module.study(cases[::2], file)
    kept = file.read_text(encoding="utf-8")
    rows = module.study(cases[::2], file)
    assert file.read_text(encoding="utf-8") == kept
    on_page = {row[0]: row for row in page_rows(repository)}
    made = [line.strip("|").split("|") for line in module.table(rows).splitlines()[2:]]
    assert len(made) == 2
    for cells in made:
        there = on_page[cells[0].strip()]
        assert there[5] == cells[5].strip() == "cubic"
        for mine, theirs in zip(cells[1:5], there[1:5]):
            numbers = [[float(x) for x in NUMBER.findall(text)] for text in (mine, theirs)]
            assert numbers[0] == pytest.approx(numbers[1], rel=0.05, abs=0.11)
    module.draw(rows, tmp_path / "degrees.svg")
    assert (tmp_path / "degrees.svg").read_text(encoding="utf-8").count("<svg") == 1
