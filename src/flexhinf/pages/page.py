"""The report of a design: one page (status, requirements, runs, margins, corners, weights, region, law), and tables for
a terminal."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from flexhinf.design.requirements import Requirement
from flexhinf.design.result import Design
from flexhinf.design.result import Status as Judged
from flexhinf.pages.design import (
    frequency,
    law,
    margins,
    moves,
    region,
    requirements,
    rest,
    step,
    weights,
)
from flexhinf.pages.drawing import (
    joint_count,
    law_name,
    notes_of,
    pose_text,
    range_text,
    rounded,
    units_of,
)
from flexhinf.pages.proof import proof_text
from flexhinf.pages.settings import design_settings, files_section
from flexhinf.report import (
    KeyNumber,
    Page,
    Provenance,
    Section,
    Settings,
    Status,
    Table,
    house_style,
    number,
)
from flexhinf.robot import catalogue, load_robot

if TYPE_CHECKING:
    from rich.table import Table as Terminal


class Part(NamedTuple):
    """A section of the page: anchor, title, its blocks (none where it does not apply), and what must not be missed."""

    anchor: str
    title: str
    blocks: Callable[[Design], list[Any]]
    remarks: Callable[[Design], Iterable[str]] = lambda design: ()


#: In the order of the page.
PARTS = (
    Part("specification", "Requirements", requirements.blocks),
    Part("step", "Step response", step.blocks, step.remarks),
    Part("draws", "Step response of robots within their tolerances", step.draw_blocks, step.draw_remarks),
    Part("load", "Load response", moves.load_blocks, moves.load_remarks),
    Part("payload", "Payload", moves.payload_blocks, moves.payload_remarks),
    Part("ring-down", "Ring-down after an impulse", rest.ring_down_blocks, rest.ring_down_remarks),
    Part("move", "Planned move with feedforward", moves.move_blocks, moves.move_remarks),
    Part("rest", "Long run at rest with dry friction", rest.blocks, rest.remarks),
    Part("along", "Margins along the move", moves.along_blocks, moves.along_remarks),
    Part("margins", "Margins of the running loop", margins.blocks, margins.remarks),
    Part("modes", "Poles", frequency.pole_blocks, frequency.pole_remarks),
    Part("corners", "Corners of the tolerances", margins.corner_blocks, margins.corner_remarks),
    Part("weights", "Weights", weights.blocks),
    Part("noise", "Noise levels of the estimator", weights.noise_blocks),
    Part("region", "Region: what is proved, what is sampled, and dissipation", region.blocks, region.remarks),
    Part("rigid", "Rigid design on the same robot", law.rigid_blocks),
    Part("law", "The law", law.law_blocks, law.law_remarks),
)


def design_page(
    design: Design, command: Sequence[str], warnings: Sequence[str] = (), files: Sequence[str] = ()
) -> Page:
    """Everything on one page.

    Parameters
    ----------
    command : sequence of str
        That makes the report again.
    warnings : sequence of str
        Of the robot's file.
    files : sequence of str
        Names of the files that stand beside the page.
    """
    notes = {**remarks(design), "specification": [" ".join(text.split()) for text in warnings]}
    with house_style():  # once for all figures
        blocks = {part: part.blocks(design) for part in PARTS}
    sections = [
        Section(part.title, (*notes_of(notes[part.anchor]), *found), part.anchor)
        for part, found in blocks.items()
        if found
    ]
    if files:
        sections.append(files_section(files))
    return Page(
        title_of(design),
        _intro(design),
        _headline(design),
        tuple(sections),
        Settings(design_settings(design)),
        Provenance(tuple(command), design.specification.seed),
        _key_numbers(design),
        status_lines(design.status, design.requirements),
    )


def status_lines(status: Judged, lines: Sequence[Requirement]) -> list[Status]:
    """What is not met, not proved and risky, one entry each; what is met where nothing is missed."""
    met = [f"{len(lines)} of {len(lines)} requirements"]
    if not any(line.stated_by != "default" for line in lines):
        met[0] += ", all of them our defaults"
    if not any(line.what.startswith("damping") for line in lines):
        met.append("neither bandwidth nor damping is required")
    met += [status.scope] if status.scope else []
    kinds = {
        "met": [] if status.not_met else met,
        "not met": status.not_met,
        "risky": status.risky,
        "not proved": status.not_proved,
    }
    texts = {kind: "; ".join(part.rstrip(".") for part in parts) for kind, parts in kinds.items()}
    return [Status(kind, f"{text[:1].upper()}{text[1:]}.") for kind, text in texts.items() if text]


def remarks(design: Design) -> dict[str, list[str]]:
    """What the reader must not miss, by the anchor of its section, in the order of the page."""
    return {part.anchor: list(part.remarks(design)) for part in PARTS}


def notes(design: Design) -> list[str]:
    """The same as plain sentences, for a terminal and for design.json."""
    return [text.replace("`", "") for texts in remarks(design).values() for text in texts]


def verdict(design: Design) -> str:
    """The status and what the loop does, in one paragraph for a terminal."""
    status, step_proof = design.status, design.step_proof
    if not step_proof.proved:  # the headline says it in a sentence
        left = tuple(text for text in status.not_proved if text not in step_proof.missing)
        status = replace(status, not_proved=left)
    parts = [status.line, _headline(design)]
    if design.mujoco is not None:
        parts.append(f"On MuJoCo's plant: {step.difference_text(design, units_of(design.evaluation))}.")
    if design.rigid is not None:
        sides = (f"fed from the {loop.side} side it is {law.loop_text(loop)}" for loop in design.rigid.loops)
        parts.append(f"The rigid design on the same robot: {'; '.join(sides)}.")
    return " ".join(parts)


def title_of(design: Design) -> str:
    """What was designed, and for which robot."""
    degree, name = design.chosen.degree, law_name(design.chosen.degree)
    kind = "A linear H∞ law" if degree == 2 else f"A {name} nonlinear H∞ law"
    if name.startswith("degree"):
        kind = f"A nonlinear H∞ law of {name}"
    return f"{kind} for the robot “{design.robot.name}”"


def _intro(design: Design) -> str:
    robot, s = design.robot, design.specification
    about = f"{robot.description.rstrip('.')}. " if robot.description else ""
    measured = ", ".join(s.measured).replace("_", " ") if s.estimator != "none" else "the true state"
    extras = f" The true plant also has {', '.join(s.extras).replace('_', ' ')}." if s.extras else ""
    slides, degrees = robot.links.slides, units_of(design.evaluation).degrees
    return (
        f"{about}{joint_count(len(robot.joint_names)).capitalize()}, {robot.drive} driven. Measured: "
        f"{measured}.{extras} "
        f"Step from {pose_text(design.start, slides, degrees)} to {pose_text(design.goal, slides, degrees)}."
    )


def _headline(design: Design) -> str:
    e = design.evaluation
    parts = [step.step_text(e.step, units_of(e))]
    if not e.margins.stable:
        parts.append("The sampled loop is unstable at the goal.")
    before, after = (frequency.vibration_damping(modes) for modes in (e.open_modes, design.law_modes))
    least = f" ({e.least_damped_joint})" if len(e.setup.joints) > 1 and e.least_damped_joint else ""
    if after:
        parts.append(
            f"Damping ratio of the vibrations: {range_text(before, 2)} without control, {range_text(after, 2)} with "
            f"the law; smallest of the running loop, estimator included: {number(e.margins.damping, 2)}{least}."
        )
    samples = e.step_samples
    if samples is not None and samples.unsettled:
        gone = f", {samples.diverged} of them diverge" if samples.diverged else ""
        parts.append(
            f"Of {len(samples)} robots sampled within their tolerances {samples.unsettled} do not settle{gone}."
        )
    elif samples is not None and len(samples):
        parts.append(
            f"All of {len(samples)} robots sampled within their tolerances settle, the slowest in "
            f"{_worst(design, 'settling', 's')}; the largest overshoot is {_worst(design, 'overshoot', '%', 2)}, the "
            f"largest input {_worst(design, 'peak', units_of(e).effort)}."
        )
    if design.payloads:
        parts.append(moves.payload_text(design))
    return " ".join([*parts, proof_text(design)])


def _worst(design: Design, metric: str, unit: str, digits: int = 3) -> str:
    """The largest value among the samples, with its joint where there are several."""
    samples = design.evaluation.step_samples
    values = getattr(samples, metric)
    joint = getattr(samples, f"{metric}_joints")[int(np.argmax(values))]
    where = f" ({joint})" if len(design.robot.joint_names) > 1 and joint else ""
    return f"{number(float(np.max(values)), digits)} {unit}{where}"


def _key_numbers(design: Design) -> list[KeyNumber]:
    e, period = design.evaluation, design.specification.period
    response, m, samples, effort = e.step, e.margins, e.step_samples, units_of(e).effort
    several, settling = len(e.setup.joints) > 1, rounded(response.settling.value)

    def of(joint: str) -> str:
        return f" ({joint})" if several and joint else ""

    def worst(metric: str, unit: str, joint: str) -> str:
        nominal = f"nominal robot{of(joint)}"
        if samples is None or not len(samples):
            return nominal
        values = getattr(samples, metric)
        text = f"worst of {len(values)} sampled robots: {_worst(design, metric, unit)}"
        if not np.isfinite(values).all():
            bad = "do not settle" if metric == "settling" else "diverge"
            text = f"{int(np.isinf(values).sum())} of {len(values)} sampled robots {bad}"
        return f"{nominal}; {text}" if several else text

    overshoot, settles, peak = (
        worst("overshoot", "%", response.overshoot.joint),
        worst("settling", "s", response.settling.joint),
        worst("peak", effort, response.peak.joint),
    )
    found = [
        KeyNumber(
            "settling time", "not settled" if settling is None else settling, "s" if settling else "", settles
        ),
        KeyNumber("overshoot", rounded(response.overshoot.value, 2), "%", overshoot),
        KeyNumber("peak input", rounded(response.peak_input), effort, peak),
    ]
    if not m.stable:
        return [*found, KeyNumber("margins", "none", note="the sampled loop at the goal is unstable")]
    low, high = m.disk_gain_margins
    delay = f"{number(m.delay_margin_s / period, 3)} periods of {number(1e3 * period, 3)} ms"
    one = f"one input{of(e.setup.joints[m.weakest_input])}"
    together = f"all at once × {number(low, 2)} to × {number(high, 3)}"
    found += [
        KeyNumber("peak sensitivity", rounded(m.peak_sensitivity), note="running loop, with the estimator"),
        KeyNumber("gain margin", f"× {number(m.gain_margin, 3)}", note=f"{one}; {together}"),
        KeyNumber("delay margin", rounded(1e3 * m.delay_margin_s), "ms", delay),
    ]
    if e.corners is not None:
        which = "corners of the tolerances" if e.corners.complete else "sampled corners"
        found.append(KeyNumber("unstable", e.corners.unstable, f"of {e.corners.count}", which))
    return found


# For a terminal of 80 columns --------------------------------------------------------------------------
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
    e, problem, run = design.evaluation, design.design_problem, design.rest
    tables = [
        requirements.requirements_of(design),
        requirements.input_table(design),
        *([step.spread_table(e)] if e.step_samples is not None and len(e.step_samples) else []),
        *([rest.rest_table(design, run)] if run is not None and run.oscillates and run.cycles else []),
        margins.margin_table(e),
        frequency.mode_table(design, brief=True),
        *([] if e.corners is None else [margins.corner_table(e)]),
        *([] if problem.search is None else [weights.candidate_table(design)]),
        *([] if problem.robustness is None else [weights.robust_table(design)]),
        *([] if design.noise_search is None else [weights.noise_table(design)]),
        *([region.budget_table(design)] if region.budget_of(design) else []),
        region.region_table(design) if design.synthesis.proved is None else region.level_table(design),
    ]
    return [table.terminal() for table in tables]
