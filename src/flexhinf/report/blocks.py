"""What a section is made of: paragraphs, notes, lists, listings, figures. See also `table` and `claims`.

Every block is a frozen value that checks itself where it is made, and knows how to write itself as HTML.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Protocol

from flexhinf.errors import InvalidInput
from flexhinf.report.figure import LIGHT
from flexhinf.report.text import escape, prose

_ROOT = re.compile(r"<svg\b[^>]*>")
_VIEW = re.compile(r'\bviewBox="\S+\s+\S+\s+([\d.]+)\s[^"]*"')
_ACTIVE = re.compile(
    r"<script|<foreignObject|\son[a-z]+\s*=|(?:href|src)\s*=\s*[\"'](?!#)|url\((?!#)|@import|<!\[CDATA|<!ENTITY",
    re.IGNORECASE,
)
_HAS_ADDRESS = re.compile(r"<metadata>.*?</metadata>", re.DOTALL)
_MARKUP = re.compile(r"<!--.*?-->|<style\b.*?</style\s*>|<(?:[^<>\"']|\"[^\"]*\"|'[^']*')*>", re.DOTALL)
_NAME = re.compile(r'(\bid="|url\(#|href="#)')
_COLOUR = re.compile("|".join(LIGHT.values()))
_ROLE = {colour: role for role, colour in LIGHT.items()}
_ID = re.compile(r"[a-z][a-z0-9-]*\Z")


class Block(Protocol):
    """A piece of a section."""

    def html(self) -> str:
        """The block as HTML, every text escaped."""
        ...

    def ids(self) -> tuple[str, ...]:
        """The anchors that this block makes on the page."""
        ...


def check_id(name: str) -> None:
    """Raise `InvalidInput` unless `name` can be an anchor: small letters, then digits and hyphens too."""
    if not _ID.match(name):
        raise InvalidInput(
            "An anchor on a report page has small letters, digits and hyphens only.",
            f"expected something like figure-03, got {name!r}",
            "another id",
        )


@dataclass(frozen=True)
class Paragraph:
    """A paragraph; `` `code` `` between backticks is set as code."""

    text: str

    def html(self) -> str:
        """The paragraph as HTML."""
        return f"<p>{prose(self.text)}</p>"

    def ids(self) -> tuple[str, ...]:
        """No anchors."""
        return ()


@dataclass(frozen=True)
class Note:
    """A paragraph that stands out: a limit, or a warning the reader must not miss."""

    text: str

    def html(self) -> str:
        """The note as HTML."""
        return f'<p class="note"><strong>Note.</strong> {prose(self.text)}</p>'

    def ids(self) -> tuple[str, ...]:
        """No anchors."""
        return ()


@dataclass(frozen=True)
class Bullets:
    """A list of short texts."""

    items: tuple[str, ...]

    def html(self) -> str:
        """The list as HTML."""
        return "<ul>" + "".join(f"<li>{prose(item)}</li>" for item in self.items) + "</ul>"

    def ids(self) -> tuple[str, ...]:
        """No anchors."""
        return ()


@dataclass(frozen=True)
class Listing:
    """Text set as it is: a command, a file, a few lines of code."""

    text: str

    def html(self) -> str:
        """The listing as HTML."""
        return f"<pre><code>{escape(self.text)}</code></pre>"

    def ids(self) -> tuple[str, ...]:
        """No anchors."""
        return ()


@dataclass(frozen=True)
class Figure:
    """A drawing with its caption and an anchor.

    Parameters
    ----------
    id : str
        The anchor, for example ``figure-03``.
    svg : str
        A drawing as `flexhinf.report.figure_to_svg` writes it.
    caption : str
        What is seen, after the label.
    label : str
        For example ``Figure 3``; set bold before the caption.
    """

    id: str
    svg: str
    caption: str
    label: str = ""

    def __post_init__(self) -> None:
        check_id(self.id)
        inline(self.svg, self.id)

    def html(self) -> str:
        """The figure as HTML, the drawing inside it."""
        label = f"<strong>{escape(self.label)}.</strong> " if self.label else ""
        drawing = inline(self.svg, self.id, described_by=f"{self.id}-caption")
        return (
            f'<figure id="{self.id}"><div class="drawing">{drawing}</div>'
            f'<figcaption id="{self.id}-caption">{label}{prose(self.caption)}</figcaption></figure>'
        )

    def ids(self) -> tuple[str, ...]:
        """The figure's own anchor."""
        return (self.id,)


@dataclass(frozen=True)
class FigureRow:
    """Figures that belong together, side by side where the page is wide enough."""

    figures: tuple[Figure, ...]

    def html(self) -> str:
        """The figures as HTML."""
        return '<div class="row">' + "".join(figure.html() for figure in self.figures) + "</div>"

    def ids(self) -> tuple[str, ...]:
        """The anchors of the figures."""
        return tuple(figure.id for figure in self.figures)


# Drawings inside a page ------------------------------------------------------------------------------
def inline(svg: str, prefix: str, described_by: str = "") -> str:
    """The ``svg`` element for the inside of an HTML page.

    Declarations, metadata and name spaces go; every id gets `prefix`, since all drawings of a page share one
    set of names; the colours of `LIGHT` become variables of the style sheet, so that a drawing follows
    light and dark; its size is left to the page. Only markup is looked at: a joint may be called ``url(x)``.

    Parameters
    ----------
    svg : str
        A whole SVG document.
    prefix : str
        Comes before every id of the drawing.
    described_by : str, optional
        The id of the element that says what is drawn.

    Raises
    ------
    InvalidInput
        `svg` is no drawing, or it could run a script or fetch something.
    """
    drawing = _HAS_ADDRESS.sub("", svg)
    root = _ROOT.search(drawing)
    view = _VIEW.search(root.group()) if root else None
    if root is None or view is None or "</svg>" not in drawing:
        raise InvalidInput(
            "A figure of a report is an SVG document with a viewBox.",
            f"got text that begins with {svg[:40]!r}",
            "figure_to_svg(figure)",
        )
    body = drawing[root.end() : drawing.rindex("</svg>") + len("</svg>")]
    active = next(filter(None, map(_ACTIVE.search, _MARKUP.findall(body))), None)
    if active or "<![CDATA[" in body:
        raise InvalidInput(
            "A figure of a report may neither run a script nor fetch anything.",
            f"found {active.group() if active else '<![CDATA['!r} in the drawing for {prefix!r}",
            "a drawing without it",
        )

    def own(mark: re.Match[str]) -> str:
        named = _NAME.sub(rf"\1{prefix}-", mark[0])
        return _COLOUR.sub(lambda match: f"var(--{_ROLE[match.group()]})", named)

    body = _MARKUP.sub(own, body)
    described = f' aria-labelledby="{described_by}"' if described_by else ""
    wide = f' style="--units: {view.group(1)}"'
    return f'<svg {view.group()}{wide} role="img"{described}>{body}'
