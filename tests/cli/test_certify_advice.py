"""What `flexhinf certify` advises for a robot of several joints is a command that runs as it is printed."""

from __future__ import annotations

import shlex
from pathlib import Path

import pytest

from flexhinf.cli import main


def advised(capsys: pytest.CaptureFixture[str]) -> list[str]:
    """The command of the error's last part."""
    text = " ".join(capsys.readouterr().err.split())
    return shlex.split(text.partition("try: ")[2].partition(", which")[0])


def test_more_than_one_joint_is_told_what_else_can_be_done(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["certify", "planar-two-link", "--degrees", "2"]) == 2
    assert advised(capsys)[:3] == ["flexhinf", "design", "planar-two-link"]
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_the_advised_command_samples_a_region(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["certify", "planar-two-link"]) == 2
    words = advised(capsys)
    assert main(words[1:]) in (0, 1)
    assert "sampled, not proved" in capsys.readouterr().out
    page = (tmp_path / "flexhinf-design" / "index.html").read_text(encoding="utf-8")
    assert "V up to" in page
    assert "No region was sampled" not in page
