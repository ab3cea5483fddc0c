"""``flexhinf identify``: a robot file with the numbers of a log, a motion for what it does not tell, and the page."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.identification.simulated import arm_log
from tests.refusals import unnamed

import flexhinf as fh
from flexhinf.cli import main

WORDS = ["identify", "log.csv", "--robot", "wrong.toml", "--measured", "link_position,motor_position"]


@pytest.fixture
def logged(folder: Path) -> Path:
    """A log of the paper's arm, and a file of it with a wrong spring."""
    arm = fh.load_robot("paper")
    times, u, y = arm_log(arm, count=2000)
    head = "time,motor_voltage,link_position,motor_position"
    np.savetxt(folder / "log.csv", np.column_stack([times, u, y]), delimiter=",", header=head, comments="")
    arm.with_values({"stiffness": 70.0, "friction": 0.2}).save(folder / "wrong.toml")
    return folder


def test_the_robot_file_has_the_numbers_of_the_log(logged: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*WORDS, "--parameters", "stiffness,friction"]) == 0
    report = logged / "flexhinf-identify"
    assert {"index.html", "identify.json", "robot.toml"} <= {path.name for path in report.iterdir()}
    assert not (report / "motion.csv").exists()
    found = fh.load_robot(report / "robot.toml")
    for name, true in (("stiffness", 100.0), ("friction", 0.1)):
        low, high = found[name].interval
        assert low - (high - low) < true < high + (high - low)
        assert 0.0 < high - low < 0.01 * true
    numbers: dict[str, Any] = json.loads((report / "identify.json").read_text(encoding="utf-8"))
    assert numbers["numbers"]["stiffness"]["identifiable"]
    assert numbers["numbers"]["stiffness"]["stated"] == 70.0
    assert unnamed(capsys.readouterr().out, "stiffness", "friction", "report") == []
    page = (report / "index.html").read_text(encoding="utf-8")
    assert [
        anchor for anchor in ("numbers", "innovations", "signals", "log") if f'id="{anchor}"' not in page
    ] == []


def test_what_the_log_does_not_tell_stays_and_a_motion_is_proposed(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rng = np.random.default_rng(0)
    rows = np.column_stack([1e-3 * np.arange(400), np.zeros(400), 1e-4 * rng.normal(size=(400, 2))])
    head = "time,motor_voltage,link_position,motor_position"
    np.savetxt(folder / "log.csv", rows, delimiter=",", header=head, comments="")
    fh.load_robot("paper").save(folder / "wrong.toml")
    assert main([*WORDS, "--parameters", "stiffness", "--motion", "3"]) == 1
    report = folder / "flexhinf-identify"
    assert fh.load_robot(report / "robot.toml")["stiffness"] == fh.load_robot("paper")["stiffness"]
    numbers = json.loads((report / "identify.json").read_text(encoding="utf-8"))
    assert not numbers["numbers"]["stiffness"]["identifiable"]
    assert numbers["motion"]["standard_errors"]["stiffness"] < 0.05
    assert len((report / "motion.csv").read_text(encoding="utf-8").splitlines()) > 100
    assert unnamed(capsys.readouterr().out, "stiffness") == []


@pytest.mark.parametrize(
    ("words", "anchors"),
    [
        (["--parameters", ""], ("--parameters",)),
        (["--parameters", "stifness"], ("stifness", "stiffness")),
        (["--parameters", "stiffness", "--robot", ""], ("--robot",)),
        (["--parameters", "stiffness", "--column", "motor_position=angle"], ("angle", "motor_position")),
    ],
)
def test_a_mistake_is_refused_before_any_work(
    logged: Path, words: list[str], anchors: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*WORDS, *words]) == 2
    assert unnamed(capsys.readouterr().err, *anchors) == []
    assert not (logged / "flexhinf-identify").exists()
