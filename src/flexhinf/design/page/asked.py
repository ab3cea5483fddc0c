"""What was asked for and what was found, line by line, and what it costs the motors."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from flexhinf.design.met import Met
from flexhinf.design.page.notes import noise_volts, remarks
from flexhinf.design.page.units import units_of
from flexhinf.design.page.words import compared
from flexhinf.design.result import Design
from flexhinf.report import Bullets, Column, Note, Paragraph, Section, Table, number

__all__ = ["Cost", "asked_section", "cost_rows", "line_cells"]


def asked_section(design: Design, warnings: Any = ()) -> Section:
    """The specification, then the inputs; warnings of the robot's file stand here."""
    told = [Note(" ".join(line.strip() for line in text.splitlines())) for text in warnings]
    about = [remark.about for remark in remarks(design)]
    short = [*([f"Noted below: {', '.join(about)}."] if about else []), *compared(design)]
    blocks = [
        *([Bullets(tuple(short))] if short else []),
        *told,
        _specification(design),
        *_reading(design),
        _cost(design),
    ]
    return Section("What was asked for, and what was found", tuple(blocks), "specification")


def line_cells(line: Met) -> tuple[str, str, str, str]:
    """Asked, found, met, and who asked."""
    unit = f" {line.unit}" if line.unit else ""
    sign = "≤" if line.at_most else "≥"
    found = f"{number(line.found, 3)}{unit}"
    if np.isinf(line.found):
        found = "diverges" if line.at_most else "none is left"
    asked = f"{sign} {number(line.asked, 3)}{unit}"
    return asked, found, "yes" if line.holds else "NO", "asked" if line.asked_for else "our default"


def _specification(design: Design) -> Table:
    rows = []
    for line in design.met:
        asked, found, met, who = line_cells(line)
        rows.append((line.what, asked, found, met, line.where, who))
    return Table(
        ("of", "limit", "found", "met", "where it was looked at", "whose limit"),
        rows,
        "The specification; a limit missed by less than 2 % of it counts as met",
        "table-specification",
    )


def _reading(design: Design) -> list[Paragraph]:
    if design.game.wanted is None:
        return [
            Paragraph(
                "No bandwidth or damping was asked for: the weights are stated, not found, and the loop is what they "
                "make of it."
            )
        ]
    return []


class Cost(NamedTuple):
    """What, the largest input, whose joint it is, and its unit."""

    what: str
    value: float
    joint: str
    unit: str

    @property
    def words(self) -> str:
        """The input with its unit."""
        return f"{number(self.value, 3)} {self.unit}"


def cost_rows(design: Design) -> list[Cost]:
    """The largest inputs of everything that was run, until it diverged where it did."""
    joints, bench, draws = design.robot.joint_names, design.bench, design.draws
    units = [bench.model.unit(name) for name in bench.model.inputs]

    def row(what: str, values: np.ndarray) -> Cost:
        sizes = np.abs(np.asarray(values, dtype=float)).reshape(-1, len(joints)).max(axis=0)
        worst = int(np.argmax(sizes))
        return Cost(what, float(sizes[worst]), joints[worst], units[worst])

    def run(what: str, response: Any) -> Cost:
        ended = "" if response.diverged is None else " (until it diverged)"
        return row(what + ended, response.run.signals["input"])

    rows = [
        row("to rest at the start", bench.rest(design.start)[1]),
        row("to rest at the goal", bench.rest(design.goal)[1]),
        run("the step, nominal robot", design.response),
    ]
    if draws is not None and len(draws):
        what = f"the step, worst of {len(draws)} robots"
        rows.append(Cost(what, float(draws.peak.max()), "", units_of(design).effort))
    if design.mujoco is not None:
        rows.append(run("the step on MuJoCo's plant", design.mujoco))
    rows += [
        run("the same way as a move with feedforward", design.move.response),
        run("torques on the links, at the goal", design.disturbed.response),
    ]
    volts = noise_volts(design)
    return rows if volts is None else [*rows, row("noise of the sensors at rest (rms)", volts)]


def _cost(design: Design) -> Table:
    s, unit = design.specification, units_of(design).effort
    limit = s.effort_limit
    many = len(design.robot.joint_names) > 1
    columns: list[Any] = ["in", "largest input", *(["joint"] if many else [])]
    columns += [Column("of the limit", "%", 1)] if limit is not None else []
    rows = [
        (
            cost.what,
            cost.words,
            *([cost.joint or "–"] if many else []),
            *([100.0 * cost.value / limit] if limit is not None else []),
        )
        for cost in cost_rows(design)
    ]
    told = "" if limit is None else f"; the limit is {limit:g} {unit}"
    return Table(columns, rows, f"What it costs the motors{told}", "table-cost")
