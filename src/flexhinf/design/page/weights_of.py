"""Weights of a penalty one by one, as settings and tables show them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from flexhinf.design.result import Design
from flexhinf.robot.signals import signal_names

__all__ = ["Weight", "effort_unit", "state_weights"]


class Weight(NamedTuple):
    """One weight: what of, its value, and the unit that makes the product one of z."""

    signal: str
    value: float
    unit: str


def state_weights(design: Design) -> list[Weight]:
    """Of states, integrals, torques of springs and their rates; none for a penalty that is code of the user's."""
    problem, joints = design.problem, design.robot.joint_names
    states = problem.penalty.states
    coded = callable(states)
    given = getattr(states, "states", None) if coded else problem.penalty.weights(problem.state_names)
    named = [] if given is None else list(zip(problem.state_names, np.asarray(given, dtype=float)))
    for group, attribute in (("joint_torque", "torques"), ("joint_torque_rate", "rates")):
        named += zip(signal_names(group, joints), getattr(states, attribute, ()) if coded else ())
    unit = problem.plant.unit
    return [Weight(name, float(weight), _inverse(unit(name))) for name, weight in named if weight]


def effort_unit(design: Design) -> str:
    """Of R2, with a z without unit."""
    units = dict.fromkeys(design.problem.plant.unit(name) for name in design.problem.input_names)
    return " or ".join(f"({unit})⁻²" if "·" in unit else f"{unit}⁻²" for unit in units)


def _inverse(unit: str) -> str:
    if not unit:
        return ""
    return f"1/({unit})" if "·" in unit or "/" in unit else f"1/{unit}"
