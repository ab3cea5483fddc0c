"""The page of regions is what its example computes. `make docs` runs the examples: tests/test_gallery.py."""

from __future__ import annotations

import runpy
from pathlib import Path
from typing import Any

import pytest


@pytest.fixture(scope="module")
def example(repository: Path) -> dict[str, Any]:
    return runpy.run_path(str(repository / "examples" / "region_of_validity.py"))


@pytest.fixture(scope="module")
def page(repository: Path) -> list[str]:
    return (repository / "docs" / "regions.md").read_text(encoding="utf-8").splitlines()


def test_the_page_of_regions_has_every_row(example: dict[str, Any], page: list[str]) -> None:
    starts = [
        f"| {example['Case'](weights, channels, goal, 0.0, {}).name} | {goal}° |"
        for weights, channels, goal in example["wanted_rows"]()
    ]
    assert [line.partition("° ")[0] + "° |" for line in page if line.startswith("| (")] == starts


@pytest.mark.ci("solves and searches regions of two rows of a page")
def test_a_row_of_the_regions_page_is_computed_again(example: dict[str, Any], page: list[str]) -> None:
    assert example["largest_steps"](example["ROWS"][0], "command", 90).row in page
    assert example["largest_steps"](example["ROWS"][1], "command", 90, seed=7).row in page


@pytest.mark.nightly("every row of the page of regions; two of them are computed in `make ci`")
def test_the_whole_table_of_the_regions_page_is_computed_again(
    example: dict[str, Any], page: list[str], tmp_path: Path
) -> None:
    rows = [case.row for case in example["main"](tmp_path, whole=True)]
    assert [row for row in rows if row not in page] == []
    assert len([line for line in page if line.startswith("| (")]) == len(rows)
    assert (tmp_path / "regions.svg").read_text(encoding="utf-8").count("<svg") == 1
