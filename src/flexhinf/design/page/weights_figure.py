"""The search drawn: what each value of its dial gave."""

from __future__ import annotations

import numpy as np

from flexhinf.design.page.drawing import side_by_side
from flexhinf.design.result import Design
from flexhinf.report import INK, MUTED, SERIES, Figure, figure_to_svg, house_style, label

__all__ = ["search_figure"]


def search_figure(design: Design) -> Figure:
    """Damping of the vibrations and γ* over the dial ζ."""
    found, wanted = design.game.found, design.game.wanted
    assert found is not None
    assert wanted is not None
    tries = sorted(found.tries, key=lambda t: t.knob)
    knob = np.array([t.knob for t in tries])
    curves = (
        ("worst of the tolerances", [t.behaviour.damping for t in tries], SERIES[1]),
        ("nominal robot", [t.behaviour.nominal_damping for t in tries], SERIES[0]),
    )
    figure, (left, right) = side_by_side(2, 3.0)
    with house_style():
        for name, values, colour in curves:
            seen = np.where(np.isfinite(values), values, np.nan)
            left.plot(knob, seen, "o-", color=colour, label=name, markersize=3.5, linewidth=1.2)
        left.axhline(wanted.damping, color=INK, linewidth=1.0, dashes=(6.0, 3.0), label="wanted")
        right.plot(
            knob, [t.design.gamma_star for t in tries], "o-", color=SERIES[0], markersize=3.5, linewidth=1.2
        )
        for axis in (left, right):
            axis.axvline(found.chosen.knob, color=MUTED, linewidth=1.0, linestyle=(0, (1.0, 1.6)), zorder=0.5)
            axis.set_xlabel("dial ζ")
        left.set_ylim(bottom=0.0)
        left.legend(loc="best")
    label(left, "smallest damping ratio", "")
    label(right, "γ*", "")
    return Figure(
        "figure-search",
        figure_to_svg(figure),
        "All at the wanted bandwidth: the smallest damping ratio of an oscillation and γ* over ζ; dotted the ζ "
        "that is used.",
        "The search",
    )
