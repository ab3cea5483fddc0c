"""Pictures whose letters stay legible: where a window is too narrow for that, a picture scrolls in its own frame."""

from __future__ import annotations

import re
from functools import cache
from math import ceil
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sphinx.application import Sphinx

#: The smallest letters that a reader sees, px.
LEGIBLE = 11.0

#: What a telephone of 390 px leaves for a picture, px; a wider one scrolls, and keys reach it.
NARROW = 374

#: The width at which the smallest letters of figures of programs, 7 inches with 8 points, are legible, px.
FIGURE = 700

_SIZE = re.compile(r"font(?:-size)?[:=]\"?\s*(?:\w+ )*([\d.]+)")
_DRAWING = re.compile(r'<p>(<img [^>]*src="[^"]*_images/([^"/]+\.svg)"[^>]*?)( ?/>)</p>')
_FIGURE = re.compile(
    r'(<img [^>]*class = "sphx-glr-single-img"|'
    r'(?<=<div class="cell_output docutils container">\n)<img [^>]*\.png"[^>]*?)( ?/>)'
)
_DRAWN = re.compile(r'(<svg [^>]*width="[\d.]+pt"[^>]*)(>.*?</svg>)', re.DOTALL)


@cache
def legible_width(drawing: str) -> int:
    """The width at which the smallest letters of an SVG are legible, px; 0 if it has none."""
    box = re.search(r'viewBox="\S+ \S+ ([\d.]+) ', drawing)
    sizes = [float(each) for each in _SIZE.findall(drawing)]
    return ceil(LEGIBLE * float(box[1]) / min(sizes)) if box and sizes else 0


def framed(begin: str, end: str, width: int, element: str = "div") -> str:
    """A picture, its first tag open before `end`, in a frame in which it keeps this width, px."""
    key = ' tabindex="0"' if width > NARROW else ""
    return f'<{element} class="picture"{key}>{begin} style="min-width: {width}px"{end}</{element}>'


def legible(body: str, drawings: dict[str, Path]) -> str:
    """The HTML of a page, its pictures in frames; `drawings` has the file of each SVG by its name in the site."""

    def of_a_file(part: re.Match[str]) -> str:
        text = drawings[part[2]].read_text(encoding="utf-8")
        return framed(part[1], part[3], legible_width(text), "p")

    body = _DRAWN.sub(lambda part: framed(part[1], part[2], legible_width(part[0])), body)
    body = _FIGURE.sub(lambda part: framed(part[1], part[2], FIGURE), body)
    return _DRAWING.sub(of_a_file, body)


def read_page(app: Sphinx, name: str, template: str, context: dict[str, Any], doctree: Any) -> None:
    """Handler of ``html-page-context``."""
    if "body" in context:
        source = Path(app.srcdir)
        context["body"] = legible(
            context["body"], {name: source / file for file, (_, name) in app.env.images.items()}
        )


def setup(app: Sphinx) -> None:
    """Register all of this file."""
    app.connect("html-page-context", read_page)
