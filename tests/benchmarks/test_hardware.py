"""Rows of ``make bench-hardware``: kept, made into tables, and measured again."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from benchmarks.hardware import __main__ as program
from benchmarks.hardware.tables import ROWS, TABLES

#: Searches amplify rounding: figures of a design agree within this fraction.
ROUNDING = 0.05


def run(repository: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "benchmarks.hardware", *arguments]
    return subprocess.run(command, cwd=repository, capture_output=True, text=True, check=False)


def test_tables_say_what_the_rows_say(tmp_path: Path) -> None:
    row = json.loads((ROWS / "planar-motor.json").read_text(encoding="utf-8")) | {"damping": 0.1234}
    (tmp_path / "planar-motor.json").write_text(json.dumps(row), encoding="utf-8")
    refused = {"robot": "spatial", "row": "spatial-link", "refused": "It cannot be held."}
    (tmp_path / "spatial-link.json").write_text(json.dumps(refused), encoding="utf-8")
    text = TABLES["robots"](tmp_path)
    assert "0.123" in text
    assert f"refused: {refused['refused']}" in text
    assert len(TABLES["payload"](tmp_path).splitlines()) == 2  # a head alone
    assert "not measured" in TABLES["arm"](tmp_path).lower()


def test_the_requirements_of_the_arm_are_shown(tmp_path: Path) -> None:
    line = ["200 random poses", "damping", "≥ 0.2*", "0.234", "met"]
    (tmp_path / "arm-half.json").write_text(json.dumps({"requirements": [line]}), encoding="utf-8")
    assert TABLES["arm"](tmp_path).splitlines()[2:] == [f"| {' | '.join(line)} |"]


def test_a_payload_that_makes_poses_unstable_is_said(tmp_path: Path) -> None:
    row = json.loads((ROWS / "arm-middle.json").read_text(encoding="utf-8"))
    row["carried"][0]["unstable"], row["carried"][-1]["unstable"] = 3, 0
    (tmp_path / "arm-middle.json").write_text(json.dumps(row), encoding="utf-8")
    first, *_, last = TABLES["payload"](tmp_path).splitlines()[2:]
    assert f"3 of {row['poses']} unstable" in first
    assert f"{row['carried'][-1]['damping']:.3f}" in last


def test_rows_that_are_there_are_not_made_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def unwanted(row: str, *others: Any) -> dict[str, Any]:
        made.append(row)
        if len(made) > 1:
            raise KeyboardInterrupt
        return {"row": row}

    made: list[str] = []
    monkeypatch.setattr(program, "made", unwanted)
    for row in program.tasks():
        if not row.startswith("spatial"):
            (tmp_path / f"{row}.json").write_text("{}", encoding="utf-8")
    monkeypatch.setattr(sys, "argv", ["hardware", "--kept", str(tmp_path)])
    assert program.main() == 130  # interrupted in the second row, and the first is kept
    assert made == ["spatial-link", "spatial-torque"]
    assert json.loads((tmp_path / "spatial-link.json").read_text(encoding="utf-8")) == {"row": "spatial-link"}
    assert not (tmp_path / "spatial-torque.json").exists()


@pytest.mark.nightly("designs, drives and judges a row anew; tables of kept rows are made in `make test`")
def test_a_row_is_measured_again_as_it_is_kept(repository: Path, tmp_path: Path) -> None:
    outcome = run(repository, "--kept", str(tmp_path), "planar-link")
    assert outcome.returncode == 0, outcome.stderr
    made, kept = (
        json.loads((folder / "planar-link.json").read_text(encoding="utf-8")) for folder in (tmp_path, ROWS)
    )
    for key in ("damping", "overshoot", "noise_share", "peak_share"):
        assert made[key] == pytest.approx(kept[key], rel=ROUNDING), key
    assert made["missed"] == kept["missed"] == []
