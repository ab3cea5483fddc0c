"""Tables of a design, a comparison and the catalogue for a terminal of 80 columns.

What is proved of a design, for a terminal.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.table import Table
from rich.text import Text

from flexhinf.design.certification import CertifiedDegree
from flexhinf.design.requirements import Requirement
from flexhinf.design.result import ComparedLaw, Comparison, Design
from flexhinf.design.specification import TOLERANCE
from flexhinf.pages.design.corners import corner_rows, corners_text
from flexhinf.pages.design.estimator_noise import is_used, selected
from flexhinf.pages.design.law_figures import TableLine, table_lines
from flexhinf.pages.design.margins import margin_rows
from flexhinf.pages.design.monte_carlo import spread_rows
from flexhinf.pages.design.poles import mode_groups
from flexhinf.pages.design.region import (
    budget_of,
    budget_rows,
    cost_text,
    degree_text,
    level_rows,
    region_strength,
    widest_step,
)
from flexhinf.pages.design.requirements import (
    INPUT_TITLES,
    found_text,
    input_rows,
    input_title,
    limit_text,
)
from flexhinf.pages.design.rest import frequency_text
from flexhinf.pages.design.weights import (
    candidate_rows,
    robust_rows,
    selected_candidates,
)
from flexhinf.pages.drawing import count_text, law_name, units_of
from flexhinf.pages.proof import RULES, penalty_text
from flexhinf.report import at_least, number
from flexhinf.robot import catalogue, load_robot

#: Columns of words; numbers are aligned to the right.
LEFT = (
    "name", "loop", "mode", "mainly", "law", "drive", "numbers", "", "in", "joint", "unit", "met", "part",
    *INPUT_TITLES,
)  # fmt: skip

#: Of a terminal; a title is not broken before it.
WIDTH = 80

#: With more joints than these only vibrations are listed; the page has all modes.
MANY = 3

#: Columns that may take several lines.
WRAPPED = ("", "in", "target ω, rad/s", "loop", "achieved")

#: Characters between columns of a comparison.
GAP = 2

#: Of the steps in the table of regions.
STARTED = "Sampled step: with the integrals at which V is smallest, not the controller's"

#: Short names of the forms of R^v.
FORMS = {"all states": "all states", "velocities only": "velocities", "link velocities only": "links",
         "motor velocities only": "motors"}  # fmt: skip


class LiteralTable(Table):
    """A table whose texts are taken as they are: a joint called [red] or :cat: is neither mark-up nor an emoji."""

    def add_column(self, header: Any = "", *others: Any, **options: Any) -> None:
        """As a table's."""
        super().add_column(Text(header), *others, **options)

    def add_row(self, *cells: Any, **options: Any) -> None:
        """As a table's."""
        super().add_row(*(Text(cell) if isinstance(cell, str) else cell for cell in cells), **options)


def robots_table() -> Table:
    """The catalogue: what each robot is, and how many of its numbers have a source."""
    table = plain_table(
        "Robots that come with flexhinf: flexhinf design NAME", "name", "joints", "drive", "numbers", ""
    )
    for name in catalogue():
        robot = load_robot(name)
        assumed = sum("assumption" in parameter.source for parameter in robot.parameters)
        numbers = f"{len(robot.parameters) - assumed} sourced\n{assumed} assumed"
        table.add_row(name, str(len(robot.joint_names)), robot.drive, numbers, robot.description)
    return table


def design_tables(design: Design) -> list[Table]:
    """In the order of the page: requirements, inputs, runs, margins, poles, corners, weights, noise, region."""
    e, problem = design.evaluation, design.design_problem
    found = [requirement_table(design), _inputs(design)]
    if e.step_samples is not None and len(e.step_samples):
        found.append(_samples(design))
    if design.rest is not None and design.rest.oscillates and design.rest.cycles:
        found.append(_rest(design))
    found += [_margins(design), _modes(design)]
    if e.corners is not None:
        found.append(_corners(design))
    if problem.search is not None:
        found.append(_search(design))
    if problem.robustness is not None:
        found.append(_robust(design))
    if design.noise_search is not None:
        found.append(_noise(design))
    if budget_of(design):
        found.append(_budget(design))
    return [*found, _regions(design) if design.synthesis.proved is None else _levels(design)]


def requirement_table(design: Design) -> Table:
    """Required, achieved, met or NOT MET; grouped by where, groups with a requirement that is not met first."""
    title = (
        f"{design.robot.name}: requirements (* our default; a miss of {100.0 * TOLERANCE:g} % counts as met)"
    )
    return lines_table(title, design.requirements, units_of(design.evaluation).degrees)


def lines_table(title: str, requirements: Sequence[Requirement], degrees: bool) -> Table:
    """Requirements grouped by where, those that are not met first; with angles in degrees or rad."""
    table = plain_table(title, "", "required", "achieved", "met")
    groups: dict[str, list[Any]] = {}
    for line in requirements:
        groups.setdefault(line.where, []).append(line)
    for where, lines in sorted(groups.items(), key=lambda group: all(line.met for line in group[1])):
        table.add_row(where)
        for line in sorted((line.shown(degrees) for line in lines), key=lambda line: line.met):
            required = f"{limit_text(line)}{'*' if line.stated_by == 'default' else ' '}"
            colour = "red" if not line.met else "yellow" if line.within_tolerance else "green"
            table.add_row(f"  {line.what}", required, found_text(line), Text(line.judgement, colour))
    return table


def _inputs(design: Design) -> Table:
    several = len(design.robot.joint_names) > 1
    table = plain_table("Inputs of the motors", "in", input_title(design), *(["joint"] if several else []))
    for row in input_rows(design):
        table.add_row(row.what, row.text, *([row.joint] if several else []))
    return table


def _samples(design: Design) -> Table:
    e = design.evaluation
    samples = e.step_samples
    assert samples is not None
    settle = f"{len(samples) - samples.unsettled} settle, {samples.diverged} diverge"
    title = f"The step on {len(samples)} robots sampled within their tolerances: {settle}"
    several = len(e.setup.joints) > 1
    table = plain_table(
        title, "", "nominal", "median", "95 % below", "worst", *(["joint"] if several else [])
    )
    for name, unit, *values, joint in spread_rows(e, units_of(e)):
        cells = (number(value, 3) for value in values)
        table.add_row(f"{name}, {unit}", *cells, *([joint] if several else []))
    return table


def _rest(design: Design) -> Table:
    run = design.rest
    assert run is not None
    unit, scale = units_of(design.evaluation).small
    title = f"{run.response.run.time[-1]:.3g} s at rest with dry friction: hunting"
    table = plain_table(title, "joint", f"amplitude, {unit}", "frequency", f"remaining error, {unit}")
    for joint, cycle, error in zip(run.response.joints, run.cycles, run.errors.tolist()):
        frequency = frequency_text(cycle.frequency) if cycle.amplitude > run.limit else "–"
        table.add_row(joint, number(scale * cycle.amplitude, 3), frequency, number(scale * error, 3))
    return table


def _margins(design: Design) -> Table:
    alone = design.specification.estimator == "none"
    heads = ("true state",) if alone else ("running loop", "true state")
    table = plain_table("Margins, linearised at the goal", "", *heads)
    for row in margin_rows(design.evaluation):
        table.add_row(*row)
    return table


def _modes(design: Design) -> Table:
    title = f"γ* of the problem = {design.gamma_star:.5g}, γ = {design.gamma:.5g}\nOscillations at the goal"
    joints = len(design.robot.joint_names)
    modes = plain_table(title, "loop", "mode", *(["mainly"] if joints > 1 else []), "Hz", "damping")
    for loop, found in mode_groups(design):
        for mode in found:
            if mode.eigenvalue.imag and (mode.vibration or joints <= MANY):
                place = [mode.joint] if joints > 1 else []
                modes.add_row(loop, mode.name, *place, f"{mode.frequency:.3g}", f"{mode.damping:.3g}")
    return modes


def _corners(design: Design) -> Table:
    e = design.evaluation
    assert e.corners is not None
    rows, forms = corner_rows(e), e.corners.forms
    title = f"Corners of the tolerances. {corners_text(e)}"
    if not forms:
        table = plain_table(title, "loop", "unstable", "growth, 1/s")
        for found in rows:
            table.add_row(found.form, str(found.unstable), number(found.rate, 3))
        return table
    table = plain_table(
        title + "\nUnstable corners over Rᵛ = q on:", "q/Rⁿ", *(FORMS[form] for form in forms)
    )
    by = {(row.form, row.ratio): row for row in rows}
    for ratio in sorted({row.ratio for row in rows if row.ratio is not None}):
        found = [by.get((form, ratio)) for form in forms]
        cells = ("–" if row is None else str(row.unstable) for row in found)
        table.add_row(number(ratio, 2), *cells)
    return table


def _search(design: Design) -> Table:
    rows = candidate_rows(design)
    shown = selected_candidates(rows)
    title = f"Search for the weights: {len(shown)} of {count_text(len(rows), 'candidate')} (* used)"
    heads = ("weight ζ", "target ω, rad/s", "bandwidth, rad/s", "damping: worst", "nominal", "γ*")
    table = plain_table(title, *heads)
    for weight, target, bandwidth, worst, nominal, gamma, used in shown:
        mark = f"{weight:.3f}{' *' if used else '  '}"
        table.add_row(mark, target, bandwidth, number(worst, 3), number(nominal, 3), number(gamma))
    return table


def _robust(design: Design) -> Table:
    r = design.design_problem.robustness
    assert r is not None
    title = (
        f"Cost of the tolerances: {r.channels} channels, {100.0 * r.fraction:.3g} % of the tolerances covered"
    )
    table = plain_table(title, "", "without", "with", "cost, %")
    for what, plain, robust in robust_rows(design):
        table.add_row(what, number(plain), number(robust), f"{100.0 * (robust / plain - 1.0):.1f}")
    return table


def _noise(design: Design) -> Table:
    search = design.noise_search
    assert search is not None
    shown = selected(search)
    unit = design.setup.model.unit(design.setup.model.inputs[0])
    title = f"Noise levels of the estimator: {len(shown)} of {count_text(search.count, 'candidate')} (* used)"
    table = plain_table(title, f"noise, {unit}", "damping", "compliance", "|S|", "gain", "")
    for one, note in shown:
        cells = (one.input_noise, one.damping, one.compliance, one.peak_sensitivity, one.gain_margin)
        table.add_row(*(_short(value) for value in cells), "*" if is_used(search, one) else note)
    return table


def _short(value: float) -> str:
    return number(value, 2) if math.isfinite(value) else "–"


def _budget(design: Design) -> Table:
    """The lower bound of the gain in the title, then what the parts of the controller use of the level."""
    attained = design.attenuation.attained
    title = "Dissipation budget of the step"
    if attained is not None:
        gain = f"√(∫|z|²/∫|d|²): {number(attained.gain)} found (lower bound), γ = {number(design.gamma)} designed"
        title = f"{gain}\n{title}"
    table = plain_table(title, "part", "uses", "with all above", "remaining level", "within budget")
    for row in budget_rows(design):
        left = number(row["left"]) if math.isfinite(row["left"]) else "–"
        kept = ("yes" if row["kept"] else "NO") if math.isfinite(row["level"]) else "–"
        table.add_row(row["part"], number(row["added"], 3), number(row["spent"], 3), left, kept)
    return table


def _levels(design: Design) -> Table:
    """The proved gain between its bounds."""
    title = "\n".join(textwrap.wrap(degree_text(design), WIDTH))
    table = plain_table(f"{title}\nGain √(∫|z|²/∫|d|²), {penalty_text(design)}", "", "value")
    for what, value in level_rows(design):
        table.add_row(what, number(value))
    return table


def _regions(design: Design) -> Table:
    unit, most = units_of(design.evaluation).position, widest_step(design)
    columns = ("degree", "law", "cost", "V ≤", f"sampled step, {unit}", "°", "residual", "time, s")
    title = "\n".join(textwrap.wrap(degree_text(design), WIDTH))
    regions = plain_table(
        f"{title}\nRegion of each solution: {region_strength(design)} (* used)\n{STARTED}", *columns
    )
    for c in design.choices:
        law = law_name(c.degree) + (" *" if c is design.chosen else "")
        sampled: tuple[str, ...] = ("–", "–", "–")
        if c.looked:
            step = min(c.step_amplitude, most)
            at_limit = "≥ " if step < c.step_amplitude else ""
            degrees = f"{at_limit}{math.degrees(step):.3g}" if unit == "rad" else "–"
            sampled = (f"{c.level:.3g}", f"{at_limit}{step:.3g}", degrees)
            if math.isinf(step):
                sampled = ("any", "any", "–")
            if math.isnan(c.level):
                sampled = ("none", "–", "–")
        seconds = f"{c.solve_seconds + c.check_seconds:.2f}"
        cost = cost_text(c, design.choices[0])
        regions.add_row(str(c.degree), law, cost, *sampled, f"{c.residual:.0e}", seconds)
    return regions


def plain_table(title: str, *columns: str) -> Table:
    """An empty table; columns of words are aligned to the left."""
    table = LiteralTable(
        title=Text(title, "table.title"),
        title_justify="left",
        box=SIMPLE_HEAD,
        pad_edge=False,
        padding=(0, 1, 0, 0),
        min_width=min(WIDTH, max(map(len, title.split("\n")))),
    )
    for column in columns:
        left = column in LEFT
        table.add_column(column, justify="left" if left else "right", no_wrap=column not in WRAPPED)
    return table


# Comparison ----------------------------------------------------------------------------------------------
def comparison_tables(comparison: Comparison, width: int = WIDTH) -> list[Table]:
    """Tables of at most `width` columns, as many laws as fit, the design's own in each; * marks the best."""
    first, found = comparison.tuned_design, []
    names = max(len(_label(line)) for line in table_lines(comparison, (first,), short=True))
    left = width - names - GAP - _width(comparison, first)
    part: list[ComparedLaw] = [first]
    room = left
    for row in sorted(comparison.compared, key=lambda row: row.tuned.cost if row.tuned else math.inf):
        if row is first:
            continue
        needed = _width(comparison, row)
        if needed > room and len(part) > 1:
            found.append(_part(comparison, part, not found))
            part, room = [first], left
        part.append(row)
        room -= needed
    return [*found, _part(comparison, part, not found)]


def _width(comparison: Comparison, row: ComparedLaw) -> int:
    """Of a law's column."""
    cells = [len(_cell(line, 0)) for line in table_lines(comparison, (row,), short=True) if line.cells]
    return max(len(row.name), *cells) + GAP


def _label(line: TableLine) -> str:
    return f" {line.label}{', ' + line.unit if line.unit else ''}" if line.cells else line.label


def _cell(line: TableLine, place: int) -> str:
    return f"{line.cells[place]}{'*' if line.best[place] else ''}"


def _part(comparison: Comparison, rows: Sequence[ComparedLaw], first: bool) -> Table:
    legend = "* best of its row, or as good as the best"
    title = f"{comparison.robot.name}: laws in the same runs; {legend}" if first else legend
    table = LiteralTable(
        title=Text(title, "table.title"),
        title_justify="left",
        box=SIMPLE_HEAD,
        show_edge=False,
        pad_edge=False,
        padding=(0, GAP - 1, 0, 0),
    )
    table.add_column("", no_wrap=True)
    for row in rows:
        table.add_column(row.name, justify="right", no_wrap=True)
    for line in table_lines(comparison, rows, short=True):
        if line.cells:
            table.add_row(_label(line), *(_cell(line, place) for place in range(len(rows))))
        else:
            table.add_row(Text(line.label, "bold"))
    return table


def certification_tables(found: Sequence[CertifiedDegree]) -> list[Table]:
    """What is proved of the law of each degree, and the runs from the largest proved steps."""
    whom = "all parameters within the tolerances" if any(one.box for one in found) else "nominal parameters"
    table = plain_table(
        f"What is proved, with the true state fed back and {whom} (* used)",
        "law", "level of V", "of the sampled", "largest step", "cells", "CPU, s",
    )  # fmt: skip
    for one in found:
        name = law_name(one.choice.degree) + (" *" if one.used else "")
        given = one.certificate
        if given is None:
            table.add_row(name, "none", "", "", "", f"{one.cpu_seconds:.1f}")
            continue
        ratio = "" if given.sampled_level is None else f"{100 * given.level / given.sampled_level:.1f} %"
        cells = given.provenance.get("cells", "")
        step = at_least(given.step_amplitude) if given.starts else "no step is stated"
        table.add_row(name, at_least(given.level), ratio, step, cells, f"{one.cpu_seconds:.1f}")
    return [table, *(_steps(one) for one in found if one.steps)]


def certification_notes(found: Sequence[CertifiedDegree]) -> list[str]:
    """Of which laws nothing is proved, and why."""
    return [f"{law_name(one.choice.degree)}: nothing is proved: {one.reason}" for one in found if one.reason]


def _steps(one: CertifiedDegree) -> Table:
    assert one.certificate is not None
    units = one.certificate.inputs[0].unit
    moved = one.certificate.states[0].unit
    table = plain_table(
        f"{law_name(one.choice.degree)}: simulated, not proved: the nominal robot from the largest proved starts",
        "integrators start", f"step, {moved}", "overshoot, %", f"first, {units}", f"peak, {units}",
    )  # fmt: skip
    for step in one.steps:
        first, peak = (", ".join(number(v) for v in values) for values in (step.first_input, step.peak_input))
        table.add_row(
            RULES.get(step.rule, step.rule),
            at_least(step.amplitude),
            number(step.overshoot_percent, decimals=1),
            first,
            peak,
        )
    return table
