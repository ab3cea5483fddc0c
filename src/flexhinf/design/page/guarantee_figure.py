"""The budget of the step drawn: V, its bound, and the level."""

from __future__ import annotations

import numpy as np

from flexhinf.design.page.drawing import thin
from flexhinf.design.result import Design
from flexhinf.report import INK, SERIES, Figure, figure_to_svg, house_style, label, legend, new_figure

__all__ = ["budget_figure"]

#: The level is drawn where the bound comes to this share of it.
NEAR = 0.05


def budget_figure(design: Design) -> list[Figure]:
    """Of the loop with all its parts; none if it diverged."""
    budget = design.guarantee.expenses[-1].budget
    if not budget.complete:
        return []
    few = thin(budget.times)
    bound = budget.start + budget.disturbance + budget.spent
    figure, (axis,) = new_figure(1)
    near = np.isfinite(budget.level) and NEAR * budget.level < float(bound.max())
    with house_style():
        axis.plot(budget.times[few], bound[few], color=SERIES[1], label="V(x0) + ½∫vᵀR2v until then")
        axis.plot(budget.times[few], budget.value[few], color=SERIES[0], label="V")
        if near:
            axis.axhline(
                budget.level, color=INK, linewidth=1.0, dashes=(6.0, 3.0), label="level of the region"
            )
        axis.set_ylim(bottom=0.0)
    label(axis, "V", "")
    legend(axis)
    beyond = (
        "" if near or not np.isfinite(budget.level) else f" (its level, {budget.level:.3g}, is far above)"
    )
    return [
        Figure(
            "figure-budget",
            figure_to_svg(figure),
            f"V along the step of the nominal robot, and the bound that is left of the promise{beyond}.",
            "The budget",
        )
    ]
