"""A check says the same on its page, in a terminal and in its JSON, of a log as of a robot."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

import flexhinf as fh
from flexhinf.findings import Finding
from flexhinf.pages import check_ending, checked_log, checked_robot, report_files
from flexhinf.report import Page
from flexhinf.robot.examination import JointFacts, RobotExamination, RobotFinding

FAULT = fh.LogFinding(
    "gap", "fault", "A gap.", "Cut `--rows` there.", "time", rows=(7, 8), numbers="expected 1 s, got 2"
)
NOTE = fh.LogFinding("still", "note", "A sensor rests.", count=3)


def log_page(*findings: fh.LogFinding) -> Page:
    return checked_log("run.csv", fh.load_robot("paper"), None, findings, ("flexhinf", "check"))


def robot_page(*findings: RobotFinding, joints: tuple[JointFacts, ...] = ()) -> Page:
    return checked_robot(
        RobotExamination(Path("arm.toml"), list(findings), list(joints)), ("flexhinf", "check")
    )


@pytest.mark.parametrize(
    ("page", "findings", "place"),
    [
        (log_page(FAULT, NOTE), (FAULT, NOTE), "8 to 9"),
        (
            robot_page(
                a := RobotFinding("fault", "A gap.", "elbow", "expected 1 s, got 2", "cut `--rows` there")
            ),
            (a,),
            "elbow",
        ),
    ],
    ids=["log", "robot"],
)
def test_findings_are_the_same_in_every_medium(page: Page, findings: tuple[Finding, ...], place: str) -> None:
    files = report_files(page, "check.json")
    html, numbers, terminal = (
        str(files["index.html"]),
        json.loads(files["check.json"]),
        check_ending(page, findings).text,
    )
    for text in (html, terminal):
        assert "A gap." in text
        assert "Expected 1 s, got 2." in text.replace("\N{NO-BREAK SPACE}", " ").replace("\n", " ")
        assert place in text
    assert numbers["says"] == page.verdict == terminal.splitlines()[-1]
    assert page.status[0].kind == "not met"
    assert [each["what"] for each in numbers["findings"]] == [each.what for each in findings]
    assert "`" not in terminal
    assert "check.json" in html  # among the files beside the page


def test_rows_of_a_log_count_from_one_and_nothing_is_conspicuous_without_findings() -> None:
    (first, second) = log_page(FAULT, NOTE).numbers["findings"]
    assert (first["rows"], second["rows"], second["count"]) == ([8, 9], None, 3)
    clean = log_page()
    assert clean.numbers["findings"] == []
    assert clean.status[0].kind == "met"
    assert "conspicuous" in clean.html()


def test_a_robot_shows_its_joints_where_it_has_some() -> None:
    """The second joint slides: N, mm; what is not known is null in the JSON, and a dash on the page."""
    joints = (
        JointFacts("hinge", False, (-math.pi, math.pi), 2.0, 8.0, 10.0, 0.02, 3.0, 4.0),
        JointFacts("rail", True, None, 1.0, 0.0, math.inf, math.nan, math.nan, math.nan),
    )
    page = robot_page(joints=joints)
    (table,) = (part.present[0] for part in page.sections if part.id == "joints")
    assert [list(row) for row in table.rows] == [  # type: ignore[attr-defined]
        ["hinge", "−180 to 180°", "2", "8 N·m", "10 N·m", "20 mrad", "3 to 4"],
        ["rail", None, "1", "0 N", None, None, None],
    ]
    assert [fact.text.split()[-2:] for fact in page.facts] == [
        ["joints", "2"], ["8", "N·m"], ["80", "%"], ["3", "Hz"],
    ]  # fmt: skip
    assert [joint["twist"] for joint in page.numbers["joints"]] == [0.02, None]
    assert len(check_ending(page, ()).tables) == 1
    bare = robot_page()
    assert "joints" not in [part.id for part in bare.sections if part.present]
    assert bare.numbers["joints"] == []
    assert check_ending(bare, ()).tables == []


@pytest.mark.costs("draws the signals of a log")
def test_the_signals_of_a_log_stand_on_the_first_screen() -> None:
    times, names = np.arange(20) * 0.1, {"output": ("motor_position",), "input": ("motor_voltage",)}
    log = fh.Log(times, np.zeros((20, 1)), np.sin(times)[:, None], names=names)
    page = checked_log("run.csv", fh.load_robot("paper"), log, (FAULT,), ())
    assert [fact.text for fact in page.facts] == ["rows 20", "period 100 ms"]
    html = page.html()
    assert html.count("<figure") == 1
    assert html.index("<figure") < html.index('id="summary"')
