"""Fig. 9: link position under parametric uncertainty, as measured."""

from __future__ import annotations

from flexhinf.paper.experiments import Experiments
from flexhinf.paper.figures.drawn import Drawn
from flexhinf.paper.figures.uncertain import draw_uncertain, step_ranges, worst_text

__all__ = ["figure_09"]


def figure_09(experiments: Experiments) -> Drawn:
    """The 90° step on plants drawn within Tables 1 and 2, coil inductance included."""
    runs = experiments.uncertain
    return Drawn(
        "09",
        "Step to 90° under the tolerances of Tables 1 and 2: link position as measured.",
        f"{len(runs)} plants drawn uniformly, with coil inductance; below, the rest of the 30 s enlarged. "
        f"{worst_text(runs)}",
        draw_uncertain(runs, "output"),
        {"nonlinear": step_ranges(runs)},
    )
