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
    from flexhinf.campaign.discrete import DiscreteSystem
    from flexhinf.campaign.disturbance_runs import Attained
    from flexhinf.campaign.disturbance_search import DisturbanceSearch, worst_disturbance
    from flexhinf.campaign.linear_loop import LinearLoop
    from flexhinf.campaign.loop_margins import Margins, margins
    from flexhinf.campaign.modes import Modes
    from flexhinf.campaign.population import Population, corner_population, corners
    from flexhinf.campaign.resting import RestingLoop
    from flexhinf.campaign.spending import Budget, budget
    from flexhinf.campaign.spending_table import Expense, budget_table
    from flexhinf.campaign.sweep import ProcessNoise, Swept, unstable_share


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'flexhinf.campaign' has no attribute {name!r}")
    value = getattr(import_module(f"flexhinf.campaign.{_HOME[name]}"), name)
    globals()[name] = value
    return value
