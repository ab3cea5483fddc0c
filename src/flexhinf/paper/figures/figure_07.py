"""Fig. 7: tracking π + sin(πt/10), NL-H∞; the linear law beside it."""

from __future__ import annotations

from typing import Any

import numpy as np

from flexhinf.paper.bench import Outcome
from flexhinf.paper.experiments import TRACKING_DURATION, TRACKING_FROM, Experiments
from flexhinf.paper.figures.drawn import Drawn
from flexhinf.paper.figures.responses import draw_responses

__all__ = ["figure_07", "tracking_numbers"]


def tracking_numbers(outcome: Outcome) -> dict[str, Any]:
    """RMS error over the run, and the largest error after the start from rest."""
    if outcome.diverged_at is not None:
        return {"tracking_rmse_rad": None, "largest_error_rad": None, "diverged_at_s": outcome.diverged_at}
    run = outcome.run
    error = run.tracked("link_position") - run.signals["reference"][:, 0]
    late = np.abs(error[run.time >= TRACKING_FROM])
    return {"tracking_rmse_rad": float(np.sqrt(np.mean(error**2))), "largest_error_rad": float(late.max())}


def figure_07(experiments: Experiments) -> Drawn:
    """Link position under the command π + sin(πt/10), from the hanging rest."""
    runs = experiments.tracking
    return Drawn(
        "07",
        "Tracking π + sin(πt/10): link position.",
        "The law acts on the angle from hanging and on the integral of the error, so a moving command is "
        "followed late.",
        draw_responses(runs, TRACKING_DURATION),
        {name: tracking_numbers(outcome) for name, outcome in runs.items()},
    )
