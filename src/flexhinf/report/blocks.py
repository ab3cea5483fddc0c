"""What a section is made of: paragraphs, notes, lists, listings, figures. See also `table` and `claims`.

Every block is a frozen value that checks itself where it is made, and knows how to write itself as HTML.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Protocol

from flexhinf.errors import InvalidInput
from flexhinf.report.svg import inline
from flexhinf.report.text import escape, prose

__all__ = ["Block", "Bullets", "Figure", "FigureRow", "Listing", "Note", "Paragraph", "check_id"]

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
