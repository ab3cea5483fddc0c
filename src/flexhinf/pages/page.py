"""The report of a design on one page: status, requirements, runs, margins, corners, weights, region, law."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from flexhinf.design.requirements import Requirement
from flexhinf.design.result import Design
from flexhinf.design.result import Status as Judged
from flexhinf.pages.design import (
    along_move,
    corners,
    estimator_noise,
    load_and_move,
    margins,
    monte_carlo,
    payload,
    poles,
    region,
    requirements,
    rest,
    ringing,
    step,
    weights,
)
from flexhinf.pages.design import law as law_section
from flexhinf.pages.drawing import (
    Units,
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
from flexhinf.report import KeyNumber, Page, Provenance, Section, Settings, Status, house_style, number


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
    Part("draws", "Step response of robots within their tolerances", monte_carlo.blocks, monte_carlo.remarks),
    Part("load", "Load response", load_and_move.load_blocks, load_and_move.load_remarks),
    Part("payload", "Payload", payload.blocks, payload.remarks),
    Part("ring-down", "Ring-down after a blow", ringing.blocks, ringing.remarks),
    Part("move", "Planned move with feedforward", load_and_move.move_blocks, load_and_move.move_remarks),
    Part("rest", "Long run at rest with dry friction", rest.blocks, rest.remarks),
    Part("along", "Margins along the move", along_move.blocks, along_move.remarks),
    Part("margins", "Margins of the running loop", margins.blocks, margins.remarks),
    Part("modes", "Poles", poles.blocks, poles.remarks),
    Part("corners", "Corners of the tolerances", corners.blocks, corners.remarks),
    Part("weights", "Weights", weights.blocks),
    Part("noise", "Noise levels of the estimator", estimator_noise.blocks),
    Part("region", "Region: what is proved, what is sampled, and dissipation", region.blocks, region.remarks),
    Part("rigid", "Rigid design on the same robot", law_section.rigid_blocks),
    Part("law", "The law", law_section.law_blocks, law_section.law_remarks),
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
    found = (
        [Status("not met", _sentence(status.not_met))] if status.not_met else [Status("met", _sentence(met))]
    )
    found += [Status("risky", _sentence(status.risky))] if status.risky else []
    return found + ([Status("not proved", _sentence(status.not_proved))] if status.not_proved else [])


def _sentence(parts: Sequence[str]) -> str:
    text = "; ".join(part.rstrip(".") for part in parts)
    return f"{text[:1].upper()}{text[1:]}."


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
        sides = (
            f"fed from the {loop.side} side it is {law_section.loop_text(loop)}"
            for loop in design.rigid.loops
        )
        parts.append(f"The rigid design on the same robot: {'; '.join(sides)}.")
    return " ".join(parts)


def title_of(design: Design) -> str:
    """What was designed, and for which robot."""
    degree, name = design.chosen.degree, law_name(design.chosen.degree)
    law = "A linear H∞ law" if degree == 2 else f"A {name} nonlinear H∞ law"
    if name.startswith("degree"):
        law = f"A nonlinear H∞ law of {name}"
    return f"{law} for the robot “{design.robot.name}”"


def _intro(design: Design) -> str:
    """Robot, sensors, true plant and step."""
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
    """What the nominal loop and the sampled robots do, and what is proved."""
    e = design.evaluation
    units, samples = units_of(e), e.step_samples
    parts = [step.step_text(e.step, units)]
    if not e.margins.stable:
        parts.append("The sampled loop is unstable at the goal.")
    before, after = (poles.vibration_damping(modes) for modes in (e.open_modes, design.law_modes))
    least = f" ({e.least_damped_joint})" if len(e.setup.joints) > 1 and e.least_damped_joint else ""
    if after:
        parts.append(
            f"Damping ratio of the vibrations: {range_text(before, 2)} without control, {range_text(after, 2)} with "
            f"the law; smallest of the running loop, estimator included: {number(e.margins.damping, 2)}{least}."
        )
    if samples is not None and len(samples):
        parts.append(_sampled(design, units))
    if design.payloads:
        parts.append(payload.carrying_text(design))
    parts.append(proof_text(design))
    return " ".join(parts)


def _sampled(design: Design, units: Units) -> str:
    samples = design.evaluation.step_samples
    assert samples is not None
    count, several = len(samples), len(design.robot.joint_names) > 1
    if samples.unsettled:
        gone = f", {samples.diverged} of them diverge" if samples.diverged else ""
        return f"Of {count} robots sampled within their tolerances {samples.unsettled} do not settle{gone}."

    def at(joints: tuple[str, ...], values: np.ndarray) -> str:
        return f" ({joints[int(np.argmax(values))]})" if several else ""

    return (
        f"All of {count} robots sampled within their tolerances settle, the slowest in "
        f"{number(float(samples.settling.max()), 3)} s{at(samples.settling_joints, samples.settling)}; the largest "
        f"overshoot is {number(float(samples.overshoot.max()), 2)} "
        f"%{at(samples.overshoot_joints, samples.overshoot)}, the "
        f"largest input {number(float(samples.peak.max()), 3)} {units.effort}{at(samples.peak_joints, samples.peak)}."
    )


def _key_numbers(design: Design) -> list[KeyNumber]:
    """The few numbers at the top."""
    e = design.evaluation
    response, m, samples, units = e.step, e.margins, e.step_samples, units_of(e)
    period, settling = design.specification.period, rounded(response.settling.value)

    several = len(e.setup.joints) > 1

    def of(joint: str) -> str:
        return f" ({joint})" if several and joint else ""

    def worst(figure: str, unit: str, joint: str) -> str:
        nominal = f"nominal robot{of(joint)}"
        if samples is None or not len(samples):
            return nominal
        return f"{nominal}; {sampled(figure, unit)}" if several else sampled(figure, unit)

    def sampled(figure: str, unit: str) -> str:
        assert samples is not None
        values = getattr(samples, figure)
        if not np.isfinite(values).all():
            bad = "do not settle" if figure == "settling" else "diverge"
            return f"{int(np.isinf(values).sum())} of {len(values)} sampled robots {bad}"
        joint = of(getattr(samples, f"{figure}_joints")[int(np.argmax(values))])
        return f"worst of {len(values)} sampled robots: {number(float(np.max(values)), 3)} {unit}{joint}"

    found = [
        KeyNumber(
            "settling time",
            "not settled" if settling is None else settling,
            "s" if settling else "",
            worst("settling", "s", response.settling.joint),
        ),
        KeyNumber(
            "overshoot",
            rounded(response.overshoot.value, 2),
            "%",
            worst("overshoot", "%", response.overshoot.joint),
        ),
        KeyNumber(
            "peak input",
            rounded(response.peak_input),
            units.effort,
            worst("peak", units.effort, response.peak.joint),
        ),
    ]
    if not m.stable:
        return [*found, KeyNumber("margins", "none", note="the sampled loop at the goal is unstable")]
    low, high = m.disk_gain_margins
    delay = f"{number(m.delay_margin_s / period, 3)} periods of {number(1e3 * period, 3)} ms"
    found += [
        KeyNumber("peak sensitivity", rounded(m.peak_sensitivity), note="running loop, with the estimator"),
        KeyNumber(
            "gain margin", f"× {number(m.gain_margin, 3)}",
            note=f"one input{of(e.setup.joints[m.weakest_input])}; "
            f"all at once × {number(low, 2)} to × {number(high, 3)}",
        ),
        KeyNumber("delay margin", rounded(1e3 * m.delay_margin_s), "ms", delay),
    ]  # fmt: skip
    if e.corners is not None:
        which = "corners of the tolerances" if e.corners.complete else "sampled corners"
        found.append(KeyNumber("unstable", e.corners.unstable, f"of {e.corners.count}", which))
    return found
