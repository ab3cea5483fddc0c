"""The top of the page: what was asked, and the numbers that matter."""

from __future__ import annotations

import numpy as np

from flexhinf.design.page.notes import noise_volts
from flexhinf.design.page.units import pose_words, step_words, units_of
from flexhinf.design.page.words import (
    joint_words,
    largest_overshoot,
    law_name,
    peak_input,
    range_of,
    slowest_settling,
    vibrations,
)
from flexhinf.design.result import Design
from flexhinf.report import KeyNumber, number

__all__ = ["asked_words", "key_numbers", "title_of"]


def title_of(design: Design) -> str:
    """What was made, and for what."""
    degree = design.chosen.degree
    law = "A linear H∞ law" if degree == 2 else f"A {law_name(degree)} nonlinear H∞ law"
    if law_name(degree).startswith("degree"):
        law = f"A nonlinear H∞ law of {law_name(degree)}"
    return f"{law} for the robot “{design.robot.name}”"


def asked_words(design: Design) -> str:
    """Robot, sensors, step, and what was to be met."""
    robot, s = design.robot, design.specification
    about = f"{robot.description.rstrip('.')}. " if robot.description else ""
    measured = ", ".join(s.measured).replace("_", " ")
    ways = ", ".join(s.extras).replace("_", " ")
    extras = f" The true plant has {ways} too." if s.extras else ""
    slides = robot.links.slides
    return (
        f"{about}{joint_words(len(robot.joint_names)).capitalize()}, {robot.drive} driven; measured: "
        f"{measured}.{extras} Step from {pose_words(design.start, slides)} to {pose_words(design.goal, slides)}. "
        f"{_wanted(design)}"
    )


def _wanted(design: Design) -> str:
    """The limits, each once, those that were asked for first."""
    lines = {line.what: line for line in reversed(design.met) if line.asked}
    words: dict[bool, list[str]] = {True: [], False: []}
    for line in design.met:
        if lines.pop(line.what, None) is not None:
            unit = f" {line.unit}" if line.unit else ""
            sign = "at most" if line.at_most else "at least"
            words[line.asked_for].append(f"{line.what} {sign} {number(line.asked, 3)}{unit}")
    parts = []
    if words[True]:
        parts.append(f"Asked for: {', '.join(words[True])}")
    if words[False]:
        parts.append(f"{'by' if parts else 'By'} default: {', '.join(words[False])}")
    return f"{'; '.join(parts)}." if parts else ""


def key_numbers(design: Design) -> list[KeyNumber]:
    """The few at the top."""
    overshoot, settling = largest_overshoot(design.response), slowest_settling(design.response)
    unit, draws = units_of(design).effort, design.draws
    volts = noise_volts(design)
    noise = "" if volts is None else f"; noise {number(float(volts.max()), 2)} {unit} rms"
    numbers = [
        KeyNumber(
            "settling time", _short(settling), "s", _worst(None if draws is None else draws.settling, "s")
        ),
        KeyNumber(
            "overshoot", _short(overshoot, 2), "%", _worst(None if draws is None else draws.overshoot, "%")
        ),
        KeyNumber(
            "peak input",
            _short(peak_input(design.response)),
            unit,
            _worst(None if draws is None else draws.peak, unit) + noise,
        ),
        KeyNumber(
            "damping of vibrations",
            range_of(vibrations(design.closed_modes), 2),
            note=f"without control: {range_of(vibrations(design.open_modes), 2)}",
        ),
        _margin(design),
    ]
    if not design.chosen.looked:
        return numbers
    if np.isnan(design.chosen.level):
        return [
            *numbers,
            KeyNumber("sampled step", "no region", note=design.chosen.limit.removeprefix("no region: ")),
        ]
    trusted = step_words(design.chosen.step_amplitude, units_of(design).position)
    return [*numbers, KeyNumber("sampled step", trusted, note="largest rest to rest, all joints; not proved")]


def _short(value: float | None, digits: int = 3) -> float | None:
    return None if value is None else float(f"{value:.{digits}g}")


def _worst(values: np.ndarray | None, unit: str) -> str:
    """Of the robots drawn."""
    if values is None or not len(values):
        return "nominal robot"
    worst = float(np.max(values))
    text = f"{number(worst, 3)} {unit}"
    if np.isinf(worst):
        text = "diverges" if unit == "%" else "never"
    return f"worst of {len(values)} robots: {text}"


def _margin(design: Design) -> KeyNumber:
    m, period = design.margins, design.specification.period
    if not m.stable:
        return KeyNumber("margins", "none", note="the sampled loop at the goal is unstable")
    late = f"delay margin {number(1e3 * m.delay_margin_s, 3)} ms = {number(m.delay_margin_s / period, 3)} periods"
    return KeyNumber("peak sensitivity", _short(m.peak_sensitivity), note=late)
