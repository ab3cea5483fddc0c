"""The step: link positions, springs and inputs in the nonlinear loop with its estimator."""

from __future__ import annotations

from flexhinf.design.page.notes import section_notes
from flexhinf.design.page.step_figure import response_figure
from flexhinf.design.page.units import units_of
from flexhinf.design.result import Design
from flexhinf.report import Column, Section, Table

__all__ = ["step_section"]


def step_section(design: Design) -> Section:
    """Drawn, and in a table."""
    blocks = (*section_notes(design, "step"), response_figure(design), _table(design))
    return Section("The step", blocks, "step")


def _table(design: Design) -> Table:
    units = units_of(design)
    rows = [
        (
            name,
            float(begin),
            float(end),
            m.get("overshoot_percent"),
            m.get("settling_time_s"),
            m.get("steady_state_error"),
            m.get("peak_input"),
            m.get("input_noise"),
        )
        for name, begin, end, m in zip(
            design.robot.joint_names, design.start, design.goal, design.response.metrics
        )
    ]
    columns = (
        "joint",
        Column("from", units.position),
        Column("to", units.position),
        Column("overshoot", "%", 1),
        Column("settling time", "s", 3),
        Column("largest error in the last tenth", units.position),
        Column("peak input", units.effort),
        Column("input noise", units.effort),
    )
    caption = "Of the true link positions. Input noise: standard deviation in the last tenth"
    return Table(columns, rows, caption, "table-step")
