"""Fig. 3: step response to 180° by NL-H∞, measured and estimated; the linear law beside it."""

from __future__ import annotations

from flexhinf.paper.experiments import STEP_DURATION, Experiments
from flexhinf.paper.figures.drawn import Drawn, step_numbers
from flexhinf.paper.figures.responses import draw_responses

__all__ = ["figure_03"]


def figure_03(experiments: Experiments) -> Drawn:
    """Link position after a command of 180° at t = 0, from the hanging rest."""
    runs = experiments.step_180
    return Drawn(
        "03",
        "Step to 180°: link position.",
        "The paper shows NL-H∞ alone; the linear law of the same γ is added. Dotted: command; grey: ±2 % of the step.",
        draw_responses(runs, STEP_DURATION, step=180.0),
        {name: step_numbers(outcome) for name, outcome in runs.items()},
    )
