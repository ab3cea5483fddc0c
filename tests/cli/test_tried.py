"""What ``flexhinf design`` tries where a workspace misses: the printed command meets, and the design is kept."""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable
from pathlib import Path

import pytest
from tests import workspaces
from tests.refusals import unnamed

import flexhinf as fh
from flexhinf.cli import main
from flexhinf.designs import advice

# Every design compiles its loops for a few runs: compiled in half the time.
pytestmark = pytest.mark.usefixtures("unoptimised")


@pytest.fixture(autouse=True)
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    """Few poses and goals, and one bandwidth; trials do not run out of time, however busy the machine."""
    monkeypatch.setattr(advice, "cpu_seconds", lambda: 0.0)
    workspaces.few(monkeypatch, POSES=3, GOALS=3, CHOSEN_POSES=2, MODAL_POSES=20, BANDWIDTHS=(28.0,))


@pytest.fixture
def robot(uncertain_arm: Callable[[str], str]) -> str:
    """A robot's file with tolerances, whose gain margin is below 2."""
    return uncertain_arm("my arm.toml")


@pytest.mark.ci("designs a workspace three times")
@pytest.mark.parametrize("words", [["--out", "here"], ["--set", "ripple=0.2"]])
def test_the_command_that_is_printed_meets_all(
    robot: str, words: list[str], folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Alone, and where one change is not enough; stated options stay, and are replaced where they are changed."""
    assert main(["design", robot, *words]) == 1
    shown = capsys.readouterr().out
    told = re.search(r"next: (flexhinf design .*)  # meets", shown)
    assert told
    command = shlex.split(told[1])
    assert command[:3] == ["flexhinf", "design", robot]
    assert len({*command}) == len(command)
    page = (folder / ("here" if "here" in words else "flexhinf-design") / "index.html").read_text("utf-8")
    assert command[-1] in page
    assert main(command[1:]) == 0
    assert unnamed(capsys.readouterr().out, "NOT MET") != []


@pytest.mark.ci("designs a workspace twice")
def test_an_interruption_keeps_the_design_and_without_advice_nothing_is_tried(
    robot: str, folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def stop(*arguments: object, **options: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(advice, "design_workspace", stop)
    assert main(["design", robot]) == 130
    shown = capsys.readouterr()
    assert unnamed(shown.out, "NOT MET", "report:") == []
    assert unnamed(shown.err, "Interrupted", "flexhinf-design") == []
    assert (folder / "flexhinf-design" / "design.toml").exists()
    assert main(["design", robot, "--no-advice"]) == 1
    assert "Tried" not in capsys.readouterr().out


@pytest.mark.ci("designs a workspace of two joints three times")
def test_joints_that_are_tried_rigid_have_a_file_that_the_command_takes(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The file lies in the report's folder, which the command does not replace."""
    monkeypatch.setattr(advice, "unseen", lambda robot, period: () if robot.rigid else ("elbow",))
    monkeypatch.setattr(advice.Trial, "met", property(lambda trial: trial.whole))
    monkeypatch.setattr(advice, "relaxable", lambda line: True)
    monkeypatch.setattr(advice, "finer_noise", lambda design: "")  # which would be tried before
    words = ["--set", "gain_margin=9", "--draws", "0", "--saturation", "48"]
    assert main(["design", "planar-two-link", *words]) == 1
    told = re.search(r"next: (flexhinf design .*)  # meets", capsys.readouterr().out)
    assert told
    command = shlex.split(told[1])
    robot = folder / command[2]
    assert fh.load_robot(robot).rigid == ("elbow",)
    assert command[-2:] == ["--out", "flexhinf-design-rigid"]
    assert {"gain_margin=9", "--draws", "--saturation"} < {*command}
    assert main([*command[1:], "--no-advice"]) in (0, 1)
    assert robot.exists()
    assert (folder / "flexhinf-design-rigid" / "index.html").exists()
