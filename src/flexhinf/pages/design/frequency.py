"""The running loop, linearised and sampled: margins, frequency responses (a line for each joint or law), what sensor
noise costs, and the corners of the tolerances."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from flexhinf.analysis import FrequencyResponse, GrowthRates, Margins
from flexhinf.designs.evaluation import LawEvaluation
from flexhinf.designs.pose_evidence import PoseEvidence
from flexhinf.designs.problem.presets import robust_applies
from flexhinf.designs.status import FEW_PERIODS, NOISE_FRACTION
from flexhinf.numerals import count_text, number
from flexhinf.pages.drawing import (
    DASHED,
    Blocks,
    Line,
    Panel,
    Units,
    changes_text,
    draw_figure,
    in_joint,
    joint_panels,
    line_style,
    listed,
    note,
    range_text,
    units_of,
)
from flexhinf.pages.settings import damping_text
from flexhinf.report import INK, MUTED, Column, Figure, LineStyle, Paragraph, Table

#: Bandwidths of more joints than this are given as a range.
FEW_JOINTS = 3

#: Headings of the forms of Rᵛ in a terminal.
FORMS = {
    "all states": "all",
    "velocities only": "velocities",
    "link velocities only": "links",
    "motor velocities only": "motors",
}

#: Decibels below the largest value that are shown.
DEPTH_DB = 90.0

#: How far a Nyquist diagram reaches to the left: the neighbourhood of −1 is what matters.
NYQUIST = 3.0

#: The horizontal axis of a panel.
FREQUENCY: dict[str, Any] = {"across": "frequency (Hz)", "log": True}

LOOP_CAPTION = "The linearised sampled loop at the goal, with estimator and delay as it runs."


# Margins ------------------------------------------------------------------------------------------------
def margins(design: PoseEvidence) -> Blocks:
    """Margins of the running loop and of state feedback, frequency responses, noise, estimation error."""
    e = design.evaluation
    m, own, s, joints = e.margins, e.state_margins, e.setup.specification, e.setup.joints
    yield from _margin_notes(e)
    text = (
        "The loop at the goal, linearised, sampled, with estimator and delay, is broken at the inputs. A gain margin "
        "is that of one input while the others stay; the disk margin lets all change at once."
    )
    if m.stable:
        distance = f", so the open loop passes −1 at a distance of {number(1.0 / m.peak_sensitivity, 2)}"
        text += (
            f" The sensitivity peaks at {number(m.peak_sensitivity, 3)} ({_hertz(m.sensitivity_frequency)} Hz)"
            f"{distance if len(m.gain_margins) == 1 else ''}."
        )
        if s.estimator != "none" and own.stable:
            raised = ": the estimator raises it (a larger `--torque-noise` makes it faster, and noisier)"
            text += (
                f" With the true state fed back the peak would be {number(own.peak_sensitivity, 3)}"
                f"{raised if m.peak_sensitivity > own.peak_sensitivity else ''}."
            )
    loops, units = [LoopLine("this law", e.frequency_response)], units_of(e)
    yield from (
        Paragraph(text),
        margin_table(e),
        lambda: _bode(loops, joints, [units.of(units.compliance, joint) for joint in joints]),
        lambda: _sensitivity(loops),
        lambda: _nyquist(loops, joints),
    )
    if e.input_noises is not None:
        yield _noise_table(e, e.input_noises)
    if s.estimator != "none":
        run, names = e.step.run, ("link position", "link velocity", "motor position", "motor velocity")
        truth, estimate = (e.setup.robot.layout.whole(run.signals[name].T) for name in ("state", "estimate"))
        errors = [units.scale * part.T for part in np.split(truth - estimate, 4)]
        parts = [
            panel
            for k, (name, error) in enumerate(zip(names, errors))
            for panel in joint_panels(
                units, name, units.rate if k % 2 else units.angle, run.time, error, linewidth=0.9
            )
        ]
        yield lambda: draw_figure(
            "estimate",
            parts,
            "True minus estimated state of every joint in the step.",
            "Estimation error",
            1.85 * len(parts),
        )


def _margin_notes(e: LawEvaluation) -> Blocks:
    m, period = e.margins, e.setup.specification.period
    if e.setup.left_out:
        yield note(
            f"The linear loop leaves out {' and '.join(e.setup.left_out).replace('_', ' ')}: the slope at standstill "
            "holds only for the smallest velocities and would count as damping. The simulated runs have it."
        )
    if e.undamped_margins is not None:
        yield note(f"{damping_text(e.setup.robot)} {_undamped_text(e.undamped_margins, period)}")
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
        k, largest = int(np.argmax(noise)), float(noise.max())
        units, joint = units_of(e), e.setup.joints[k]
        share = f", {number(100.0 * largest / peak, 2)} % of the step's peak input" if peak else ""
        yield note(
            f"In equilibrium the sensor noise moves an input{in_joint(joint, e.setup.joints)} by "
            f"{units.text(largest, units.effort, joint, 2)} rms{share}. Try a slower estimator (smaller "
            "--torque-noise), better sensors, or less --bandwidth."
        )


def _undamped_text(m: Margins, period: float) -> str:
    """What the running loop tolerates where nothing damps the springs, which decides nothing."""
    late = f"{number(m.delay_margin_s / period, 3)} samples of extra delay are tolerated"
    damped = f", the smallest damping ratio is {number(m.damping, 3)}" if m.damping < 1.0 else ""
    text = f"{late}{damped}" if m.stable else "the loop is unstable"
    return f"Without damping of the springs {text} (decides nothing)."


def _hertz(frequency: float) -> str:
    return number(frequency / (2.0 * np.pi), 3)


def margin_table(e: LawEvaluation) -> Table:
    """Table of the margins of the running loop, and with the true state fed back where there is an estimator."""
    alone, period = e.setup.specification.estimator == "none", e.setup.specification.period
    loops, joints = [e.margins] if alone else [e.margins, e.state_margins], e.setup.joints
    damped = in_joint(e.least_damped_joint, joints)
    tracked = [name.removeprefix("link_position_") for name in e.margins.positions]
    of = f" ({', '.join(tracked)})" if 1 < len(tracked) <= FEW_JOINTS else ""

    def gains(m: Margins) -> str:
        low, high = (number(float(value), 3) for value in m.gain_margins[m.weakest_input])
        return f"× {low}, × {high}{f' ({joints[m.weakest_input]})' if len(m.gain_margins) > 1 else ''}"

    def bandwidths(m: Margins) -> str:
        many = len(m.bandwidth) > FEW_JOINTS and np.isfinite(m.bandwidth).all()
        return (
            f"{range_text(m.bandwidth)} (slowest: {tracked[int(np.argmin(m.bandwidth))]})"
            if many
            else ", ".join(number(float(w), 3) for w in m.bandwidth)
        )

    lines: dict[str, Callable[[Margins], str]] = {
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
    return Table(
        (
            "linearised at the goal",
            Column("running loop", brief="true state" if alone else "", right=True),
            *([] if alone else [Column("true state fed back", brief="true state", right=True)]),
        ),
        [(what, *(value(m) if m.stable else "unstable" for m in loops)) for what, value in lines.items()],
        "Margins, the loop broken at the inputs",
        "table-margins",
        title="Margins, linearised at the goal",
    )


def rms_text(values: np.ndarray, units: Units) -> str:
    """The range of a number of each motor, with its unit; of joints that turn and of those that slide."""
    parts: dict[str, list[float]] = {}
    for joint, value in zip(units.joints, values.tolist()):
        parts.setdefault(units.of(units.effort, joint), []).append(value)
    return listed([f"{range_text(part, 2)} {unit}" for unit, part in parts.items()])


def _noise_table(e: LawEvaluation, together: np.ndarray) -> Table:
    gains, plant, units, joints = e.margins.noise_to_input, e.setup.model, units_of(e), e.setup.joints
    assert e.setup.noise is not None
    several, rows = len(joints) > 1, list[Sequence[object]]()
    for name, sigma, column in zip(plant.outputs, e.setup.noise.tolist(), gains.T):
        gain, unit, worst = float(column.max()), plant.unit(name), joints[int(np.argmax(column))]
        rows.append(
            (
                name.replace("_", " "),
                f"{number(sigma, 3)} {unit}",
                f"{number(gain)} {units.of(units.effort, worst)}/{unit}",
                f"{number(gain * sigma, 3)} {units.of(units.effort, worst)}",
                *([worst] if several else []),
            )
        )
    return Table(
        (
            "sensor",
            "its noise (rms)",
            "gain to the input (rms)",
            Column("at the motor (rms)", right=True),
            *(["motor"] if several else []),
        ),
        rows,
        "Noise of each sensor at the motor that it moves most; all sensors together: "
        f"{rms_text(together, units)} rms",
        "table-noise",
    )


# Frequency responses ------------------------------------------------------------------------------------
class LoopLine(NamedTuple):
    """A loop in the frequency figures: name in the legend, frequency response, and number of its line style."""

    name: str
    response: FrequencyResponse
    style: int = 0


def frequency_figures(
    loops: Sequence[LoopLine], joints: Sequence[str], compliance: Sequence[str]
) -> list[Figure]:
    """Bode, sensitivity and Nyquist diagram of one loop, a line for each joint; or of several, a line for each, of the
    joint that a torque on its link moves most. `compliance`: of each joint the unit of a link position over a torque on
    it."""
    return [_bode(loops, joints, compliance), _sensitivity(loops), _nyquist(loops, joints)] if loops else []


def _bode(loops: Sequence[LoopLine], joints: Sequence[str], compliance: Sequence[str]) -> Figure:
    lines, command, phase, torque = _lines(loops, joints), list[Line](), list[Line](), dict[str, list[Line]]()
    for name, style, response, joint in lines:
        below = response.frequencies <= 0.97 * np.pi / response.linear.period  # at its end the phase jumps
        hertz = response.frequencies[below] / (2.0 * np.pi)
        followed = response.command[below, joint, joint]
        command.append(Line(hertz, _decibel(followed), name, style))
        phase.append(Line(hertz, np.degrees(np.unwrap(np.angle(followed))), None, style))
        moved = Line(hertz, _decibel(_moved(response, joint)[below]), None, style)
        torque.setdefault(compliance[joint], []).append(moved)
    which = "" if len(loops) == 1 or len(joints) == 1 else f" Joint: {joints[lines[0][3]]}."
    return draw_figure(
        "bode",
        (
            Panel("command → link", "dB", command, (0.0, 20.0 * np.log10(np.sqrt(0.5))), depth=DEPTH_DB),
            Panel("phase", "°", phase),
            *(
                Panel(f"torque → link\n(dB of {unit})", "", lines, depth=DEPTH_DB, **FREQUENCY)
                for unit, lines in torque.items()
            ),
        ),
        f"{LOOP_CAPTION} Dotted: 0 dB, and −3 dB, where the bandwidth is read.{which}",
        "Bode diagram",
        2.8 * (2 + len(torque)),
    )


def _sensitivity(loops: Sequence[LoopLine]) -> Figure:
    alone = len(loops) == 1
    curves = [
        ("sensitivity S" if alone else x.name, x.response, x.response.sensitivity, x.style) for x in loops
    ]
    if alone:
        curves.append(("complementary sensitivity T", loops[0].response, loops[0].response.complementary, 1))
    lines = [
        Line(
            response.frequencies / (2.0 * np.pi),
            _decibel(np.linalg.norm(values, ord=2, axis=(1, 2))),
            name,
            line_style(style),
        )
        for name, response, values, style in curves
    ]
    return draw_figure(
        "sensitivity",
        [
            Panel(
                f"largest singular value{'' if alone else ' of S'}",
                "dB",
                lines,
                (0.0,),
                depth=DEPTH_DB,
                **FREQUENCY,
            )
        ],
        f"{LOOP_CAPTION} S: how much the loop amplifies a disturbance at the motors"
        f"{'; T: an error of the model' if alone else ''}. Dotted: 0 dB.",
        "Sensitivity",
        3.6,
    )


def _nyquist(loops: Sequence[LoopLine], joints: Sequence[str]) -> Figure:
    lines, closest, distance = list[Line](), "", np.inf
    for place, (name, style, response, joint) in enumerate(_lines(loops, joints)):
        opened = response.input_loops[:, joint]
        distance = min(distance, float(np.nanmin(np.abs(1.0 + opened))))
        lines.append(Line(np.real(opened), np.imag(opened), name, {**style, "zorder": 3.0 - 0.01 * place}))
    turn = np.linspace(0.0, 2.0 * np.pi, 200)
    mark: LineStyle = {"color": INK, "marker": "+", "markersize": 9.0, "linestyle": "none"}
    lines += [
        Line(np.cos(turn), np.sin(turn), "unit circle", {"color": MUTED, "linewidth": 0.8}),
        Line(np.array([-1.0]), np.array([0.0]), "−1", mark),
    ]
    if len(loops) == 1:
        dashed: LineStyle = {"color": INK, "linewidth": 1.0, "dashes": DASHED, "zorder": 1.0}
        lines.append(Line(distance * np.cos(turn) - 1.0, distance * np.sin(turn), None, dashed))
        closest = f" The dashed circle about −1 has the smallest distance, {distance:.2f}."
    others = " The loops at the other inputs are closed." if len(joints) > 1 else ""
    return draw_figure(
        "nyquist",
        [
            Panel(
                "imaginary part",
                "",
                lines,
                across="real part",
                x=(-NYQUIST, 0.6 * NYQUIST),
                y=(-0.5 * NYQUIST, 0.5 * NYQUIST),
                also=lambda axes: axes.set_aspect("equal"),
            )
        ],
        f"{LOOP_CAPTION} Opened at one input, positive frequencies, negative feedback.{others}{closest}",
        "Nyquist diagram",
        4.1,
    )


def _lines(
    loops: Sequence[LoopLine], joints: Sequence[str]
) -> list[tuple[str, LineStyle, FrequencyResponse, int]]:
    """Name, style, response and joint of each line; of several loops the joint that a torque moves most in the 1st."""
    first = loops[0].response
    if len(loops) == 1:
        names = enumerate(joints if len(joints) > 1 else [loops[0].name])
        return [(name, line_style(k), first, k) for k, name in names]
    joint = int(np.argmax([np.abs(_moved(first, joint)).max() for joint in range(len(first.linear.names))]))
    return [(loop.name, line_style(loop.style), loop.response, joint) for loop in loops]


def _moved(response: FrequencyResponse, joint: int) -> np.ndarray:
    name = response.linear.names[joint].replace("link_position", "link_torque", 1)
    return response.disturbance[:, joint, response.linear.disturbances.index(name)]


def _decibel(values: np.ndarray) -> np.ndarray:
    return 20.0 * np.log10(np.maximum(np.abs(values), 1e-300))


# Corners of the tolerances ------------------------------------------------------------------------------
def corners(design: PoseEvidence) -> Blocks:
    """Table of the unstable corners of the tolerances; nothing for a robot without."""
    e = design.evaluation
    cases, state = e.corners, e.state_corners
    if cases is None:
        return
    if cases.unstable:
        advice = (
            "the law itself is unstable there: try a shorter --period or --unknown-delay, or less --bandwidth"
            if state is not None and state.unstable > 0
            else "the estimator causes it: try another --torque-noise or --estimator"
        )
        applies = robust_applies(e.setup.robot, e.setup.specification, e.setup.goal)
        preset = ", or --preset robust" if applies else ""
        yield note(
            f"{cases.unstable} of {cases.count} corners of the tolerances are unstable with this estimator; "
            f"{advice}{preset}."
        )
    yield from (
        Paragraph(corners_text(e)),
        Paragraph(
            f"{'All' if cases.complete else 'Sampled'} corners: every uncertain parameter at one end of its "
            "tolerance, all "
            "together. For each the loop is linearised at the goal; robots between the corners are not covered."
        ),
    )
    if cases.swept:
        free = " or ".join(f"“{form}”" for form in cases.retunable)
        parts = ", ".join(
            f"with “{form}” at {len(cases.stable_ratios(form))} of {count_text(len(cases.of_form(form)), 'ratio')} only"
            for form in cases.forms
            if form not in cases.retunable
        )
        may = f"With Rᵛ of the form {free} none is unstable at any ratio tried." if free else ""
        otherwise = (
            " Otherwise that" if free else "No form keeps all corners stable at all ratios tried: that"
        )
        yield Paragraph(
            "No paper gives Rᵛ, the process noise that the estimator assumes, and the gain of a filter depends only on "
            f"its ratio q/Rⁿ and on where q stands. {may}{f'{otherwise} holds {parts}.' if parts else ''} Forms that "
            "are not listed were not tried."
        )
    yield corner_table(e)


def corners_text(e: LawEvaluation) -> str:
    """Sentence with the number of unstable corners as designed, and the worst of them."""
    corners, state, s = e.corners, e.state_corners, e.setup.specification
    assert corners is not None
    of = f"of {'the ' if not corners.unstable else ''}{corners.count} {'' if corners.complete else 'sampled '}corners"
    unstable = f"{corners.unstable or 'None'} {of} {'is' if corners.unstable < 2 else 'are'} unstable"
    other, sensors = "", "true state"
    if s.estimator != "none":
        sensors = ", ".join(s.measured).replace("_", " ")
        other = "" if state is None else f"; with the true state fed back {state.unstable}"
    worst, rate = corners.population.values[corners.worst], corners.designed.fastest
    grows = (
        f"{'grows' if rate >= 0.0 else 'decays'} with {number(abs(rate), 3)} 1/s"
        if np.isfinite(rate)
        else "has no equilibrium at the goal"
    )
    corner = changes_text(worst, e.setup.true.robot, e.setup.extras)
    return f"Measured: {sensors}. {unstable}{other}. The worst corner ({corner}) {grows}."


def corner_rows(e: LawEvaluation) -> list[dict[str, Any]]:
    """Unstable corners, their share in percent and the largest growth rate (1/s), as designed ("form"), with the true
    state, then for every form and ratio q/Rⁿ of Rᵛ."""
    corners, alone = e.corners, e.setup.specification.estimator == "none"
    assert corners is not None
    loops: list[tuple[str, float | None, GrowthRates | None]] = [
        ("true state" if alone else "as designed", None, corners.designed),
        ("true state", None, None if alone else e.state_corners),
        *((form, ratio, rates) for form in corners.forms for ratio, rates in corners.of_form(form).items()),
    ]
    return [
        {
            "form": form,
            "ratio": ratio,
            "unstable": int((rates.rates[rates.kinds == "corner"] >= 0.0).sum()),
            "percent": 100.0 * rates.share("corner"),
            "rate": float(rates.rates[rates.kinds == "corner"].max()),
        }
        for form, ratio, rates in loops
        if rates is not None
    ]


def corner_table(e: LawEvaluation) -> Table:
    """Table of unstable corners and growth rates over q/Rⁿ, a pair of columns for each form of Rᵛ; without forms, of
    the loops that were evaluated."""
    assert e.corners is not None
    rows, forms = corner_rows(e), e.corners.forms
    title = f"Corners of the tolerances. {corners_text(e)}"
    if not forms:
        return Table.of(
            (
                Column("loop", key="form"),
                Column("unstable", key="unstable"),
                Column("growth", "1/s", digits=3, key="rate"),
            ),
            rows,
            "Unstable corners, and the growth rate of the worst; a negative rate decays",
            "table-corners",
            title=title,
        )

    def texts(row: dict[str, Any] | None) -> tuple[str, str]:
        if row is None:
            return "–", "–"
        rate = number(row["rate"], 3) if np.isfinite(row["rate"]) else "no equilibrium"
        return f"{row['unstable']} ({number(row['percent'], 2)} %)" if row["unstable"] else "0", rate

    by, cells = {(row["form"], row["ratio"]): row for row in rows}, list[Sequence[object]]()
    for ratio in sorted({row["ratio"] for row in rows if row["ratio"] is not None}):
        exponent = round(float(np.log10(ratio)))
        power = number(10.0**exponent, 1).removeprefix("1·") if abs(exponent) > 3 else number(ratio)
        cells.append((power, *(text for form in forms for text in texts(by.get((form, ratio))))))
    return Table(
        (
            "q/Rⁿ",
            *(
                column
                for form in forms
                for column in (
                    Column(f"{form}: unstable", brief=FORMS[form]),
                    Column("fastest growth, 1/s", brief=None),
                )
            ),
        ),
        cells,
        "Unstable corners over Rᵛ, by the states on which q stands; a negative growth rate decays",
        "table-corners",
        title=f"{title}\nUnstable corners over Rᵛ = q on:",
    )
