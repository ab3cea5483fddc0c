"""How the design's promise fares: the gain that the worst disturbance attains, and what the controller's parts spend.

γ is what the law was designed for. It bounds the gain from above as far as the inequality holds; the sampled region
checks a slightly weaker one. What a disturbance found by search attains is a bound from below. Everything that is not
the law fed the true state (sampling, delay, estimator, limits) spends of the region's level, see
`flexhinf.analysis.dissipation_budget`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexhinf.analysis import Attained, BudgetTerm, budget_terms, worst_disturbance
from flexhinf.design.bench import Bench
from flexhinf.design.linearised import Linearised
from flexhinf.design.synthesis import Synthesis
from flexhinf.errors import NumericalFailure

__all__ = ["Guarantee", "guarantee", "looked_for"]

#: With more states no disturbance is searched for: one ascent takes minutes.
MOST_STATES = 15

#: Length of the disturbances, in lengths of the step response, and at most, s.
STEPS, LONGEST = 2.0, 20.0


@dataclass(frozen=True, eq=False)
class Guarantee:
    """From below, and along the step.

    Attributes
    ----------
    attained : Attained or None
        The worst disturbance found with which V stays below the sampled level, true state; None if none was looked for.
    expenses : tuple of BudgetTerm
        Of the step, row by row; the level is infinite where no region was looked at.
    """

    attained: Attained | None
    expenses: tuple[BudgetTerm, ...]


def looked_for(states: int, rays: int) -> bool:
    """Whether a disturbance is searched for."""
    return states <= MOST_STATES and rays > 0


def guarantee(bench: Bench, synthesis: Synthesis, linear: Linearised) -> Guarantee:
    """Both, with the chosen solution at the goal."""
    s, law, chosen = bench.specification, synthesis.solution, synthesis.chosen
    duration = linear.step_length(s)
    level = chosen.level if chosen.looked and np.isfinite(chosen.level) and chosen.level > 0.0 else None
    attained = None
    if level is not None and looked_for(len(law.state_names), synthesis.rays):
        horizon = min(LONGEST, STEPS * duration)
        attained = worst_disturbance(
            synthesis.problem, law, None, s.period, level=level, horizon=horizon, seed=s.seed
        )
    x, u = bench.robot.operating_point(bench.start)
    try:
        expenses = budget_terms(
            law, bench.model, s.period, np.inf if level is None else level, delay=s.delay or None,
            estimator=bench.estimator(bench.start), saturation=s.saturation, start="bumpless",
            initial_state=x, initial_input=u, duration=duration, noise=bench.noise, seed=s.seed,
        )  # fmt: skip
    except NumericalFailure:
        expenses = ()
    return Guarantee(attained, expenses)
