"""Fig. 5: step response to 90°, NL-H∞ against L-H∞."""

from __future__ import annotations

from flexhinf.paper.experiments import STEP_DURATION, Experiments
from flexhinf.paper.figures.drawn import Drawn, step_numbers
from flexhinf.paper.figures.responses import draw_responses

__all__ = ["figure_05"]


def figure_05(experiments: Experiments) -> Drawn:
    """Link position after a command of 90° at t = 0, from the hanging rest."""
    runs = experiments.step_90
    return Drawn(
        "05",
        "Step to 90°: link position by NL-H∞ and by L-H∞.",
        "Measured and estimated lie on each other. Dotted: command; grey: ±2 % of the step.",
        draw_responses(runs, STEP_DURATION, step=90.0),
        {name: step_numbers(outcome) for name, outcome in runs.items()},
    )
