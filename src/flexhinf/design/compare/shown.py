"""Figures of merit as a reader sees them: units, scales, and words for what has no number."""

from __future__ import annotations

import numpy as np

from flexhinf.design.compare.merits import COST, DRAWN, LINEAR, LOAD, MOVE, RAW, STEP, Merit
from flexhinf.design.compare.result import Comparison, Row
from flexhinf.report import number

__all__ = ["SHORT", "cell", "corners", "group_title", "in_words", "knob", "reached", "unit_of"]

#: Titles of groups where there is little room.
SHORT = {
    STEP: "step as commanded", RAW: "raw step", LOAD: "torque on the links", MOVE: "planned move",
    DRAWN: "within the tolerances", LINEAR: "linearised loop", COST: "cost",
}  # fmt: skip

#: Where a figure is from, in a sentence.
WHERE = {
    STEP: " of the step", RAW: " of the raw step", LOAD: " under the load",
    MOVE: " of the move", DRAWN: " within the tolerances", LINEAR: "", COST: "",
}  # fmt: skip


def unit_of(merit: Merit, comparison: Comparison) -> str:
    """As it is shown."""
    if merit.unit == "input":
        return comparison.reference.unit
    if merit.unit == "small input":
        return f"m{comparison.reference.unit}"
    if merit.unit == "length":
        return comparison.reference.units["error"]
    if merit.key == "drawn_unsettled":
        return f"of {len(comparison.drawn)}"
    if merit.key == "unstable_corners":
        return f"of {corners(comparison)}"
    return merit.unit


def corners(comparison: Comparison) -> int:
    """Plants that linearised loops were looked at with."""
    return max((row.linear.corners for row in comparison.compared if row.linear is not None), default=0)


def cell(merit: Merit, value: float | None, comparison: Comparison) -> str:
    """One figure without its unit."""
    if value is None:
        return "–"
    if np.isinf(value):
        if "settling" in merit.key:
            return f"> {comparison.reference.step_duration:g}"
        return "∞" if merit.key == "delay_margin_s" else "diverges"
    if merit.unit in ("length", "ms", "small input"):
        value *= 1e3
    if merit.unit == "%":
        return number(value, decimals=1)
    if value == round(value) and merit.unit == "":
        return number(int(value))
    if 0.0 < abs(value) < 10.0 ** (1 - merit.digits):
        return number(value, 2)
    if abs(value) >= 10.0**merit.digits:
        return number(round(value))
    decimals = merit.digits - 1 - (0 if value == 0.0 else int(np.floor(np.log10(abs(value)))))
    return number(value, decimals=min(max(decimals, 0), merit.digits))


def in_words(merit: Merit, comparison: Comparison) -> str:
    """The name of a figure in a sentence."""
    return f"{merit.label}{WHERE[merit.group]}"


def group_title(group: str, comparison: Comparison) -> str:
    """What was run for a group of figures."""
    reference = comparison.reference
    bench, plan = reference.bench, reference.plan
    torque, length = reference.units["torque"], reference.units["position"]
    loads = ", ".join(number(float(value), 3) for value in reference.load)
    return {
        STEP: f"Step {_poses(bench.start)} → {_poses(bench.goal)} {length}, as each law is commanded: with integrals "
        "the input continues, without it jumps",
        RAW: "The raw step: the same with integrals at zero, so that every input jumps; not counted",
        LOAD: f"Torque of {loads} {torque} on the links, at the goal",
        MOVE: f"Planned move of {number(float(plan.duration), 3)} s over the same way, with feedforward",
        DRAWN: f"{len(comparison.drawn)} robots within their tolerances: step and move",
        LINEAR: "Linearised loop with its estimator, at the goal",
        COST: "Cost",
    }[group]


def _poses(values: np.ndarray) -> str:
    return f"({', '.join(number(float(value), 3) for value in values)})"


def knob(row: Row, what: str) -> str:
    """The number that was tuned, if it is this one."""
    return number(row.tuned.knob, 3) if row.tuned is not None and row.kind.knob == what else "–"


def reached(row: Row) -> str:
    """What a law was tuned to, as reached; marked where the target is missed."""
    if row.tuned is None or row.tuned.response is None:
        return "–"
    return f"{number(row.tuned.response, 3)}{'' if row.tuned.met else ' (missed)'}"
