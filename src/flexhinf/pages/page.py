"""The report of a design: one page (status, requirements, runs, margins, corners, weights, region, law), and tables for
a terminal."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import takewhile
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from flexhinf.design.requirements import Requirement
from flexhinf.design.result import Design, Status as Judged
from flexhinf.pages.design import frequency, law, region, requirements, runs, step, weights
from flexhinf.pages.drawing import (
    Blocks,
    in_joint,
    joint_count,
    law_name,
    note,
    pose_text,
    range_text,
    rounded,
    units_of,
    with_figures,
)
from flexhinf.pages.settings import design_settings, files_section
from flexhinf.report import (
    KeyNumber,
    Note,
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
    """A section of the page: anchor, title, and its blocks, notes first; none where it does not apply."""

    anchor: str
    title: str
    blocks: Callable[[Design], Blocks]


#: In the order of the page.
PARTS = (
    Part("specification", "Requirements", requirements.requirements),
    Part("step", "Step response", step.step),
    Part("draws", "Step response of robots within their tolerances", step.samples),
    Part("load", "Load response", runs.load),
    Part("payload", "Payload", runs.payload),
    Part("ring-down", "Ring-down after an impulse", runs.ring_down),
    Part("move", "Planned move with feedforward", runs.move),
    Part("rest", "Long run at rest with dry friction", runs.long_run),
    Part("along", "Margins along the move", runs.margins_along),
    Part("margins", "Margins of the running loop", frequency.margins),
    Part("modes", "Poles", law.poles),
    Part("corners", "Corners of the tolerances", frequency.corners),
    Part("weights", "Weights", weights.weights),
    Part("noise", "Noise levels of the estimator", weights.noise_levels),
    Part("region", "Region: what is proved, what is sampled, and dissipation", region.region),
    Part("rigid", "Rigid design on the same robot", law.rigid),
    Part("law", "The law", law.law),
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
    robot, s, sections = design.robot, design.specification, []
    about = f"{robot.description.rstrip('.')}. " if robot.description else ""
    measured = ", ".join(s.measured).replace("_", " ") if s.estimator != "none" else "the true state"
    extras = f" The true plant also has {', '.join(s.extras).replace('_', ' ')}." if s.extras else ""
    slides, degrees = robot.links.slides, units_of(design.evaluation).degrees
    start, goal = (pose_text(pose, slides, degrees) for pose in (design.start, design.goal))
    joints = joint_count(len(robot.joint_names)).capitalize()
    with house_style():  # once for all figures
        for part in PARTS:
            blocks = with_figures(part.blocks(design))
            if part.anchor == "specification":
                blocks = [*(note(" ".join(text.split())) for text in warnings), *blocks]
            if not all(isinstance(block, Note) for block in blocks):
                sections.append(Section(part.title, tuple(blocks), part.anchor))
    if files:
        sections.append(files_section(files))
    return Page(
        title_of(design),
        f"{about}{joints}, {robot.drive} driven. Measured: {measured}.{extras} Step from {start} to {goal}.",
        _headline(design),
        tuple(sections),
        Settings(design_settings(design)),
        Provenance(tuple(command), s.seed),
        _key_numbers(design),
        status_lines(design.status, design.requirements),
    )


def remarks(design: Design) -> dict[str, list[str]]:
    """What the reader must not miss, by the anchor of its section, in the order of the page."""
    return {
        part.anchor: [
            note.text
            for note in takewhile(lambda block: isinstance(block, Note), part.blocks(design))
            if isinstance(note, Note)
        ]
        for part in PARTS
    }


def notes(design: Design) -> list[str]:
    """The same as plain sentences, for a terminal and for design.json."""
    return [text.replace("`", "") for texts in remarks(design).values() for text in texts]


def status_lines(status: Judged, lines: Sequence[Requirement]) -> list[Status]:
    """What is not met, not proved and risky, one entry each; what is met where nothing is missed."""
    met = [f"{len(lines)} of {len(lines)} requirements"]
    if not any(line.stated_by != "default" for line in lines):
        met[0] += ", all of them our defaults"
    if not any(line.what.startswith("damping") for line in lines):
        met.append("neither bandwidth nor damping is required")
    kinds = {
        "met": [] if status.not_met else [*met, *filter(None, [status.scope])],
        "not met": status.not_met,
        "risky": status.risky,
        "not proved": status.not_proved,
    }
    texts = {kind: "; ".join(part.rstrip(".") for part in parts) for kind, parts in kinds.items()}
    return [Status(kind, f"{text[:1].upper()}{text[1:]}.") for kind, text in texts.items() if text]


def verdict(design: Design) -> str:
    """The status and what the loop does, in one paragraph for a terminal."""
    status, step_proof = design.status, design.step_proof
    if not step_proof.proved:  # the headline says it in a sentence
        left = tuple(text for text in status.not_proved if text not in step_proof.missing)
        status = replace(status, not_proved=left)
    parts = [status.line, _headline(design)]
    if design.mujoco is not None:
        parts.append(f"On MuJoCo's plant: {step.difference_text(design)}.")
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


def _headline(design: Design) -> str:
    e, samples, units = design.evaluation, design.evaluation.step_samples, units_of(design.evaluation)
    parts = [step.step_text(e.step, units)]
    if not e.margins.stable:
        parts.append("The sampled loop is unstable at the goal.")
    before, after = (law.vibration_damping(modes) for modes in (e.open_modes, design.law_modes))
    if after:
        parts.append(
            f"Damping ratio of the vibrations: {range_text(before, 2)} without control, {range_text(after, 2)} with "
            f"the law; smallest of the running loop, estimator included: {number(e.margins.damping, 2)}"
            f"{in_joint(e.least_damped_joint, e.setup.joints)}."
        )
    if samples is not None and samples.unsettled:
        gone = f", {samples.diverged} of them diverge" if samples.diverged else ""
        within = f"Of {len(samples)} robots sampled within their tolerances"
        parts.append(f"{within} {samples.unsettled} do not settle{gone}.")
    elif samples is not None and len(samples):
        parts.append(
            f"All of {len(samples)} robots sampled within their tolerances settle, the slowest in "
            f"{_worst(design, 'settling', 's')}; the largest overshoot is {_worst(design, 'overshoot', '%', 2)}, the "
            f"largest input {_worst(design, 'peak', units.effort)}."
        )
    if design.payloads:
        parts.append(runs.payload_text(design))
    return " ".join([*parts, region.proof_text(design)])


def _worst(design: Design, metric: str, unit: str, digits: int = 3) -> str:
    """The largest value among the samples, with its joint where there are several."""
    samples = design.evaluation.step_samples
    values = getattr(samples, metric)
    joint = getattr(samples, f"{metric}_joints")[int(np.argmax(values))]
    return f"{number(float(np.max(values)), digits)} {unit}{in_joint(joint, design.robot.joint_names)}"


def _key_numbers(design: Design) -> list[KeyNumber]:
    e, period, joints = design.evaluation, design.specification.period, design.evaluation.setup.joints
    response, m, samples, numbers = e.step, e.margins, e.step_samples, []
    time = rounded(response.settling.value)
    settles = ("not settled", "") if time is None else (time, "s")
    overshoot = (rounded(response.overshoot.value, 2), "%")
    peak = (rounded(response.peak_input), units_of(e).effort)
    for name, metric, (value, unit), joint in (
        ("settling time", "settling", settles, response.settling.joint),
        ("overshoot", "overshoot", overshoot, response.overshoot.joint),
        ("peak input", "peak", peak, response.peak.joint),
    ):
        text = nominal = f"nominal robot{in_joint(joint, joints)}"
        if samples is not None and len(samples):
            values = getattr(samples, metric)
            text = f"worst of {len(values)} sampled robots: {_worst(design, metric, unit or 's')}"
            if not np.isfinite(values).all():
                bad = "do not settle" if metric == "settling" else "diverge"
                text = f"{int(np.isinf(values).sum())} of {len(values)} sampled robots {bad}"
            text = f"{nominal}; {text}" if len(joints) > 1 else text
        numbers.append(KeyNumber(name, value, unit, text))
    if not m.stable:
        return [*numbers, KeyNumber("margins", "none", note="the sampled loop at the goal is unstable")]
    low, high = m.disk_gain_margins
    delay = f"{number(m.delay_margin_s / period, 3)} periods of {number(1e3 * period, 3)} ms"
    one = f"one input{in_joint(joints[m.weakest_input], joints)}"
    together = f"all at once × {number(low, 2)} to × {number(high, 3)}"
    numbers += [
        KeyNumber("peak sensitivity", rounded(m.peak_sensitivity), note="running loop, with the estimator"),
        KeyNumber("gain margin", f"× {number(m.gain_margin, 3)}", note=f"{one}; {together}"),
        KeyNumber("delay margin", rounded(1e3 * m.delay_margin_s), "ms", delay),
    ]
    if e.corners is not None:
        which = "corners of the tolerances" if e.corners.complete else "sampled corners"
        numbers.append(KeyNumber("unstable", e.corners.unstable, f"of {e.corners.count}", which))
    return numbers


# For a terminal of 80 columns --------------------------------------------------------------------------
def design_tables(design: Design) -> list[Terminal]:
    """The tables of the page that have a title for a terminal, in its order; of the modes fewer rows."""
    tables = (
        block for part in PARTS for block in part.blocks(design) if isinstance(block, Table) and block.title
    )
    short = (law.mode_table(design, brief=True) if table.id == "table-modes" else table for table in tables)
    return [table.terminal() for table in short]


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
