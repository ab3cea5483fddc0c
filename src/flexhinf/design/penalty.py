"""Which penalty a design has, and who says so."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from flexhinf.design.specification import Specification
from flexhinf.design.weights import scaled_weights
from flexhinf.errors import InvalidInput
from flexhinf.plant import Penalty

__all__ = ["ChosenPenalty", "chosen_penalty"]


@dataclass(frozen=True, eq=False)
class ChosenPenalty:
    """A penalty with its source.

    Attributes
    ----------
    penalty : Penalty
    source, effort_source : str
    """

    penalty: Penalty
    source: str
    effort_source: str


def chosen_penalty(robot: Any, goal: Any, specification: Specification) -> ChosenPenalty:
    """The asked one; weights for an asked bandwidth; the robot's own; or weights of ours, in this order.

    Raises
    ------
    InvalidInput
        If both weights and a bandwidth are asked for.
    """
    s = specification
    if s.penalty is not None and s.bandwidth is not None:
        raise InvalidInput(
            "Weights and a bandwidth contradict each other.",
            f"expected one of them, got penalty {s.penalty!r} and bandwidth {s.bandwidth:g} Hz",
            "leave out --bandwidth, or --penalty",
        )
    own = robot.penalty
    if s.penalty is not None or (s.bandwidth is None and own is not None):
        penalty = own if s.penalty is None else Penalty.of(s.penalty)
        source = "the robot's file" if s.penalty is None else "option --penalty"
        priced = "the robot's file" if own is not None else "ours"
        if s.penalty is not None and not isinstance(s.penalty, Penalty) and own is not None:
            penalty = replace(penalty, effort=own.effort)
        if s.effort is not None:
            penalty, priced = replace(penalty, effort=s.effort), "option --effort"
        return ChosenPenalty(penalty, source, priced)
    scaled = scaled_weights(robot, goal, s.bandwidth, s.effort)
    return ChosenPenalty(scaled.penalty, scaled.source, "ours" if s.effort is None else "option --effort")
