"""What the level γ is worth on the running loop: the worst disturbance found, and the dissipation budget of the step.

γ is what the law was designed for. The sampled region checks the dissipation inequality at a slightly weaker level, at
samples. The gain that a disturbance found by search attains is a lower bound. Everything that is not the law fed the
true state (sampling, delay, estimator, limits) uses up a part of the region's level, see
`flexhinf.analysis.dissipation`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexhinf.analysis import Attained, BudgetTerm, budget_terms, worst_disturbance
from flexhinf.design.loop_setup import LoopSetup
from flexhinf.design.synthesis.steps import Synthesis
from flexhinf.errors import FlexhinfError, NumericalFailure

#: With more states no disturbance is searched for: one ascent takes minutes.
MOST_STATES = 15

#: Length of the disturbances, in lengths of the step response, and at most, s.
STEPS, LONGEST = 2.0, 20.0


@dataclass(frozen=True, eq=False)
class Attenuation:
    """What was found."""

    # The worst disturbance found (a lower bound of the gain) with which V stays below the sampled level, or the one
    # of the preset proved, with the true state fed back; None if none was searched for, or the search failed
    attained: Attained | None
    # Of the step; the level is infinite where there is no region. Empty where the step diverges, where it starts
    # outside the region, and with more than `MOST_STATES` states where there is no region: each term takes a compiled
    # loop of its own. Empty for the preset proved: where parameters are uncertain the proved V is not the one whose
    # gradient is the law
    budget: tuple[BudgetTerm, ...]
    failure: str = ""  # Why the search for a disturbance failed; empty where it did not

    @property
    def lasts(self) -> bool:
        """Whether the region's level lasts for the whole step, all terms of the budget together."""
        return not self.budget or bool(self.budget[-1].budget.kept)


def searches_disturbance(states: int, rays: int) -> bool:
    """Whether a disturbance is searched for."""
    return states <= MOST_STATES and rays > 0


def attenuation(setup: LoopSetup, synthesis: Synthesis, duration: float) -> Attenuation:
    """The worst disturbance and the budget, with the chosen solution at the goal.

    `duration`: of the step, s.
    """
    s, law, chosen, proved = setup.specification, synthesis.solution, synthesis.chosen, synthesis.proved
    level = chosen.level if chosen.looked and np.isfinite(chosen.level) and chosen.level > 0.0 else None
    problem = synthesis.problem
    if (
        proved is not None and proved.certificate is not None
    ):  # the penalty whose gain is proved, and its region
        problem, level = proved.problem, proved.inner_level
    attained, failure = None, ""
    if level is not None and searches_disturbance(len(law.state_names), synthesis.rays):
        horizon = min(LONGEST, STEPS * duration)
        try:
            attained = worst_disturbance(
                problem, law, None, s.period, level=level, horizon=horizon, seed=s.seed
            )
        except FlexhinfError as error:
            failure = " ".join(str(error).split())
    budget = _budget(setup, synthesis, level, duration) if proved is None else ()
    return Attenuation(attained, budget, failure)


def _budget(
    setup: LoopSetup, synthesis: Synthesis, level: float | None, duration: float
) -> tuple[BudgetTerm, ...]:
    s = setup.specification
    if level is None and len(synthesis.solution.state_names) > MOST_STATES:
        return ()
    x, u = setup.robot.operating_point(setup.start)
    try:
        terms = tuple(
            budget_terms(
                synthesis.solution, setup.model, s.period, np.inf if level is None else level,
                delay=s.delay or None, estimator=setup.estimator(setup.start), saturation=setup.limits.saturated,
                start="bumpless", initial_state=x, initial_input=u, duration=duration, noise=setup.noise,
                seed=s.seed,
            )
        )  # fmt: skip
    except NumericalFailure:
        return ()
    return within_level(terms)


def within_level(terms: tuple[BudgetTerm, ...]) -> tuple[BudgetTerm, ...]:
    """The same; none where the step starts above the level, so that there is nothing to spend."""
    return () if terms and terms[-1].budget.start > terms[-1].budget.level else terms
