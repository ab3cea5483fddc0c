"""The parts of the pages that the code makes are what the code makes."""

from __future__ import annotations

import runpy
from pathlib import Path
from typing import Any

import pytest

MAKE: dict[str, Any] = runpy.run_path(str(Path(__file__).resolve().parents[2] / "docs" / "make.py"))


@pytest.mark.parametrize(
    "name", [*MAKE["QUICK"], *(pytest.param(name, marks=pytest.mark.slow) for name in MAKE["SLOW"])]
)
def test_a_part_is_what_the_code_makes(name: str, repository: Path) -> None:
    page = repository / {**MAKE["QUICK"], **MAKE["SLOW"]}[name][0]
    figure = MAKE["FIGURE"].read_text(encoding="utf-8")
    assert MAKE["written"](name) == page.read_text(encoding="utf-8"), f"run: python docs/make.py {name}"
    assert MAKE["FIGURE"].read_text(encoding="utf-8") == figure
