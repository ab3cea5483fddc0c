"""The way of the step as a planned move with feedforward, the law in error coordinates."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from flexhinf.design.evaluation import LawEvaluation
from flexhinf.design.report.drawing import (
    DOTTED,
    figure_block,
    joint_lines,
    limit_lines,
    reference_line,
    thin,
)
from flexhinf.design.report.formatting import Units, units_of
from flexhinf.design.report.remarks import Remark, notes_of
from flexhinf.design.report.sections.step import effort_limit
from flexhinf.design.result import Design
from flexhinf.report import (
    MUTED,
    Column,
    Figure,
    Paragraph,
    Section,
    Table,
    house_style,
    label,
    legend,
    new_figure,
    number,
)

__all__ = ["remarks", "section"]


def section(design: Design) -> Section:
    """What a plan changes, figure and table."""
    e = design.evaluation
    units = units_of(e)
    blocks = (
        *notes_of(remarks(design)),
        Paragraph(_text(e, units)),
        _figure(e, units),
        _table(e, units),
    )
    return Section("Planned move with feedforward", blocks, "move")


def remarks(design: Design) -> Iterator[Remark]:
    """A move that diverges."""
    if design.evaluation.move.response.diverged_at is not None:
        yield Remark(
            "move", "the move diverges",
            "The loop diverges while it follows the planned move. Ask for a smaller step or a lower `--bandwidth`.",
        )  # fmt: skip


def _text(e: LawEvaluation, units: Units) -> str:
    step, move = e.step.peak_input, e.move.response.peak_input
    return (
        "Robots follow plans more often than steps. Here the plan covers the way of the step with limited jerk in "
        f"{e.move.plan.duration:.3g} s, its feedforward comes from the elastic inverse dynamics, and the law acts on "
        f"the error that is left. The move needs at most {number(move, 3)} {units.effort}, the step "
        f"{number(step, 3)} {units.effort}."
    )


def _figure(e: LawEvaluation, units: Units) -> Figure:
    move, joints = e.move, e.setup.robot.joint_names
    response, (unit, scale) = move.response, units.small
    time, few = response.run.time, thin(response.run.time)
    limit, name = effort_limit(e, units)
    away = response.positions - response.goal
    figure, axes = new_figure(3, height=6.6)
    joint_lines(axes[0], time, units.scale * away, joints)
    joint_lines(axes[1], time, scale * move.error, joints)
    joint_lines(axes[2], time, response.inputs, joints)
    with house_style():
        for joint in range(len(joints)):
            plan = units.scale * (away - move.error)[few, joint]
            axes[0].plot(
                time[few],
                plan,
                color=MUTED,
                linewidth=1.2,
                linestyle=DOTTED,
                label="plan" if joint == 0 else None,
            )
    reference_line(axes[1])
    limit_lines(axes[2], limit, response.inputs, name)
    label(axes[0], "link position − goal", units.angle)
    label(axes[1], "link position − plan", unit)
    label(axes[2], "input", units.effort)
    legend(axes[0])
    return figure_block(
        "move", figure,
        "Link positions and the plan (dotted), the difference of the two, and the inputs. The inputs jump where the "
        "fourth derivative of the plan does.",
        "The move",
    )  # fmt: skip


def _table(e: LawEvaluation, units: Units) -> Table:
    unit, scale = units.small
    ways = np.abs(e.setup.goal - e.setup.start)
    rows = [
        (
            row["joint"],
            units.scale * float(way),
            scale * row["largest_error"],
            100.0 * row["largest_error"] / float(way) if way else None,
            scale * row["rms_error"],
            row["peak_input"],
        )
        for row, way in zip(e.move.metrics, ways)
    ]
    columns = (
        "joint",
        Column("way", units.angle),
        Column("largest error", unit),
        Column("of the way", "%", 2),
        Column("rms error", unit),
        Column("peak input", units.effort),
    )
    return Table(columns, rows, "Errors of the true link positions from the plan", "table-move")
