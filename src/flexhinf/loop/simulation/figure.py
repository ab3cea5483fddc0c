"""A matplotlib figure that shows itself in a notebook, without pyplot and its global state."""

from __future__ import annotations

import warnings
from io import StringIO

import matplotlib as mpl
from matplotlib.figure import Figure


class NotebookFigure(Figure):
    """A figure whose value at the end of a notebook's cell is its drawing, as SVG."""

    def _repr_svg_(self) -> str:
        text = StringIO()
        with mpl.rc_context({"svg.fonttype": "none"}), warnings.catch_warnings():
            warnings.filterwarnings(
                "ignore", "Glyph .* missing from font"
            )  # the browser has fonts for every script
            self.savefig(text, format="svg")
        return text.getvalue()

    def _repr_html_(self) -> str:
        svg = self._repr_svg_()
        return svg[svg.index("<svg") :]
