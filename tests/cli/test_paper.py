"""``flexhinf paper``: what is wrong with its options, and where it writes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from flexhinf.cli import main


@pytest.mark.parametrize(
    ("words", "what"),
    [
        (["--nope"], "--nope"),
        (["--perio", "1"], "--perio."),
        (["--period", "fast"], "--period"),
        (["--period", "-0.001"], "sampling period"),
        (["--period", "inf"], "sampling period"),
        (["--gamma-ratio", "0"], "γ/γ*"),
        (["--gamma-ratio", "-2"], "γ/γ*"),
        (["--gamma-ratio", "nan"], "γ/γ*"),
        (["--gamma-ratio", "0.9"], "attenuation"),
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
    words: list[str], what: str, folder: Path, refused: Callable[..., str]
) -> None:
    told = refused(["paper", *words], what, folder)
    assert what in told.splitlines()[0]
    assert list(folder.iterdir()) == []


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


def test_help_lists_defaults(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["paper", "--help"]) == 0
    shown = capsys.readouterr().out
    for default in ("flexhinf-paper", "0.001", "ukf", "4"):
        assert f"[default: {default}]" in shown
