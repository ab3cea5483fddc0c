"""How the robot rests at its goal."""

from __future__ import annotations

import numpy as np

from flexhinf.design.page.units import units_of
from flexhinf.design.result import Design
from flexhinf.report import Column, Section, Table

__all__ = ["rest_section"]


def rest_section(design: Design) -> Section:
    """The operating point of the law."""
    n, plant, units = len(design.goal), design.problem.plant, units_of(design)
    x, u = design.problem.operating_point, design.problem.operating_input
    stiffness = np.atleast_1d(plant.parameters.named(plant.parameters.vector()).stiffness)
    rows = [
        (name, float(x[j]), float(x[2 * n + j]), float(stiffness[j] * (x[2 * n + j] - x[j])), float(u[j]))
        for j, name in enumerate(design.robot.joint_names)
    ]
    columns = (
        "joint",
        Column("link position", units.position, 5),
        Column("motor position, seen from the link", units.position, 5),
        Column("gravity held by the spring", units.spring, 3),
        Column("holding input", units.effort, 3),
    )
    return Section("Rest at the goal", (Table(columns, rows, "The operating point", "table-rest"),), "rest")
