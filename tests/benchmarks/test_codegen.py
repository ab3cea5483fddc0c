"""Rows of ``make bench-codegen``: what they promise, and one of a small controller, measured."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from benchmarks import codegen, firmware
from tests.builders import arm_controller


def test_rows_that_are_kept_are_of_every_design_and_clean_and_cost_no_more_than_before() -> None:
    kept = json.loads(codegen.KEPT.read_text(encoding="utf-8"))
    rows, before = kept["programs"], kept["before"]["programs"]
    assert [row["links"] for row in rows] == [*firmware.DESIGNS]
    assert [row["misra"] for row in rows] == [0] * len(rows)
    for row in rows:
        old = before[str(row["links"])]
        assert row["step"] <= 1.02 * old["step"]
        assert row["stack"] <= old["stack"]
    assert set(kept["before"]["text"]) == set(kept["text"])
    assert "(× 0.97) | 528 (800) |" in codegen.table(
        {**kept, "programs": [{**rows[0], "step": 0.9714 * before["1"]["step"], "stack": 528}]}
    )


def test_a_statement_is_no_docstring() -> None:
    text = '"""A file."""\n\ndef f():\n    """A function."""\n    if True:\n        return 1\n    "kept"\n'
    assert sum(1 for _ in codegen.statements(text)) == 3


@pytest.mark.ci("compiles, counts and checks exported C")
def test_a_small_controller_is_measured(tmp_path: Path) -> None:
    for tool in ("gcc", "objdump", "valgrind", "cppcheck"):
        if shutil.which(tool) is None:
            pytest.skip(f"missing: {tool}")
    arm_controller(kind=None).save(tmp_path / "1.controller")
    row = codegen.measured(1, tmp_path)
    assert row["misra"] == 0
    assert 0 < row["step"] < row["instructions"] < 10_000
    assert 0 < row["stack"] < 4_000
    assert row["kernel"] > 0.01
    assert f"| {row['instructions']:,} |" in codegen.table({"programs": [row], "text": codegen.lengths()})
