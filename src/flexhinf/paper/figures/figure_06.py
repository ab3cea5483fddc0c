"""Fig. 6: the control signals of Fig. 5."""

from __future__ import annotations

from flexhinf.paper.experiments import STEP_DURATION, Experiments
from flexhinf.paper.figures.drawn import Drawn, draw_inputs

__all__ = ["figure_06"]


def figure_06(experiments: Experiments) -> Drawn:
    """Motor voltage during the 90° step."""
    runs = experiments.step_90
    return Drawn(
        "06",
        "Step to 90°: motor voltage by NL-H∞ and by L-H∞.",
        "At rest at 90° the motor holds the full gravity torque M g L: 10.9 V.",
        draw_inputs(runs, STEP_DURATION),
        {name: {"peak_control_V": outcome.metrics["peak_input"]} for name, outcome in runs.items()},
    )
