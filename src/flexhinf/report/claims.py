"""Claims and what became of them: a table with one verdict per claim, and the evidence of each below."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

from flexhinf.errors import InvalidInput
from flexhinf.report.blocks import Block, check_id, escape, prose

Verdict = Literal["holds", "fails", "ties", "not judged"]

_SIGN: dict[str, str] = {"holds": "✓", "fails": "✗", "ties": "≈", "not judged": "○"}

#: The order of a page: what fails first.
_ORDER: tuple[str, ...] = ("fails", "ties", "not judged", "holds")


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
    criterion : str, optional
        By what it is judged, fixed before the result; shown before the verdict.

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
    criterion: str = ""

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
        entry = {"id": self.id, "text": self.text, "criterion": self.criterion, "verdict": self.verdict}
        entry |= {"evidence": self.evidence, "repair": self.repair}
        return {key: value for key, value in entry.items() if value or key not in ("criterion", "repair")}


@dataclass(frozen=True)
class Claims(Block):
    """A table of judged claims, those that fail first; each row leads to the claim's `ClaimEvidence` on the same
    page."""

    claims: Sequence[Claim]

    def html(self) -> str:
        """The table as HTML."""
        rows = "".join(_row(claim) for claim in by_verdict(self.claims))
        return (
            '<div class="table"><table class="claims"><thead><tr><th scope="col">Claim</th>'
            '<th scope="col">Criterion</th><th scope="col">Verdict</th></tr></thead>'
            f"<tbody>{rows}</tbody></table></div>"
        )


@dataclass(frozen=True)
class ClaimEvidence(Block):
    """One claim with its criterion, its verdict, the numbers behind it, and the tables and figures that show it."""

    claim: Claim
    blocks: Sequence[Block] = ()

    def html(self) -> str:
        """An article; colour is never the only sign of a verdict."""
        claim = self.claim
        own = {name for block in self.blocks for name in block.ids()}
        links = ", ".join(
            f'<a href="#{name}">{escape(_spoken(name))}</a>' for name in claim.figures if name not in own
        )
        seen = f' <span class="seen">See {links}.</span>' if links else ""
        parts = [f'<article class="claim" id="claim-{claim.id}"><h3>{prose(claim.text)}</h3>']
        if claim.criterion:
            parts.append(f"<p><strong>Criterion.</strong> {prose(claim.criterion)}</p>")
        parts.append(f"<p>{badge(claim.verdict)} {prose(claim.evidence)}{seen}</p>")
        if claim.repair:
            parts.append(f'<p class="repair"><strong>Repaired by:</strong> {prose(claim.repair)}</p>')
        return "\n".join([*parts, *(block.html() for block in self.blocks), "</article>"])

    def ids(self) -> tuple[str, ...]:
        """The claim's anchor and those of its blocks."""
        return (f"claim-{self.claim.id}", *(name for block in self.blocks for name in block.ids()))


def by_verdict(claims: Sequence[Claim]) -> list[Claim]:
    """Claims with those that fail first, those that hold last; otherwise in their order."""
    return sorted(claims, key=lambda claim: _ORDER.index(claim.verdict))


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
    return (
        f'<tr><td><a href="#claim-{claim.id}">{prose(claim.text)}</a></td>'
        f'<td data-label="Criterion">{prose(claim.criterion)}</td><td>{badge(claim.verdict)}</td></tr>'
    )


def _spoken(anchor: str) -> str:
    """``figure-03`` is read as Figure 3."""
    word, _, rest = anchor.partition("-")
    return f"{word.capitalize()} {rest.lstrip('0') or rest}".strip()
