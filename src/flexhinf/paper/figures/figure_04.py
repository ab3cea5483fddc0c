"""Fig. 4: the control signal of Fig. 3."""

from __future__ import annotations

from flexhinf.paper.experiments import STEP_DURATION, Experiments
from flexhinf.paper.figures.drawn import Drawn, draw_inputs

__all__ = ["figure_04"]


def figure_04(experiments: Experiments) -> Drawn:
    """Motor voltage during the 180° step."""
    runs = experiments.step_180
    return Drawn(
        "04",
        "Step to 180°: motor voltage.",
        "The law is held between samples.",
        draw_inputs(runs, STEP_DURATION),
        {name: {"peak_control_V": outcome.metrics["peak_input"]} for name, outcome in runs.items()},
    )
