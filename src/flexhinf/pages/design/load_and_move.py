"""Two more runs: constant torques on the links at the goal, and a move: the way of the step, or the stated one."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from flexhinf.design.evaluation import LawEvaluation
from flexhinf.design.responses import LoadResponse
from flexhinf.design.result import Design
from flexhinf.pages.design.step import effort_limit, peak_text
from flexhinf.pages.drawing import (
    Units,
    figure_block,
    joint_lines,
    joint_table,
    limit_lines,
    plan_lines,
    reference_line,
    units_of,
    vertical_line,
)
from flexhinf.report import (
    Column,
    Figure,
    Paragraph,
    Table,
    label,
    legend,
    new_figure,
)


def load_blocks(design: Design) -> list[Any]:
    """Figure and table."""
    e = design.evaluation
    loaded = e.load_response
    figure = load_figure(
        e, loaded, "load",
        f"The robot is in equilibrium at the goal. At {loaded.at:g} s (dotted) constant torques begin to act on all "
        "links at once. Neither law nor estimator knows of them.",
        "Torques on the links",
    )  # fmt: skip
    return [figure, _load_table(e, units_of(e))]


def load_remarks(design: Design) -> Iterator[str]:
    """A load run that diverges, or does not recover."""
    found = design.evaluation.load_response
    if found.response.diverged_at is not None:
        yield "With torques on the links the loop diverges. Try a smaller `--load`."
        return
    slow = [row["joint"] for row in found.metrics if row["recovery_time_s"] is None]
    if slow:
        names = f"{' and '.join(slow)} {'is' if len(slow) == 1 else 'are'}"
        yield (
            f"With constant torques on the links, {names} still more than 2 % of the step away from the goal at the "
            "end of the load run."
        )


def load_figure(e: LawEvaluation, loaded: LoadResponse, name: str, caption: str, title: str) -> Figure:
    """Deviations of the links from the goal, and inputs, before and under constant torques on the links."""
    units, joints, response = units_of(e), loaded.response.joints, loaded.response
    run, (unit, scale) = response.run, units.small
    figure, axes = new_figure(2)
    joint_lines(axes[0], run.time, scale * (response.positions - response.goal), joints)
    joint_lines(axes[1], run.time, response.inputs, joints)
    reference_line(axes[0])
    limit, limited = effort_limit(e, units)
    limit_lines(axes[1], limit, response.inputs, limited)
    for axis in axes:
        vertical_line(axis, loaded.at)
    label(axes[0], "link position − goal", unit)
    label(axes[1], "input", units.effort)
    if len(joints) > 1:
        legend(axes[0])
    return figure_block(name, figure, caption, title)


def _load_table(e: LawEvaluation, units: Units) -> Table:
    parameters, layout = e.setup.model.parameters, e.setup.robot.layout
    stiffness = np.full(layout.n, np.inf)
    stiffness[layout.elastic] = parameters.named(parameters.vector()).stiffness
    unit, scale = units.small
    rows = [
        (
            row["joint"],
            row["load"],
            scale * abs(row["load"]) / float(k),
            scale * row["peak_deviation"],
            row["recovery_time_s"],
            scale * row["remaining_error"],
        )
        for row, k in zip(e.load_response.metrics, stiffness)
    ]
    columns = (
        "joint",
        Column("torque on the link", units.load),
        Column("twist of its spring", unit),
        Column("largest deviation", unit),
        Column("recovered after", "s", 3),
        Column("remaining deviation", unit),
    )
    caption = (
        "Twist: of the spring under this torque alone. Recovered: within 2 % of the joint's step from start to goal "
        "from then on. Remaining: largest in the last tenth of the time under load"
    )
    return joint_table(columns, rows, caption, "table-load")


# The planned move ---------------------------------------------------------------------------------------
def move_blocks(design: Design) -> list[Any]:
    """What a plan changes, figure and table."""
    e = design.evaluation
    units = units_of(e)
    return [Paragraph(_text(e, units)), _move_figure(e, units), _move_table(e, units)]


def move_remarks(design: Design) -> Iterator[str]:
    """A move that diverges."""
    if design.evaluation.move.response.diverged_at is not None:
        yield (
            "The loop diverges while it follows the planned move. Ask for a slower move, "
            "a smaller step or a lower `--bandwidth`."
        )


def _text(e: LawEvaluation, units: Units) -> str:
    step, move = peak_text(e.step, units), peak_text(e.move.response, units)
    duration, stated = f"{e.move.plan.duration:.3g} s", e.setup.specification.move is not None
    about = (
        f"The stated move takes {duration} ({e.move.plan.name})."
        if stated
        else f"Robots follow plans more often than steps. Here the plan covers the way of the step in {duration} "
        f"({e.setup.specification.shaping if e.setup.specification.shaping == 'quintic' else 'limited jerk'})."
    )
    return (
        f"{about} Its feedforward comes from the elastic inverse dynamics, and the law acts on the error that is left. "
        f"The move needs at most {move}, the step {step}."
    )


def _move_figure(e: LawEvaluation, units: Units) -> Figure:
    move, joints = e.move, e.setup.robot.joint_names
    response, (unit, scale), time = move.response, units.small, move.response.run.time
    limit, name = effort_limit(e, units)
    stated = e.setup.specification.move is not None
    origin = 0.0 if stated else response.goal
    figure, axes = new_figure(3, height=6.6)
    joint_lines(
        axes[0], time, units.scale * (response.positions - origin), joints if len(joints) > 1 else ["link"]
    )
    joint_lines(axes[1], time, scale * move.error, joints)
    joint_lines(axes[2], time, response.inputs, joints)
    plan_lines(axes[0], time, units.scale * (move.planned - origin), "plan")
    reference_line(axes[1])
    limit_lines(axes[2], limit, response.inputs, name)
    label(axes[0], "link position" if stated else "link position − goal", units.angle)
    label(axes[1], "link position − plan", unit)
    label(axes[2], "input", units.effort)
    legend(axes[0])
    return figure_block(
        "move", figure,
        "Link positions and the plan (dotted), the difference of the two, and the inputs. The inputs jump where the "
        "fourth derivative of the plan does.",
        "The move",
    )  # fmt: skip


def _move_table(e: LawEvaluation, units: Units) -> Table:
    unit, scale = units.small
    rows = [
        (
            row["joint"],
            units.scale * float(way),
            scale * row["largest_error"],
            100.0 * row["largest_error"] / float(way) if way else None,
            scale * row["rms_error"],
            scale * row["final_error"],
            row["peak_input"],
            units.scale * row["peak_speed"],
        )
        for row, way in zip(e.move.metrics, e.move.ways)
    ]
    columns = (
        "joint",
        Column("way", units.angle),
        Column("largest error", unit),
        Column("of the way", "%", 2),
        Column("rms error", unit),
        Column("error at the end", unit),
        Column("peak input", units.effort),
        Column("peak speed", units.rate),
    )
    caption = (
        "Errors of the true link positions from the plan. Way: between the extreme positions of the plan. Error at the "
        "end: largest in the last tenth of the run"
    )
    return joint_table(columns, rows, caption, "table-move")
