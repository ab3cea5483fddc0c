"""What sampling, delay, estimator and limits spend of a level set, one after the other in the same loop."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from flexhinf.analysis.spending import Budget, budget
from flexhinf.errors import NumericalFailure
from flexhinf.loop import Controller, Loop
from flexhinf.plant import Law, Plant

__all__ = ["Expense", "budget_table"]


@dataclass(frozen=True, eq=False)
class Expense:
    """One row: the loop with all that stands in the rows above, and this.

    Attributes
    ----------
    name : str
        "sampling", "delay", "estimator", "saturation".
    budget : Budget
        Of this loop.
    added : float
        ½ ∫ vᵀ R2 v more than in the row above; infinite if the loop diverged.
    """

    name: str
    budget: Budget
    added: float


def budget_table(
    law: Law,
    plant: Plant,
    period: float = 1e-3,
    level: float = np.inf,
    *,
    delay: float | None = None,
    estimator: Any = None,
    saturation: Any = None,
    start: str = "zero",
    **run: Any,
) -> tuple[Expense, ...]:
    """Run the same law with the exact state at the samples, then with delay, estimator and limits added in turn.

    Parameters
    ----------
    law : Law
        With a value function: a solution of `solve_hji`.
    plant : Plant
        The law's own: a budget says nothing of another.
    period, delay : float
        s; the delay a whole number of periods. None leaves the row out, as for the following.
    level : float
        c of {V ≤ c}.
    estimator, saturation, start
        As of `flexhinf.loop.Controller`.
    **run
        As of `Loop.run`: initial_state, duration, noise, …; the noise only where the estimator is.

    Raises
    ------
    InvalidInput
        As `budget`, and if something does not fit.
    """
    rows: list[Expense] = []
    added = {"sampling": True, "delay": delay, "estimator": estimator, "saturation": saturation}
    so_far: dict[str, Any] = {}
    for name, part in added.items():
        if part is None:
            continue
        so_far[name] = part
        observer = so_far.get("estimator")
        controller = Controller(law, observer, period, so_far.get("saturation"), start=start)
        loop = Loop(plant, controller, delay=so_far.get("delay", 0.0))
        settings = {**run, "noise": run.get("noise") if observer is not None else None}
        found = _budget_of(loop, level, settings)
        above = rows[-1].budget.total if rows else 0.0
        more = found.total - above if np.isfinite(above) else float("inf")
        rows.append(Expense(name, found, more))
    return tuple(rows)


def _budget_of(loop: Loop, level: float, settings: dict[str, Any]) -> Budget:
    """Of one run; one that diverged has spent everything."""
    given = settings.get("initial_input")
    try:
        return budget(loop.run(**settings), loop, level, given)
    except NumericalFailure as failure:
        run: Any = getattr(failure, "trajectory", None)
        if run is None or len(run.time) < 2:
            raise
        nothing = np.full(len(run.time), np.nan)
        return Budget(run.time, float(level), float("nan"), nothing, nothing, nothing, False)
