"""What docs/workspace.md says of a robot stands in a row of that robot, in one of the tables of the benchmark."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from benchmarks.workspace.rows import ROWS
from benchmarks.workspace.tables import TABLES

QUANTITY = re.compile(r"(?<![\d.,])\d[\d,.]*(?: of \d+| (?:mrad|ms|µs|s|%)(?![a-z]))|(?<![\d.,])\d+\.\d+")


@pytest.fixture
def page(repository: Path) -> str:
    return (repository / "docs" / "workspace.md").read_text(encoding="utf-8")


def quantities(text: str) -> list[str]:
    """Numbers with a unit, counts out of others, and decimal numbers."""
    return [each.rstrip(".,") for each in QUANTITY.findall(text)]


def test_what_counts_as_a_number() -> None:
    text = "arrives at 39 of 40, 0.81 % of ripple, 1,234 µs, 0.27, and leaves 6.2 mrad, with 1 kg. One of 2."
    assert quantities(text) == ["39 of 40", "0.81 %", "1,234 µs", "0.27", "6.2 mrad"]


def test_what_is_said_stands_in_a_row(page: str) -> None:
    """But for what the text says to be a try without rows."""
    said = "".join(
        page.partition(f"{head}\n")[2].partition("\n#")[0]
        for head in ("## What came out", "### What is missed")
    )
    rows = "\n".join(
        [*(line for line in page.splitlines() if line.startswith("|")), *(t(ROWS) for t in TABLES.values())]
    )
    known = set(quantities(rows)) | set(re.findall(r"\d+(?:\.\d+)?", rows))
    sentences = [
        each for each in re.split(r"(?<=\.)\s", re.sub(r"`[^`]*`", "", said)) if "without rows" not in each
    ]
    counted = [each for sentence in sentences for each in quantities(sentence)]
    assert len(counted) > 10
    assert [each for each in counted if each not in known] == []
