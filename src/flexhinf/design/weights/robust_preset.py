"""The preset `robust`: the weights and noise levels that `flexhinf.design.weights.whole_loop` finds, as a problem."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from flexhinf.design.estimators import EstimatorNoise
from flexhinf.design.weights.design_problem import DesignProblem
from flexhinf.design.weights.linear_family import LinearDesign, behaviour_of
from flexhinf.design.weights.search import Candidate, SearchResult
from flexhinf.design.weights.whole_loop import Made, Search, WholeLoop
from flexhinf.plant import GeneralisedPlant


@dataclass(frozen=True, eq=False)
class WholeLoopSearch:
    """What was found, beside the preset `damped` that it began with.

    Attributes
    ----------
    damped, found : WholeLoop
        The same where nothing better was found.
    frequency, damping : float
        Factors of ω and ζ of all joints, over those of `damped`.
    links, motors : float
        Factors of the noise levels.
    fraction : float
        Of what the channels can cover.
    count : int
        Candidates.
    corner : str
        The corner at which the loop becomes unstable first, by its changes.
    """

    damped: WholeLoop
    found: WholeLoop
    frequency: float
    damping: float
    links: float
    motors: float
    fraction: float
    count: int
    corner: str

    @property
    def better(self) -> bool:
        """Whether any candidate was better than `damped`."""
        return self.found is not self.damped


def search_whole_loop(
    found: Search, progress: Callable[[str], None] = lambda text: None
) -> tuple[DesignProblem, EstimatorNoise | None, WholeLoopSearch]:
    """The problem of the preset robust, its noise levels, and how they were found: runs a search."""
    damped, levels = found.damped, found.levels
    best, judged, point = found.run()
    progress(f"weights and noise levels for the tolerances: {found.count} loops tried")
    assert damped.target is not None
    factors = dict(zip(("frequency", "damping", "links", "motors"), np.exp(point[:4]).tolist()))
    outcome = WholeLoopSearch(
        found.own, judged, **factors, fraction=found.fraction(point), count=found.count,
        corner=found.named(judged.corner),
    )  # fmt: skip
    if best.channelled is None:
        return replace(damped, preset="robust"), levels, outcome
    return (
        best.channelled.checked(damped.target, _chosen(damped, best), _source(outcome)),
        best.levels,
        outcome,
    )


def at_pose(
    covered: DesignProblem, damped: DesignProblem, found: WholeLoopSearch
) -> tuple[GeneralisedPlant, float]:
    """The problem, and its level, of the same factors at another pose.

    Parameters
    ----------
    covered, damped : DesignProblem
        There, as of `search_whole_loop`.
    """
    if not found.better:
        return damped.problem, damped.gamma
    assert covered.covering is not None
    assert damped.search is not None
    first = damped.search.chosen
    made = covered.covering.problem(
        found.frequency * first.target_frequency, found.damping * first.damping_weights, found.fraction
    )
    return made.problem, made.gamma


def _chosen(damped: DesignProblem, best: Made) -> SearchResult:
    """The candidates of `damped`, and the one that the search on the whole loop took."""
    found, made = damped.search, best.channelled
    assert found is not None
    assert made is not None
    p = made.linear.scaled(made.gamma, made.scalings).design(made.gamma, made.gamma_star).p
    design = LinearDesign(made.gain, p, made.gamma, made.gamma_star)
    one = Candidate(best.frequency, best.damping, design, behaviour_of(made.covering.family, made.gain))
    return SearchResult(one, (*found.candidates, one))


def _source(outcome: WholeLoopSearch) -> str:
    return (
        f"searched on the running loop: its corners are stable up to {outcome.found.scale:.3g} times the tolerances, "
        f"{outcome.damped.scale:.3g} with the preset damped"
    )
