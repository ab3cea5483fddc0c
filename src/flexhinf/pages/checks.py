"""Findings about a log or a robot's description: sentences, a table, and the report of a check."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict

import numpy as np

from flexhinf.findings import Finding, above_note, worst
from flexhinf.identification import Log, LogFinding
from flexhinf.numerals import number, number_text
from flexhinf.pages.drawing import Line, Panel, SignalUnits, draw_figure, listed, note, range_text, thin
from flexhinf.pages.estimate_figures import MOST_PANELS, signal_label
from flexhinf.pages.pictures import robot_picture
from flexhinf.pages.terminal import Ending, wrapped
from flexhinf.report import (
    INK,
    SERIES,
    Badge,
    Cell,
    Column,
    Fact,
    Figure,
    LineStyle,
    Page,
    Paragraph,
    Section,
    Table,
)
from flexhinf.robot import Robot
from flexhinf.robot.examination import JointFacts, RobotExamination

#: Colours of the severities in a table.
COLOURS = {"fault": "red", "doubt": "yellow", "note": "green"}

#: Mark of a page whose worst finding is of a severity.
MARKS = {"fault": "not met", "doubt": "risky", "note": "met"}

#: What the severities mean for a log, and for a robot.
OF_LOG = (
    "What the log shows of itself and beside its robot: a fault makes numbers wrong that are taken from it, a "
    "doubt may, a note is something to know"
)
OF_ROBOT = (
    "With a fault no robot can be made of the file; a doubt makes a design wrong or impossible, or rests on a guess; a "
    "note is something to know"
)


# Findings ---------------------------------------------------------------------------------------------
def finding_texts(findings: Sequence[LogFinding]) -> list[str]:
    """Sentences of the findings that are more than a note, the worst first."""
    return [finding.text for finding in above_note(findings)]


def counted(findings: Sequence[Finding]) -> str:
    """How many there are of each severity, the worst first: ``1 fault and 2 notes``; empty without any."""
    counts = {severity: sum(each.severity == severity for each in findings) for severity in COLOURS}
    return listed([f"{count} {name}{'s' * (count != 1)}" for name, count in counts.items() if count])


def _numbers_text(finding: Finding) -> str:
    """What was expected and what there is, as a sentence; empty without numbers."""
    return f"{finding.numbers[:1].upper()}{finding.numbers[1:]}." if finding.numbers else ""


def _line(finding: Finding) -> str:
    """The finding in a terminal: how severe, what, where, the numbers, what to try."""
    advice = finding.advice.replace("`", "")
    parts = (
        f"{finding.severity}: {finding.what}",
        f"[{finding.place}]" if finding.place else "",
        _numbers_text(finding),
        advice if advice.endswith(".") or not advice else f"To try: {advice}.",
    )
    return wrapped(" ".join(filter(None, parts)))


def finding_section(
    findings: Sequence[Finding],
    numbers: Sequence[object],
    title: str = "What the log shows of itself",
    caption: str = OF_LOG,
    everywhere: str = "all",
) -> Section:
    """The findings as a section of a page: how severe, what, where, how often, what to try.

    `numbers`: of each for the JSON. `everywhere`: the place of one that has none.
    """
    columns = (
        Column("", of=lambda each: Cell(each.severity, COLOURS[each.severity])),
        Column("finding", of=lambda each: f"{each.what} {_numbers_text(each)}".rstrip()),
        Column("where", brief=None, of=lambda each: each.place or everywhere),
        Column("places", right=True, brief=None, of=lambda each: str(each.count)),
        Column("to try", of=lambda each: each.advice.removeprefix("To try: ").replace("`", "")),
    )
    table = Table.of(columns, findings, caption, "table-findings", title="Findings", stacks=True)
    found = table if findings else Paragraph("Nothing is conspicuous.")
    return Section(title, (found,), "findings", True, numbers={"findings": numbers})


def log_findings(findings: Sequence[LogFinding]) -> Section:
    """The section of what a log shows of itself; rows from 1 on in the JSON."""
    rows = [
        {
            "kind": each.kind, "severity": each.severity, "what": each.what, "advice": each.advice,
            "signal": each.signal, "column": each.column, "count": each.count,
            "rows": None if each.rows is None else [row + 1 for row in each.rows],
        }
        for each in findings
    ]  # fmt: skip
    return finding_section(findings, rows)


def check_ending(page: Page, findings: Sequence[Finding]) -> Ending:
    """What a terminal says of a check: the joints of a robot, each finding with what to try, and the verdict."""
    joints = [block for part in page.sections if part.id == "joints" for block in part.present]
    tables = [block.terminal() for block in joints if isinstance(block, Table)]
    return Ending(tables, "\n".join([*map(_line, findings), page.verdict]))


def _status(findings: Sequence[Finding], verdict: str) -> list[Badge]:
    return [Badge(MARKS[worst(findings)], verdict)]


# A log ------------------------------------------------------------------------------------------------
#: States of a log, by its worst finding.
STATES = {
    "fault": "The log is ill",
    "doubt": "The log is doubtful",
    "note": "Nothing speaks against the log",
}


def checked_log(
    source: str,
    robot: Robot,
    log: Log | None,
    findings: Sequence[LogFinding],
    command: Sequence[str],
    warnings: Sequence[str] = (),
    degrees: bool = False,
) -> Page:
    """The report of a log that was checked; `log` is None where it could not be read. Its figure shows angles in
    `degrees` if stated."""
    size, facts, several = "a log that cannot be read", list[Fact](), counted(findings)
    verdict = f"{STATES[worst(findings)]}{f': {several}' if several else ''}."
    if log is not None:
        seconds = number_text(float(log.times[-1] - log.times[0]), "s")
        measured = listed([signal_label(name) for name in log.names.get("output", ())])
        size = f"a log of {len(log)} rows in {seconds}, with {measured}"
        facts = [Fact("rows", len(log)), Fact("period", number(1e3 * log.period), "ms")]
    return Page(
        f"The log {source}, checked",
        f"{size[0].upper()}{size[1:]}, beside the robot “{robot.name}”.",
        verdict,
        [log_findings(findings), Section("The robot's file", [*map(note, warnings)], "robot")],
        command,
        facts=facts,
        status=_status(findings, verdict),
        details=finding_texts(findings)[:3],
        lead=[] if log is None else [lambda: _signals(log, robot, findings, degrees)],
        head={"says": verdict},
    )


def _signals(log: Log, robot: Robot, findings: Sequence[LogFinding], degrees: bool) -> Figure:
    """The signals of a log, those with findings first, with the rows of these."""
    units = SignalUnits(robot.plant(log.names.get("output", ())), degrees)
    tables = {
        name: values
        for kind, table in (("output", log.outputs), ("input", log.inputs))
        for name, values in zip(log.names.get(kind, ()), table.T)
    }
    named = dict.fromkeys(finding.signal for finding in above_note(findings))
    order = [*(name for name in named if name in tables), *(name for name in tables if name not in named)]
    panels: list[Panel] = []
    for name in order[:MOST_PANELS]:
        (scale, unit), few = units.of(name), thin(log.times)
        values = scale * tables[name]
        lines = [Line(log.times[few], values[few], "in the log", {"color": SERIES[0], "linewidth": 1.2})]
        for finding in above_note(findings):
            if finding.rows is not None and finding.signal in (name, "time"):
                ends = np.clip(finding.rows, 0, len(log) - 1)
                mark: LineStyle = {"color": INK, "linestyle": "", "marker": "o", "markersize": 4.0}
                lines.append(Line(log.times[ends], values[ends], finding.kind, mark))
        panels.append(Panel(signal_label(name), unit, lines))
    marked = any(len(panel.lines) > 1 for panel in panels)
    left = f" Drawn: {len(panels)} of {len(order)} signals." if len(order) > len(panels) else ""
    caption = f"As they stand in the log.{' Dots: first and last row of a finding.' * marked}{left}"
    return draw_figure("signals", panels, caption, "Signals of the log")


# A robot ----------------------------------------------------------------------------------------------
def _joint_table(joints: Sequence[JointFacts]) -> Table:
    """A row for each joint: its range, mass, weight against its motor, twist and vibrations."""

    def ends(joint: JointFacts) -> str | None:
        scale, unit = (1e3, " mm") if joint.slides else (math.degrees(1.0), "°")
        return joint.limits and f"{' to '.join(number(scale * end) for end in joint.limits)}{unit}"

    def force(joint: JointFacts, value: float, digits: int) -> str | None:
        return number_text(value, "N" if joint.slides else "N·m", digits) if math.isfinite(value) else None

    def twist(joint: JointFacts) -> str | None:
        unit = "mm" if joint.slides else "mrad"
        return None if math.isnan(joint.twist) else number_text(1e3 * joint.twist, unit, 3)

    def hertz(joint: JointFacts) -> str | None:
        return None if math.isnan(joint.slowest) else range_text([joint.slowest, joint.fastest])

    return Table.of(
        (
            Column("joint", of=lambda joint: joint.name),
            Column("range", brief=None, of=ends),
            Column("link, kg", right=True, of=lambda joint: number(joint.mass, 3)),
            Column("weight at most", right=True, of=lambda joint: force(joint, joint.weight, 3)),
            Column("motor at most", right=True, of=lambda joint: force(joint, joint.effort, 4)),
            Column("twist by it", right=True, of=twist),
            Column("vibration, Hz", right=True, of=hertz),
        ),
        joints,
        "Each joint over its range: the largest torque that holds the arm, what the motor gives, the spring's twist "
        "under it, and vibrations that are mostly of this joint",
        "table-joints",
        title="Joints",
        stacks=True,
    )


def _extremes(joints: Sequence[JointFacts]) -> list[Fact]:
    """What decides most about a design: the largest weight, the motor that it uses most of, the softest joint."""
    found = list[tuple[str, str, str, JointFacts]]()
    heaviest = max(joints, key=lambda joint: joint.weight)
    if heaviest.weight > 0.0:
        unit = "N" if heaviest.slides else "N·m"
        found.append(("largest weight", number(heaviest.weight, 3), unit, heaviest))
    if used := [joint for joint in joints if math.isfinite(joint.effort) and joint.weight > 0.0]:
        most = max(used, key=lambda joint: joint.weight / joint.effort)
        share = number(100.0 * most.weight / most.effort, 2)
        found.append(("most that weight takes of a motor", share, "%", most))
    if swinging := [joint for joint in joints if not math.isnan(joint.slowest)]:
        softest = min(swinging, key=lambda joint: joint.slowest)
        found.append(("slowest vibration", number(softest.slowest, 3), "Hz", softest))
    return [
        Fact(name, value, unit, joint.name if len(joints) > 1 else "") for name, value, unit, joint in found
    ]


def checked_robot(result: RobotExamination, command: Sequence[str]) -> Page:
    """The report of a robot's description that was checked."""
    joints, findings = result.joints, result.findings
    state, several = "The links can be read, and a design needs springs and motors", counted(findings)
    if worst(findings) == "fault":
        state = "No robot can be made of this file"
    elif result.robot is not None:
        state = "A design can be made"
    verdict = f"{state}: {several}." if several else f"{state}; nothing is conspicuous."
    robot = result.robot
    own = [asdict(each) for each in findings]
    return Page(
        f"The robot {result.path.name}, checked",
        "Before any design: what is wrong or doubtful in a robot's description.",
        verdict,
        [
            finding_section(findings, own, "What the description shows", OF_ROBOT, "the file"),
            Section(
                "Joints",
                (_joint_table(joints) if joints else None,),
                "joints",
                True,
                numbers={"joints": [asdict(each) for each in joints]},
            ),
        ],
        command,
        facts=[Fact("joints", len(joints)), *_extremes(joints)] if joints else [],
        status=_status(findings, verdict),
        details=[finding.what for finding in above_note(findings)][:3],
        lead=[] if robot is None else [lambda: robot_picture(robot)],
        head={"says": verdict},
    )
