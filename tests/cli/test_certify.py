"""``flexhinf certify``: a certificate is written, checked, and refused where it claims too much."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from flexhinf.certify import load_certificate
from flexhinf.cli import main

DESIGN = """[design]
robot = "paper"
pose = [3.141592653589793]
penalty = [75, 27, 90, 27, 330]
effort = 10
checked_penalty = [60, 0, 0, 0, 300]
gamma_ratio = 1.5
checked_gamma_ratio = 1.6
degrees = [2, 4]
"""


@pytest.mark.slow
def test_a_design_is_certified_and_its_certificate_checked(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "design.toml").write_text(DESIGN, encoding="utf-8")
    assert main(["certify", "design.toml", "--degree", "2"]) == 0
    shown = capsys.readouterr().out
    for text in (
        "99.9 %",
        "V smallest",
        "input unchanged",
        "Steps from rest up to 1.49",
        "nominal parameters",
    ):
        assert text in shown, text
    assert sorted(path.name for path in folder.iterdir()) == ["certificate.json", "design.toml"]
    certificate = load_certificate(folder / "certificate.json")
    assert certificate.about.startswith("paper, goal 3.14159, degree 2")
    replace(certificate, level=1.002 * certificate.level, starts=()).save(folder / "more.json")
    assert main(["certify", "--check", "more.json"]) == 1
    assert "REFUSED: " in capsys.readouterr().out


@pytest.mark.slow
def test_a_certificate_is_proved_again(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "design.toml").write_text(DESIGN, encoding="utf-8")
    assert main(["certify", "design.toml", "--degree", "4", "--out", "four.json"]) == 0
    assert main(["certify", "--check", "four.json"]) == 0
    assert "PROVED again from the file alone" in capsys.readouterr().out
    content = json.loads((folder / "four.json").read_text(encoding="utf-8"))
    assert content["format"] == "flexhinf certificate"


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["certify"], "a robot, a design file, or --check FILE"),
        (["certify", "paper", "--check", "certificate.json"], "without a robot"),
        pytest.param(
            ["certify", "paper", "--goal", "90deg", "--degrees", "2"],
            "no margin in some direction",
            marks=pytest.mark.slow,
        ),
        (["certify", "planar-two-link", "--degrees", "2"], "at most 5 states"),
        (["certify", "--check", "missing.json"], "missing.json"),
    ],
)
def test_what_cannot_be_certified_is_told_and_nothing_is_written(
    folder: Path, capsys: pytest.CaptureFixture[str], words: list[str], text: str
) -> None:
    assert main(words) == 2
    assert text in " ".join(capsys.readouterr().err.split())
    assert list(folder.iterdir()) == []
