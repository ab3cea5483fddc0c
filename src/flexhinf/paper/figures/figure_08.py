"""Fig. 8: the control signal of Fig. 7."""

from __future__ import annotations

from flexhinf.paper.experiments import TRACKING_DURATION, Experiments
from flexhinf.paper.figures.drawn import Drawn, draw_inputs

__all__ = ["figure_08"]


def figure_08(experiments: Experiments) -> Drawn:
    """Motor voltage while tracking."""
    runs = experiments.tracking
    return Drawn(
        "08",
        "Tracking π + sin(πt/10): motor voltage.",
        "",
        draw_inputs(runs, TRACKING_DURATION),
        {name: {"peak_control_V": outcome.metrics["peak_input"]} for name, outcome in runs.items()},
    )
