"""Requirements: limit, achieved value, place and criterion; then the inputs of the motors."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from flexhinf.design.requirements import Requirement
from flexhinf.design.responses import Response
from flexhinf.design.result import Design
from flexhinf.design.specification import TOLERANCE
from flexhinf.pages.drawing import Blocks, limit_text as effort_text, units_of
from flexhinf.report import Cell, Column, Paragraph, Table, number


def requirements(design: Design) -> Blocks:
    """Table of the requirements, those that are not met first, and of the inputs."""
    yield requirement_table(
        design.requirements, units_of(design.evaluation).degrees,
        f"{design.robot.name}: requirements (* our default; a miss of {100.0 * TOLERANCE:g} % counts as met)",
    )  # fmt: skip
    if design.design_problem.target is None:
        yield Paragraph("No bandwidth or damping is required: they result from the weights, which are given.")
    limits, rows = design.setup.limits, []
    several, limited = len(design.setup.joints) > 1, limits.limits_effort
    for row in input_rows(design):
        limit = float(limits.effort[limits.joints.index(row["joint"])]) if row["joint"] else np.inf
        known = np.isfinite(row["value"])
        more = ([row["joint"] or "–"] if several else []) + (
            [100.0 * row["value"] / limit if known and np.isfinite(limit) else None] if limited else []
        )
        rows.append((row["what"], f"{number(row['value'], 3)} {row['unit']}" if known else "diverges", *more))
    bound = (
        f"; the limit is {effort_text(limits.effort)} {units_of(design.evaluation).effort}" if limited else ""
    )
    yield Table(
        (
            "in", "input nearest its limit" if len(set(limits.effort.tolist())) > 1 else "largest input",
            *(["joint"] if several else []),
            *([Column("of its limit", "%", 1, brief=None)] if limited else []),
        ),
        rows, f"Inputs of the motors{bound}", "table-cost", title="Inputs of the motors",
    )  # fmt: skip


def limit_text(line: Requirement) -> str:
    """The limit with its sign and unit, for example ``≤ 60 V``."""
    return f"{'≤' if line.at_most else '≥'} {number(line.limit, 3)}{line.unit_text}"


def achieved_text(line: Requirement) -> str:
    """The achieved value with its unit and the joint of the worst value."""
    if np.isinf(line.found):
        return "diverges" if line.at_most else "unlimited"
    places = [line.joint, "" if line.at is None else f"at {number(line.at, 3)} s"]
    where = f" ({', '.join(filter(None, places))})" if any(places) else ""
    return f"{number(line.found, 3)}{line.unit_text}{where}"


def requirement_text(line: Requirement) -> str:
    """A requirement in one phrase, for example ``overshoot 9 % (at most 5 %; nominal robot)``."""
    limit = f"{'at most' if line.at_most else 'at least'} {limit_text(line).split(' ', 1)[1]}"
    return f"{line.what} {achieved_text(line)} ({limit}; {line.where})"


def requirement_table(lines: Iterable[Requirement], degrees: bool = False, title: str = "") -> Table:
    """Requirements grouped by where they hold; those that are not met, and their groups, first."""
    groups: dict[str, list[Requirement]] = {}
    for line in sorted(lines, key=lambda line: line.met):
        groups.setdefault(line.where, []).append(line.converted(degrees))
    rows: list[Any] = []
    for where, group in groups.items():
        rows.append(where)
        for line in group:
            judged = Cell(line.judgement, {"met": "green", "NOT MET": "red"}.get(line.judgement, "yellow"))
            source = f"`{line.stated_by}`" if line.stated_by.startswith("--") else line.stated_by
            limit = limit_text(line)
            if source == "default":
                source, limit = "our default", f"{limit}*"
            rows.append((line.what, limit, achieved_text(line), judged, line.criterion, source))
    return Table(
        (
            "requirement", Column("required", right=True), Column("achieved", right=True), "met",
            Column("criterion", brief=None), Column("stated by", brief=None),
        ),
        rows,
        f"A limit that is missed by at most {100.0 * TOLERANCE:g} % of it, the accuracy of the searches, counts as "
        "met, and the line says so. * our default",
        "table-specification", stacks=True, title=title,
    )  # fmt: skip


def input_rows(design: Design) -> list[dict[str, Any]]:
    """The largest inputs of every run, until it diverged where it did: "what", "value", "joint", "unit"."""
    e, setup, samples = design.evaluation, design.setup, design.evaluation.step_samples
    runs: tuple[tuple[str, Response | np.ndarray | None], ...] = (
        ("equilibrium at the start", setup.equilibrium(design.start)[1]),
        ("equilibrium at the goal", setup.equilibrium(design.goal)[1]),
        ("step, nominal robot", e.step),
        (
            f"step, worst of {0 if samples is None else len(samples)} sampled robots",
            samples.inputs if samples is not None and len(samples) else None,
        ),
        ("step on MuJoCo's plant", design.mujoco),
        ("planned move with feedforward", e.move.response),
        ("load response: torques on the links", e.load_response.response),
        ("sensor noise in equilibrium (rms)", e.input_noises),
    )
    rows, effort = [], setup.limits.effort
    for what, run in ((what, run) for what, run in runs if run is not None):
        inputs = run.inputs if isinstance(run, Response) else np.asarray(run, dtype=float)
        cut = " (until it diverged)" if isinstance(run, Response) and run.diverged_at is not None else ""
        sizes = np.abs(inputs).reshape(-1, len(setup.joints)).max(axis=0)
        worst = int(np.argmax(sizes / effort) if np.isfinite(effort).any() else np.argmax(sizes))
        value, unit = float(sizes[worst]), setup.model.unit(setup.model.inputs[worst])
        joint = setup.joints[worst] if np.isfinite(value) else ""
        rows.append({"what": f"{what}{cut}", "value": value, "joint": joint, "unit": unit})
    return rows
