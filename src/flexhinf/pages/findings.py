"""Findings on pages and in terminals: how many there are, the colour of each, the mark of the worst."""

from __future__ import annotations

from collections.abc import Sequence

from flexhinf.findings import Finding, worst
from flexhinf.pages.drawing import listed
from flexhinf.report import Badge, Cell

#: Colours of the severities in a table.
COLOURS = {"fault": "red", "doubt": "yellow", "note": "green"}

#: Mark of a page whose worst finding is of a severity.
MARKS = {"fault": "not met", "doubt": "risky", "note": "met"}


def severity_cell(finding: Finding) -> Cell:
    """The severity of a finding in a table."""
    return Cell(finding.severity, COLOURS[finding.severity])


def counted(findings: Sequence[Finding]) -> str:
    """How many there are of each severity, the worst first: ``1 fault and 2 notes``; empty without any."""
    counts = {severity: sum(each.severity == severity for each in findings) for severity in COLOURS}
    return listed([f"{count} {name}{'s' * (count != 1)}" for name, count in counts.items() if count])


def numbers_sentence(finding: Finding) -> str:
    """What was expected and what there is, as a sentence behind another one; empty without numbers."""
    return f" {finding.numbers[:1].upper()}{finding.numbers[1:]}." if finding.numbers else ""


def place_text(finding: Finding) -> str:
    """Where it is, behind a sentence of a terminal; empty for everywhere."""
    return f" [{finding.place}]" if finding.place else ""


def page_status(findings: Sequence[Finding], verdict: str) -> Badge:
    """The mark of a page with such findings."""
    return Badge(MARKS[worst(findings)], verdict)
