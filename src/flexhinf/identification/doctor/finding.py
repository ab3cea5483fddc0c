"""A finding about a log: what it is, where, how often, how severe, what to do."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from flexhinf.errors import InvalidInput
from flexhinf.findings import Severity
from flexhinf.notebook import Summarised


@dataclass(frozen=True, repr=False)
class LogFinding(Summarised):
    """Something that a log shows of itself, or beside its robot.

    `kind`: of the list of checks, such as "gap" or "turns". `severity`: "fault", "doubt" or "note". `what`: a sentence.
    `advice`: what to try, with the options of the commands in backticks; those of `read_log` have the same names.
    `signal`: of the plant, or "time". `column`: the file's name of it. `rows`: the first and the last row of the log,
    from 0 on, or None for all. `count`: in how many places. `refused`: whether no filter is to see such a log, and
    `numbers`: what was expected of it, and what it has.

    Examples
    --------
    >>> import flexhinf as fh
    >>> fh.LogFinding("gap", "doubt", "A gap of 0.8 s.", "Cut the log there.", "time", rows=(700, 701)).severity
    'doubt'
    """

    kind: str
    severity: Severity
    what: str
    advice: str = ""
    signal: str = ""
    column: str = ""
    rows: tuple[int, int] | None = None
    count: int = 1
    refused: bool = False
    numbers: str = ""

    def summary(self) -> dict[str, str]:
        """Severity, sentence, place, advice."""
        facts = {"severity": self.severity, "what": self.what, "where": self.place, "to try": self.advice}
        return {name: text for name, text in facts.items() if text}

    @property
    def text(self) -> str:
        """The sentence, and what to try."""
        return f"{self.what} {self.advice}".strip()

    @property
    def place(self) -> str:
        """Column and rows, as text: ``pos, rows 701 to 702``."""
        name = self.column or self.signal
        if self.rows is None:
            return name
        first, last = self.rows[0] + 1, self.rows[1] + 1
        rows = f"row {first}" if first == last else f"rows {first} to {last}"
        return f"{name}, {rows}" if name else rows

    def error(self) -> InvalidInput:
        """The finding as the refusal of a log."""
        return InvalidInput(self.what, self.numbers, self.advice.removeprefix("To try: ").replace("`", ""))

    @staticmethod
    def of(error: InvalidInput) -> LogFinding:
        """The refusal of a log as a finding."""
        return LogFinding(
            "refused", "fault", error.what, f"To try: {error.advice}.", refused=True, numbers=error.found
        )


def refuse_unusable(findings: Iterable[LogFinding]) -> None:
    """Raise the refusal of the first finding with which no filter is to see the log."""
    for finding in findings:
        if finding.refused:
            raise finding.error()
