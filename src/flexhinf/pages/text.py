"""Tables of a design, of its proofs and of the catalogue for a terminal of 80 columns."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from flexhinf.design.certification import CertifiedDegree
from flexhinf.design.result import Design
from flexhinf.pages.design.frequency import mode_table
from flexhinf.pages.design.margins import corner_table, margin_table
from flexhinf.pages.design.monte_carlo import spread_table
from flexhinf.pages.design.region import budget_of, budget_table, level_table, region_table
from flexhinf.pages.design.requirements import input_table, requirements_of
from flexhinf.pages.design.rest import rest_table
from flexhinf.pages.design.weights import candidate_table, noise_table, robust_table
from flexhinf.pages.drawing import law_name
from flexhinf.pages.proof import RULES
from flexhinf.report import Column, Table, at_least, number
from flexhinf.robot import catalogue, load_robot

if TYPE_CHECKING:
    from rich.table import Table as Terminal


def robots_table() -> Terminal:
    """The catalogue: what each robot is, and how many of its numbers have a source."""
    rows = []
    for name in catalogue():
        robot = load_robot(name)
        assumed = sum("assumption" in parameter.source for parameter in robot.parameters)
        numbers = f"{len(robot.parameters) - assumed} sourced\n{assumed} assumed"
        rows.append((name, len(robot.joint_names), robot.drive, numbers, robot.description))
    title = "Robots that come with flexhinf: flexhinf design NAME"
    return Table(("name", "joints", "drive", "numbers", ""), rows, title).terminal()


def design_tables(design: Design) -> list[Terminal]:
    """In the order of the page: requirements, inputs, runs, margins, poles, corners, weights, noise, region."""
    e, problem, rest = design.evaluation, design.design_problem, design.rest
    tables = [
        requirements_of(design),
        input_table(design),
        *([spread_table(e)] if e.step_samples is not None and len(e.step_samples) else []),
        *([rest_table(design, rest)] if rest is not None and rest.oscillates and rest.cycles else []),
        margin_table(e),
        mode_table(design, brief=True),
        *([] if e.corners is None else [corner_table(e)]),
        *([] if problem.search is None else [candidate_table(design)]),
        *([] if problem.robustness is None else [robust_table(design)]),
        *([] if design.noise_search is None else [noise_table(design)]),
        *([budget_table(design)] if budget_of(design) else []),
        region_table(design) if design.synthesis.proved is None else level_table(design),
    ]
    return [table.terminal() for table in tables]


def certification_tables(found: Sequence[CertifiedDegree]) -> list[Terminal]:
    """What is proved of the law of each degree, and the runs from the largest proved steps."""
    rows = []
    for one in found:
        name, given = law_name(one.choice.degree) + (" *" if one.used else ""), one.certificate
        if given is None:
            rows.append((name, "none", "", "", "", one.cpu_seconds))
            continue
        ratio = "" if given.sampled_level is None else f"{100 * given.level / given.sampled_level:.1f} %"
        step = at_least(given.step_amplitude) if given.starts else "no step is stated"
        cells = given.provenance.get("cells", "")
        rows.append((name, at_least(given.level), ratio, step, cells, one.cpu_seconds))
    columns = (
        "law", Column("level of V", right=True), Column("of the sampled", right=True),
        Column("largest step", right=True), Column("cells", right=True), Column("CPU", "s", 1),
    )  # fmt: skip
    whom = "all parameters within the tolerances" if any(one.box for one in found) else "nominal parameters"
    title = f"What is proved, with the true state fed back and {whom} (* used)"
    return [Table(columns, rows, title).terminal(), *(_steps(one) for one in found if one.steps)]


def certification_notes(found: Sequence[CertifiedDegree]) -> list[str]:
    """Of which laws nothing is proved, and why."""
    return [f"{law_name(one.choice.degree)}: nothing is proved: {one.reason}" for one in found if one.reason]


def _steps(one: CertifiedDegree) -> Terminal:
    assert one.certificate is not None
    effort, position = one.certificate.inputs[0].unit, one.certificate.states[0].unit
    rows = []
    for step in one.steps:
        inputs = (
            ", ".join(number(v) for v in values) for values in (step.first_input, step.peak_input)
        )  # of each motor
        start = RULES.get(step.rule, step.rule)
        rows.append((start, at_least(step.amplitude), step.overshoot_percent, *inputs))
    columns = (
        "integrators start", Column("step", position, right=True), Column("overshoot", "%", 1),
        Column("first", effort, right=True), Column("peak", effort, right=True),
    )  # fmt: skip
    name = law_name(one.choice.degree)
    title = f"{name}: simulated, not proved: the nominal robot from the largest proved starts"
    return Table(columns, rows, title).terminal()
