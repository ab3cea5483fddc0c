"""The running loop, linearised and sampled: margins, what sensor noise costs, and the corners of the tolerances."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from flexhinf.analysis import GrowthRates, Margins, ToleranceCorners
from flexhinf.design.evaluation import LawEvaluation
from flexhinf.design.result import FEW_PERIODS, NOISE_FRACTION, Design
from flexhinf.pages.design.frequency import Loop, frequency_figures
from flexhinf.pages.drawing import (
    Panel,
    Units,
    changes_text,
    count_text,
    figure_block,
    range_text,
    time_figure,
    units_of,
)
from flexhinf.report import Column, Figure, Paragraph, Table, number

#: Bandwidths of more joints than this are given as a range.
FEW_JOINTS = 3

#: Headings of the forms of Rᵛ in a terminal.
FORMS = {
    "all states": "all", "velocities only": "velocities", "link velocities only": "links",
    "motor velocities only": "motors",
}  # fmt: skip


def blocks(design: Design) -> list[Any]:
    """Margins beside those of the true state, frequency responses, noise, estimation error."""
    e = design.evaluation
    units, joints = units_of(e), e.setup.joints
    figures = frequency_figures([Loop("this law", e.frequency_response)], joints, units.load, units.position)
    noise = [] if e.input_noises is None else [_noise_table(e, e.input_noises, units)]
    error = [] if e.setup.specification.estimator == "none" else [_estimation_figure(e, units)]
    return [Paragraph(_text(e)), margin_table(e), *figures, *noise, *error]


def remarks(design: Design) -> Iterator[str]:
    """An unstable loop, a small delay margin, noise at the motors, extras that the linear loop leaves out."""
    e = design.evaluation
    m, s = e.margins, e.setup.specification
    if e.setup.left_out:
        names = " and ".join(e.setup.left_out).replace("_", " ")
        yield (
            f"The linear loop leaves out {names}: the slope at standstill holds only for the smallest velocities and "
            "would count as damping. The simulated runs have it."
        )
    if not m.stable:
        yield (
            "Linearised at the goal, the sampled loop with its estimator is unstable. Try a shorter --period, a faster "
            "estimator (--torque-noise) or a slower law (--bandwidth)."
        )
        return
    if m.delay_margin_s < FEW_PERIODS * s.period:
        yield (
            f"The loop tolerates {number(1e3 * m.delay_margin_s, 2)} ms of extra delay, "
            f"{number(m.delay_margin_s / s.period, 2)} periods. A late computation and a slow bus may use that "
            f"up; the loop would then oscillate at {number(m.delay_frequency / (2.0 * np.pi), 3)} Hz. Try a "
            "shorter --period, less --damping or less --bandwidth."
        )
    noise, peak = e.input_noises, e.step.peak_input
    if noise is not None and float(noise.max()) > NOISE_FRACTION * peak:
        worst, effort = int(np.argmax(noise)), units_of(e).effort
        where = f" ({e.setup.joints[worst]})" if len(noise) > 1 else ""
        share = (
            f", {number(100.0 * float(noise[worst]) / peak, 2)} % of the step's peak input" if peak else ""
        )
        yield (
            f"In equilibrium the sensor noise moves an input{where} by {number(float(noise[worst]), 2)} {effort} "
            f"rms{share}. Try a slower estimator (smaller --torque-noise), better sensors, or less --bandwidth."
        )


def _text(e: LawEvaluation) -> str:
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
    if e.setup.specification.estimator == "none" or not own.stable:
        return f"{text}."
    text += f". With the true state fed back the peak would be {number(own.peak_sensitivity, 3)}"
    if m.peak_sensitivity <= own.peak_sensitivity:
        return f"{text}."
    return (
        f"{text}: the estimator raises it. A larger `--torque-noise` makes the estimator faster, and the noise at the "
        "motors larger."
    )


def margin_table(e: LawEvaluation) -> Table:
    """Margins of the running loop, and with the true state fed back where there is an estimator."""
    alone = e.setup.specification.estimator == "none"
    loops = [e.margins] if alone else [e.margins, e.state_margins]
    period, joints = e.setup.specification.period, e.setup.joints
    several = len(joints) > 1
    tracked = [name.removeprefix("link_position_") for name in e.margins.positions]
    damped = f" ({e.least_damped_joint})" if several and e.least_damped_joint else ""
    of = f" ({', '.join(tracked)})" if 1 < len(tracked) <= FEW_JOINTS else ""

    def hertz(frequency: float) -> str:
        return number(frequency / (2.0 * np.pi), 3)

    def gains(m: Margins) -> str:
        """Factors of the gain of the input with the smallest margin."""
        low, high = (number(float(value), 3) for value in m.gain_margins[m.weakest_input])
        return f"× {low}, × {high}{f' ({joints[m.weakest_input]})' if len(m.gain_margins) > 1 else ''}"

    def bandwidths(m: Margins) -> str:
        """Of every joint; where there are many their range, and the slowest."""
        if len(m.bandwidth) > FEW_JOINTS and np.isfinite(m.bandwidth).all():
            return f"{range_text(m.bandwidth)} (slowest: {tracked[int(np.argmin(m.bandwidth))]})"
        return ", ".join(number(float(w), 3) for w in m.bandwidth)

    quantities: dict[str, Callable[[Margins], str]] = {
        "delay margin, ms": lambda m: number(1e3 * m.delay_margin_s, 3),
        "delay margin, periods": lambda m: number(m.delay_margin_s / period, 3),
        "then oscillates at, Hz": lambda m: hertz(m.delay_frequency),
        f"gain margin{', worst input' if several else ''}": gains,
        "disk margin: gain": lambda m: "× {}, × {}".format(*(number(g, 3) for g in m.disk_gain_margins)),
        "disk margin: phase, °": lambda m: number(np.degrees(m.disk_phase_margin), 3),
        "peak sensitivity": lambda m: number(m.peak_sensitivity, 3),
        "peak sensitivity at, Hz": lambda m: hertz(m.sensitivity_frequency),
        "peak complementary": lambda m: number(m.peak_complementary, 3),
        "smallest damping ratio": lambda m: number(m.damping, 3) + (damped if m is e.margins else ""),
        "smallest damping at, Hz": lambda m: hertz(m.damping_frequency),
        f"bandwidth{of}, rad/s": bandwidths,
    }
    rows = [
        (name, *(value(m) if m.stable else "unstable" for m in loops)) for name, value in quantities.items()
    ]
    heads = [Column("running loop", brief="true state" if alone else "", right=True)]
    heads += [] if alone else [Column("true state fed back", brief="true state", right=True)]
    return Table(
        ("linearised at the goal", *heads), rows, "Margins, the loop broken at the inputs", "table-margins",
        title="Margins, linearised at the goal",
    )  # fmt: skip


def _noise_table(e: LawEvaluation, together: np.ndarray, units: Units) -> Table:
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
        "sensor", "its noise (rms)", "gain to the input (rms)", Column("at the motor (rms)", units.effort),
        *(["motor"] if several else []),
    )  # fmt: skip
    caption = (
        "Noise of each sensor at the motor that it moves most; all sensors together: "
        f"{range_text(together, 2)} {units.effort} rms"
    )
    return Table(columns, rows, caption, "table-noise")


def _estimation_figure(e: LawEvaluation, units: Units) -> Figure:
    run, n = e.step.run, len(e.setup.joints)
    truth, estimate = (e.setup.robot.layout.whole(run.signals[name].T) for name in ("state", "estimate"))
    error = units.scale * (truth - estimate).T
    names = ("link position", "link velocity", "motor position", "motor velocity")
    panels = [
        Panel(name, units.rate if k % 2 else units.angle, error[:, k * n : (k + 1) * n])
        for k, name in enumerate(names)
    ]
    figure, _ = time_figure(run.time, e.setup.joints, panels, 7.4, linewidth=0.9)
    caption = "True minus estimated state of every joint in the step."
    return figure_block("estimate", figure, caption, "Estimation error")


# Corners of the tolerances ------------------------------------------------------------------------------
def corner_blocks(design: Design) -> list[Any]:
    """How many corners are unstable; none for a robot without tolerances."""
    e = design.evaluation
    if e.corners is None:
        return []
    how = (
        f"{'All' if e.corners.complete else 'Sampled'} corners: every uncertain parameter at one end of its tolerance, "
        "all of them together, products of tolerances included. For each the sampled loop at the goal, with estimator "
        "and delay, is linearised; robots between the corners are not covered."
    )
    retuning = [Paragraph(_retuning(e.corners))] if e.corners.swept else []
    return [Paragraph(corners_text(e)), Paragraph(how), *retuning, corner_table(e)]


def corner_remarks(design: Design) -> Iterator[str]:
    """Corners that are unstable as designed."""
    corners, state = design.evaluation.corners, design.evaluation.state_corners
    if corners is None or not corners.unstable:
        return
    preset = "" if design.design_problem.preset == "robust" else ", or --preset robust"
    advice = f"the estimator causes it: try another --torque-noise or --estimator{preset}"
    if state is not None and state.unstable > 0:
        advice = (
            f"the law itself does not stand them: try a shorter --period or --delay, less --bandwidth{preset}"
        )
    yield (
        f"{corners.unstable} of {corners.count} corners of the tolerances are unstable with this estimator; {advice}."
    )


def corners_text(e: LawEvaluation) -> str:
    """How many corners are unstable as designed, and the worst of them."""
    corners, state, s = e.corners, e.state_corners, e.setup.specification
    assert corners is not None
    which = "" if corners.complete else "sampled "
    unstable = f"None of the {corners.count} {which}corners is unstable"
    if corners.unstable:
        verb = "is" if corners.unstable == 1 else "are"
        unstable = f"{corners.unstable} of {corners.count} {which}corners {verb} unstable"
    other, sensors = "", "true state"
    if s.estimator != "none":
        sensors = ", ".join(s.measured).replace("_", " ")
        other = "" if state is None else f"; with the true state fed back {state.unstable}"
    worst, rate = corners.population.values[corners.worst], corners.designed.fastest
    grows = "has no equilibrium at the goal"
    if np.isfinite(rate):
        grows = f"{'grows' if rate >= 0.0 else 'decays'} with {number(abs(rate), 3)} 1/s"
    changes = changes_text(worst, e.setup.robot, s.extras)
    return f"Measured: {sensors}. {unstable}{other}. The worst corner ({changes}) {grows}."


def _retuning(corners: ToleranceCorners) -> str:
    free = [f"“{form}”" for form in corners.retunable]
    parts = ", ".join(
        f"with “{form}” at {len(corners.stable_ratios(form))} of {count_text(len(corners.of_form(form)), 'ratio')} only"
        for form in corners.forms
        if form not in corners.retunable
    )
    may = f"With Rᵛ of the form {' or '.join(free)} no corner is unstable at any ratio tried." if free else ""
    some = f" Otherwise that holds {parts}." if parts and free else ""
    if parts and not free:
        some = f"No form keeps every corner stable at all ratios tried: that holds {parts}."
    return (
        "No paper gives Rᵛ, the process noise that the estimator assumes, and the gain of a filter depends only on its "
        f"ratio q/Rⁿ and on where q stands. {may}{some} Forms that are not listed were not tried."
    )


def corner_rows(e: LawEvaluation) -> list[dict[str, Any]]:
    """Unstable corners, their share in percent and the largest growth rate (1/s), as designed ("form"), with the true
    state, then for every form and ratio q/Rⁿ of Rᵛ."""
    corners, alone = e.corners, e.setup.specification.estimator == "none"
    assert corners is not None
    rows = [_corner_row("true state" if alone else "as designed", None, corners.designed)]
    if not alone and e.state_corners is not None:
        rows.append(_corner_row("true state", None, e.state_corners))
    for form in corners.forms:
        rows += [_corner_row(form, ratio, rates) for ratio, rates in corners.of_form(form).items()]
    return rows


def _corner_row(form: str, ratio: float | None, rates: GrowthRates) -> dict[str, Any]:
    growth = rates.rates[rates.kinds == "corner"]
    unstable, percent = int((growth >= 0.0).sum()), 100.0 * rates.share("corner")
    return {
        "form": form,
        "ratio": ratio,
        "unstable": unstable,
        "percent": percent,
        "rate": float(growth.max()),
    }


def corner_table(e: LawEvaluation) -> Table:
    """Unstable corners and growth rates over q/Rⁿ, a pair of columns for each form of Rᵛ; without forms, of the loops
    that were looked at."""
    assert e.corners is not None
    rows, forms = corner_rows(e), e.corners.forms
    title = f"Corners of the tolerances. {corners_text(e)}"
    if not forms:
        columns = (
            Column("loop", key="form"),
            Column("unstable", key="unstable"),
            Column("growth", "1/s", digits=3, key="rate"),
        )
        caption = "Unstable corners, and the growth rate of the worst; a negative rate decays"
        return Table.of(columns, rows, caption, "table-corners", title=title)
    by, cells = {(row["form"], row["ratio"]): row for row in rows}, []
    for ratio in sorted({row["ratio"] for row in rows if row["ratio"] is not None}):
        texts = [text for form in forms for text in _corner_cells(by.get((form, ratio)))]
        exponent = round(float(np.log10(ratio)))
        power = number(10.0**exponent, 1).removeprefix("1·") if abs(exponent) > 3 else number(ratio)
        cells.append((power, *texts))
    heads = [
        column
        for form in forms
        for column in (
            Column(f"{form}: unstable", brief=FORMS[form]), Column("fastest growth, 1/s", brief=None)
        )
    ]  # fmt: skip
    caption = "Unstable corners over Rᵛ, by the states on which q stands; a negative growth rate decays"
    title += "\nUnstable corners over Rᵛ = q on:"
    return Table(("q/Rⁿ", *heads), cells, caption, "table-corners", title=title)


def _corner_cells(row: dict[str, Any] | None) -> tuple[str, str]:
    if row is None:
        return "–", "–"
    share = f"{row['unstable']} ({number(row['percent'], 2)} %)" if row["unstable"] else "0"
    return share, number(row["rate"], 3) if np.isfinite(row["rate"]) else "no equilibrium"
