"""What a robot's description shows before any design: findings, and what weight and springs do to each joint."""

from __future__ import annotations

import math
import shlex
from collections.abc import Sequence
from dataclasses import asdict

from flexhinf.findings import above_note, worst
from flexhinf.numerals import number, number_text
from flexhinf.pages.drawing import range_text
from flexhinf.pages.findings import counted, numbers_sentence, page_status, place_text, severity_cell
from flexhinf.pages.pictures import robot_picture
from flexhinf.pages.terminal import Ending, wrapped
from flexhinf.report import (
    Column,
    KeyNumber,
    Page,
    Paragraph,
    Provenance,
    Section,
    Settings,
    Table,
    finite,
    to_json,
)
from flexhinf.robot.examination import JointFacts, RobotExamination


def joint_table(joints: Sequence[JointFacts]) -> Table:
    """A row for each joint: its range, mass, weight against its motor, twist and vibrations."""
    rows: list[Sequence[object]] = []
    for joint in joints:
        angle, torque, twist = (" mm", "N", "mm") if joint.slides else ("°", "N·m", "mrad")
        scale = 1e3 if joint.slides else math.degrees(1.0)
        ends = (
            None
            if joint.limits is None
            else f"{number(scale * joint.limits[0], 4)} to {number(scale * joint.limits[1], 4)}{angle}"
        )
        hertz = None if math.isnan(joint.slowest) else range_text([joint.slowest, joint.fastest])
        rows.append(
            (
                joint.name,
                ends,
                number(joint.mass, 3),
                number_text(joint.weight, torque, 3),
                None if not math.isfinite(joint.effort) else number_text(joint.effort, torque),
                None if math.isnan(joint.twist) else number_text(1e3 * joint.twist, twist, 3),
                hertz,
            )
        )
    return Table(
        (
            "joint",
            Column("range", brief=None),
            Column("link, kg", right=True),
            Column("weight at most", right=True),
            Column("motor at most", right=True),
            Column("twist by it", right=True),
            Column("vibration, Hz", right=True),
        ),
        rows,
        "Each joint over its range: the largest torque that holds the arm, what the motor gives, the spring's twist "
        "under it, and vibrations that are mostly of this joint",
        "table-joints",
        title="Joints",
        stacks=True,
    )


def robot_finding_table(result: RobotExamination) -> Table:
    """A row for each finding: how severe, what, where, what to try."""
    rows = [
        (
            severity_cell(finding),
            f"{finding.what}{numbers_sentence(finding)}",
            finding.place or "the file",
            finding.advice.replace("`", ""),
        )
        for finding in result.findings
    ]
    return Table(
        ("", "finding", Column("where", brief=None), "to try"),
        rows,
        "With a fault no robot can be made of the file; a doubt makes a design wrong or impossible, or rests on a "
        "guess; a note is something to know",
        "table-findings",
        title="Findings",
        stacks=True,
    )


def robot_verdict(result: RobotExamination) -> str:
    """How many findings there are of each severity, and whether a design can be made, as a sentence."""
    several = counted(result.findings)
    state = (
        "No robot can be made of this file"
        if worst(result.findings) == "fault"
        else "A design can be made"
        if result.robot is not None
        else "The links can be read, and a design needs springs and motors"
    )
    return f"{state}: {several}." if several else f"{state}; nothing is conspicuous."


def checked_robot_ending(result: RobotExamination) -> Ending:
    """What a terminal says of a description: its joints, each finding with what to try, and the verdict."""
    texts: list[str] = []
    for finding in result.findings:
        advice = f" To try: {finding.advice}." if finding.advice else ""
        behind = f"{place_text(finding)}{numbers_sentence(finding)}{advice.replace('`', '')}"
        texts.append(wrapped(f"{finding.severity}: {finding.what}{behind}"))
    tables = [joint_table(result.joints).terminal()] if result.joints else []
    return Ending(tables, "\n".join([*texts, robot_verdict(result)]))


def _extremes(joints: Sequence[JointFacts]) -> list[KeyNumber]:
    """What decides most about a design: the largest weight, the motor that it uses most of, the softest joint."""
    keys: list[KeyNumber] = []

    def add(name: str, value: str, unit: str, joint: JointFacts) -> None:
        keys.append(KeyNumber(name, value, unit, joint.name if len(joints) > 1 else ""))

    heaviest = max(joints, key=lambda joint: joint.weight)
    if heaviest.weight > 0.0:
        add("largest weight", number(heaviest.weight, 3), "N" if heaviest.slides else "N·m", heaviest)
    used = [joint for joint in joints if math.isfinite(joint.effort) and joint.weight > 0.0]
    if used:
        most = max(used, key=lambda joint: joint.weight / joint.effort)
        add("most that weight takes of a motor", number(100.0 * most.weight / most.effort, 2), "%", most)
    swinging = [joint for joint in joints if not math.isnan(joint.slowest)]
    if swinging:
        softest = min(swinging, key=lambda joint: joint.slowest)
        add("slowest vibration", number(softest.slowest, 3), "Hz", softest)
    return keys


def checked_robot_page(result: RobotExamination, command: Sequence[str]) -> Page:
    """The page of a description that was checked."""
    verdict, count = robot_verdict(result), len(result.joints)
    found = robot_finding_table(result) if result.findings else Paragraph("Nothing is conspicuous.")
    sections = [Section("What the description shows", (found,), "findings", open=True)]
    picture = None if result.robot is None else robot_picture(result.robot)
    if result.joints:
        sections.append(Section("Joints", (joint_table(result.joints),), "joints", open=True))
    keys = [KeyNumber("joints", count), *_extremes(result.joints)] if count else []
    return Page(
        f"The robot {result.path.name}, checked",
        "Before any design: what is wrong or doubtful in a robot's description.",
        verdict,
        sections,
        Settings({}),
        Provenance(shlex.join(command), None),
        keys,
        [page_status(result.findings, verdict)],
        [finding.what for finding in above_note(result.findings)][:3],
        [] if picture is None else [picture],
    )


def checked_robot_files(page: Page, result: RobotExamination) -> dict[str, str | bytes]:
    """The files of the report by name."""
    numbers = finite(
        {
            "findings": [asdict(finding) for finding in result.findings],
            "joints": [asdict(joint) for joint in result.joints],
            "says": robot_verdict(result),
        }
    )
    return {"index.html": page.html(), "check.json": to_json(numbers)}
