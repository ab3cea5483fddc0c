"""One self-contained HTML page: no network, no scripts, light and dark, fit to be printed.

From top to bottom: what was asked, what is not met, not proved or risky, the verdict, the numbers that matter; sections
with figures and tables; then every assumption and setting, versions, seed and the command that makes the page again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from importlib import resources

from flexhinf.errors import InvalidInput
from flexhinf.report.blocks import Block, Provenance, Settings, check_id, escape, prose, scalar, unit_html
from flexhinf.report.claims import ClaimEvidence, Claims
from flexhinf.report.figure import DARK, LIGHT

#: The badge of a status: its colours in the style sheet, and a sign, since colour is never the only one.
_BADGES = {
    "met": ("holds", "✓"),
    "proved": ("holds", "✓"),
    "not met": ("fails", "✗"),
    "not proved": ("not-judged", "○"),
    "risky": ("ties", "!"),
}


@dataclass(frozen=True)
class Status:
    """Part of the line at the top that says how far a result can be relied on.

    Parameters
    ----------
    kind : {"met", "proved", "not met", "not proved", "risky"}
    text : str
        What is.

    Raises
    ------
    InvalidInput
        For another kind.
    """

    kind: str
    text: str

    def __post_init__(self) -> None:
        if self.kind not in _BADGES:
            raise InvalidInput(
                "A status is of one of five kinds.",
                f"expected one of {', '.join(_BADGES)}; got {self.kind!r}",
                "'risky' for what holds with little to spare",
            )

    def html(self) -> str:
        """The status as an entry of the line, its badge first."""
        colours, sign = _BADGES[self.kind]
        badge = f'<span class="badge {colours}"><span aria-hidden="true">{sign}</span> {self.kind}</span>'
        return f"<li>{badge} {prose(self.text)}</li>"


@dataclass(frozen=True)
class KeyNumber:
    """One of the few numbers at the top of a page."""

    label: str
    value: object
    unit: str = ""
    note: str = ""

    def html(self) -> str:
        """The number as an entry of the strip."""
        note = f'<dd class="small">{prose(self.note)}</dd>' if self.note else ""
        value = f"{escape(scalar(self.value))}{unit_html(self.unit)}"
        return f"<div><dt>{prose(self.label)}</dt><dd>{value}</dd>{note}</div>"


@dataclass(frozen=True)
class Section:
    """A heading and the blocks under it; `id` is its anchor."""

    title: str
    blocks: Sequence[Block]
    id: str

    def __post_init__(self) -> None:
        check_id(self.id)

    def html(self) -> str:
        """The section as HTML."""
        body = "\n".join(block.html() for block in self.blocks)
        return f'<section id="{self.id}">\n<h2>{prose(self.title)}</h2>\n{body}\n</section>'

    def ids(self) -> tuple[str, ...]:
        """Its own anchor and those of its blocks."""
        return (self.id, *(name for block in self.blocks for name in block.ids()))


@dataclass(frozen=True)
class Page:
    """A report.

    Parameters
    ----------
    asked : str
        What was asked, in one or two sentences.
    verdict : str
        What came out, in one line.
    settings : Settings
        Every assumption and setting.
    provenance : Provenance
        Command, seed, versions.
    numbers : sequence of KeyNumber, optional
        The numbers that matter, at the top.
    status : sequence of Status, optional
        What is not met, not proved or risky, before the verdict.

    Raises
    ------
    InvalidInput
        Two parts of the page have the same anchor, or a claim points at a figure or at evidence that is not there.
    """

    title: str
    asked: str
    verdict: str
    sections: Sequence[Section]
    settings: Settings
    provenance: Provenance
    numbers: Sequence[KeyNumber] = field(default=())
    status: Sequence[Status] = field(default=())

    def __post_init__(self) -> None:
        names = [name for section in self.sections for name in section.ids()]
        twice = sorted(
            {name for name in names if names.count(name) > 1} | ({"settings", "again"} & set(names))
        )
        if twice:
            raise InvalidInput(
                "Every anchor of a report page is there once ('settings' and 'again' are the page's own).",
                f"used more than once: {', '.join(twice)}",
                "another id",
            )
        blocks = [block for section in self.sections for block in section.blocks]
        pointed = {n for b in blocks if isinstance(b, ClaimEvidence) for n in b.claim.figures}
        pointed |= {f"claim-{c.id}" for b in blocks if isinstance(b, Claims) for c in b.claims}
        lost = sorted(pointed - set(names))
        if lost:
            raise InvalidInput(
                "A claim points at a figure or at evidence that is not on the page.",
                f"not found: {', '.join(lost)}",
                "the id of a figure of this page; a ClaimEvidence for each of the Claims",
            )

    def html(self) -> str:
        """The whole page as text; the same page gives the same text."""
        tail = (
            Section("Settings", (self.settings,), "settings"),
            Section("How to make this again", (self.provenance,), "again"),
        )
        sections = (*self.sections, *tail)
        contents = "".join(f'<li><a href="#{part.id}">{prose(part.title)}</a></li>' for part in sections)
        strip = "".join(entry.html() for entry in self.numbers)
        strip = f'<dl class="numbers">{strip}</dl>\n' if strip else ""
        status = "".join(entry.html() for entry in self.status)
        status = f'<ul class="status">{status}</ul>\n' if status else ""
        body = "\n".join(section.html() for section in sections)
        return (
            '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
            '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
            '<meta name="color-scheme" content="light dark">\n<meta name="generator" content="flexhinf">\n'
            f"<title>{escape(self.title)}</title>\n<style>\n{_style()}</style>\n</head>\n<body>\n<main>\n<header>\n"
            f'<h1>{prose(self.title)}</h1>\n<p class="asked">{prose(self.asked)}</p>\n'
            f'{status}<p class="verdict">{prose(self.verdict)}</p>\n{strip}</header>\n'
            f'<nav aria-label="Contents"><ol>{contents}</ol></nav>\n{body}\n</main>\n</body>\n</html>\n'
        )


def _style() -> str:
    """The style sheet, the palette's colours as variables before it."""
    light = "".join(f"  --{role}: {colour};\n" for role, colour in LIGHT.items())
    dark = "".join(f"    --{role}: {colour};\n" for role, colour in DARK.items())
    sheet = resources.files("flexhinf.report").joinpath("page.css").read_text(encoding="utf-8")
    # Paper is light: the dark colours are for screens only.
    screen = f"@media screen and (prefers-color-scheme: dark) {{\n  :root {{\n{dark}  }}\n}}\n"
    return f":root {{\n{light}}}\n{screen}{sheet}"
