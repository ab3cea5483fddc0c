"""Torques on the links, at rest at the goal."""

from __future__ import annotations

import numpy as np

from flexhinf.design.page.drawing import joint_lines, limit_lines, zero_line
from flexhinf.design.page.notes import section_notes
from flexhinf.design.page.step_figure import effort_limit
from flexhinf.design.page.units import units_of
from flexhinf.design.result import Design
from flexhinf.report import (
    MUTED,
    Column,
    Figure,
    Section,
    Table,
    figure_to_svg,
    house_style,
    label,
    legend,
    new_figure,
)

__all__ = ["load_section"]


def load_section(design: Design) -> Section:
    """How far they push the links, and how soon that is over."""
    blocks = (*section_notes(design, "load"), _figure(design), _table(design))
    return Section("Torques on the links", blocks, "load")


def _figure(design: Design) -> Figure:
    disturbed, joints, units = design.disturbed, design.robot.joint_names, units_of(design)
    run = disturbed.response.run
    figure, axes = new_figure(2)
    joint_lines(axes[0], run.time, disturbed.response.positions - design.goal, joints)
    joint_lines(axes[1], run.time, run.signals["input"], joints)
    zero_line(axes[0])
    limit, name = effort_limit(design)
    limit_lines(axes[1], limit, run.signals["input"], name)
    with house_style():
        for axis in axes:
            axis.axvline(disturbed.at, color=MUTED, linewidth=1.0, linestyle=(0, (1.0, 1.6)), zorder=0.5)
    label(axes[0], "link position − goal", units.position)
    label(axes[1], "input", units.effort)
    if len(joints) > 1:
        legend(axes[0])
    return Figure(
        "figure-load",
        figure_to_svg(figure),
        f"At rest at the goal; at {disturbed.at:g} s (dotted) constant torques begin to act on all links at once: "
        "neither law nor estimator is told.",
        "Torques on the links",
    )


def _table(design: Design) -> Table:
    units = units_of(design)
    p = design.problem.plant.parameters
    stiffness = np.atleast_1d(p.named(p.vector()).stiffness).astype(float)
    rows = [
        (
            name,
            float(load),
            float(abs(load) / k),
            m.get("peak_deviation"),
            m.get("recovery_time_s"),
            m.get("remaining"),
        )
        for name, load, k, m in zip(
            design.robot.joint_names, design.disturbed.load, stiffness, design.disturbed.metrics
        )
    ]
    columns = (
        "joint",
        Column("torque on the link", units.load),
        Column("twist of its spring", units.position),
        Column("largest deviation", units.position),
        Column("recovered after", "s", 3),
        Column("left in the last tenth", units.position),
    )
    caption = (
        "Twist: that of the spring under the torque alone; recovered: within 5 % of the largest deviation"
    )
    return Table(columns, rows, caption, "table-load")
