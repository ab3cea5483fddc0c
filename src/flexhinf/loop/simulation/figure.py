"""The plot of a run, which is displayed in a notebook without pyplot and its global state."""

# Matplotlib's types leave some arguments open.
# pyright: reportUnknownMemberType=false
from __future__ import annotations

import warnings
from io import StringIO
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure


class NotebookFigure(Figure):
    """A figure that a notebook displays as SVG at the end of a cell."""

    def _repr_svg_(self) -> str:
        text = StringIO()
        with mpl.rc_context({"svg.fonttype": "none"}), warnings.catch_warnings():
            # The browser has fonts for every script.
            warnings.filterwarnings("ignore", "Glyph .* missing from font")
            self.savefig(text, format="svg")
        return text.getvalue()

    def _repr_html_(self) -> str:
        svg = self._repr_svg_()
        return svg[svg.index("<svg") :]


def plot_run(run: Any) -> NotebookFigure:
    """Plot a `Trajectory`: tracked states (or all) with command and estimate above, inputs below; angles in degrees."""
    with mpl.rc_context({"text.parse_math": False}):  # a dollar sign in a name is no formula
        figure = NotebookFigure(figsize=(7.0, 5.0), layout="constrained")
        above, below = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
        names = run.judged or run.names["estimate"]
        for k, name in enumerate(names):
            scale, unit = _display_unit(run, name)
            above.plot(run.time, scale * run.tracked(name), f"C{k}", label=_label(name, unit))
            estimate = scale * run.signal("estimate", name)
            above.plot(run.time, estimate, color="0.1", ls="--", lw=0.8, label="_" if k else "estimated")
            if name in run.names["reference"]:
                command = scale * run.signal("reference", name)
                above.plot(run.time, command, color="0.4", ls=":", lw=0.9, label="_" if k else "command")
        for name, unit, u in zip(run.names["input"], run.units["input"], run.signals["input"].T):
            below.plot(run.time, u, f"C{run.names['input'].index(name)}", label=_label(name, unit))
        below.set_xlabel("time (s)")
        units = [_display_unit(run, name)[1] for name in names]
        for axes, several, what in ((above, units, "states"), (below, run.units["input"], "inputs")):
            axes.set_ylabel(_label(what, ", ".join(dict.fromkeys(unit for unit in several if unit))))
            axes.legend(frameon=False, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=4)
            axes.grid(alpha=0.3)
    return figure


def _display_unit(run: Any, name: str) -> tuple[float, str]:
    unit = dict(zip(run.names["estimate"], run.units["estimate"]))[name]
    return (180.0 / np.pi, "°") if unit == "rad" else (1.0, unit)


def _label(name: str, unit: str) -> str:
    text = name.replace("_", " ")
    return f"{text} ({unit})" if unit else text
