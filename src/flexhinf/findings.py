"""How severe a finding is, about a log or a robot's description, and the order that follows from it."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Literal, Protocol, TypeVar

#: How severe a finding is, the worst first. A fault makes numbers wrong, or a robot impossible; a doubt may; a note is
#: something to know.
Severity = Literal["fault", "doubt", "note"]
SEVERITIES: tuple[Severity, ...] = ("fault", "doubt", "note")


class Finding(Protocol):
    """What findings of all kinds have."""

    @property
    def severity(self) -> Severity:
        """How severe it is."""
        ...

    @property
    def what(self) -> str:
        """A sentence."""
        ...

    @property
    def place(self) -> str:
        """Where it is; empty for everywhere."""
        ...

    @property
    def numbers(self) -> str:
        """What was expected, and what there is."""
        ...

    @property
    def advice(self) -> str:
        """What to try; options between backticks."""
        ...

    @property
    def count(self) -> int:
        """In how many places."""
        ...


AnyFinding = TypeVar("AnyFinding", bound=Finding)


def ordered(findings: Iterable[AnyFinding]) -> tuple[AnyFinding, ...]:
    """Findings, the worst first; of equal ones in the order of the checks, causes before what follows from them."""
    return tuple(sorted(findings, key=lambda finding: SEVERITIES.index(finding.severity)))


def above_note(findings: Iterable[AnyFinding]) -> list[AnyFinding]:
    """Findings that are more than a note."""
    return [finding for finding in findings if finding.severity != "note"]


def worst(findings: Iterable[Finding]) -> Severity:
    """The severity of the worst finding; a note where there is none."""
    found: list[Severity] = ["note", *(finding.severity for finding in findings)]
    return min(found, key=SEVERITIES.index)
