"""docs/robot_file.md lists every key of a robot file; its commands are run by test_commands."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from flexhinf.robot.file_keys import TABLES
from flexhinf.robot.parameters import QUANTITIES


@pytest.fixture
def page(repository: Path) -> str:
    return (repository / "docs" / "robot_file.md").read_text(encoding="utf-8")


def test_the_page_lists_every_key_with_its_unit(page: str) -> None:
    rows = [line for line in page.splitlines() if line.startswith("| `")]
    listed = {name: row for row in rows for name in re.findall(r"`([a-z_]+)`", row.split("|")[1])}
    pages = ("", "joint", "link", "sensor", "spring", "motor", "payload", "tolerances")
    keys = {key for table in pages for key in TABLES[table]}
    tables = {"joint", "link", "sensor", "spring", "motor", "penalty", "payload", "tolerances"}
    assert sorted(keys - tables - set(listed)) == []
    units = {key: QUANTITIES[key] for key in listed if key in QUANTITIES}
    wrong = [
        key
        for key, unit in units.items()
        if unit.unit not in listed[key] or unit.sliding_unit not in listed[key]
    ]
    assert len(units) > 20
    assert wrong == []
