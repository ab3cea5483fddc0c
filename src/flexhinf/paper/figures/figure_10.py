"""Fig. 10: the runs of Fig. 9, as estimated."""

from __future__ import annotations

import numpy as np

from flexhinf.paper.experiments import Experiments
from flexhinf.paper.figures.drawn import Drawn
from flexhinf.paper.figures.uncertain import draw_uncertain, spread, step_ranges

__all__ = ["figure_10"]


def figure_10(experiments: Experiments) -> Drawn:
    """What the estimator, which believes in the nominal plant, makes of the runs of Fig. 9."""
    runs = experiments.uncertain
    whole = [u.metrics["estimation_rmse"] for u in runs if u.diverged_at is None]
    columns = np.array(whole).T if whole else np.zeros((0, 0))
    return Drawn(
        "10",
        "The runs of Figure 9 as estimated.",
        "The estimator believes in the nominal plant without coil."
        if experiments.bench.settings.estimator != "none"
        else "The true state is fed back, so they are the same.",
        draw_uncertain(runs, "estimate"),
        {"nonlinear": {**step_ranges(runs), "estimation_rmse": [spread(column) for column in columns]}},
    )
