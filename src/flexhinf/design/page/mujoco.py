"""The same controller and noise on MuJoCo's plant."""

from __future__ import annotations

from flexhinf.design.page.units import units_of
from flexhinf.design.page.words import mujoco_words
from flexhinf.design.result import Design
from flexhinf.report import Column, Section, Table

__all__ = ["mujoco_section"]


def mujoco_section(design: Design) -> Section | None:
    """The figures of merit of both plants side by side; None if it was not run."""
    if design.mujoco is None:
        return None
    units = units_of(design)
    rows = [
        (
            plant,
            name,
            m.get("overshoot_percent"),
            m.get("settling_time_s"),
            m.get("steady_state_error"),
            m.get("peak_input"),
        )
        for plant, response in (("ours", design.response), ("MuJoCo's", design.mujoco))
        for name, m in zip(design.robot.joint_names, response.metrics)
    ]
    columns = (
        "plant",
        "joint",
        Column("overshoot", "%"),
        Column("settling time", "s", 3),
        Column("largest error in the last tenth", units.position),
        Column("peak input", units.effort),
    )
    caption = f"The same controller and noise on MuJoCo's plant: {mujoco_words(design)}"
    return Section("The step on MuJoCo's plant", (Table(columns, rows, caption, "table-mujoco"),), "mujoco")
