"""Tolerances drawn and worst cases searched: many true plants, margins, disturbances and what runs spend."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

_HOME = {
    "DiscreteSystem": "discrete",
    "LinearLoop": "linear_loop",
    "Margins": "loop_margins",
    "Modes": "modes",
    "RestingLoop": "resting",
    "margins": "loop_margins",
}

__all__ = ["DiscreteSystem", "LinearLoop", "Margins", "Modes", "RestingLoop", "margins"]

if TYPE_CHECKING:
    from flexhinf.campaign.discrete import DiscreteSystem
    from flexhinf.campaign.linear_loop import LinearLoop
    from flexhinf.campaign.loop_margins import Margins, margins
    from flexhinf.campaign.modes import Modes
    from flexhinf.campaign.resting import RestingLoop


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'flexhinf.campaign' has no attribute {name!r}")
    value = getattr(import_module(f"flexhinf.campaign.{_HOME[name]}"), name)
    globals()[name] = value
    return value
