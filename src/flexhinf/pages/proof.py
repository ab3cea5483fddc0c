"""What is proved of a design's law: in a sentence, and in design.json."""

from __future__ import annotations

import math
from typing import Any

from flexhinf.certify.starts import SMALLEST_VALUE, UNCHANGED_INPUT
from flexhinf.design.result import Design
from flexhinf.pages.drawing import listed
from flexhinf.report import at_least, at_most

#: The certificate for all tolerances, beside that of the nominal robot.
BOX_FILE = "certificate-tolerances.json"

#: Rules of the integrators' start, in short.
RULES = {SMALLEST_VALUE: "V smallest", UNCHANGED_INPUT: "input unchanged"}


def proof_text(design: Design) -> str:
    """What is proved of the step that is asked for, then of the law for all tolerances and for the nominal robot; why
    nothing is."""
    proof, texts = design.proof, [design.step_proof.text]
    given, box = proof.certificate, proof.box
    if box is not None:
        texts.append(
            f"Proved, for every robot within the tolerances with the true state fed back: the step of "
            f"{_amplitude_text(design, abs(box.step))} without a jump of the input, γ = {at_most(box.gamma)} for "
            f"{penalty_text(design)}."
        )
    if given is None:
        return " ".join(filter(None, [*texts, f"No region is proved: {proof.reason.rstrip('.')}."]))
    reach = "in the region,"
    if given.starts:  # first with the integrators as the controller starts them
        start = min(given.starts, key=lambda start: start.rule != UNCHANGED_INPUT)
        other = (
            ""
            if start.rule == UNCHANGED_INPUT
            else " (only with the integrators started where V is smallest)"
        )
        steps = f"{_amplitude_text(design, start.amplitude)}{other}"
        reach = f"rest-to-rest steps of up to {steps} stay in the region with"
    text = f"γ = {at_most(given.gamma)}."
    if proof.inside and proof.budget:
        spent, left = (f"{100.0 * v / given.level:.2g}" for v in (_spent(design), given.level - proof.start))
        parts = listed([term.name for term in proof.budget])
        kept = "covers" if proof.lasts else "does not cover"
        text += f" The step leaves {left} % of the level, which {kept} the {spent} % that {parts} spend."
    elif proof.inside:
        text += " What the estimator and the sampling spend is not covered."
    whom = "every robot within the tolerances" if covers_tolerances(design) else "the nominal robot"
    texts.append(f"Proved, for {whom} with the true state fed back: {reach} {text}")
    return " ".join(filter(None, texts))


def _spent(design: Design) -> float:
    budget = design.proof.budget
    return budget[-1].budget.total if budget else float("nan")


def penalty_text(design: Design) -> str:
    """The z whose gain is proved for all tolerances."""
    if design.specification.checked_penalty is not None:
        return "the z of the checked penalty"
    own = design.robot.penalty
    return "the z of the robot's own penalty" if own else "the z of Eq. (11), scaled to the robot"


def covers_tolerances(design: Design) -> bool:
    """Whether the proof is for a box of parameters."""
    given = design.proof.certificate
    return given is not None and any(p.low < p.high for p in given.parameters)


def _amplitude_text(design: Design, amplitude: float) -> str:
    slides = any(design.robot.links.slides)
    in_degrees = design.specification.in_degrees and not slides
    scale, unit = (180.0 / math.pi, "°") if in_degrees else (1.0, " m" if slides else " rad")
    return f"{at_least(scale * amplitude, 3)}{unit}"


def proof_numbers(design: Design) -> dict[str, Any]:
    """For design.json."""
    proof, given, box = design.proof, design.proof.certificate, design.proof.box
    tolerances: dict[str, Any] = {"proved": covers_tolerances(design), "reason": proof.box_reason}
    if box is not None and box.certificate is not None:
        tolerances = {
            "proved": True, "gamma": box.gamma, "step": abs(box.step), "level": box.certificate.level,
            "cpu_s": box.cpu_seconds, "file": BOX_FILE,
        }  # fmt: skip
    if given is None:
        return {
            "strength": "SampledCheck", "proved": False, "step_proved": design.step_proof.proved,
            "reason": proof.reason, "cpu_s": proof.cpu_seconds, "for_all_tolerances": tolerances,
        }  # fmt: skip
    return {
        "strength": "Certificate", "proved": True, "feedback": given.feedback,
        "parameters": "tolerances" if covers_tolerances(design) else "nominal",
        "gamma": given.gamma, "level": given.level, "sampled_level": given.sampled_level,
        "steps": {RULES.get(start.rule, start.rule): start.amplitude for start in given.starts},
        "step_proved": design.step_proof.proved,
        "start": proof.start, "starts_inside": proof.inside, "spent": _spent(design), "lasts": proof.lasts,
        "attained_gain": given.attained_gain, "cpu_s": proof.cpu_seconds, "file": "certificate.json",
        "for_all_tolerances": tolerances,
    }  # fmt: skip
