"""Claims and what became of them: a table with one verdict per claim."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

from flexhinf.errors import InvalidInput
from flexhinf.report.blocks import check_id
from flexhinf.report.text import escape, prose

__all__ = ["Claim", "Claims", "Verdict", "summary"]

Verdict = Literal["holds", "fails", "ties", "not judged"]

_SIGN: dict[str, str] = {"holds": "✓", "fails": "✗", "ties": "≈", "not judged": "○"}


@dataclass(frozen=True)
class Claim:
    """One claim, judged.

    Parameters
    ----------
    id : str
        Its name in ``metrics.json`` and, after ``claim-``, its anchor on the page.
    text : str
        The claim in one sentence.
    verdict : {"holds", "fails", "ties", "not judged"}
        "ties": the difference lies within its own confidence interval.
    evidence : str
        The numbers behind the verdict.
    repair : str, optional
        Where the claim fails: the smallest change that makes it hold.
    figures : tuple of str, optional
        Anchors of the figures that show it.

    Raises
    ------
    InvalidInput
        The verdict is none of the four, or the id cannot be an anchor.
    """

    id: str
    text: str
    verdict: Verdict
    evidence: str
    repair: str = ""
    figures: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        check_id(self.id)
        if self.verdict not in get_args(Verdict):
            raise InvalidInput(
                "A claim has one of four verdicts.",
                f"expected one of {', '.join(get_args(Verdict))}; got {self.verdict!r} for {self.id!r}",
                "'not judged' where the run gave no evidence",
            )

    def as_dict(self) -> dict[str, str]:
        """The claim as it stands in ``metrics.json``."""
        entry = {"id": self.id, "text": self.text, "verdict": self.verdict, "evidence": self.evidence}
        return {**entry, "repair": self.repair} if self.repair else entry


@dataclass(frozen=True)
class Claims:
    """A table of judged claims; colour is never the only sign of a verdict."""

    claims: Sequence[Claim]

    def html(self) -> str:
        """The table as HTML."""
        rows = "".join(_row(claim) for claim in self.claims)
        return (
            '<div class="table"><table class="claims"><thead><tr><th scope="col">Verdict</th>'
            '<th scope="col">Claim</th><th scope="col">Evidence</th></tr></thead>'
            f"<tbody>{rows}</tbody></table></div>"
        )

    def ids(self) -> tuple[str, ...]:
        """One anchor per claim."""
        return tuple(f"claim-{claim.id}" for claim in self.claims)


def summary(claims: Sequence[Claim]) -> str:
    """How many claims got which verdict, as words.

    Examples
    --------
    >>> summary([Claim("a", "A.", "holds", "1 < 2"), Claim("b", "B.", "fails", "2 > 1")])
    'Of 2 claims 1 holds, 1 fails.'
    """
    plural = {"holds": "hold", "fails": "fail", "ties": "tie", "not judged": "not judged"}
    verdicts = [claim.verdict for claim in claims]
    counts = [(verdict, verdicts.count(verdict)) for verdict in get_args(Verdict)]
    parts = []
    for verdict, count in counts:
        if count:
            words = verdict if count == 1 else plural[verdict]
            auxiliary = ("is " if count == 1 else "are ") if verdict == "not judged" else ""
            parts.append(f"{count} {auxiliary}{words}")
    noun = "claim" if len(verdicts) == 1 else "claims"
    return f"Of {len(verdicts)} {noun} {', '.join(parts)}." if parts else "No claim was judged."


def badge(verdict: str) -> str:
    """A coloured label with a sign and the word."""
    kind = verdict.replace(" ", "-")
    sign = f'<span aria-hidden="true">{_SIGN[verdict]}</span>'
    return f'<span class="badge {kind}">{sign} {escape(verdict)}</span>'


def _row(claim: Claim) -> str:
    links = ", ".join(f'<a href="#{name}">{escape(_spoken(name))}</a>' for name in claim.figures)
    seen = f'<span class="seen">{links}</span>' if links else ""
    repair = (
        f'<p class="repair"><strong>Repaired by:</strong> {prose(claim.repair)}</p>' if claim.repair else ""
    )
    return (
        f'<tr id="claim-{claim.id}"><td>{badge(claim.verdict)}</td>'
        f"<td>{prose(claim.text)} {seen}</td><td>{prose(claim.evidence)}{repair}</td></tr>"
    )


def _spoken(anchor: str) -> str:
    """``figure-03`` is read as Figure 3."""
    word, _, rest = anchor.partition("-")
    return f"{word.capitalize()} {rest.lstrip('0') or rest}".strip()
