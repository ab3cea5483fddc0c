"""Tables for a terminal of 80 columns."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from flexhinf.design.result import Design
from flexhinf.design.words import law_name
from flexhinf.robot import catalogue, load_robot

if TYPE_CHECKING:
    from rich.table import Table

__all__ = ["design_tables", "met_table", "robots_table"]


def robots_table() -> Table:
    """The catalogue: what each robot is, and how many of its numbers have a source."""
    table = _table(
        "Robots that ship with flexhinf: flexhinf design NAME", "name", "joints", "drive", "numbers", ""
    )
    for name in catalogue():
        robot = load_robot(name)
        assumed = sum("assumption" in parameter.source for parameter in robot.parameters)
        numbers = f"{len(robot.parameters) - assumed} sourced\n{assumed} assumed"
        table.add_row(name, str(len(robot.joint_names)), robot.drive, numbers, robot.description)
    return table


def design_tables(design: Design) -> list[Table]:
    """What oscillates without and with the law, and what each degree gives."""
    title = (
        f"{design.robot.name}: γ* = {design.gamma_star:.5g}, γ = {design.solution.gamma:.5g}; what oscillates"
    )
    modes = _table(title, "loop", "mode", "mainly", "Hz", "damping")
    for loop, found in (("without control", design.open_modes), ("with this law", design.closed_modes)):
        for mode in found:
            if mode.eigenvalue.imag:
                modes.add_row(loop, mode.name, mode.joint, f"{mode.frequency:.3g}", f"{mode.damping:.3g}")
    unit = design.problem.plant.unit(design.problem.integrate[0])
    columns = ("degree", "law", "V ≤", f"step, {unit}", "°", "residual", "solve, s", "check, s")
    regions = _table("Where each solution can be trusted: sampled, not proved (* used)", *columns)
    for c in design.choices:
        law = law_name(c.degree) + (" *" if c is design.chosen else "")
        looked: tuple[Any, ...] = ("–", "–", "–")
        if c.looked:
            degrees = f"{math.degrees(c.step_amplitude):.3g}" if unit == "rad" else "–"
            looked = (f"{c.level:.3g}", f"{c.step_amplitude:.3g}", degrees)
        times = f"{c.solve_seconds:.2f}", f"{c.check_seconds:.1f}"
        regions.add_row(str(c.degree), law, *looked, f"{c.residual:.0e}", *times)
    return [modes, regions]


def met_table(design: Design) -> Table:
    """The specification line by line: asked, found, met or NOT MET."""
    table = _table(
        "What was asked for, and what was found (* default)", "", "asked", "found", "unit", "outcome"
    )
    where = None
    for line in design.met:
        if line.where != where:
            table.add_row(line.where)
            where = line.where
        asked = f"{'≤' if line.at_most else '≥'} {line.asked:.4g}{' ' if line.asked_for else '*'}"
        outcome = "[green]met[/]" if line.holds else "[red]NOT MET[/]"
        table.add_row(f"  {line.what}", asked, f"{line.found:.4g}", line.unit, outcome)
    return table


def _table(title: str, *columns: str) -> Table:
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0))
    words = ("name", "loop", "mode", "mainly", "law", "drive", "numbers", "unit", "outcome", "")
    for column in columns:
        table.add_column(column, justify="left" if column in words else "right", no_wrap=column != "")
    return table
