"""What a claim is, before and after it is judged: its criterion is fixed first, its verdict is computed from it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from flexhinf.paper.experiments import Experiments
from flexhinf.report import Claim, Table


@dataclass(frozen=True)
class Finding:
    """Result of computing one claim's criterion.

    Attributes
    ----------
    verdict : bool or str
        Whether the criterion is met; "ties" or "not judged" where it cannot be said.
    evidence : str
        The numbers behind the verdict, in a sentence.
    tables : tuple of Table
    numbers : dict
        For ``metrics.json``.
    data : object
        What the page draws.
    """

    verdict: bool | str
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
    """One claim of the paper, or one question of ours.

    Attributes
    ----------
    text : str
        The claim in a sentence; ``{feedback}`` stands for what is fed back to the law.
    criterion : str
        By what it is judged.
    judge : callable
        Computes the criterion.
    figures : tuple of str
        Anchors of the paper's figures that show it.
    ours : bool
        Whether the question is ours; otherwise the claim is the paper's.
    """

    id: str
    text: str
    criterion: str
    judge: Callable[[Experiments], Finding]
    figures: tuple[str, ...] = ()
    ours: bool = False

    def judged(self, experiments: Experiments) -> Judged:
        """Compute the verdict."""
        finding, verdict = self.judge(experiments), "not judged"
        if isinstance(finding.verdict, str):
            verdict = finding.verdict
        else:
            verdict = "holds" if finding.verdict else "fails"
        text = self.text.format(feedback=experiments.setup.feedback)
        claim = Claim(self.id, text, verdict, finding.evidence, "", self.figures, self.criterion)  # pyright: ignore[reportArgumentType]
        return Judged(claim, finding, self.ours)
