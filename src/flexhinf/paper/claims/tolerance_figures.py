"""Drawings of the tolerance claim: unstable share over R^v, and the worst plant's long run."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from flexhinf.paper.bench import Outcome
from flexhinf.paper.claims.repair import Study
from flexhinf.paper.tolerance_sweep import ALL_STATES, GOALS, VELOCITIES, name_goal
from flexhinf.report import (
    MUTED,
    SERIES,
    Figure,
    figure_to_svg,
    house_style,
    label,
    legend,
    new_figure,
    settling_band,
)

__all__ = ["share_figure", "worst_figure"]

#: Length of the paper's step responses, s.
SHORT = 8.0


@house_style()
def share_figure(known: Study, q: float) -> Figure:
    """Per cent of unstable corners over q, for both forms of R^v."""
    figure, panels = new_figure(len(GOALS))
    corners = known.population.kinds == "corner"
    for axes, goal in zip(panels, GOALS, strict=True):
        for form, colour, marker in ((ALL_STATES, SERIES[0], "o"), (VELOCITIES, SERIES[1], "s")):
            cases = [c for c in known.sweep.swept if c.form == form]
            share = np.array([100.0 * np.mean(known.rates[c, goal][corners] >= 0.0) for c in cases])
            swept = np.array([c.q or 0.0 for c in cases])
            axes.plot(swept, share, color=colour, marker=marker, markersize=4.5, label=f"R^v on {form}")
        if q > 0.0:
            axes.axvline(
                q, color=MUTED, linewidth=1.0, linestyle=(0, (1.0, 1.6)), label="settings (all states)"
            )
        axes.set_xscale("log")
        axes.set_ylim(-3.0, 103.0)
        label(axes, f"unstable at {name_goal(goal)}", "%")
    panels[-1].set_xlabel("q, variance added at each sample")
    legend(panels[0])
    caption = (
        "Share of 400 corners of the tolerances whose loop is unstable, over the process noise R^v that the "
        "paper does not give. The paper's penalty, coil in the true plant; by eigenvalues."
    )
    return Figure("figure-tolerances", figure_to_svg(figure), caption)


@house_style()
def worst_figure(runs: Mapping[str, Outcome], goal: float, plant: str, case: str) -> Figure:
    """The link's position in 30 s with the paper's and with repaired penalties, after the first response."""
    figure, panels = new_figure(len(runs), height=1.0 + 1.5 * len(runs))
    errors = {name: _error(outcome, goal) for name, outcome in runs.items()}
    reach = min(95.0, 1.1 * max(float(np.abs(e).max()) for _, e in errors.values()))
    for axes, (name, (time, error)), colour in zip(panels, errors.items(), SERIES, strict=False):
        axes.plot(time, np.clip(error, -reach, reach), color=colour, linewidth=1.0)
        axes.set_ylim(-reach, reach)
        settling_band(axes, 0.0, np.degrees(goal))
        axes.axvline(SHORT, color=MUTED, linewidth=1.0, linestyle=(0, (1.0, 1.6)))
        label(axes, "error", "°", name)
    caption = (
        f"Error of the link after a step to {name_goal(goal)}, from 1 s on, for the plant that grows fastest "
        f"({plant}), {case}, no noise. The dotted line at 8 s is where a usual step response ends; the band "
        "is ±2 % of the step."
    )
    return Figure("figure-worst-plant", figure_to_svg(figure), caption)


def _error(outcome: Outcome, goal: float) -> tuple[np.ndarray, np.ndarray]:
    """(time, error in degrees) from 1 s on; of a run that diverged earlier, all of it."""
    run = outcome.run
    shown = run.time >= min(1.0, 0.5 * run.time[-1])
    return run.time[shown], np.degrees(run.signal("state", "link_position")[shown] - goal)
