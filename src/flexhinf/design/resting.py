"""The sampled loop of a design at rest at its goal, with its estimator: what margins and tolerances are judged on."""

from __future__ import annotations

from flexhinf.analysis import EquilibriumLoop
from flexhinf.design.bench import Bench
from flexhinf.plant import Law

__all__ = ["resting_loop"]


def resting_loop(bench: Bench, law: Law, estimated: bool = True) -> EquilibriumLoop:
    """The loop of a law about the goal.

    Parameters
    ----------
    bench : Bench
    law : Law
        The one at the goal, where the bench has a schedule.
    estimated : bool
        With the estimator of the bench; otherwise the true state is fed back.
    """
    s = bench.specification
    estimator = bench.estimator(bench.goal) if estimated else None
    return EquilibriumLoop(
        law, estimator, bench.true_plant, s.period, bench.goal, delay=round(s.delay / s.period)
    )
