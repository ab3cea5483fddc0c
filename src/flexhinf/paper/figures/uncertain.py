"""How many runs on perturbed plants are drawn and counted."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from flexhinf.paper.experiments import UncertainRun
from flexhinf.report import (
    figure_to_svg,
    house_style,
    label,
    legend,
    new_figure,
    quantile_band,
    settling_band,
)

__all__ = ["draw_uncertain", "spread", "step_ranges", "worst_text"]

#: The first part of a run, shown in full; the rest is shown enlarged.
SHOWN = 6.0


def spread(values: Any) -> list[float | None]:
    """[smallest, median, largest] of the numbers among the values."""
    numbers = [float(v) for v in values if v is not None]
    return [min(numbers), float(np.median(numbers)), max(numbers)] if numbers else [None, None, None]


def step_ranges(runs: Sequence[UncertainRun]) -> dict[str, Any]:
    """Ranges over the plants, and how many did not settle (or diverged)."""
    metrics = [u.metrics for u in runs]
    return {
        "plants": len(runs),
        "overshoot_percent": spread(m["overshoot_percent"] for m in metrics),
        "settling_time_s": spread(m["settling_time_s"] for m in metrics),
        "steady_state_error_rad": spread(m["steady_state_error"] for m in metrics),
        "unsettled": sum(m["settling_time_s"] is None for m in metrics),
        "diverged": sum(u.diverged_at is not None for u in runs),
    }


def _worst(runs: Sequence[UncertainRun]) -> int:
    """The run with the largest error at its end."""
    return int(np.argmax([_last_error(u) for u in runs]))


def _last_error(u: UncertainRun) -> float:
    if u.diverged_at is not None:
        return np.inf
    return float(u.metrics["steady_state_error"])


def worst_text(runs: Sequence[UncertainRun]) -> str:
    """Which plant ended farthest from the command."""
    worst = runs[_worst(runs)]
    stiffness, mass = worst.values["stiffness"], worst.values["mass"]
    error = np.degrees(_last_error(worst))
    how = "diverged" if not np.isfinite(error) else f"its true link is off by at most {error:.2g}° then"
    return (
        f"The worst run has the largest error in the last 3 s (k = {stiffness:.1f} N·m/rad, M = {mass:.3f} kg): {how}; "
        "what is drawn has the measurement's noise on it."
    )


def draw_uncertain(runs: Sequence[UncertainRun], kind: str) -> str:
    """Band of all runs, the worst one drawn; the first seconds above, the enlarged rest below."""
    whole = [u for u in runs if u.diverged_at is None]
    figure, _ = new_figure(2, height=5.0)
    with house_style():
        figure.clear()
        above, below = figure.subplots(2, 1)
    if not whole:
        above.text(0.5, 0.5, "every run diverged", ha="center", transform=above.transAxes)
        return figure_to_svg(figure)
    time, command = whole[0].time, whole[0].command
    values = np.array([getattr(u, kind) for u in whole])
    worst = _worst(whole)
    for axes, part in ((above, time <= SHOWN), (below, time >= SHOWN)):
        if axes is above:
            settling_band(axes, command, command)
        quantile_band(axes, time[part], values[:, part], worst=worst)
        label(axes, "link position", "°")
    below.set_xlabel("time (s)")
    figure.align_ylabels([above, below])
    legend(above)
    return figure_to_svg(figure)
