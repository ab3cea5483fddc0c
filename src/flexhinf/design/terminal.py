"""Tables for a terminal of 80 columns."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from flexhinf.design.page.asked import cost_rows
from flexhinf.design.page.corners import sweep_cells, sweep_rows, sweep_words
from flexhinf.design.page.drawn import spread_rows
from flexhinf.design.page.guarantee import budget_rows
from flexhinf.design.page.margins import margin_rows
from flexhinf.design.page.units import units_of
from flexhinf.design.page.weights import robust_rows, some_tries, try_rows
from flexhinf.design.page.words import law_name
from flexhinf.design.result import Design
from flexhinf.report import number
from flexhinf.robot import catalogue, load_robot

if TYPE_CHECKING:
    from rich.table import Table

__all__ = ["design_tables", "met_table", "robots_table"]

#: Columns of words; numbers are aligned to the right.
LEFT = (
    "name", "loop", "mode", "mainly", "law", "drive", "numbers", "", "in", "joint", "unit",
    "outcome", "part", "largest input",
)  # fmt: skip

#: Of a terminal; a title is not broken before it.
WIDTH = 80

#: With more joints than these, swings are left to the page.
MANY = 3

#: Columns that may take several lines.
WRAPPED = ("", "in", "pace, rad/s")


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
    """In the order of the page: specification, inputs, weights, tolerances, modes, margins, regions."""
    found = [met_table(design), _cost(design)]
    if design.game.found is not None:
        found.append(_search(design))
    if design.game.robustness is not None:
        found.append(_robust(design))
    if design.draws is not None and len(design.draws):
        found.append(_tolerances(design))
    found += [_modes(design), _margins(design)]
    if design.tolerances is not None:
        found.append(_corners(design))
    if design.guarantee.expenses:
        found.append(_budget(design))
    return [*found, _regions(design)]


def met_table(design: Design) -> Table:
    """The specification line by line: asked, found, met or NOT MET."""
    title = f"{design.robot.name}: what was asked for, and what was found (* default)"
    table = _table(title, "", "asked", "found", "unit", "outcome")
    where = None
    for line in design.met:
        if line.where != where:
            table.add_row(line.where)
            where = line.where
        asked = f"{'≤' if line.at_most else '≥'} {line.asked:.4g}{' ' if line.asked_for else '*'}"
        outcome = "[green]met[/]" if line.holds else "[red]NOT MET[/]"
        table.add_row(f"  {line.what}", asked, number(line.found, 3), line.unit, outcome)
    return table


def _cost(design: Design) -> Table:
    table = _table("What it costs the motors", "in", "largest input", "joint")
    for cost in cost_rows(design):
        table.add_row(cost.what, cost.words, cost.joint)
    return table


def _search(design: Design) -> Table:
    """Some tries of the search."""
    rows = try_rows(design)
    title = f"Search for the weights: {len(rows)} tries, some of them (* used)"
    table = _table(title, "dial ζ", "pace, rad/s", "bandwidth, rad/s", "damping: worst", "nominal", "γ*")
    for knob, pace, bandwidth, worst, nominal, gamma, is_used in some_tries(rows):
        dial = f"{knob:.3f}{' *' if is_used else '  '}"
        table.add_row(dial, pace, bandwidth, number(worst, 3), number(nominal, 3), number(gamma))
    return table


def _robust(design: Design) -> Table:
    r = design.game.robustness
    assert r is not None
    title = f"The tolerances' price: {r.channels} channels, {100.0 * r.share:.3g} % of the tolerances covered"
    table = _table(title, "", "without", "with", "cost, %")
    for what, plain, robust in robust_rows(design):
        table.add_row(what, number(plain), number(robust), f"{100.0 * (robust / plain - 1.0):.1f}")
    return table


def _tolerances(design: Design) -> Table:
    draws = design.draws
    assert draws is not None
    settle = f"{len(draws) - draws.unsettled} settle, {draws.diverged} diverge"
    title = f"The step on {len(draws)} robots within their tolerances: {settle}"
    table = _table(title, "", "nominal", "median", "95 % below", "worst")
    for name, unit, *values in spread_rows(design):
        cells = ("–" if value is None else number(value, 3) for value in values)
        table.add_row(f"{name}, {unit}", *cells)
    return table


def _modes(design: Design) -> Table:
    title = (
        f"{design.robot.name}: γ* = {design.gamma_star:.5g}, γ = {design.solution.gamma:.5g}; what oscillates"
    )
    modes = _table(title, "loop", "mode", "mainly", "Hz", "damping")
    for loop, found in (("without control", design.open_modes), ("with this law", design.closed_modes)):
        for mode in found:
            if mode.eigenvalue.imag and (mode.vibration or len(design.robot.joint_names) <= MANY):
                modes.add_row(loop, mode.name, mode.joint, f"{mode.frequency:.3g}", f"{mode.damping:.3g}")
    return modes


def _margins(design: Design) -> Table:
    alone = design.specification.estimator == "none"
    heads = ("true state",) if alone else ("with the estimator", "true state")
    table = _table("The sampled loop at the goal", "", *heads)
    for row in margin_rows(design):
        table.add_row(*row[: 1 + len(heads)])
    return table


def _corners(design: Design) -> Table:
    cells, title = sweep_cells(design), f"Corners of the tolerances, the sampled loop: {sweep_words(design)}"
    if not cells:
        table = _table(title, "loop", "unstable", "growth, 1/s")
        for found in sweep_rows(design):
            table.add_row(found.form, str(found.unstable), number(found.rate, 3))
        return table
    table = _table(
        title, "q/Rⁿ", "all states: unstable", "growth, 1/s", "velocities: unstable", "growth, 1/s"
    )
    for row in cells:
        table.add_row(*row)
    return table


def _budget(design: Design) -> Table:
    """γ from above and below in the title, then what the parts of the controller spend."""
    attained = design.guarantee.attained
    title = "What the controller's parts spend of the region in the step"
    if attained is not None:
        gain = f"√(∫|z|²/∫|d|²): {number(attained.gain)} found, γ = {number(design.solution.gamma)} designed"
        title = f"{gain}\n{title}"
    table = _table(title, "part", "spends", "with all above", "left of the level", "lasts")
    for row in budget_rows(design):
        left = number(row["left"]) if math.isfinite(row["left"]) else "–"
        lasts = ("yes" if row["kept"] else "NO") if math.isfinite(row["level"]) else "–"
        table.add_row(row["part"], number(row["added"], 3), number(row["spent"], 3), left, lasts)
    return table


def _regions(design: Design) -> Table:
    columns = (
        "degree",
        "law",
        "V ≤",
        f"step, {units_of(design).position}",
        "°",
        "residual",
        "solve, s",
        "check, s",
    )
    regions = _table("Where each solution can be trusted: sampled, not proved (* used)", *columns)
    for c in design.choices:
        law = law_name(c.degree) + (" *" if c is design.chosen else "")
        looked: tuple[Any, ...] = ("–", "–", "–")
        if c.looked:
            degrees = f"{math.degrees(c.step_amplitude):.3g}" if units_of(design).position == "rad" else "–"
            looked = (f"{c.level:.3g}", f"{c.step_amplitude:.3g}", degrees)
            if math.isnan(c.step_amplitude):
                looked = ("no region", "–", "–")
            if math.isinf(c.step_amplitude):
                looked = ("any", "any", "–")
        times = f"{c.solve_seconds:.2f}", f"{c.check_seconds:.1f}"
        regions.add_row(str(c.degree), law, *looked, f"{c.residual:.0e}", *times)
    return regions


def _table(title: str, *columns: str) -> Table:
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    table = Table(
        title=title,
        title_justify="left",
        box=SIMPLE_HEAD,
        pad_edge=False,
        padding=(0, 1, 0, 0),
        min_width=min(WIDTH, max(map(len, title.split("\n")))),
    )
    for column in columns:
        table.add_column(column, justify="left" if column in LEFT else "right", no_wrap=column not in WRAPPED)
    return table
