"""The same way as a planned move with feedforward, the law in error coordinates."""

from __future__ import annotations

import numpy as np

from flexhinf.design.page.drawing import joint_lines, limit_lines, zero_line
from flexhinf.design.page.notes import section_notes
from flexhinf.design.page.step_figure import effort_limit
from flexhinf.design.page.units import units_of
from flexhinf.design.page.words import peak_input
from flexhinf.design.result import Design
from flexhinf.report import (
    MUTED,
    Column,
    Figure,
    Paragraph,
    Section,
    Table,
    figure_to_svg,
    house_style,
    label,
    legend,
    new_figure,
    number,
)

__all__ = ["move_section"]


def move_section(design: Design) -> Section:
    """Plan, error, input, and what they come to."""
    blocks = (*section_notes(design, "move"), Paragraph(_words(design)), _figure(design), _table(design))
    return Section("The same way as a move with feedforward", blocks, "move")


def _words(design: Design) -> str:
    step, move, unit = peak_input(design.response), peak_input(design.move.response), units_of(design).effort
    return (
        f"Robots are moved along plans, not by steps: here a jerk-limited one of {design.move.plan.duration:.3g} s, "
        "its feedforward from the elastic inverse dynamics, and the law on what is left. Its peak input is "
        f"{number(move, 3)} {unit}, that of the step {number(step, 3)} {unit}."
    )


def _figure(design: Design) -> Figure:
    move, joints, units = design.move, design.robot.joint_names, units_of(design)
    run, limit = move.response.run, effort_limit(design)
    figure, axes = new_figure(3, height=7.2)
    away = move.response.positions - design.goal
    joint_lines(axes[0], run.time, away, joints)
    joint_lines(axes[1], run.time, move.error, joints)
    joint_lines(axes[2], run.time, run.signals["input"], joints)
    plan = away - move.error
    with house_style():
        for joint in range(len(joints)):
            axes[0].plot(
                run.time, plan[:, joint], color=MUTED, linewidth=1.2, linestyle=(0, (1.0, 1.6)),
                label="plan" if joint == 0 else None,
            )  # fmt: skip
    zero_line(axes[1])
    limit_lines(axes[2], limit[0], run.signals["input"], limit[1])
    label(axes[0], "link position − goal", units.position)
    label(axes[1], "link position − plan", units.position)
    label(axes[2], "input", units.effort)
    legend(axes[0])
    return Figure(
        "figure-move",
        figure_to_svg(figure),
        "Link positions and the plan (dotted), what is between them, and the inputs, which jump where the "
        "snap of the plan does.",
        "The move",
    )


def _table(design: Design) -> Table:
    units = units_of(design)
    ways = np.abs(design.goal - design.start)
    rows = [
        (
            name,
            float(way),
            m.get("largest_error"),
            None if not way or "largest_error" not in m else 100.0 * m["largest_error"] / float(way),
            m.get("rms_error"),
            m.get("peak_input"),
        )
        for name, way, m in zip(design.robot.joint_names, ways, design.move.metrics)
    ]
    columns = (
        "joint",
        Column("way", units.position),
        Column("largest error", units.position),
        Column("of the way", "%", 2),
        Column("rms error", units.position),
        Column("peak input", units.effort),
    )
    return Table(columns, rows, "Of the true link positions from the plan", "table-move")
