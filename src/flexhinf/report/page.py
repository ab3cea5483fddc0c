"""One self-contained HTML page: no network, light and dark, fit to be printed, readable without its one script.

The first screen has the verdict in one sentence, the numbers that matter and the figures that show the result. Below
stand the summary and the sections, which fold; then every assumption and setting, versions, seed and the command that
makes the page again. The script marks the current section, opens what a link points at, and enlarges figures.
"""

from __future__ import annotations

import base64
import hashlib
import shlex
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib import resources
from itertools import groupby
from typing import Any, Literal, get_args

from flexhinf.copies import shared_out
from flexhinf.errors import refuse_if
from flexhinf.report.blocks import (
    Anchored,
    Bullets,
    Figure,
    Note,
    PageBlock,
    escape,
    finite,
    prose,
    scalar,
    unit_html,
)
from flexhinf.report.facts import Fact, Provenance, Settings
from flexhinf.report.figure import DARK, LIGHT, house_style
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
class JudgedClaim(Anchored):
    """One claim of a paper, judged: "holds", "fails", "ties" (the difference lies within its own confidence interval)
    or "not judged"; another verdict is refused with `InvalidInput`.

    `id` is its name in ``metrics.json`` and, after ``claim-``, its anchor; `evidence` the numbers behind the verdict;
    `figures` anchors of the figures that show it; `criterion` is fixed before the result and shown before the verdict;
    `blocks` are tables and figures of its own, `numbers` what else ``metrics.json`` holds, `data` what a page draws.
    `parts` are the verdicts of the same criterion for each step alone, where it is about several or could be.
    """

    id: str
    text: str
    verdict: Verdict
    evidence: str
    figures: tuple[str, ...] = ()
    criterion: str = ""
    blocks: Sequence[PageBlock] = ()
    numbers: Mapping[str, object] = field(default_factory=dict[str, object])
    data: Any = None
    parts: Mapping[str, Verdict] = field(default_factory=dict[str, Verdict])

    def __post_init__(self) -> None:
        super().__post_init__()
        for verdict in (self.verdict, *self.parts.values()):
            one_of("There is no such verdict.", verdict, get_args(Verdict))

    @property
    def parts_text(self) -> str:
        """The verdict for each step alone, such as ``90°: holds, 180°: fails``; empty for a claim without parts."""
        return ", ".join(f"{part}: {verdict}" for part, verdict in self.parts.items())

    def as_dict(self) -> dict[str, object]:
        """The claim as it stands in ``metrics.json``."""
        return {
            "id": self.id,
            "text": self.text,
            **({"criterion": self.criterion} if self.criterion else {}),
            "verdict": self.verdict,
            **({"by_step": dict(self.parts)} if self.parts else {}),
            "evidence": self.evidence,
            **({"numbers": self.numbers} if self.numbers else {}),
        }

    def ids(self) -> tuple[str, ...]:
        """The anchors of the claim and of its blocks."""
        return (f"claim-{self.id}", *(name for block in self.blocks for name in block.ids()))

    def html(self) -> str:
        """The claim as HTML, with its evidence; colour is never the only sign of a verdict."""
        links: list[str] = []
        for name in (name for name in self.figures if name not in self.ids()):
            word, _, tail = name.partition("-")  # figure-03 is read as Figure 3
            spoken = f"{word.capitalize()} {tail.lstrip('0') or tail}".strip()
            links.append(f'<a href="#{name}">{escape(spoken)}</a>')
        alone = f" ({prose(self.parts_text)})" if self.parts else ""
        seen = f' <span class="seen">See {", ".join(links)}.</span>' if links else ""
        return "\n".join(
            filter(
                None,
                (
                    f'<article class="claim" id="claim-{self.id}"><h3>{prose(self.text)}</h3>',
                    f"<p><strong>Criterion.</strong> {prose(self.criterion)}</p>" if self.criterion else "",
                    f"<p>{badge(self.verdict)}{alone} {prose(self.evidence)}{seen}</p>",
                    *(block.html() for block in self.blocks),
                    "</article>",
                ),
            )
        )


@dataclass(frozen=True)
class Claims(PageBlock):
    """A table of judged claims, those that fail first; each row leads to the claim's evidence on the same page."""

    claims: Sequence[JudgedClaim]

    def html(self) -> str:
        """The table as HTML."""
        rows = "".join(
            f'<tr><td><a href="#claim-{claim.id}">{prose(claim.text)}</a></td><td data-label="Criterion">'
            f"{prose(claim.criterion)}</td><td>{badge(claim.verdict)}"
            + "".join(f"<br>{prose(f'{part}: {verdict}')}" for part, verdict in claim.parts.items())
            + "</td></tr>"
            for claim in by_verdict(self.claims)
        )
        return (
            '<div class="table"><table class="claims"><thead><tr><th scope="col">Claim</th>'
            '<th scope="col">Criterion</th><th scope="col">Verdict</th></tr></thead>'
            f"<tbody>{rows}</tbody></table></div>"
        )


def by_verdict(claims: Sequence[JudgedClaim]) -> list[JudgedClaim]:
    """Claims with those that fail first, those that hold last; otherwise in their order."""
    return sorted(claims, key=lambda claim: ("fails", "ties", "not judged", "holds").index(claim.verdict))


def summary(claims: Sequence[JudgedClaim]) -> str:
    """Number of claims with each verdict, as a sentence.

    Examples
    --------
    >>> summary([JudgedClaim("a", "A.", "holds", "1 < 2"), JudgedClaim("b", "B.", "fails", "2 > 1")])
    'Of 2 claims 1 holds, 1 fails.'
    """
    verbs = {
        "holds": ("holds", "hold"),
        "fails": ("fails", "fail"),
        "ties": ("ties", "tie"),
        "not judged": ("is not judged", "are not judged"),
    }
    counts = Counter(claim.verdict for claim in claims)
    parts = [f"{counts[kind]} {text[counts[kind] > 1]}" for kind, text in verbs.items() if counts[kind]]
    noun = "claim" if len(claims) == 1 else "claims"
    return f"Of {len(claims)} {noun} {', '.join(parts)}." if parts else "No claim was judged."


def badge(kind: str) -> str:
    """A coloured label with a sign and the word."""
    colours, sign = _BADGES[kind]
    return f'<span class="badge {colours}"><span aria-hidden="true">{sign}</span> {kind}</span>'


@dataclass(frozen=True)
class Badge:
    """An entry at the top that says how far a result can be relied on: met, proved, not met, not proved, not judged
    or risky. Another kind is refused with `InvalidInput`."""

    kind: str
    text: str

    def __post_init__(self) -> None:
        own = set(get_args(Verdict)) - {"not judged"}
        one_of("There is no such status.", self.kind, [kind for kind in _BADGES if kind not in own])


#: What is drawn when a page is made, None where there is nothing to draw: who reads notes or tables only draws nothing.
Drawing = Callable[[], Figure | None]


@dataclass(frozen=True)
class Section(Anchored):
    """A heading and the blocks under it, which fold; `id` is its anchor. It shows if it has blocks.

    A block may be the function that draws it; None is left out. `open`: whether the page shows the blocks before a
    reader asks for them. `group`: heading of this section and of those after it in the contents. `brief`: the result in
    a few words, beside the heading. `numbers`: what the JSON beside the page has of it.
    """

    title: str
    blocks: Sequence[PageBlock | Drawing | None]
    id: str
    open: bool = False
    group: str = ""
    brief: str = ""
    numbers: Mapping[str, object] = field(default_factory=dict[str, object])

    @property
    def present(self) -> list[PageBlock]:
        """The blocks that are there, drawn."""
        return [block for block in self.blocks if isinstance(block, PageBlock)]

    def ids(self) -> tuple[str, ...]:
        """The anchors of the section and of its blocks."""
        return (self.id, *(name for block in self.present for name in block.ids()))

    def html(self) -> str:
        """The section as HTML."""
        notes = sum(isinstance(block, Note) for block in self.present)
        brief = f'<span class="brief">{prose(self.brief)}</span>' if self.brief else ""
        if notes:
            brief += f'<span class="badge ties">{notes} note{"s" * (notes > 1)}</span>'
        return (
            f'<section id="{self.id}">\n<details{" open" * self.open}><summary><h2>{prose(self.title)}</h2>{brief}'
            f"</summary>\n{arranged(self.present)}\n</details></section>"
        )


@house_style()
def with_figures(*sections: Iterable[PageBlock | Drawing | None]) -> list[list[PageBlock]]:
    """The blocks of each section with all figures drawn, on all processors."""
    found = [list(blocks) for blocks in sections]
    undrawn = [block for blocks in found for block in blocks if callable(block)]
    figures = iter(shared_out(lambda draw: draw(), undrawn))
    blocks_of = ([next(figures) if callable(block) else block for block in blocks] for blocks in found)
    return [list(filter(None, blocks)) for blocks in blocks_of]


def arranged(blocks: Sequence[PageBlock]) -> str:
    """Blocks as HTML; figures that follow each other stand side by side where there is room."""
    parts: list[str] = []
    for pictures, run in groupby(blocks, lambda block: isinstance(block, Figure)):
        texts = [block.html() for block in run]
        parts += [f'<div class="figures">{"".join(texts)}</div>'] if pictures and len(texts) > 1 else texts
    return "\n".join(parts)


@dataclass(frozen=True)
class Page:
    """A report as data. First screen: the title, the verdict in one sentence, how far it can be relied on, the facts
    that matter, and the `lead`, two figures at most. Then the summary with the request, every status in full and
    `details` of the verdict; the sections; every setting; the command that makes it again, seed and versions.

    `html` is the page, `numbers` the JSON beside it: `head`, and what the sections have. A figure may be the function
    that draws it, and in the `lead` the name of a figure of the sections, which then stands on the first screen; they
    are drawn for `html` only.

    Raises InvalidInput: two parts of the page have the same anchor, or a claim points at a figure or at evidence that
    is not there.
    """

    title: str
    request: str
    verdict: str
    sections: Sequence[Section]
    command: Sequence[str] = ()
    seed: int | None = None
    settings: Mapping[str, Sequence[Fact]] = field(default_factory=dict[str, Sequence[Fact]])
    facts: Sequence[Fact] = field(default=())
    status: Sequence[Badge] = field(default=())
    details: Sequence[str] = field(default=())
    lead: Sequence[Figure | Drawing | str] = field(default=())
    head: Mapping[str, object] = field(default_factory=dict[str, object])

    @property
    def said(self) -> list[str]:
        """The verdict and its details, in sentences."""
        return [self.verdict, *self.details]

    @property
    def numbers(self) -> dict[str, Any]:
        """Content of the JSON beside the page."""
        parts = [part.numbers for part in self.sections]
        return finite({key: value for part in (self.head, *parts) for key, value in part.items()})

    @property
    def provenance(self) -> Provenance:
        """Where the page comes from."""
        return Provenance(shlex.join(self.command), self.seed)

    def with_figures(self) -> Page:
        """The page with all its figures drawn."""
        own = [each for each in self.lead if not isinstance(each, str)]
        lead, *blocks_of = with_figures(own, *(part.blocks for part in self.sections))
        pictures = {block.id: block for blocks in blocks_of for block in blocks if isinstance(block, Figure)}
        named = [pictures.get(f"figure-{name}") for name in self.lead if isinstance(name, str)]
        sections = [
            replace(part, blocks=[block for block in blocks if block not in named])
            for part, blocks in zip(self.sections, blocks_of)
        ]
        first = [block for block in (*lead, *named) if isinstance(block, Figure)]
        return replace(self, sections=sections, lead=first)

    def __post_init__(self) -> None:
        lead = [part for part in self.lead if isinstance(part, Figure)]
        names = [name for part in (*lead, *self.sections) for name in part.ids()] + OWN
        refuse_if(
            twice := sorted(name for name, times in Counter(names).items() if times > 1),
            f"Every anchor of a report page is there once ({', '.join(map(repr, OWN))} are the page's own).",
            f"used more than once: {', '.join(twice)}",
            "another id",
        )
        blocks = [block for section in self.sections for block in section.present]
        pointed = {n for b in blocks if isinstance(b, JudgedClaim) for n in b.figures} | {
            f"claim-{c.id}" for b in blocks if isinstance(b, Claims) for c in b.claims
        }
        undrawn = any(callable(block) for part in self.sections for block in part.blocks)
        refuse_if(
            lost := [] if undrawn else sorted(pointed - set(names)),
            "A claim points at a figure or at evidence that is not on the page.",
            f"not found: {', '.join(lost)}",
            "a Figure, or a JudgedClaim for each",
        )

    def _summary(self) -> str:
        """The request, every status in full, and the details of the verdict."""
        status = "".join(
            f"<li>{badge(line.kind)} {prose(line.text[:1].upper() + line.text[1:])}</li>"
            for line in self.status
        )
        status = f'<ul class="status">{status}</ul>\n' if status else ""
        details = Bullets(tuple(self.details)).html() if self.details else ""
        return f'<p class="asked">{prose(self.request)}</p>\n{status}{details}'

    def _header(self) -> str:
        """The first screen."""
        named = dict.fromkeys(line.kind for line in self.status)  # once, however many entries are of a kind
        kinds = "".join(f'<a href="#summary">{badge(kind)}</a>' for kind in named)
        kinds = f'<p class="kinds">{kinds}</p>\n' if kinds else ""
        strip = "".join(
            f"<div><dt>{prose(n.name)}</dt><dd>{escape(scalar(n.value))}{unit_html(n.unit)}</dd>"
            + (f'<dd class="small">{prose(n.note)}</dd></div>' if n.note else "</div>")
            for n in self.facts
        )
        strip = f'<dl class="numbers">{strip}</dl>\n' if strip else ""
        return (
            f'<header id="top">\n<h1>{prose(self.title)}</h1>\n<p class="verdict">{prose(self.verdict)}</p>\n'
            f"{kinds}{strip}{arranged([part for part in self.lead if isinstance(part, Figure)])}\n</header>\n"
        )

    def html(self) -> str:
        """The whole page as text; the same page gives the same text."""
        page = self.with_figures()
        light = "".join(f"  --{role}: {colour};\n" for role, colour in LIGHT.items())
        dark = "".join(f"    --{role}: {colour};\n" for role, colour in DARK.items())
        sheet, script = (
            resources.files("flexhinf.report").joinpath(f"page.{kind}").read_text(encoding="utf-8")
            for kind in ("css", "js")
        )
        digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
        # Paper is light: the dark colours are for screens only.
        screen = f"@media screen and (prefers-color-scheme: dark) {{\n  :root {{\n{dark}  }}\n}}\n"
        settings, last = Settings(self.settings), "About this page"
        count = sum(map(len, self.settings.values()))
        brief = f"all {count}{', and who states them' * settings.noted}"
        sections = (
            *(part for part in page.sections if part.present),
            *([Section("Settings", (settings,), "settings", group=last, brief=brief)] if count else []),
            Section("How to make this again", (self.provenance,), "again", group="" if count else last),
        )
        contents = '<li><a href="#top">Result</a></li><li><a href="#summary">Summary</a></li>' + "".join(
            (f'<li class="group">{prose(part.group)}</li>' if part.group else "")
            + f'<li><a href="#{part.id}">{prose(part.title)}</a></li>'
            for part in sections
        )
        body = "\n".join(section.html() for section in sections)
        return (
            '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
            '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
            '<meta name="color-scheme" content="light dark">\n<meta name="generator" content="flexhinf">\n'
            # Nothing is fetched, and no other script runs.
            "<meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; style-src 'unsafe-inline'; "
            f"img-src data:; script-src 'sha256-{digest}'\">\n"
            f"<title>{escape(self.title)}</title>\n<style>\n:root {{\n{light}}}\n{screen}{sheet}</style>\n</head>\n"
            '<body>\n<a class="skip" href="#summary">Skip to the summary</a>\n'
            f"{_CONTENTS}{contents}</ol></nav>\n<main>\n"
            f'{page._header()}<section id="summary" class="summary">\n<h2>Summary</h2>\n{self._summary()}\n</section>\n'
            f"{body}\n</main>\n{_LARGE}<script>{script}</script>\n</body>\n</html>\n"
        )


#: Anchors of the page itself.
OWN = ["top", "summary", "settings", "again", "contents"]

_CONTENTS = (
    '<nav aria-label="Contents"><p class="bar"><button type="button" class="menu" aria-expanded="false" '
    'aria-controls="contents">Contents</button><span class="here"></span>'
    '<button type="button" class="folds">Open all</button></p><ol id="contents">'
)

_LARGE = (
    '<dialog class="large" aria-label="Figure, enlarged"><button type="button" class="close">Close (Esc)</button>'
    '<div class="stage"></div></dialog>\n'
)
