"""What a log shows of itself, as a table and as sentences that come before anything that blames the model."""

from __future__ import annotations

import shlex
from collections.abc import Sequence

import numpy as np

from flexhinf.findings import above_note, worst
from flexhinf.identification import Log, LogFinding
from flexhinf.numerals import number_text
from flexhinf.pages.drawing import Line, Panel, SignalUnits, draw_figure, listed, note, thin
from flexhinf.pages.estimate_figures import MOST_PANELS, signal_label
from flexhinf.pages.findings import counted, numbers_sentence, page_status, place_text, severity_cell
from flexhinf.pages.terminal import Ending, wrapped
from flexhinf.report import (
    INK,
    SERIES,
    Column,
    Figure,
    KeyNumber,
    LineStyle,
    Page,
    Paragraph,
    Provenance,
    Section,
    Settings,
    Table,
    finite,
    house_style,
    to_json,
)
from flexhinf.robot import Robot


def finding_texts(findings: Sequence[LogFinding]) -> list[str]:
    """Sentences of the findings that are more than a note, the worst first."""
    return [finding.text for finding in above_note(findings)]


def finding_table(findings: Sequence[LogFinding]) -> Table:
    """A row for each finding: how severe, what, where, how often, what to try."""
    rows = [
        (
            severity_cell(finding),
            f"{finding.what}{f' ({finding.numbers})' if finding.numbers else ''}",
            finding.place or "all",
            str(finding.count),
            finding.advice.removeprefix("To try: ").replace("`", ""),
        )
        for finding in findings
    ]
    return Table(
        ("", "finding", Column("where", brief=None), Column("places", right=True, brief=None), "to try"),
        rows,
        "What the log shows of itself and beside its robot: a fault makes numbers wrong that are taken from it, a "
        "doubt may, a note is something to know",
        "table-findings",
        title="Findings",
        stacks=True,
    )


def finding_section(findings: Sequence[LogFinding]) -> Section:
    """The findings as a section of a page."""
    found = finding_table(findings) if findings else Paragraph("Nothing is conspicuous.")
    return Section("What the log shows of itself", (found,), "findings", open=True)


def finding_numbers(findings: Sequence[LogFinding]) -> list[dict[str, object]]:
    """The findings for the JSON of a page; rows from 1 on."""
    return [
        {
            "kind": finding.kind,
            "severity": finding.severity,
            "what": finding.what,
            "advice": finding.advice,
            "signal": finding.signal,
            "column": finding.column,
            "count": finding.count,
            "rows": None if finding.rows is None else [row + 1 for row in finding.rows],
        }
        for finding in findings
    ]


def checked_verdict(findings: Sequence[LogFinding]) -> str:
    """How many findings there are of each severity, as a sentence."""
    states = {
        "fault": "The log is ill",
        "doubt": "The log is doubtful",
        "note": "Nothing speaks against the log",
    }
    several = counted(findings)
    return f"{states[worst(findings)]}{f': {several}' if several else ''}."


def checked_log_ending(findings: Sequence[LogFinding]) -> Ending:
    """What a terminal says of a log that was checked: each finding with what to try, and the verdict."""
    texts: list[str] = []
    for finding in findings:
        behind = f"{numbers_sentence(finding)}{place_text(finding)} {finding.advice.replace('`', '')}"
        texts.append(wrapped(f"{finding.severity}: {finding.what}{behind}".strip()))
    return Ending([], "\n".join([*texts, checked_verdict(findings)]))


def checked_log_page(
    source: str,
    robot: Robot,
    log: Log | None,
    findings: Sequence[LogFinding],
    command: Sequence[str],
    warnings: Sequence[str] = (),
    degrees: bool = False,
) -> Page:
    """The page of a log that was checked; `log` is None where it could not be read. Its figure shows angles in
    `degrees` if stated."""
    size = "a log that cannot be read"
    keys = []
    if log is not None:
        seconds = number_text(float(log.times[-1] - log.times[0]), "s")
        measured = listed([signal_label(name) for name in log.names.get("output", ())])
        size = f"a log of {len(log)} rows in {seconds}, with {measured}"
        keys = [
            KeyNumber("rows", len(log)),
            KeyNumber("period", number_text(1e3 * log.period, ""), "ms"),
        ]
    verdict = checked_verdict(findings)
    sections = [finding_section(findings)]
    with house_style():
        lead = [] if log is None else [_signals(log, robot, findings, degrees)]
    if warnings:
        sections.append(Section("The robot's file", tuple(note(text) for text in warnings), "robot"))
    return Page(
        f"The log {source}, checked",
        f"{size[0].upper()}{size[1:]}, beside the robot “{robot.name}”.",
        verdict,
        sections,
        Settings({}),
        Provenance(shlex.join(command), None),
        keys,
        [page_status(findings, verdict)],
        finding_texts(findings)[:3],
        lead,
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


def checked_log_files(page: Page, findings: Sequence[LogFinding]) -> dict[str, str | bytes]:
    """The files of the report by name."""
    numbers = finite({"findings": finding_numbers(findings), "says": checked_verdict(findings)})
    return {"index.html": page.html(), "check.json": to_json(numbers)}
