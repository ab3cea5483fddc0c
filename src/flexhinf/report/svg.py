"""A drawing inside a page: its names made unique, its colours handed to the page's style sheet."""

from __future__ import annotations

import re

from flexhinf.errors import InvalidInput
from flexhinf.report.figure import LIGHT

__all__ = ["inline"]

_ROOT = re.compile(r"<svg\b[^>]*>")
_VIEW = re.compile(r'\bviewBox="[^"]*"')
_ACTIVE = re.compile(
    r"<script|<foreignObject|\son[a-z]+\s*=|(?:href|src)\s*=\s*[\"'](?!#)|url\((?!#)|@import|<!\[CDATA|<!ENTITY",
    re.IGNORECASE,
)
_HAS_ADDRESS = re.compile(r"<metadata>.*?</metadata>", re.DOTALL)
_MARKUP = re.compile(r"<!--.*?-->|<style\b.*?</style\s*>|<(?:[^<>\"']|\"[^\"]*\"|'[^']*')*>", re.DOTALL)
_NAME = re.compile(r'(\bid="|url\(#|href="#)')
_COLOUR = re.compile("|".join(LIGHT.values()))
_ROLE = {colour: role for role, colour in LIGHT.items()}


def inline(svg: str, prefix: str, described_by: str = "") -> str:
    """The ``svg`` element for the inside of an HTML page.

    Declarations, metadata and name spaces go; every id gets `prefix`, since all drawings of a page share one
    set of names; the colours of `palette` become variables of the style sheet, so that a drawing follows
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
    return f'<svg {view.group()} role="img"{described}>{body}'
