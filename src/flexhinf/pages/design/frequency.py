"""The running loop, linearised and sampled: margins, frequency responses (a line for each joint or law), what sensor
noise costs, and the corners of the tolerances."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from flexhinf.analysis import FrequencyResponse, GrowthRates, Margins
from flexhinf.design.evaluation import LawEvaluation
from flexhinf.design.result import FEW_PERIODS, NOISE_FRACTION, Design
from flexhinf.pages.drawing import (
    DASHED,
    Blocks,
    Panel,
    changes_text,
    count_text,
    figure_block,
    frequency_axis,
    in_joint,
    line_style,
    note,
    panels,
    range_text,
    reference_line,
    time_block,
    units_of,
)
from flexhinf.report import (
    INK,
    MUTED,
    Column,
    Figure,
    Paragraph,
    Table,
    house_style,
    label,
    legend,
    number,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: Bandwidths of more joints than this are given as a range.
FEW_JOINTS = 3

#: Headings of the forms of Rᵛ in a terminal.
FORMS = {
    "all states": "all", "velocities only": "velocities", "link velocities only": "links",
    "motor velocities only": "motors",
}  # fmt: skip

#: Decibels below the largest value that are shown.
SHOWN_DB = 90.0

#: Fraction of half the sampling frequency that a Bode diagram shows: the phase jumps at its end.
SHOWN_BAND = 0.97

#: How far a Nyquist diagram reaches to the left: the neighbourhood of −1 is what matters.
NYQUIST = 3.0

RUNNING = "The linearised sampled loop at the goal, with estimator and delay as it runs."


# Margins ------------------------------------------------------------------------------------------------
def margins(design: Design) -> Blocks:
    """Margins beside those of the true state, frequency responses, noise, estimation error."""
    e, units = design.evaluation, units_of(design.evaluation)
    m, own, s, joints = e.margins, e.state_margins, e.setup.specification, e.setup.joints
    yield from _margin_notes(e)
    text = (
        "The loop at the goal, linearised, sampled, with estimator and delay, is broken at the inputs. A gain margin "
        "is that of one input while the others stay; the disk margin lets all change at once."
    )
    if m.stable:
        text += f" The sensitivity peaks at {number(m.peak_sensitivity, 3)} ({_hertz(m.sensitivity_frequency)} Hz)"
        if len(m.gain_margins) == 1:
            text += f", so the open loop passes −1 at a distance of {number(1.0 / m.peak_sensitivity, 2)}"
        text += "."
        if s.estimator != "none" and own.stable:
            text += f" With the true state fed back the peak would be {number(own.peak_sensitivity, 3)}"
            text += (
                "."
                if m.peak_sensitivity <= own.peak_sensitivity
                else ": the estimator raises it (a larger `--torque-noise` makes it faster, and noisier)."
            )
    yield Paragraph(text)
    yield margin_table(e)
    loops = [Loop("this law", e.frequency_response)]
    yield lambda: _bode(loops, joints, units.load, units.position)
    yield lambda: _sensitivity(loops)
    yield lambda: _nyquist(loops, joints)
    if e.input_noises is not None:
        yield _noise_table(e, e.input_noises)
    if s.estimator != "none":
        yield lambda: _estimation_figure(e)


def _margin_notes(e: LawEvaluation) -> Blocks:
    """Extras that the linear loop leaves out, an unstable loop, a small delay margin, noise at the motors."""
    m, period = e.margins, e.setup.specification.period
    if e.setup.left_out:
        names = " and ".join(e.setup.left_out).replace("_", " ")
        yield note(
            f"The linear loop leaves out {names}: the slope at standstill holds only for the smallest velocities and "
            "would count as damping. The simulated runs have it."
        )
    if not m.stable:
        yield note(
            "Linearised at the goal, the sampled loop with its estimator is unstable. Try a shorter --period, a faster "
            "estimator (--torque-noise) or a slower law (--bandwidth)."
        )
        return
    if m.delay_margin_s < FEW_PERIODS * period:
        yield note(
            f"The loop tolerates {number(1e3 * m.delay_margin_s, 2)} ms of extra delay, "
            f"{number(m.delay_margin_s / period, 2)} periods. A late computation and a slow bus may use that up; the "
            f"loop would then oscillate at {_hertz(m.delay_frequency)} Hz. Try a shorter --period, less --damping or "
            "less --bandwidth."
        )
    noise, peak = e.input_noises, e.step.peak_input
    if noise is not None and float(noise.max()) > NOISE_FRACTION * peak:
        k = int(np.argmax(noise))
        share = f", {number(100.0 * float(noise[k]) / peak, 2)} % of the step's peak input" if peak else ""
        yield note(
            f"In equilibrium the sensor noise moves an input{in_joint(e.setup.joints[k], e.setup.joints)} by "
            f"{number(float(noise[k]), 2)} {units_of(e).effort} rms{share}. Try a slower estimator (smaller "
            "--torque-noise), better sensors, or less --bandwidth."
        )


def _hertz(frequency: float) -> str:
    """A frequency in rad/s as Hz."""
    return number(frequency / (2.0 * np.pi), 3)


def margin_table(e: LawEvaluation) -> Table:
    """Margins of the running loop, and with the true state fed back where there is an estimator."""
    alone = e.setup.specification.estimator == "none"
    loops = [e.margins] if alone else [e.margins, e.state_margins]
    period, joints = e.setup.specification.period, e.setup.joints
    tracked = [name.removeprefix("link_position_") for name in e.margins.positions]
    damped = in_joint(e.least_damped_joint, joints)
    of = f" ({', '.join(tracked)})" if 1 < len(tracked) <= FEW_JOINTS else ""

    def gains(m: Margins) -> str:
        """Factors of the gain of the input with the smallest margin."""
        low, high = (number(float(value), 3) for value in m.gain_margins[m.weakest_input])
        return f"× {low}, × {high}{f' ({joints[m.weakest_input]})' if len(m.gain_margins) > 1 else ''}"

    def bandwidths(m: Margins) -> str:
        """Of every joint; where there are many their range, and the slowest."""
        if len(m.bandwidth) > FEW_JOINTS and np.isfinite(m.bandwidth).all():
            return f"{range_text(m.bandwidth)} (slowest: {tracked[int(np.argmin(m.bandwidth))]})"
        return ", ".join(number(float(w), 3) for w in m.bandwidth)

    values: dict[str, Callable[[Margins], str]] = {
        "delay margin, ms": lambda m: number(1e3 * m.delay_margin_s, 3),
        "delay margin, periods": lambda m: number(m.delay_margin_s / period, 3),
        "then oscillates at, Hz": lambda m: _hertz(m.delay_frequency),
        f"gain margin{', worst input' if len(joints) > 1 else ''}": gains,
        "disk margin: gain": lambda m: "× {}, × {}".format(*(number(g, 3) for g in m.disk_gain_margins)),
        "disk margin: phase, °": lambda m: number(np.degrees(m.disk_phase_margin), 3),
        "peak sensitivity": lambda m: number(m.peak_sensitivity, 3),
        "peak sensitivity at, Hz": lambda m: _hertz(m.sensitivity_frequency),
        "peak complementary": lambda m: number(m.peak_complementary, 3),
        "smallest damping ratio": lambda m: number(m.damping, 3) + (damped if m is e.margins else ""),
        "smallest damping at, Hz": lambda m: _hertz(m.damping_frequency),
        f"bandwidth{of}, rad/s": bandwidths,
    }
    rows = [(what, *(value(m) if m.stable else "unstable" for m in loops)) for what, value in values.items()]
    heads = [Column("running loop", brief="true state" if alone else "", right=True)]
    heads += [] if alone else [Column("true state fed back", brief="true state", right=True)]
    return Table(
        ("linearised at the goal", *heads), rows, "Margins, the loop broken at the inputs", "table-margins",
        title="Margins, linearised at the goal",
    )  # fmt: skip


def _noise_table(e: LawEvaluation, together: np.ndarray) -> Table:
    noise, gains, plant, units = e.setup.noise, e.margins.noise_to_input, e.setup.model, units_of(e)
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


def _estimation_figure(e: LawEvaluation) -> Figure:
    run, n, units = e.step.run, len(e.setup.joints), units_of(e)
    truth, estimate = (e.setup.robot.layout.whole(run.signals[name].T) for name in ("state", "estimate"))
    error = units.scale * (truth - estimate).T
    names = ("link position", "link velocity", "motor position", "motor velocity")
    signals = [
        Panel(name, units.rate if k % 2 else units.angle, error[:, k * n : (k + 1) * n])
        for k, name in enumerate(names)
    ]
    caption, joints = "True minus estimated state of every joint in the step.", e.setup.joints
    return time_block("estimate", run.time, joints, signals, caption, "Estimation error", 7.4, linewidth=0.9)


# Frequency responses ------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Loop:
    """A loop in these figures: its name in the legend, and the number of its line's style."""

    name: str
    response: FrequencyResponse
    style: int = 0


def frequency_figures(loops: Sequence[Loop], joints: Sequence[str], load: str, position: str) -> list[Figure]:
    """Bode, sensitivity and Nyquist diagram of one loop, a line for each joint; or of several, a line for each, of the
    joint that a torque on its link moves most. `load` and `position` are the units of these."""
    if not loops:
        return []
    return [_bode(loops, joints, load, position), _sensitivity(loops), _nyquist(loops, joints)]


@house_style()
def _bode(loops: Sequence[Loop], joints: Sequence[str], load: str, position: str) -> Figure:
    (figure, (command, phase, torque)), lines = _stacked(3, 8.4), _lines(loops, joints)
    for name, style, response, joint in lines:
        below = response.frequencies <= SHOWN_BAND * np.pi / response.period
        hertz = response.frequencies[below] / (2.0 * np.pi)
        followed = response.command[below, joint, joint]
        command.plot(hertz, _decibel(followed), label=name, **style)
        phase.plot(hertz, np.degrees(np.unwrap(np.angle(followed))), **style)
        torque.plot(hertz, _decibel(_moved(response, joint)[below]), **style)
    reference_line(command)
    reference_line(command, 20.0 * np.log10(np.sqrt(0.5)))
    for axis in (command, torque):
        _bounded(axis)
    label(command, "command → link", "dB")
    label(phase, "phase", "°")
    label(torque, f"torque → link\n(dB of {position}/({load}))", "")
    if len(loops) > 1 or len(joints) > 1:
        legend(command)
    which = "" if len(loops) == 1 or len(joints) == 1 else f" Joint: {joints[lines[0][3]]}."
    return figure_block(
        "bode", figure,
        f"{RUNNING} Dotted: 0 dB, and −3 dB, where the bandwidth is read.{which}", "Bode diagram",
    )  # fmt: skip


@house_style()
def _sensitivity(loops: Sequence[Loop]) -> Figure:
    figure, (axis,) = _stacked(1, 3.6)
    alone = len(loops) == 1
    lines = [("sensitivity S" if alone else x.name, x.response, "sensitivity", x.style) for x in loops]
    if alone:
        lines.append(("complementary sensitivity T", loops[0].response, "complementary", 1))
    for name, response, which, style in lines:
        sizes = np.linalg.norm(getattr(response, which), ord=2, axis=(1, 2))
        axis.plot(response.frequencies / (2.0 * np.pi), _decibel(sizes), label=name, **line_style(style))
    reference_line(axis)
    _bounded(axis)
    label(axis, f"largest singular value{'' if alone else ' of S'}", "dB")
    legend(axis)
    second = "; T: an error of the model" if alone else ""
    caption = f"{RUNNING} S: how much the loop amplifies a disturbance at the motors{second}. Dotted: 0 dB."
    return figure_block("sensitivity", figure, caption, "Sensitivity")


@house_style()
def _nyquist(loops: Sequence[Loop], joints: Sequence[str]) -> Figure:
    from matplotlib.patches import Circle

    figure, ((axis,),) = panels(1, 1, 4.6)
    closest, distances = "", []
    for place, (name, style, response, joint) in enumerate(_lines(loops, joints)):
        opened = response.input_loops[:, joint]
        distances.append(float(np.nanmin(np.abs(1.0 + opened))))
        axis.plot(np.real(opened), np.imag(opened), label=name, zorder=3.0 - 0.01 * place, **style)
    turn = np.linspace(0.0, 2.0 * np.pi, 200)
    axis.plot(np.cos(turn), np.sin(turn), color=MUTED, linewidth=0.8, label="unit circle")
    axis.plot([-1.0], [0.0], "+", color=INK, markersize=9.0, label="−1")
    if len(loops) == 1:
        radius = min(distances)
        circle = Circle((-1.0, 0.0), radius, fill=False, color=INK, linewidth=1.0, linestyle=(0, DASHED))
        axis.add_patch(circle)
        closest = f" The dashed circle about −1 has the smallest distance, {radius:.2f}."
    axis.set(xlim=(-NYQUIST, 0.6 * NYQUIST), ylim=(-0.5 * NYQUIST, 0.5 * NYQUIST), aspect="equal")
    axis.set(xlabel="real part", ylabel="imaginary part")
    legend(axis)
    others = " The loops at the other inputs are closed." if len(joints) > 1 else ""
    caption = f"{RUNNING} Opened at one input, positive frequencies, negative feedback.{others}{closest}"
    return figure_block("nyquist", figure, caption, "Nyquist diagram")


def _lines(
    loops: Sequence[Loop], joints: Sequence[str]
) -> list[tuple[str, dict[str, Any], FrequencyResponse, int]]:
    """Name, style, response and joint of each line; of several loops the joint that a torque moves most in the 1st."""
    first = loops[0].response
    if len(loops) == 1:
        names = joints if len(joints) > 1 else [loops[0].name]
        return [(name, line_style(k), first, k) for k, name in enumerate(names)]
    joint = int(np.argmax([np.abs(_moved(first, joint)).max() for joint in range(len(first.positions))]))
    return [(loop.name, line_style(loop.style), loop.response, joint) for loop in loops]


def _moved(response: FrequencyResponse, joint: int) -> np.ndarray:
    """Torque on a link → its own position (F,)."""
    name = response.positions[joint].replace("link_position", "link_torque", 1)
    return response.disturbance[:, joint, response.disturbances.index(name)]


def _stacked(rows: int, height: float) -> tuple[Any, list[Axes]]:
    figure, grid = panels(rows, 1, height, sharex=True)
    axes = [row[0] for row in grid]
    axes[-1].set_xlabel("frequency (Hz)")
    figure.align_ylabels(axes)
    frequency_axis(axes[-1])
    return figure, axes


def _decibel(values: np.ndarray) -> np.ndarray:
    return 20.0 * np.log10(np.maximum(np.abs(values), 1e-300))


def _bounded(axis: Axes) -> None:
    """No more than `SHOWN_DB` below the largest value: what is smaller says nothing."""
    low, high = axis.get_ylim()
    axis.set_ylim(max(low, high - SHOWN_DB), high)


# Corners of the tolerances ------------------------------------------------------------------------------
def corners(design: Design) -> Blocks:
    """How many corners are unstable; none for a robot without tolerances."""
    e, cases, state = design.evaluation, design.evaluation.corners, design.evaluation.state_corners
    if cases is None:
        return
    if cases.unstable:
        preset = "" if design.design_problem.preset == "robust" else ", or --preset robust"
        advice = f"the estimator causes it: try another --torque-noise or --estimator{preset}"
        if state is not None and state.unstable > 0:
            advice = f"the law itself does not stand them: try a shorter --period or --delay, less --bandwidth{preset}"
        yield note(
            f"{cases.unstable} of {cases.count} corners of the tolerances are unstable with this estimator; {advice}."
        )
    yield Paragraph(corners_text(e))
    yield Paragraph(
        f"{'All' if cases.complete else 'Sampled'} corners: every uncertain parameter at one end of its tolerance, all "
        "together. For each the loop is linearised at the goal; robots between the corners are not covered."
    )
    if cases.swept:
        free = [f"“{form}”" for form in cases.retunable]
        parts = ", ".join(
            f"with “{form}” at {len(cases.stable_ratios(form))} of {count_text(len(cases.of_form(form)), 'ratio')} only"
            for form in cases.forms
            if form not in cases.retunable
        )
        may = f"With Rᵛ of the form {' or '.join(free)} none is unstable at any ratio tried." if free else ""
        some = f" Otherwise that holds {parts}." if parts and free else ""
        if parts and not free:
            some = f"No form keeps every corner stable at all ratios tried: that holds {parts}."
        yield Paragraph(
            "No paper gives Rᵛ, the process noise that the estimator assumes, and the gain of a filter depends only on "
            f"its ratio q/Rⁿ and on where q stands. {may}{some} Forms that are not listed were not tried."
        )
    yield corner_table(e)


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


def corner_rows(e: LawEvaluation) -> list[dict[str, Any]]:
    """Unstable corners, their share in percent and the largest growth rate (1/s), as designed ("form"), with the true
    state, then for every form and ratio q/Rⁿ of Rᵛ."""
    corners, alone = e.corners, e.setup.specification.estimator == "none"
    assert corners is not None
    own = "true state" if alone else "as designed"
    loops: dict[tuple[str, float | None], GrowthRates] = {(own, None): corners.designed}
    if not alone and e.state_corners is not None:
        loops["true state", None] = e.state_corners
    for form in corners.forms:
        loops |= {(form, ratio): rates for ratio, rates in corners.of_form(form).items()}
    rows = []
    for (form, ratio), rates in loops.items():
        growth = rates.rates[rates.kinds == "corner"]
        counts = {"unstable": int((growth >= 0.0).sum()), "percent": 100.0 * rates.share("corner")}
        rows.append({"form": form, "ratio": ratio, **counts, "rate": float(growth.max())})
    return rows


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
        texts = []
        for row in (by.get((form, ratio)) for form in forms):
            if row is None:
                texts += ["–", "–"]
                continue
            share = f"{row['unstable']} ({number(row['percent'], 2)} %)" if row["unstable"] else "0"
            texts += [share, number(row["rate"], 3) if np.isfinite(row["rate"]) else "no equilibrium"]
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
