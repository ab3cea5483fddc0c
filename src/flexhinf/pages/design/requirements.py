"""What is required, what the loop achieves, where, and by which criterion; then what it costs the motors."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from flexhinf.design.joint_limits import JointLimits
from flexhinf.design.requirements import Requirement
from flexhinf.design.responses import Response
from flexhinf.design.result import Design
from flexhinf.design.specification import TOLERANCE
from flexhinf.pages.drawing import Units, units_of
from flexhinf.pages.drawing import limit_text as effort_text
from flexhinf.report import Column, Paragraph, Table, number

#: What `input_rows` holds: with the same limit for all motors, and where they differ.
INPUT_TITLES = ("largest input", "input nearest its limit")


def blocks(design: Design) -> list[Any]:
    """Requirements, those that are not met first; inputs."""
    given = (
        "No bandwidth or damping is required: the weights are given, and the loop has what results from them."
    )
    free = [Paragraph(given)] if design.design_problem.target is None else []
    units = units_of(design.evaluation)
    lines = [line.shown(units.degrees) for line in design.requirements]
    return [requirement_table(lines), *free, _inputs(design, units)]


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
    sign = "at most" if line.at_most else "at least"
    limit = limit_text(line).split(" ", 1)[1]
    return f"{line.what} {found_text(line)} ({sign} {limit}; {line.where})"


def requirement_table(lines: Sequence[Requirement]) -> Table:
    """One row for each requirement, those that are not met first."""
    rows = [
        (
            line.what,
            limit_text(line),
            found_text(line),
            "NO" if not line.met else line.judgement if line.within_tolerance else "yes",
            line.where,
            line.criterion,
            _source(line.stated_by),
        )
        for line in sorted(lines, key=lambda line: line.met)
    ]
    return Table(
        ("requirement", "required", "achieved", "met", "where", "criterion", "stated by"),
        rows,
        f"A limit that is missed by at most {100.0 * TOLERANCE:g} % of it counts as met, the accuracy of the searches; "
        "the line says so",
        "table-specification",
        stacks=True,
    )


def _source(stated_by: str) -> str:
    """Who states a requirement; an option as code."""
    if stated_by == "default":
        return "our default"
    return f"`{stated_by}`" if stated_by.startswith("--") else stated_by


class InputRow(NamedTuple):
    """The largest input of one run: what was run, the value, the joint and the unit."""

    what: str
    value: float
    joint: str
    unit: str

    @property
    def text(self) -> str:
        """The input with its unit."""
        return f"{number(self.value, 3)} {self.unit}"


def input_rows(design: Design) -> list[InputRow]:
    """The largest inputs of everything that was run, until the run diverged where it did."""
    e, setup = design.evaluation, design.setup
    joints, samples = setup.joints, e.step_samples
    units, effort = [setup.model.unit(name) for name in setup.model.inputs], setup.limits.effort

    def row(what: str, values: np.ndarray) -> InputRow:
        sizes = np.abs(np.asarray(values, dtype=float)).reshape(-1, len(joints)).max(axis=0)
        worst = int(np.argmax(sizes / effort) if np.isfinite(effort).any() else np.argmax(sizes))
        return InputRow(what, float(sizes[worst]), joints[worst], units[worst])

    def run(what: str, response: Response) -> InputRow:
        return row(what + ("" if response.diverged_at is None else " (until it diverged)"), response.inputs)

    rows = [
        row("equilibrium at the start", setup.equilibrium(design.start)[1]),
        row("equilibrium at the goal", setup.equilibrium(design.goal)[1]),
        run("step, nominal robot", e.step),
    ]
    if samples is not None and len(samples):
        worst = row(f"step, worst of {len(samples)} sampled robots", samples.inputs)
        rows.append(worst if np.isfinite(worst.value) else worst._replace(joint=""))
    if design.mujoco is not None:
        rows.append(run("step on MuJoCo's plant", design.mujoco))
    rows += [
        run("planned move with feedforward", e.move.response),
        run("load response: torques on the links", e.load_response.response),
    ]
    noise = e.input_noises
    return rows if noise is None else [*rows, row("sensor noise in equilibrium (rms)", noise)]


def input_title(design: Design) -> str:
    """What the inputs of `input_rows` are."""
    return INPUT_TITLES[bool(len(set(design.setup.limits.effort.tolist())) > 1)]


def _percent(row: InputRow, limits: JointLimits) -> float | None:
    """Of the limit of the row's joint; None where it has none, or the run diverged."""
    limit = float(limits.effort[limits.joints.index(row.joint)]) if row.joint else np.inf
    return 100.0 * row.value / limit if np.isfinite(row.value) and np.isfinite(limit) else None


def _inputs(design: Design, units: Units) -> Table:
    limits, several = design.setup.limits, len(design.setup.joints) > 1
    columns: list[Any] = ["in", input_title(design), *(["joint"] if several else [])]
    columns += [Column("of its limit", "%", 1)] if limits.limits_effort else []
    rows = [
        (
            row.what,
            row.text if np.isfinite(row.value) else "diverges",
            *([row.joint or "–"] if several else []),
            *([_percent(row, limits)] if limits.limits_effort else []),
        )
        for row in input_rows(design)
    ]
    given = f"; the limit is {effort_text(limits.effort)} {units.effort}" if limits.limits_effort else ""
    return Table(columns, rows, f"Inputs of the motors{given}", "table-cost")
