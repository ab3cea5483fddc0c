"""What the paper says of its weights: 60 x1 reduces the overshoot, 300 x5 makes the response fast.

Each weight is varied with the other kept; γ is the same multiple of each design's own γ*. Criteria: the
overshoot of the 90° and of the 180° step falls as the weight of x1 grows from 0.5 to 2 times the paper's;
the settling time of both falls as the weight of x5 grows likewise. Judged on every neighbouring pair of
weights.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

from flexhinf.errors import FlexhinfError
from flexhinf.loop import Step
from flexhinf.paper.claims.judged import Judged
from flexhinf.paper.claims.smallest import smallest_change
from flexhinf.paper.experiments import STEP_DURATION, Experiments
from flexhinf.report import Claim, Column, Table

__all__ = ["judge_integral_weight", "judge_link_weight"]

LINK_WEIGHTS = (15.0, 30.0, 60.0, 90.0, 120.0)
INTEGRAL_WEIGHTS = (100.0, 150.0, 300.0, 450.0, 600.0)
GOALS = (math.pi / 2, math.pi)


def _sweep(
    experiments: Experiments, pairs: list[tuple[float, float]], velocity: float = 0.0
) -> list[list[Any]]:
    """Rows: weights of x1 and x5, then overshoot and settling at 90° and at 180°; `velocity` weighs x2 and x4."""
    rows = []
    for link, integral in pairs:
        row: list[Any] = [link, integral]
        try:
            weights = {"link_position": link, "link_position_integral": integral}
            law = experiments.bench.law({**weights, "link_velocity": velocity, "motor_velocity": velocity})
        except FlexhinfError:
            rows.append([*row, None, None, None, None])
            continue
        for goal in GOALS:
            m = experiments.bench.run(law, Step(goal), STEP_DURATION).metrics
            row += [m["overshoot_percent"], m["settling_time_s"]]
        rows.append(row)
    return rows


def _falls(values: list[float | None]) -> bool:
    """Every value is smaller than the one before; a missing one is infinite."""
    numbers = [math.inf if v is None else v for v in values]
    return all(b < a for a, b in pairwise(numbers))


def _table(rows: list[list[Any]], caption: str, anchor: str) -> Table:
    columns = [Column("weight of x1", "", 0), Column("weight of x5", "", 0)]
    for goal in ("90°", "180°"):
        columns += [Column(f"{goal} overshoot", "%", 2), Column(f"{goal} settling", "s", 2)]
    return Table(columns, rows, caption, anchor)


def _list(values: list[float | None], decimals: int) -> str:
    return ", ".join("–" if v is None else f"{v:.{decimals}f}" for v in values)


def judge_link_weight(experiments: Experiments) -> Judged:
    """link-weight-reduces-overshoot."""
    rows = _sweep(experiments, [(w, 300.0) for w in LINK_WEIGHTS])
    columns = [[row[k] for row in rows] for k in (2, 4)]
    middle = slice(1, None)  # 0.5 to 2 times the paper's weight
    holds = all(_falls(column[middle]) for column in columns)
    evidence = (
        f"Weights of x1 {', '.join(f'{w:g}' for w in LINK_WEIGHTS)}: overshoot {_list(columns[0], 1)} % at 90°, "
        f"{_list(columns[1], 1)} % at 180°."
    )
    claim = Claim(
        "link-weight-reduces-overshoot",
        "60 x1 reduces the overshoot of the step response.",
        "holds" if holds else "fails",
        evidence,
        "" if holds else _repaired_link(experiments),
        ("table-link-weight",),
    )
    return Judged(claim, (_table(rows, "The weight of x1 varied.", "table-link-weight"),))


def _repaired_link(experiments: Experiments) -> str:
    """The smallest equal weights on the two velocities with which the overshoot falls as the weight of x1 grows."""

    def holds(velocity: float) -> bool:
        rows = _sweep(experiments, [(w, 300.0) for w in LINK_WEIGHTS[1:]], velocity)
        return all(_falls([row[k] for row in rows]) for k in (2, 4))

    velocity = smallest_change(holds, 0.25, 64.0)
    if velocity is None:
        return "no equal weights of x2 and x4 up to 64 make the overshoot fall steadily."
    return f"weights of {velocity:.2g} on x2 and x4 (smallest, by bisection)."


def judge_integral_weight(experiments: Experiments) -> Judged:
    """integral-weight-is-fast."""
    rows = _sweep(experiments, [(60.0, w) for w in INTEGRAL_WEIGHTS])
    settling = [[row[k] for row in rows] for k in (3, 5)]
    overshoot = [[row[k] for row in rows] for k in (2, 4)]
    holds = all(_falls(column[1:]) for column in settling)
    evidence = (
        f"Weights of x5 {', '.join(f'{w:g}' for w in INTEGRAL_WEIGHTS)}: settling {_list(settling[0], 2)} s at 90°, "
        f"{_list(settling[1], 2)} s at 180°; overshoot {_list(overshoot[0], 1)} % and {_list(overshoot[1], 1)} %."
    )
    repair = "" if holds else _repair(experiments)
    claim = Claim(
        "integral-weight-is-fast",
        "300 x5 guarantees a fast response to a step command (settling falls as the weight grows).",
        "holds" if holds else "fails",
        evidence,
        repair,
        ("table-integral-weight",),
    )
    return Judged(claim, (_table(rows, "The weight of x5 varied.", "table-integral-weight"),))


def _repair(experiments: Experiments) -> str:
    """The smallest equal weights on the two velocities with which settling falls as the weight of x5 grows."""

    def settling(velocity: float) -> list[list[float | None]]:
        rows = _sweep(experiments, [(60.0, w) for w in INTEGRAL_WEIGHTS[1:]], velocity)
        return [[row[k] for row in rows] for k in (3, 5)]

    velocity = smallest_change(lambda w: all(map(_falls, settling(w))), 0.25, 64.0)
    if velocity is None:
        return "no equal weights of x2 and x4 up to 64 make the settling time fall steadily."
    found = settling(velocity)
    return (
        f"weights of {velocity:.2g} on x2 and x4 (smallest, by bisection): settling {_list(found[0], 2)} s at 90° and "
        f"{_list(found[1], 2)} s at 180° for weights of x5 of {', '.join(f'{w:g}' for w in INTEGRAL_WEIGHTS[1:])}."
    )
