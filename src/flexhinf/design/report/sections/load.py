"""Constant torques on all links, at the goal: how far they push the links, and how soon the loop is back."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from flexhinf.design.evaluation import LawEvaluation
from flexhinf.design.report.drawing import (
    figure_block,
    joint_lines,
    limit_lines,
    reference_line,
    vertical_line,
)
from flexhinf.design.report.formatting import Units, units_of
from flexhinf.design.report.remarks import Remark, notes_of
from flexhinf.design.report.sections.step import effort_limit
from flexhinf.design.result import Design
from flexhinf.report import Column, Figure, Section, Table, label, legend, new_figure

__all__ = ["remarks", "section"]


def section(design: Design) -> Section:
    """Figure and table."""
    e = design.evaluation
    units = units_of(e)
    blocks = (*notes_of(remarks(design)), _figure(e, units), _table(e, units))
    return Section("Load response", blocks, "load")


def remarks(design: Design) -> Iterator[Remark]:
    """A load run that diverges, or does not recover."""
    found = design.evaluation.load_response
    if found.response.diverged_at is not None:
        yield Remark(
            "load", "the load run diverges",
            "With torques on the links the loop diverges. Try a smaller `--load`.",
        )  # fmt: skip
        return
    slow = [row["joint"] for row in found.metrics if row["recovery_time_s"] is None]
    if slow:
        names = f"{' and '.join(slow)} {'is' if len(slow) == 1 else 'are'}"
        yield Remark(
            "load", "a load that is not recovered from",
            f"With constant torques on the links, {names} still more than 2 % of the step away from the goal at the "
            "end of the load run.",
        )  # fmt: skip


def _figure(e: LawEvaluation, units: Units) -> Figure:
    loaded, joints = e.load_response, e.setup.robot.joint_names
    run, (unit, scale) = loaded.response.run, units.small
    figure, axes = new_figure(2)
    joint_lines(axes[0], run.time, scale * (loaded.response.positions - loaded.response.goal), joints)
    joint_lines(axes[1], run.time, loaded.response.inputs, joints)
    reference_line(axes[0])
    limit, name = effort_limit(e, units)
    limit_lines(axes[1], limit, loaded.response.inputs, name)
    for axis in axes:
        vertical_line(axis, loaded.at)
    label(axes[0], "link position − goal", unit)
    label(axes[1], "input", units.effort)
    if len(joints) > 1:
        legend(axes[0])
    return figure_block(
        "load", figure,
        f"The robot is in equilibrium at the goal. At {loaded.at:g} s (dotted) constant torques begin to act on all "
        "links at once. Neither law nor estimator knows of them.",
        "Torques on the links",
    )  # fmt: skip


def _table(e: LawEvaluation, units: Units) -> Table:
    parameters = e.setup.model.parameters
    stiffness = np.atleast_1d(parameters.named(parameters.vector()).stiffness).astype(float)
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
    return Table(columns, rows, caption, "table-load")
