"""What `flexhinf certify` advises for a robot of several joints is a command that runs as it is printed."""

from __future__ import annotations

import json
import shlex
from pathlib import Path
from types import SimpleNamespace

import pytest

import flexhinf as fh
from flexhinf.cli import main
from flexhinf.designs import certification


def advised(capsys: pytest.CaptureFixture[str]) -> list[str]:
    """The command of the error's last part."""
    text = " ".join(capsys.readouterr().err.split())
    return shlex.split(text.partition("try: ")[2].partition(", which")[0])


def test_more_than_one_joint_is_told_what_else_can_be_done(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["certify", "planar-two-link", "--pose", "home", "--degrees", "2"]) == 2
    assert advised(capsys)[:3] == ["flexhinf", "design", "planar-two-link"]
    assert not list(tmp_path.iterdir())


def test_the_advice_names_the_file_that_was_typed_and_keeps_what_was_asked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Not the name that the robot gives itself, which is no file."""
    monkeypatch.chdir(tmp_path)
    file = Path(fh.__file__).parent / "robot" / "catalogue" / "planar-two-link.toml"
    text = file.read_text(encoding="utf-8").replace('"planar-two-link"', '"vertarm"', 1)
    Path("my arm.toml").write_text(text, encoding="utf-8")
    asked = ["my arm.toml", "--pose", "45,30", "--measured", "link_position,motor_position"]
    assert main(["certify", *asked, "--decay", "0.1", "--threads", "1", "--damping", "0.2"]) == 2
    asked[1] = "--pose"
    assert advised(capsys) == [
        "flexhinf",
        "design",
        *asked,
        "--degrees",
        "2",
        "--damping",
        "0.3",
        "--set",
        "rays=50",
    ]


@pytest.mark.parametrize(
    "words", [["paper", "--pose", "home"], ["paper", "--degree", "4", "--pose", "90deg", "--set", "effort=9"]]
)
def test_where_nothing_is_proved_the_advice_is_the_whole_command(
    words: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """`flexhinf certify paper --pose home`, which is tried first. With the advised options it may come to a proof, or
    say more."""
    known = list[fh.Specification]()

    def tried(robot: fh.Robot, s: fh.Specification, *_: object, **__: object) -> tuple[object, ...]:
        known.append(s)
        choice = SimpleNamespace(degree=4)
        return (SimpleNamespace(used=True, certificate=None, reason="no margin", box=None, choice=choice),)

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(certification, "certify_design", tried)
    assert main(["certify", *words]) == 2
    command = shlex.split(
        " ".join(capsys.readouterr().err.split()).partition("try: ")[2].partition(", or ")[0]
    )
    assert command[:3] == ["flexhinf", "certify", "paper"]
    assert main(command[1:]) == 2
    assert (known[1].preset, known[1].degrees, known[1].pose) == ("damped", (2,), known[0].pose)
    again = " ".join(capsys.readouterr().err.split()).partition("try: ")[2]
    assert "flexhinf" not in again
    assert again


@pytest.mark.parametrize(
    "less",
    [
        pytest.param(
            ["--draws", "0", "--estimator", "none"],
            marks=pytest.mark.ci("designs two links and samples a region"),
        ),
        pytest.param([], marks=pytest.mark.nightly("the command as it is printed")),
    ],
    ids=["less", "whole"],
)
def test_the_advised_command_samples_a_region(
    less: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["certify", "planar-two-link", "--pose", "0.3,0.2"]) == 2
    words = advised(capsys)
    assert words[-1] == "rays=50"
    words[-1] = "rays=5" if less else words[-1]  # a setting is stated once
    assert main([*words[1:], *less]) in (0, 1)
    page = (tmp_path / "flexhinf-design" / "index.html").read_text(encoding="utf-8")
    assert "V up to" in page
    notes = json.loads((tmp_path / "flexhinf-design" / "design.json").read_text(encoding="utf-8"))["notes"]
    assert not any("--set rays" in note for note in notes)  # a region was sampled
