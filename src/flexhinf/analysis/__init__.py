"""Tolerances drawn and worst cases searched: many true plants, margins, disturbances and what runs spend."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

_HOME = {
    "Attained": "disturbance_runs",
    "Budget": "spending",
    "DiscreteSystem": "discrete",
    "DisturbanceSearch": "disturbance_search",
    "Expense": "spending_table",
    "LinearLoop": "linear_loop",
    "Margins": "loop_margins",
    "Modes": "modes",
    "Population": "population",
    "ProcessNoise": "sweep",
    "RestingLoop": "resting",
    "Swept": "sweep",
    "budget": "spending",
    "budget_table": "spending_table",
    "corner_population": "population",
    "corners": "population",
    "margins": "loop_margins",
    "unstable_share": "sweep",
    "worst_disturbance": "disturbance_search",
}

__all__ = [
    "Attained", "Budget", "DiscreteSystem", "DisturbanceSearch", "Expense", "LinearLoop", "Margins", "Modes",
    "Population", "ProcessNoise", "RestingLoop", "Swept", "budget", "budget_table", "corner_population", "corners",
    "margins", "unstable_share", "worst_disturbance",
]  # fmt: skip

if TYPE_CHECKING:
    from flexhinf.analysis.discrete import DiscreteSystem
    from flexhinf.analysis.disturbance_runs import Attained
    from flexhinf.analysis.disturbance_search import DisturbanceSearch, worst_disturbance
    from flexhinf.analysis.linear_loop import LinearLoop
    from flexhinf.analysis.loop_margins import Margins, margins
    from flexhinf.analysis.modes import Modes
    from flexhinf.analysis.population import Population, corner_population, corners
    from flexhinf.analysis.resting import RestingLoop
    from flexhinf.analysis.spending import Budget, budget
    from flexhinf.analysis.spending_table import Expense, budget_table
    from flexhinf.analysis.sweep import ProcessNoise, Swept, unstable_share


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'flexhinf.analysis' has no attribute {name!r}")
    value = getattr(import_module(f"flexhinf.analysis.{_HOME[name]}"), name)
    globals()[name] = value
    return value
