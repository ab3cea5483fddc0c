"""What is required, what the loop achieves, where, and by which criterion; then what it costs the motors."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from flexhinf.design.requirements import Requirement
from flexhinf.design.responses import Response
from flexhinf.design.result import Design
from flexhinf.design.specification import TOLERANCE
from flexhinf.pages.drawing import limit_text as effort_text
from flexhinf.pages.drawing import units_of
from flexhinf.report import Cell, Column, Paragraph, Table, number

#: Of the judgement in a terminal.
COLOURS = {"met": "green", "NOT MET": "red"}


def blocks(design: Design) -> list[Any]:
    """Requirements, those that are not met first; inputs."""
    given = (
        "No bandwidth or damping is required: the weights are given, and the loop has what results from them."
    )
    free = [Paragraph(given)] if design.design_problem.target is None else []
    return [requirements_of(design), *free, input_table(design)]


def limit_text(line: Requirement) -> str:
    """The limit with its sign and unit, for example ``≤ 60 V``."""
    return f"{'≤' if line.at_most else '≥'} {number(line.limit, 3)}{line.unit_text}"


def found_text(line: Requirement) -> str:
    """What is achieved, with its unit and the joint of the worst value."""
    if np.isinf(line.found):
        return "diverges" if line.at_most else "unlimited"
    words = [line.joint, "" if line.at is None else f"at {number(line.at, 3)} s"]
    joint = f" ({', '.join(word for word in words if word)})" if any(words) else ""
    return f"{number(line.found, 3)}{line.unit_text}{joint}"


def requirement_text(line: Requirement) -> str:
    """A requirement in one phrase, for example ``overshoot 9 % (at most 5 %; nominal robot)``."""
    limit = limit_text(line).split(" ", 1)[1]
    return (
        f"{line.what} {found_text(line)} ({'at most' if line.at_most else 'at least'} {limit}; {line.where})"
    )


def requirements_of(design: Design) -> Table:
    """The requirements of a design."""
    title = (
        f"{design.robot.name}: requirements (* our default; a miss of {100.0 * TOLERANCE:g} % counts as met)"
    )
    return requirement_table(design.requirements, units_of(design.evaluation).degrees, title)


def requirement_table(lines: Iterable[Requirement], degrees: bool = False, title: str = "") -> Table:
    """Requirements grouped by where they hold; those that are not met, and their groups, first.

    Parameters
    ----------
    degrees : bool
        Whether angles are in degrees.
    title : str
        In a terminal.
    """
    groups: dict[str, list[Requirement]] = {}
    for line in sorted(lines, key=lambda line: line.met):
        groups.setdefault(line.where, []).append(line.shown(degrees))
    rows: list[Any] = []
    for where, group in groups.items():
        rows.append(where)
        for line in group:
            judged = Cell(line.judgement, COLOURS.get(line.judgement, "yellow"))
            default = line.stated_by == "default"
            source = f"`{line.stated_by}`" if line.stated_by.startswith("--") else line.stated_by
            required = f"{limit_text(line)}{'*' if default else ''}"
            source = "our default" if default else source
            rows.append((line.what, required, found_text(line), judged, line.criterion, source))
    columns = (
        "requirement", Column("required", right=True), Column("achieved", right=True), "met",
        Column("criterion", brief=None),
        Column("stated by", brief=None),
    )  # fmt: skip
    caption = (
        f"A limit that is missed by at most {100.0 * TOLERANCE:g} % of it counts as met, the accuracy of the searches; "
        "the line says so. * our default"
    )
    return Table(columns, rows, caption, "table-specification", stacks=True, title=title)


def input_rows(design: Design) -> list[dict[str, Any]]:
    """The largest inputs of everything that was run, until the run diverged where it did: "what", "value", "joint",
    "unit"."""
    e, setup = design.evaluation, design.setup
    joints, samples = setup.joints, e.step_samples
    units, effort = [setup.model.unit(name) for name in setup.model.inputs], setup.limits.effort

    def row(what: str, values: np.ndarray) -> dict[str, Any]:
        sizes = np.abs(np.asarray(values, dtype=float)).reshape(-1, len(joints)).max(axis=0)
        worst = int(np.argmax(sizes / effort) if np.isfinite(effort).any() else np.argmax(sizes))
        return {"what": what, "value": float(sizes[worst]), "joint": joints[worst], "unit": units[worst]}

    def run(what: str, response: Response) -> dict[str, Any]:
        return row(what + ("" if response.diverged_at is None else " (until it diverged)"), response.inputs)

    rows = [
        row("equilibrium at the start", setup.equilibrium(design.start)[1]),
        row("equilibrium at the goal", setup.equilibrium(design.goal)[1]),
        run("step, nominal robot", e.step),
    ]
    if samples is not None and len(samples):
        rows.append(row(f"step, worst of {len(samples)} sampled robots", samples.inputs))
        if not np.isfinite(rows[-1]["value"]):
            rows[-1]["joint"] = ""
    if design.mujoco is not None:
        rows.append(run("step on MuJoCo's plant", design.mujoco))
    rows += [
        run("planned move with feedforward", e.move.response),
        run("load response: torques on the links", e.load_response.response),
    ]
    noise = e.input_noises
    return rows if noise is None else [*rows, row("sensor noise in equilibrium (rms)", noise)]


def input_table(design: Design) -> Table:
    """The largest input of every run, its joint, and its percentage of that joint's limit."""
    limits, several, records = design.setup.limits, len(design.setup.joints) > 1, []
    for row in input_rows(design):
        limit = float(limits.effort[limits.joints.index(row["joint"])]) if row["joint"] else np.inf
        known = np.isfinite(row["value"])
        records.append(
            {
                **row,
                "text": f"{number(row['value'], 3)} {row['unit']}" if known else "diverges",
                "joint": row["joint"] or "–",
                "percent": 100.0 * row["value"] / limit if known and np.isfinite(limit) else None,
            }
        )
    differ = len(set(limits.effort.tolist())) > 1
    columns = [
        Column("in", key="what"),
        Column("input nearest its limit" if differ else "largest input", key="text"),
        *([Column("joint", key="joint")] if several else []),
        *([Column("of its limit", "%", 1, key="percent", brief=None)] if limits.limits_effort else []),
    ]
    units = units_of(design.evaluation)
    given = f"; the limit is {effort_text(limits.effort)} {units.effort}" if limits.limits_effort else ""
    caption = f"Inputs of the motors{given}"
    return Table.of(columns, records, caption, "table-cost", title="Inputs of the motors")
