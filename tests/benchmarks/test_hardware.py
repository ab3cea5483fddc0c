"""Rows of ``make bench-hardware``: kept, made into tables, and measured again."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from benchmarks.hardware import __main__ as program
from benchmarks.hardware.robots import ROBOTS, files_of, without_new_keys
from benchmarks.hardware.tables import ROWS, TABLES

import flexhinf as fh

#: Searches amplify rounding: figures of a design agree within this fraction.
ROUNDING = 0.05


def run(repository: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "benchmarks.hardware", *arguments]
    return subprocess.run(command, cwd=repository, capture_output=True, text=True, check=False)


@pytest.mark.parametrize("name", [name for name, urdf in ROBOTS.items() if not urdf.startswith(":")])
def test_a_file_for_older_versions_has_the_same_numbers(name: str, tmp_path: Path) -> None:
    file, elastic = files_of(name)
    own = tmp_path / "own.toml"
    own.write_text(without_new_keys(elastic or file), encoding="utf-8")
    assert "effort_limit" not in own.read_text(encoding="utf-8")
    new = fh.load_robot(file, elastic=elastic)
    old = fh.load_robot(file, elastic=own) if elastic else fh.load_robot(own)
    uncertain = {p.name: p.interval for p in new.uncertain}
    assert old.nominal.items() >= {k: v for k, v in new.nominal.items() if "inertia_scale" not in k}.items()
    assert {p.name for p in old.uncertain} & set(uncertain)
    assert all(p.interval == uncertain[p.name] for p in old.uncertain if p.name in uncertain)


def test_tables_say_what_the_rows_say(tmp_path: Path) -> None:
    row = json.loads((ROWS / "planar-motor.json").read_text(encoding="utf-8")) | {"damping": 0.1234}
    (tmp_path / "planar-motor.json").write_text(json.dumps(row), encoding="utf-8")
    refused = {"robot": "spatial", "row": "spatial-link", "refused": "It cannot be held."}
    (tmp_path / "spatial-link.json").write_text(json.dumps(refused), encoding="utf-8")
    text = TABLES["robots"](tmp_path)
    assert "0.123" in text
    assert f"refused: {refused['refused']}" in text
    assert "0.123" in TABLES["reasons"](tmp_path)
    assert len(TABLES["payload"](tmp_path).splitlines()) == 2  # a head alone


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
    assert made == ["spatial-link", "spatial-link-linear"]
    assert json.loads((tmp_path / "spatial-link.json").read_text(encoding="utf-8")) == {"row": "spatial-link"}
    assert not (tmp_path / "spatial-link-linear.json").exists()


@pytest.mark.slow
def test_a_row_is_measured_again_as_it_is_kept(repository: Path, tmp_path: Path) -> None:
    outcome = run(repository, "--kept", str(tmp_path), "planar-link")
    assert outcome.returncode == 0, outcome.stderr
    made, kept = (
        json.loads((folder / "planar-link.json").read_text(encoding="utf-8")) for folder in (tmp_path, ROWS)
    )
    for key in ("damping", "overshoot", "noise_share", "peak_share"):
        assert made[key] == pytest.approx(kept[key], rel=ROUNDING), key
    assert made["missed"] == kept["missed"] == []
