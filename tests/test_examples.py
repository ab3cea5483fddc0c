"""The examples run, and say something true."""

from __future__ import annotations

import runpy
from pathlib import Path

import pytest
from tests.test_gallery import TRUE


def test_every_example_is_tested(repository: Path) -> None:
    found = {file.stem for file in (repository / "examples").glob("*.py")}
    tested = {name.removeprefix("test_example_") for name in globals() if name.startswith("test_example_")}
    assert tested & set(TRUE) == set()
    assert found == tested | set(TRUE)


@pytest.mark.ci
def test_a_row_of_the_regions_page_is_computed_again(repository: Path) -> None:
    example = runpy.run_path(str(repository / "examples" / "region_of_validity.py"))
    page = (repository / "docs" / "regions.md").read_text(encoding="utf-8").splitlines()
    assert example["largest_steps"](example["ROWS"][0], "command", 90).row in page
    assert example["largest_steps"](example["ROWS"][1], "command", 90, seed=7).row in page


@pytest.mark.ci
def test_example_region_of_validity(repository: Path, tmp_path: Path) -> None:
    cases = runpy.run_path(str(repository / "examples" / "region_of_validity.py"))["main"](tmp_path)
    for case in cases:
        linear, cubic, quintic = case.steps.values()
        assert linear < 0.5 < 1.4 < cubic < quintic
    assert cases[1].steps[6] > cases[0].steps[6]
    assert (tmp_path / "regions.svg").read_text().count("<svg") == 1


@pytest.mark.ci
def test_the_whole_table_of_the_regions_page_is_computed_again(repository: Path) -> None:
    example = runpy.run_path(str(repository / "examples" / "region_of_validity.py"))
    page = (repository / "docs" / "regions.md").read_text(encoding="utf-8").splitlines()
    rows = [example["largest_steps"](*wanted).row for wanted in example["wanted_rows"]()]
    assert [row for row in rows if row not in page] == []
    assert len([line for line in page if line.startswith("| (")]) == len(rows)
