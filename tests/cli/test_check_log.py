"""``flexhinf check LOG``: its findings, exit codes 0, 1 and 2, the report; and the advice, followed."""

from __future__ import annotations

import json
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.logs import arm_log, write_log
from tests.refusals import unnamed

import flexhinf as fh
from flexhinf.cli import main

SIGNALS = ("motor_voltage", "motor_position", "link_position")
WORDS = ["check", "log.csv", "--robot", "paper", "--no-model"]


@pytest.fixture
def columns(folder: Path) -> list[np.ndarray]:
    """Time, voltage and both encoders of the paper's arm, 1 s at 1 kHz, in a new folder."""
    times, u, y = arm_log(fh.load_robot("paper"), count=1000, measured=SENSORS)
    return [times, u[:, 0], *y.T]


SENSORS = ("motor_position", "link_position")


@pytest.mark.costs("a page with a figure")
def test_a_good_log_is_good_and_an_ill_one_has_a_page(
    columns: list[np.ndarray], folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Both encoders are looked at, without --measured; nothing is written unless --out says so."""
    write_log(folder / "log.csv", SIGNALS, *columns)
    assert main(WORDS) == 0
    assert [path.name for path in folder.iterdir()] == ["log.csv"]
    columns[3][300:] = 0.1
    columns[3][:300] = 0.1
    write_log(folder / "log.csv", SIGNALS, *columns)
    capsys.readouterr()
    assert main([*WORDS, "--out", "checked"]) == 2
    said = capsys.readouterr().out
    assert unnamed(said, "fault", "Link position", "1 fault", "report") == []
    numbers: dict[str, Any] = json.loads((folder / "checked" / "check.json").read_text(encoding="utf-8"))
    assert [(one["kind"], one["severity"]) for one in numbers["findings"]] == [("dead", "fault")]
    page = (folder / "checked" / "index.html").read_text(encoding="utf-8")
    assert unnamed(page, 'id="findings"', 'id="figure-signals"', "never changes") == []


def test_a_doubt_ends_with_one(
    columns: list[np.ndarray], folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    kept = np.r_[0:300, 700:1000]
    write_log(folder / "log.csv", SIGNALS, *[column[kept] for column in columns])
    assert main(WORDS) == 1
    assert unnamed(capsys.readouterr().out, "doubt", "gap", "rows 1 to 300") == []


@pytest.mark.parametrize("turns", [True, False])
def test_the_advice_of_a_fault_leads_to_a_good_log(
    columns: list[np.ndarray], folder: Path, capsys: pytest.CaptureFixture[str], turns: bool
) -> None:
    """A turn, and lost values; the options of the advice, as they are printed."""
    columns[2] = (
        (columns[2] % (2.0 * np.pi)) if turns else np.where(np.arange(1000) % 100 == 7, -9999.0, columns[2])
    )
    write_log(folder / "log.csv", SIGNALS, *columns)
    assert main(WORDS) == 2
    said = " ".join(capsys.readouterr().out.split())
    option = said.split("To try: ")[1].split(",")[0]
    assert option == ("--unwrap motor_position" if turns else "--missing -9999")
    assert main([*WORDS, *shlex.split(option)]) == 0


def test_a_refused_log_is_a_fault_with_the_options_of_the_command_line(
    columns: list[np.ndarray], folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Times in another unit, which no filter is to see; a table of text; and no file at all is a mistake."""
    write_log(folder / "log.csv", SIGNALS, 1e6 * columns[0], *columns[1:])
    assert main(WORDS) == 2
    assert unnamed(" ".join(capsys.readouterr().out.split()), "fault", '--time "time [ms]"') == []
    (folder / "log.csv").write_text(
        "Zeit,motor_voltage,motor_position\n0,1,2\n1,2,3\n2,3,4\n", encoding="utf-8"
    )
    assert main(WORDS) == 2
    assert unnamed(capsys.readouterr().out, "times", "--time") == []


def test_a_mistake_is_one(folder: Path, refused: Callable[..., str]) -> None:
    refused(WORDS, "log.csv", folder)
    refused(["check", "log.csv"], "robot", folder)


def test_columns_of_all_joints_are_named_by_one_option_each(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The advice to the letter, of a log whose columns are in another order than the joints."""
    robot = fh.load_robot("planar-two-link")
    times = 1e-3 * np.arange(2000)
    u, y = (np.sin(np.outer(times, (3.0, 5.0)) + phase) for phase in (0.0, 1.0))
    write_log(folder / "log.csv", ("u2", "q2", "u1", "q1"), times, u[:, 1], y[:, 1], u[:, 0], y[:, 0])
    words = ["check", "log.csv", "--robot", "planar-two-link", "--no-model"]
    assert main(words) == 2
    said = " ".join(capsys.readouterr().out.split())
    advised = shlex.split(said.partition("To try: ")[2].partition(", if")[0])
    assert main([*words, *advised]) == 0
    log = fh.read_log("log.csv", robot.plant(), dict(text.split("=") for text in advised[1::2]))
    np.testing.assert_allclose(log.inputs, u)
    np.testing.assert_allclose(log.outputs, y)
    assert main([*words, *advised[:-1], "link_position=p#"]) == 2
    assert unnamed(capsys.readouterr().out, "link_position", "2 columns", "p#") == []
