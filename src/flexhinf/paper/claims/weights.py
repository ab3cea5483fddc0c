"""What the paper says of its weights: 60 x1 reduces the overshoot, 300 x5 guarantees a fast response.

Each weight is varied with the other kept; γ is the same multiple of each design's own γ*. Judged on every neighbouring
pair of the weights shown, for the step to 90° and for that to 180°.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

from flexhinf.errors import FlexhinfError
from flexhinf.loop import Step
from flexhinf.paper.claims.judgement import Judged, smallest_change
from flexhinf.paper.experiments import STEP_DURATION, Experiments
from flexhinf.paper.loop_setup import GOALS, name_goal
from flexhinf.report import Claim, Column, Table

LINK_WEIGHTS = (15.0, 30.0, 60.0, 90.0, 120.0)
INTEGRAL_WEIGHTS = (100.0, 150.0, 300.0, 450.0, 600.0)
PAPER_LINK, PAPER_INTEGRAL = 60.0, 300.0

#: What is read off each step: name of the metric, head of the column, unit, digits after the point.
METRICS = (
    ("overshoot_percent", "overshoot", "%", 2),
    ("rise_time_s", "rise 10–90 %", "s", 3),
    ("settling_time_s", "settling", "s", 2),
)

#: Largest equal weight of x2 and x4 that is tried as a repair.
LARGEST_VELOCITY = 64.0

Row = dict[Any, Any]


def sweep_weights(
    experiments: Experiments, pairs: Sequence[tuple[float, float]], velocity: float = 0.0
) -> list[Row]:
    """Metrics of the steps by goal, for weights of x1 and x5; `velocity` weighs x2 and x4. None where no law exists."""
    rows = []
    for link, integral in pairs:
        row: Row = {"weights": (link, integral)}
        weights = {"link_position": link, "link_position_integral": integral}
        try:
            law = experiments.setup.law({**weights, "link_velocity": velocity, "motor_velocity": velocity})
        except FlexhinfError:
            rows.append({**row, **{goal: {key: None for key, *_ in METRICS} for goal in GOALS}})
            continue
        for goal in GOALS:
            row[goal] = experiments.setup.run(law, Step(goal), STEP_DURATION).metrics()
        rows.append(row)
    return rows


def _falls(rows: Sequence[Row], metric: str) -> bool:
    """At both goals every value is smaller than the one before; a missing one is infinite."""
    columns = [[math.inf if row[g][metric] is None else row[g][metric] for row in rows] for g in GOALS]
    return all(b < a for column in columns for a, b in pairwise(column))


def _table(rows: Sequence[Row], caption: str, anchor: str) -> Table:
    columns = [Column("weight of x1", "", 0), Column("weight of x5", "", 0)]
    columns += [
        Column(f"{name_goal(g)} {head}", unit, digits) for g in GOALS for _, head, unit, digits in METRICS
    ]
    cells = [(*row["weights"], *(row[g][key] for g in GOALS for key, *_ in METRICS)) for row in rows]
    return Table(columns, cells, caption, anchor)


def _range(rows: Sequence[Row], goal: float, metric: str, digits: int) -> str:
    """The metric with the smallest and with the largest weight: ``1.00 to 0.45``."""
    ends = [row[goal][metric] for row in (rows[0], rows[-1])]
    return " to ".join("none" if end is None else f"{end:.{digits}f}" for end in ends)


# 60 x1 -------------------------------------------------------------------------------------------------
def judge_link_weight(experiments: Experiments) -> Judged:
    """link-weight-reduces-overshoot."""
    rows = sweep_weights(experiments, [(weight, PAPER_INTEGRAL) for weight in LINK_WEIGHTS])
    holds = _falls(rows, "overshoot_percent")
    listed = ", ".join(f"{weight:g}" for weight in LINK_WEIGHTS)
    claim = Claim(
        "link-weight-reduces-overshoot",
        "60 x1 reduces the overshoot of the step response.",
        "holds" if holds else "fails",
        f"From a weight of {LINK_WEIGHTS[0]:g} to {LINK_WEIGHTS[-1]:g} the overshoot goes from "
        f"{_range(rows, GOALS[0], 'overshoot_percent', 1)} % at 90° and from "
        f"{_range(rows, GOALS[1], 'overshoot_percent', 1)} % at 180°.",
        "" if holds else _repaired_link(experiments),
        ("table-link-weight",),
        f"With 300 x5 kept, the overshoot of the steps to 90° and 180° falls with each larger weight of x1: {listed}.",
    )
    return Judged(claim, (_table(rows, "The weight of x1 varied.", "table-link-weight"),))


def _repaired_link(experiments: Experiments) -> str:
    """The smallest equal weights on the two velocities with which the overshoot falls as the weight of x1 grows."""
    pairs = [(weight, PAPER_INTEGRAL) for weight in LINK_WEIGHTS]
    return _smallest_velocity(experiments, pairs, "overshoot_percent", "overshoot")


# 300 x5 ------------------------------------------------------------------------------------------------
def judge_integral_weight(experiments: Experiments) -> Judged:
    """integral-weight-is-fast."""
    pairs = [(PAPER_LINK, weight) for weight in INTEGRAL_WEIGHTS]
    rows = sweep_weights(experiments, pairs)
    holds = _falls(rows, "rise_time_s")
    listed = ", ".join(f"{weight:g}" for weight in INTEGRAL_WEIGHTS)
    settles = (
        "The settling time (±2 %) falls too."
        if _falls(rows, "settling_time_s")
        else "The settling time (±2 %) does not fall steadily: it jumps where another swing leaves the band."
    )
    claim = Claim(
        "integral-weight-is-fast",
        "300 x5 guarantees a fast response to a step command.",
        "holds" if holds else "fails",
        f"From a weight of {INTEGRAL_WEIGHTS[0]:g} to {INTEGRAL_WEIGHTS[-1]:g} the rise time goes from "
        f"{_range(rows, GOALS[0], 'rise_time_s', 2)} s at 90° and from {_range(rows, GOALS[1], 'rise_time_s', 2)} s at "
        f"180°. {settles} The overshoot goes from {_range(rows, GOALS[0], 'overshoot_percent', 1)} % and "
        f"{_range(rows, GOALS[1], 'overshoot_percent', 1)} %.",
        "" if holds else _smallest_velocity(experiments, pairs, "rise_time_s", "rise time"),
        ("table-integral-weight",),
        "“Fast” is read as a short time of rise from 10 to 90 % of the step. With 60 x1 kept, it falls at 90° and at "
        f"180° with each larger weight of x5: {listed}.",
    )
    return Judged(claim, (_table(rows, "The weight of x5 varied.", "table-integral-weight"),))


def _smallest_velocity(
    experiments: Experiments, pairs: Sequence[tuple[float, float]], metric: str, name: str
) -> str:
    """The smallest equal weights on the two velocities with which a metric falls along the sweep."""
    velocity = smallest_change(
        lambda w: _falls(sweep_weights(experiments, pairs, w), metric), 0.25, LARGEST_VELOCITY
    )
    if velocity is None:
        return f"no equal weights of x2 and x4 up to {LARGEST_VELOCITY:g} make the {name} fall steadily."
    return f"weights of {velocity:.2g} on x2 and x4 (smallest, by bisection)."
