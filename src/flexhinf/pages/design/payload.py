"""Payloads that the model does not know: the step, gripping, margins, and what the motors say of the masses."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from flexhinf.analysis import Margins
from flexhinf.design.payload import PayloadEvaluation, payload_requirements
from flexhinf.design.responses import Response
from flexhinf.design.result import Design
from flexhinf.design.specification import RINGS
from flexhinf.pages.design.load_and_move import load_figure
from flexhinf.pages.drawing import finite, listed, units_of
from flexhinf.report import Column, Figure, Paragraph, Table, number


def blocks(design: Design) -> list[Any]:
    """What the robot carries, the heaviest payload as it is gripped, and a table; none without a range of masses."""
    if not design.payloads:
        return []
    found: list[Any] = [Paragraph(_what(design))]
    heaviest = design.payloads[-1]
    if heaviest.load_step is not None:
        found.append(_figure(design, heaviest))
    return [*found, _table(design)]


def carrying_text(design: Design) -> str:
    """The heaviest payload in one sentence."""
    one, (unit, scale) = design.payloads[-1], units_of(design.evaluation).small
    if one.step.diverged_at is not None:
        return f"With {number(one.mass, 3)} kg of payload, which the model does not know, the step diverges."
    text = (
        f"With {number(one.mass, 3)} kg of payload, which the model does not know, the step overshoots by "
        f"{number(one.step.overshoot.value, 2)} %"
    )
    if one.load_step is None:
        return f"{text}."
    back = (
        f"and is back within 2 % of its step after {number(one.recovery.value, 2)} s"
        if np.isfinite(one.recovery.value)
        else "and is not back within 2 % of its step in the run"
    )
    gap = "" if unit == "°" else " "
    where = f" ({one.deflection.joint})" if len(design.robot.joint_names) > 1 else ""
    return f"{text}; gripping it the robot sags by {number(scale * one.deflection.value, 2)}{gap}{unit}{where} {back}."


def remarks(design: Design) -> Iterator[str]:
    """A payload that is not carried, or not as required."""
    for one in design.payloads:
        if one.step.diverged_at is not None or (
            one.load_step and one.load_step.response.diverged_at is not None
        ):
            yield (
                f"The loop diverges with {number(one.mass, 3)} kg of payload. Try a nominal mass nearer to it, "
                "LOWER..NOMINAL..UPPER, or a lower `--bandwidth`."
            )
            return
    missed = [line for line in design.requirements if not line.met and line.where in _places(design)]
    if missed:
        what = listed(list(dict.fromkeys(line.what for line in missed)))
        yield (
            f"With a payload that the model does not know, requirements are not met: {what}. Try a nominal mass in the "
            "middle of the range, `--payload LOWER..NOMINAL..UPPER@LINK`, or weigh it and design for it."
        )


def _places(design: Design) -> set[str]:
    """Where requirements with a payload are judged."""
    limits, s = design.setup.limits, design.specification
    return {line.where for one in design.payloads for line in payload_requirements(s, limits, one, RINGS)}


def _what(design: Design) -> str:
    """How a payload that nobody told is carried, and what the motors say of it."""
    names = [p for p in design.robot.uncertain if p.name.startswith("payload_mass")]
    ranges = ", ".join(
        f"{p.name.removeprefix('payload_mass').strip('_') or 'the link'}: {p.interval[0]:g} to {p.interval[1]:g} kg, "
        f"{p.value:g} kg in the model"
        for p in names
    )
    text = (
        f"Payload on {ranges}. Law and estimator know the model's mass alone; what is heavier is carried by the "
        "integrals of the position errors."
    )
    weighed = design.payloads[-1].weighed
    if weighed is None:
        return text
    said = ", ".join(f"{number(mass, 3)} kg" for mass in weighed.masses.values())
    hidden = max(weighed.hidden.values())
    friction = f", of which dry friction may hide {number(hidden, 2)} kg" if hidden > 0.0 else ""
    return (
        f"{text} At rest the motors say {said} for the heaviest{friction}: flexhinf.robot.weigh_payload weighs, and a "
        "design for that mass is one more call."
    )


def _figure(design: Design, one: PayloadEvaluation) -> Figure:
    """Deviations of the links and inputs while the heaviest payload is gripped."""
    assert one.load_step is not None
    return load_figure(
        design.evaluation, one.load_step, "payload",
        f"At rest at the goal the robot grips {number(one.mass, 3)} kg at {one.load_step.at:g} s (dotted): the weight "
        "beyond what the model carries acts on all links at once. Neither law nor estimator knows of it.",
        "Gripping the heaviest payload",
    )  # fmt: skip


def _table(design: Design) -> Table:
    """A row for each payload, the model's own first."""
    e, (unit, scale) = design.evaluation, units_of(design.evaluation).small
    known = sum(p.value for p in design.robot.uncertain if p.name.startswith("payload_mass"))
    rows = [
        (
            f"{number(known, 3)} kg, as in the model",
            *_step(design, e.step),
            None,
            None,
            None,
            *_margins(e.margins),
        )
    ]
    for one in design.payloads:
        sags: tuple[float | None, ...] = (None, None, None)
        if one.load_step is not None:
            sags = scale * one.deflection.value, finite(one.recovery.value), scale * one.remaining.value
        name = f"{number(one.mass, 3)} kg"
        rows.append((name, *_step(design, one.step), *sags, *_margins(one.margins)))
    columns = (
        "payload", Column("overshoot", "%", 2), Column("settling", "s", 3),
        Column("peak input", units_of(e).effort), Column("sag when gripped", unit), Column("back after", "s", 2),
        Column("remaining sag", unit), Column("damping", "", 3), Column("peak sensitivity", "", 2),
        Column("gain margin", "", 2),
    )  # fmt: skip
    caption = (
        "Step, gripping, and the running loop at the goal, with the payload in the true robot. Worst joints; the peak "
        "input is that of the motor nearest to its limit. Back: within 2 % of the joint's step from then on"
    )
    return Table(columns, rows, caption, "table-payload", stacks=True)


def _step(design: Design, response: Response) -> tuple[float | None, ...]:
    """Overshoot, settling and peak input."""
    limits = design.setup.limits
    used = limits.input_use(response).value if limits.limits_peak else response.peak_input
    return tuple(finite([response.overshoot.value, response.settling.value, used]))


def _margins(found: Margins) -> tuple[float | None, ...]:
    return tuple(finite([found.damping, found.peak_sensitivity, found.gain_margin]))
