"""What docs/workspace.md says of a robot stands in a row of that robot: its tables are made parts."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from benchmarks.workspace.robots import ROBOTS

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


def test_what_is_said_of_a_robot_stands_in_its_rows(page: str) -> None:
    section = page.partition("## Against the criterion")[2].partition("\n## ")[0]
    said = re.finditer(r"^- \*\*([\w-]+)\*\*:((?:.|\n(?=  ))*)", section, re.MULTILINE)
    bullets = {found[1]: found[2] for found in said}
    assert set(bullets) == set(ROBOTS)
    for robot, text in bullets.items():
        rows = "\n".join(line for line in page.splitlines() if re.match(rf"\| {robot}[ |]", line))
        known = set(quantities(rows)) | set(re.findall(r"\d+(?:\.\d+)?", rows))
        missing = [each for each in quantities(text) if each not in known]
        assert missing == [], robot
