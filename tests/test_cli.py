"""The command line: options, exit codes, three-part messages, nothing half-written."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from flexhinf.cli import main


@pytest.mark.parametrize(
    ("words", "what"),
    [
        (["--nope"], "No such option: --nope"),
        (["--perio", "1"], "No such option: --perio"),
        (["--period", "fast"], "--period"),
        (["--period", "-0.001"], "sampling period"),
        (["--period", "inf"], "sampling period"),
        (["--gamma-ratio", "0"], "γ/γ*"),
        (["--gamma-ratio", "-2"], "γ/γ*"),
        (["--gamma-ratio", "nan"], "γ/γ*"),
        (["--gamma-ratio", "0.9"], "No stabilising solution"),
        (["--degree", "1"], "degree of V"),
        (["--degree", "4.5"], "--degree"),
        (["--degree", "99"], "degree of V"),
        (["--seed", "-1"], "seed"),
        (["--estimator", "kalman"], "estimator"),
        (["--process-noise", "-1"], "process noise"),
        (["--measurement-noise", "0"], "measurement noise"),
    ],
)
def test_a_users_mistake_is_told_in_three_parts(
    words: list[str],
    what: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["paper", *words]) == 2
    told = capsys.readouterr().err
    assert "Traceback" not in told
    lines = [line.strip() for line in told.splitlines() if line.strip()]
    assert what in lines[0]
    assert lines[1].startswith("found:")
    assert lines[2].startswith("try:")
    assert list(tmp_path.iterdir()) == []


def test_an_output_that_cannot_be_written_is_refused_before_the_work(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "notes.txt"
    file.write_text("mine")
    other = tmp_path / "mine"
    other.mkdir()
    (other / "thesis.tex").write_text("mine")
    for place in (file, other, file / "below"):
        assert main(["paper", "--out", str(place)]) == 2
        assert "try:" in capsys.readouterr().err
    assert file.read_text() == "mine"
    assert [f.name for f in other.iterdir()] == ["thesis.tex"]


def test_help_lists_commands_and_defaults(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 0
    assert "paper" in capsys.readouterr().out
    assert main(["paper", "--help"]) == 0
    shown = capsys.readouterr().out
    for default in ("flexhinf-paper", "0.001", "ukf", "4"):
        assert f"[default: {default}]" in shown
    assert main(["--version"]) == 0
    assert capsys.readouterr().out.startswith("flexhinf ")


def test_an_unknown_command_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["papers"]) == 2
    assert "papers" in capsys.readouterr().err


def test_it_runs_as_a_module() -> None:
    outcome = subprocess.run(
        [sys.executable, "-m", "flexhinf", "paper", "--nope"], capture_output=True, text=True, check=False
    )
    assert outcome.returncode == 2
    assert "try:" in outcome.stderr
