"""Formulas as MathML, which browsers draw themselves: the site loads no script from elsewhere."""

from __future__ import annotations

import re
from typing import Any

from docutils import nodes
from docutils.utils.math import MathError
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.application import Sphinx
from sphinx.util import logging

_LOG = logging.getLogger(__name__)
_FRACTION = re.compile(r"(\\[dt]?frac)\s*(\d)\s*(\d)")  # ½ without braces


def mathml(node: nodes.Element, block: bool) -> str:
    """The formula of a node; what is not understood is a warning, and stays as it is written."""
    text = _FRACTION.sub(r"\1{\2}{\3}", node.astext())
    several = "\\\\" in text and "\\begin{" not in text
    try:
        return tex2mathml(rf"\begin{{aligned}}{text}\end{{aligned}}" if several else text, as_block=block)
    except MathError as error:
        _LOG.warning("formula: %s: %s", error, text, location=node)
        return f"<code>{nodes.unescape(text)}</code>"


def visit_math(self: Any, node: nodes.Element) -> None:
    """A formula in a sentence."""
    self.body.append(self.starttag(node, "span", "", CLASS="math") + mathml(node, False) + "</span>")
    raise nodes.SkipNode


def visit_displaymath(self: Any, node: nodes.Element) -> None:
    """A formula in a line of its own, with its number."""
    self.body.append(self.starttag(node, "div", CLASS="math formula", tabindex="0") + mathml(node, True))
    if node["number"]:
        self.body.append(f'<span class="eqno">({node["number"]})')
        self.add_permalink_ref(node, "Link to this equation")
        self.body.append("</span>")
    self.body.append("</div>\n")
    raise nodes.SkipNode


def setup(app: Sphinx) -> None:
    """Register all of this file."""
    app.add_html_math_renderer("mathml", (visit_math, None), (visit_displaymath, None))
