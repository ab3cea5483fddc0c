"""What a claim is, before and after it is judged: its criterion is fixed first, its verdict is computed from it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from flexhinf.paper.loop_setup import PaperSetup
from flexhinf.report import Claim, Table
from flexhinf.report.page import Verdict


@dataclass(frozen=True)
class Finding:
    """Result of computing one claim's criterion: whether it is met ("ties" or "not judged" where it cannot be said),
    the numbers behind that in a sentence, tables, numbers for ``metrics.json``, and what the page draws."""

    verdict: bool | Verdict
    evidence: str
    tables: tuple[Table, ...] = ()
    numbers: dict[str, Any] = field(default_factory=dict)
    data: Any = None


@dataclass(frozen=True)
class Judged:
    """A claim with its verdict and what shows it."""

    claim: Claim
    finding: Finding
    ours: bool

    def as_dict(self) -> dict[str, Any]:
        """The claim as it stands in ``metrics.json``."""
        numbers = {"numbers": self.finding.numbers} if self.finding.numbers else {}
        return {**self.claim.as_dict(), **numbers}


@dataclass(frozen=True)
class PaperClaim:
    """One claim of the paper, or one question of ours, in a sentence (``{feedback}`` stands for what is fed back to the
    law), with its criterion, what computes it, and anchors of the paper's figures that show it."""

    id: str
    text: str
    criterion: str
    judge: Callable[[PaperSetup], Finding]
    figures: tuple[str, ...] = ()
    ours: bool = False

    def judged(self, setup: PaperSetup) -> Judged:
        """Compute the verdict."""
        finding, kind = self.judge(setup), setup.settings.estimator
        verdict = finding.verdict
        if not isinstance(verdict, str):
            verdict = "holds" if verdict else "fails"
        text = self.text.format(feedback="the true state" if kind == "none" else f"the {kind.upper()}")
        claim = Claim(self.id, text, verdict, finding.evidence, self.figures, self.criterion)
        return Judged(claim, finding, self.ours)
