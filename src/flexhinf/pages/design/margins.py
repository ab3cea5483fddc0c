"""The running loop, linearised and sampled: margins, what sensor noise costs, and the estimator's error in the step."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from flexhinf.analysis import Margins
from flexhinf.design.evaluation import LawEvaluation
from flexhinf.design.result import FEW_PERIODS, NOISE_FRACTION, Design
from flexhinf.pages.design.frequency import Loop, frequency_figures
from flexhinf.pages.drawing import Units, figure_block, joint_lines, range_text, units_of
from flexhinf.report import Column, Figure, Paragraph, Table, label, legend, new_figure, number

#: Bandwidths of more joints than this are given as a range.
FEW_JOINTS = 3


def blocks(design: Design) -> list[Any]:
    """Margins beside those of the true state, frequency responses, noise, estimation error."""
    e = design.evaluation
    units, joints = units_of(e), e.setup.joints
    figures = frequency_figures([Loop("this law", e.frequency_response)], joints, units.load, units.position)
    noise = [] if e.input_noises is None else [_noise(e, units)]
    error = estimation_figure(e, units)
    return [Paragraph(_text(e)), _table(e), *figures, *noise, *([] if error is None else [error])]


def remarks(design: Design) -> Iterator[str]:
    """An unstable loop, a small delay margin, noise at the motors, extras that the linear loop leaves out."""
    e = design.evaluation
    found, s = e.margins, e.setup.specification
    if e.setup.left_out:
        names = " and ".join(e.setup.left_out).replace("_", " ")
        yield (
            f"The linear loop leaves out {names}: the slope at standstill holds only for the smallest velocities and "
            "would count as damping. The simulated runs have it."
        )
    if not found.stable:
        yield (
            "Linearised at the goal, the sampled loop with its estimator is unstable. Try a shorter --period, a faster "
            "estimator (--torque-noise) or a slower law (--bandwidth)."
        )
        return
    if found.delay_margin_s < FEW_PERIODS * s.period:
        yield (
            f"The loop tolerates {number(1e3 * found.delay_margin_s, 2)} ms of extra delay, "
            f"{number(found.delay_margin_s / s.period, 2)} periods. A late computation and a slow bus may use that "
            f"up; the loop would then oscillate at {number(found.delay_frequency / (2.0 * np.pi), 3)} Hz. Try a "
            "shorter --period, less --damping or less --bandwidth."
        )
    noise, peak = e.input_noises, e.step.peak_input
    if noise is not None and float(noise.max()) > NOISE_FRACTION * peak:
        worst = int(np.argmax(noise))
        units = units_of(e)
        where = f" ({e.setup.joints[worst]})" if len(noise) > 1 else ""
        share = (
            f", {number(100.0 * float(noise[worst]) / peak, 2)} % of the step's peak input" if peak else ""
        )
        yield (
            f"In equilibrium the sensor noise moves an input{where} by {number(float(noise[worst]), 2)} {units.effort} "
            f"rms{share}. Try a slower estimator (smaller --torque-noise), better sensors, or less --bandwidth."
        )


def _text(e: LawEvaluation) -> str:
    """What the table is of, and what the sensitivity means."""
    m, own = e.margins, e.state_margins
    text = (
        "The loop at the goal is linearised, sampled, and has its estimator and delay. It is broken at the inputs; "
        "with several inputs a gain margin is that of one input while the others stay, and the disk margin lets all "
        "inputs change at once."
    )
    if not m.stable:
        return text
    text += (
        f" The sensitivity peaks at {number(m.peak_sensitivity, 3)} "
        f"({number(m.sensitivity_frequency / (2.0 * np.pi), 3)} Hz)"
    )
    if len(m.gain_margins) == 1:
        text += f", so the open loop passes −1 at a distance of {number(1.0 / m.peak_sensitivity, 2)}"
    text += "."
    if e.setup.specification.estimator == "none" or not own.stable:
        return text
    if m.peak_sensitivity > own.peak_sensitivity:
        return (
            text
            + f" With the true state fed back the peak would be {number(own.peak_sensitivity, 3)}: the estimator "
            "raises it. A larger `--torque-noise` makes the estimator faster, and the noise at the motors larger."
        )
    return text + f" With the true state fed back the peak would be {number(own.peak_sensitivity, 3)}."


def margin_rows(e: LawEvaluation) -> list[tuple[str, ...]]:
    """Name of a figure, of the running loop, and with the true state fed back where there is an estimator."""
    alone = e.setup.specification.estimator == "none"
    loops = [e.margins] if alone else [e.margins, e.state_margins]
    period, joints = e.setup.specification.period, e.setup.joints
    several = len(joints) > 1
    tracked = ", ".join(name.removeprefix("link_position_") for name in e.margins.positions)
    damped = f" ({e.least_damped_joint})" if several and e.least_damped_joint else ""
    of = f" ({tracked})" if 1 < len(e.margins.positions) <= FEW_JOINTS else ""

    def row(what: str, value: Callable[[Margins], str]) -> tuple[str, ...]:
        return (what, *(value(found) if found.stable else "unstable" for found in loops))

    def hertz(frequency: float) -> str:
        return number(frequency / (2.0 * np.pi), 3)

    return [
        row("delay margin, ms", lambda m: number(1e3 * m.delay_margin_s, 3)),
        row("delay margin, periods", lambda m: number(m.delay_margin_s / period, 3)),
        row("then oscillates at, Hz", lambda m: hertz(m.delay_frequency)),
        row(f"gain margin{', worst input' if several else ''}", lambda m: _gains(m, joints)),
        row("disk margin: gain", lambda m: "× {}, × {}".format(*(number(g, 3) for g in m.disk_gain_margins))),
        row("disk margin: phase, °", lambda m: number(np.degrees(m.disk_phase_margin), 3)),
        row("peak sensitivity", lambda m: number(m.peak_sensitivity, 3)),
        row("peak sensitivity at, Hz", lambda m: hertz(m.sensitivity_frequency)),
        row("peak complementary", lambda m: number(m.peak_complementary, 3)),
        row("smallest damping ratio", lambda m: number(m.damping, 3) + (damped if m is e.margins else "")),
        row("smallest damping at, Hz", lambda m: hertz(m.damping_frequency)),
        row(f"bandwidth{of}, rad/s", lambda m: _bandwidths(m.bandwidth, tuple(tracked.split(", ")))),
    ]


def _bandwidths(found: np.ndarray, joints: tuple[str, ...]) -> str:
    """Of every joint; where there are many their range, and the slowest."""
    if len(found) > FEW_JOINTS and np.isfinite(found).all():
        return f"{range_text(found)} (slowest: {joints[int(np.argmin(found))]})"
    return ", ".join(number(float(w), 3) for w in found)


def _gains(m: Margins, joints: tuple[str, ...]) -> str:
    """Factors of the gain of the input with the smallest margin."""
    worst = m.weakest_input
    low, high = (float(value) for value in m.gain_margins[worst])
    name = f" ({joints[worst]})" if len(m.gain_margins) > 1 else ""
    return f"× {number(low, 3)}, × {number(high, 3)}{name}"


def _table(e: LawEvaluation) -> Table:
    alone = e.setup.specification.estimator == "none"
    heads = ("running loop",) if alone else ("running loop", "true state fed back")
    return Table(
        ("linearised at the goal", *heads),
        margin_rows(e),
        "Margins, the loop broken at the inputs",
        "table-margins",
    )


def _noise(e: LawEvaluation, units: Units) -> Table:
    """Gain from each sensor to the input that it moves most, the sensor's noise, and their product."""
    noise, gains, plant = e.setup.noise, e.margins.noise_to_input, e.setup.model
    assert noise is not None
    several, rows = len(e.setup.joints) > 1, []
    for k, (name, sigma) in enumerate(zip(plant.outputs, noise)):
        worst, unit = int(np.argmax(gains[:, k])), plant.unit(name)
        gain = float(gains[worst, k])
        texts = f"{number(float(sigma), 3)} {unit}", f"{number(gain)} {units.effort}/{unit}"
        joint = [e.setup.joints[worst]] if several else []
        rows.append((name.replace("_", " "), *texts, float(gain * sigma), *joint))
    columns = (
        "sensor",
        "its noise (rms)",
        "gain to the input (rms)",
        Column("at the motor (rms)", units.effort),
    )
    caption = "Noise of each sensor at the motor that it moves most"
    if e.input_noises is not None:
        caption += f"; all sensors together: {range_text(e.input_noises, 2)} {units.effort} rms"
    return Table((*columns, *(["motor"] if several else [])), rows, caption, "table-noise")


def estimation_figure(e: LawEvaluation, units: Units) -> Figure | None:
    """True minus estimated positions and velocities in the step; None without an estimator."""
    run, joints = e.step.run, e.setup.joints
    if e.setup.specification.estimator == "none":
        return None
    n = len(joints)
    layout = e.setup.robot.layout
    truth, estimate = (layout.whole(run.signals[name].T) for name in ("state", "estimate"))
    error = units.scale * (truth - estimate).T
    figure, axes = new_figure(4, height=7.4)
    titles = ("link position", "link velocity", "motor position", "motor velocity")
    for k, axis in enumerate(axes):
        joint_lines(axis, run.time, error[:, k * n : (k + 1) * n], joints, linewidth=0.9)
        label(axis, titles[k], units.rate if k % 2 else units.angle)
    if n > 1:
        legend(axes[0])
    return figure_block(
        "estimate", figure, "True minus estimated state of every joint in the step.", "Estimation error"
    )
