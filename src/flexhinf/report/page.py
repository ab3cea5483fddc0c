"""One self-contained HTML page: no network, no scripts, light and dark, fit to be printed.

From top to bottom: the request, what is not met, not proved or risky, the verdict, the numbers that matter; sections
with figures and tables; then every assumption and setting, versions, seed and the command that makes the page again.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib import resources
from typing import Any, Literal, get_args

from flexhinf.errors import refuse_if
from flexhinf.report.blocks import (
    Anchored,
    Block,
    Provenance,
    Setting,
    Settings,
    escape,
    prose,
    scalar,
    unit_html,
)
from flexhinf.report.figure import DARK, LIGHT
from flexhinf.validation import one_of

Verdict = Literal["holds", "fails", "ties", "not judged"]

#: Colours in the style sheet and sign of each verdict and status: colour is never the only one.
_BADGES = {
    "holds": ("holds", "✓"),
    "fails": ("fails", "✗"),
    "ties": ("ties", "≈"),
    "not judged": ("not-judged", "○"),
    "met": ("holds", "✓"),
    "proved": ("holds", "✓"),
    "not met": ("fails", "✗"),
    "not proved": ("not-judged", "○"),
    "risky": ("ties", "!"),
}


@dataclass(frozen=True)
class Claim(Anchored):
    """One claim of a paper, judged: "holds", "fails", "ties" (the difference lies within its own confidence interval)
    or "not judged"; another verdict is refused with `InvalidInput`.

    `id` is its name in ``metrics.json`` and, after ``claim-``, its anchor; `evidence` the numbers behind the verdict;
    `figures` anchors of the figures that show it; `criterion` is fixed before the result and shown before the verdict;
    `blocks` are tables and figures of its own, `numbers` what else ``metrics.json`` holds, `data` what a page draws.
    """

    id: str
    text: str
    verdict: Verdict
    evidence: str
    figures: tuple[str, ...] = ()
    criterion: str = ""
    blocks: Sequence[Block] = ()
    numbers: Mapping[str, Any] = field(default_factory=dict)
    data: Any = None

    def __post_init__(self) -> None:
        super().__post_init__()
        one_of("There is no such verdict.", self.verdict, get_args(Verdict))

    def as_dict(self) -> dict[str, Any]:
        """The claim as it stands in ``metrics.json``."""
        return {
            "id": self.id,
            "text": self.text,
            **({"criterion": self.criterion} if self.criterion else {}),
            "verdict": self.verdict,
            "evidence": self.evidence,
            **({"numbers": self.numbers} if self.numbers else {}),
        }

    def ids(self) -> tuple[str, ...]:
        """The anchors of the claim and of its blocks."""
        return (f"claim-{self.id}", *(name for block in self.blocks for name in block.ids()))

    def html(self) -> str:
        """The claim as HTML, with its evidence; colour is never the only sign of a verdict."""
        links = []
        for name in (name for name in self.figures if name not in self.ids()):
            word, _, tail = name.partition("-")  # figure-03 is read as Figure 3
            spoken = f"{word.capitalize()} {tail.lstrip('0') or tail}".strip()
            links.append(f'<a href="#{name}">{escape(spoken)}</a>')
        seen = f' <span class="seen">See {", ".join(links)}.</span>' if links else ""
        return "\n".join(filter(None, (
            f'<article class="claim" id="claim-{self.id}"><h3>{prose(self.text)}</h3>',
            f"<p><strong>Criterion.</strong> {prose(self.criterion)}</p>" if self.criterion else "",
            f"<p>{badge(self.verdict)} {prose(self.evidence)}{seen}</p>", *(block.html() for block in self.blocks),
            "</article>",
        )))  # fmt: skip


@dataclass(frozen=True)
class Claims(Block):
    """A table of judged claims, those that fail first; each row leads to the claim's evidence on the same page."""

    claims: Sequence[Claim]

    def html(self) -> str:
        """The table as HTML."""
        rows = "".join(
            f'<tr><td><a href="#claim-{claim.id}">{prose(claim.text)}</a></td><td data-label="Criterion">'
            f"{prose(claim.criterion)}</td><td>{badge(claim.verdict)}</td></tr>"
            for claim in by_verdict(self.claims)
        )
        return (
            '<div class="table"><table class="claims"><thead><tr><th scope="col">Claim</th>'
            '<th scope="col">Criterion</th><th scope="col">Verdict</th></tr></thead>'
            f"<tbody>{rows}</tbody></table></div>"
        )


def by_verdict(claims: Sequence[Claim]) -> list[Claim]:
    """Claims with those that fail first, those that hold last; otherwise in their order."""
    return sorted(claims, key=lambda claim: ("fails", "ties", "not judged", "holds").index(claim.verdict))


def summary(claims: Sequence[Claim]) -> str:
    """Number of claims with each verdict, as a sentence.

    Examples
    --------
    >>> summary([Claim("a", "A.", "holds", "1 < 2"), Claim("b", "B.", "fails", "2 > 1")])
    'Of 2 claims 1 holds, 1 fails.'
    """
    verbs = {
        "holds": ("holds", "hold"), "fails": ("fails", "fail"), "ties": ("ties", "tie"),
        "not judged": ("is not judged", "are not judged"),
    }  # fmt: skip
    counts = Counter(claim.verdict for claim in claims)
    parts = [f"{counts[kind]} {text[counts[kind] > 1]}" for kind, text in verbs.items() if counts[kind]]
    noun = "claim" if len(claims) == 1 else "claims"
    return f"Of {len(claims)} {noun} {', '.join(parts)}." if parts else "No claim was judged."


def badge(kind: str) -> str:
    """A coloured label with a sign and the word."""
    colours, sign = _BADGES[kind]
    return f'<span class="badge {colours}"><span aria-hidden="true">{sign}</span> {kind}</span>'


@dataclass(frozen=True)
class Status:
    """An entry at the top that says how far a result can be relied on: met, proved, not met, not proved or
    risky. Another kind is refused with `InvalidInput`."""

    kind: str
    text: str

    def __post_init__(self) -> None:
        one_of(
            "There is no such status.", self.kind, [kind for kind in _BADGES if kind not in get_args(Verdict)]
        )


class KeyNumber(Setting):
    """One of the few numbers at the top of a page."""


@dataclass(frozen=True)
class Section(Anchored):
    """A heading and the blocks under it; `id` is its anchor."""

    title: str
    blocks: Sequence[Block]
    id: str

    def ids(self) -> tuple[str, ...]:
        """The anchors of the section and of its blocks."""
        return (self.id, *(name for block in self.blocks for name in block.ids()))

    def html(self) -> str:
        """The section as HTML."""
        body = "\n".join(block.html() for block in self.blocks)
        return f'<section id="{self.id}">\n<h2>{prose(self.title)}</h2>\n{body}\n</section>'


@dataclass(frozen=True)
class Page:
    """A report: the request, in one or two sentences; the verdict, in one line; the sections; every setting;
    command, seed and versions; the numbers that matter; what is not met, not proved or risky.

    Raises InvalidInput: two parts of the page have the same anchor, or a claim points at a figure or at evidence that
    is not there.
    """

    title: str
    request: str
    verdict: str
    sections: Sequence[Section]
    settings: Settings
    provenance: Provenance
    numbers: Sequence[KeyNumber] = field(default=())
    status: Sequence[Status] = field(default=())

    def __post_init__(self) -> None:
        names = [*(name for section in self.sections for name in section.ids()), "settings", "again"]
        refuse_if(
            twice := sorted(name for name, times in Counter(names).items() if times > 1),
            "Every anchor of a report page is there once ('settings' and 'again' are the page's own).",
            f"used more than once: {', '.join(twice)}",
            "another id",
        )
        blocks = [block for section in self.sections for block in section.blocks]
        pointed = {n for b in blocks if isinstance(b, Claim) for n in b.figures} | {
            f"claim-{c.id}" for b in blocks if isinstance(b, Claims) for c in b.claims
        }
        refuse_if(
            lost := sorted(pointed - set(names)),
            "A claim points at a figure or at evidence that is not on the page.",
            f"not found: {', '.join(lost)}",
            "a Figure, or a Claim for each",
        )

    def html(self) -> str:
        """The whole page as text; the same page gives the same text."""
        light = "".join(f"  --{role}: {colour};\n" for role, colour in LIGHT.items())
        dark = "".join(f"    --{role}: {colour};\n" for role, colour in DARK.items())
        sheet = resources.files("flexhinf.report").joinpath("page.css").read_text(encoding="utf-8")
        # Paper is light: the dark colours are for screens only.
        screen = f"@media screen and (prefers-color-scheme: dark) {{\n  :root {{\n{dark}  }}\n}}\n"
        sections = (
            *self.sections,
            Section("Settings", (self.settings,), "settings"),
            Section("How to make this again", (self.provenance,), "again"),
        )
        contents = "".join(f'<li><a href="#{part.id}">{prose(part.title)}</a></li>' for part in sections)
        strip = "".join(
            f"<div><dt>{prose(n.name)}</dt><dd>{escape(scalar(n.value))}{unit_html(n.unit)}</dd>"
            + (f'<dd class="small">{prose(n.note)}</dd></div>' if n.note else "</div>")
            for n in self.numbers
        )
        strip = f'<dl class="numbers">{strip}</dl>\n' if strip else ""
        status = "".join(f"<li>{badge(line.kind)} {prose(line.text)}</li>" for line in self.status)
        status = f'<ul class="status">{status}</ul>\n' if status else ""
        body = "\n".join(section.html() for section in sections)
        return (
            '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
            '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
            '<meta name="color-scheme" content="light dark">\n<meta name="generator" content="flexhinf">\n'
            f"<title>{escape(self.title)}</title>\n<style>\n:root {{\n{light}}}\n{screen}{sheet}</style>\n</head>\n"
            f'<body>\n<main>\n<header>\n<h1>{prose(self.title)}</h1>\n<p class="asked">{prose(self.request)}</p>\n'
            f'{status}<p class="verdict">{prose(self.verdict)}</p>\n{strip}</header>\n'
            f'<nav aria-label="Contents"><ol>{contents}</ol></nav>\n{body}\n</main>\n</body>\n</html>\n'
        )
