"""Frequency responses of the running loop (Bode, sensitivity, Nyquist; a line a joint, or a line a law), and poles: of
the robot without control, of the loop, and of the estimation error."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from flexhinf.analysis import FrequencyResponse
from flexhinf.design.problem.modes import Mode
from flexhinf.design.result import Design
from flexhinf.design.specification import RINGS
from flexhinf.loop.simulation.metrics import damping_ratio
from flexhinf.pages.drawing import (
    DASHED,
    DOTTED,
    figure_block,
    frequency_axis,
    legend_above,
    line_style,
    panels,
    range_text,
    reference_line,
    vertical_line,
)
from flexhinf.report import INK, MUTED, SERIES, Column, Figure, Paragraph, Table, house_style, label, legend

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: Decibels below the largest value that are shown.
SHOWN_DB = 90.0

#: Fraction of half the sampling frequency that a Bode diagram shows: the phase jumps at its end.
SHOWN_BAND = 0.97

#: How far a Nyquist diagram reaches to the left: the neighbourhood of −1 is what matters.
NYQUIST = 3.0

#: An estimation error at a vibration with less damping than this is hardly corrected by the sensors.
HARDLY_SEEN = 0.01

#: Damping ratios whose lines are drawn in the s-plane.
RAYS = (0.1, 0.3, 0.7)

#: The s-plane reaches so many times as far as the fastest oscillation of robot and law; faster poles are on the right.
ROOM = 1.8

#: Below this frequency, Hz, a pole is at zero and has no place on a logarithmic axis.
SLOWEST = 1e-3

#: With more joints than these a terminal lists vibrations only.
MANY = 3

RUNNING = "The linearised sampled loop at the goal, with estimator and delay as it runs."


@dataclass(frozen=True)
class Loop:
    """A loop in these figures: its name in the legend, and the number of its line's style."""

    name: str
    response: FrequencyResponse
    style: int = 0


def frequency_figures(loops: Sequence[Loop], joints: Sequence[str], load: str, position: str) -> list[Figure]:
    """All three figures of the loops; none without a loop that could be linearised.

    Parameters
    ----------
    loops : sequence of Loop
        One: a line for each joint. Several: a line for each, of the joint that follows the command worst.
    load, position : str
        Units of torques on links and of link positions.
    """
    if not loops:
        return []
    return [_bode(loops, joints, load, position), _sensitivity(loops), _nyquist(loops, joints)]


@house_style()
def _bode(loops: Sequence[Loop], joints: Sequence[str], load: str, position: str) -> Figure:
    figure, (command, phase, torque) = _stacked(3, 8.4)
    for name, style, response, joint in _lines(loops, joints):
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
    which = "" if len(loops) == 1 or len(joints) == 1 else f" Joint: {joints[_worst(loops)]}."
    return figure_block(
        "bode", figure,
        f"{RUNNING} Magnitude and phase from the commanded to the true link position (dotted: 0 dB, and −3 dB, where "
        f"the bandwidth is read), and magnitude from a torque on the link to its position.{which}",
        "Bode diagram",
    )  # fmt: skip


@house_style()
def _sensitivity(loops: Sequence[Loop]) -> Figure:
    figure, (axis,) = _stacked(1, 3.6)
    alone = len(loops) == 1
    lines = [
        ("sensitivity S" if alone else one.name, one.response, "sensitivity", one.style) for one in loops
    ]
    if alone:
        lines.append(("complementary sensitivity T", loops[0].response, "complementary", 1))
    for name, response, which, style in lines:
        sizes = np.linalg.norm(getattr(response, which), ord=2, axis=(1, 2))
        axis.plot(response.frequencies / (2.0 * np.pi), _decibel(sizes), label=name, **line_style(style))
    reference_line(axis)
    _bounded(axis)
    label(axis, f"largest singular value{'' if alone else ' of S'}", "dB")
    legend(axis)
    second = "; T: how much an error of the model is amplified" if alone else ""
    return figure_block(
        "sensitivity", figure,
        f"{RUNNING} S: how much the loop amplifies a disturbance at the motors (above 0 dB: more than without "
        f"control){second}. Dotted: 0 dB.",
        "Sensitivity",
    )  # fmt: skip


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
        axis.add_patch(
            Circle((-1.0, 0.0), radius, fill=False, color=INK, linewidth=1.0, linestyle=(0, DASHED))
        )
        closest = f" The dashed circle about −1 has the smallest distance, {radius:.2f}."
    axis.set_xlim(-NYQUIST, 0.6 * NYQUIST)
    axis.set_ylim(-0.5 * NYQUIST, 0.5 * NYQUIST)
    axis.set_aspect("equal")
    axis.set_xlabel("real part")
    label(axis, "imaginary part", "")
    legend(axis)
    others = " The loops at the other inputs are closed." if len(joints) > 1 else ""
    return figure_block(
        "nyquist", figure,
        f"{RUNNING} The loop opened at one input, positive frequencies, negative feedback.{others}{closest} "
        "Curves that leave the frame go on.",
        "Nyquist diagram",
    )  # fmt: skip


def _lines(
    loops: Sequence[Loop], joints: Sequence[str]
) -> list[tuple[str, dict[str, Any], FrequencyResponse, int]]:
    """Name, style, response and joint of each line."""
    if len(loops) == 1:
        response = loops[0].response
        names = joints if len(joints) > 1 else [loops[0].name]
        return [(name, line_style(k), response, k) for k, name in enumerate(names)]
    joint = _worst(loops)
    return [(loop.name, line_style(loop.style), loop.response, joint) for loop in loops]


def _worst(loops: Sequence[Loop]) -> int:
    """The joint that a torque on its link moves most, in the first loop."""
    first = loops[0].response
    return int(np.argmax([np.abs(_moved(first, joint)).max() for joint in range(len(first.positions))]))


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


# Poles --------------------------------------------------------------------------------------------------
@dataclass(frozen=True, eq=False)
class PoleGroup:
    """Poles (1/s) of one loop, with its marker: "x" and "+" are open, others filled unless `hollow`."""

    name: str
    poles: np.ndarray
    marker: str
    colour: str
    hollow: bool = False

    @property
    def style(self) -> dict[str, Any]:
        """For Matplotlib's ``plot``."""
        face = {"markerfacecolor": "none" if self.hollow else self.colour}
        return {"color": self.colour, "markersize": 6.0, "linestyle": "none", "marker": self.marker, **face}


@house_style()
def poles_figure(groups: Sequence[PoleGroup]) -> Figure:
    """The s-plane near the imaginary axis, and damping over frequency for all poles."""
    figure, ((plane, damping),) = panels(1, 2, 3.6)
    groups = [group for group in groups if len(group.poles)]
    poles = np.concatenate([group.poles for group in groups[:2]])  # without control, and with the law
    oscillating = np.abs(poles[np.abs(np.imag(poles)) > 0.0])
    size = ROOM * float(oscillating.max() if len(oscillating) else np.abs(poles).max(initial=1.0))
    dotted = {"color": MUTED, "linewidth": 0.8, "linestyle": DOTTED, "zorder": 0.5}
    for ray in RAYS:
        plane.plot([0.0, -ray * 2.0 * size], [0.0, np.sqrt(1.0 - ray**2) * 2.0 * size], **dotted)
    low = -0.05
    for group in groups:
        upper = group.poles[np.imag(group.poles) >= 0.0]
        plane.plot(np.real(upper), np.imag(upper), **group.style)
        hertz = np.abs(upper) / (2.0 * np.pi)
        ratio = damping_ratio(upper[hertz > SLOWEST])
        low = min([low, *(value - 0.05 for value in ratio.tolist() if value > -1.0 + 1e-9)])
        damping.plot(hertz[hertz > SLOWEST], ratio, label=group.name, **group.style)
    right = min(size, float(np.real(poles).max(initial=0.0)))
    plane.set_xlim(-size, max(0.12 * size, 1.15 * right))
    plane.set_ylim(-0.03 * size, size)
    plane.set_xlabel("Re λ (1/s)")
    vertical_line(plane, 0.0)
    label(plane, "Im λ", "rad/s")
    frequency_axis(damping)
    damping.margins(x=0.06)
    damping.set_ylim(max(low, -1.05), 1.08)
    damping.axhspan(-2.0, 0.0, color=SERIES[1], alpha=0.08, linewidth=0)
    damping.set_xlabel("frequency |λ|/2π (Hz)")
    reference_line(damping)
    label(damping, "damping ratio", "")
    legend_above(figure, damping, 2)
    return figure_block(
        "poles", figure,
        "Left: poles λ in the s-plane, upper half, near the imaginary axis (faster ones on the right only); dotted "
        f"rays have damping ratio {', '.join(f'{ray:g}' for ray in RAYS)}. Right: damping ratio −Re λ/|λ| over "
        "frequency of all poles; 1 decays without oscillating, below zero (shaded) grows. Poles at zero are left out "
        "on the right.",
        "Poles",
    )  # fmt: skip


def pole_blocks(design: Design) -> list[Any]:
    """Figure, a table of what oscillates or does not decay, and what decays without oscillating."""
    looks = ((MUTED, "o", True), (SERIES[0], "o", False), (SERIES[2], "^", False))
    named = [
        (name, np.array([mode.eigenvalue for mode in modes], dtype=complex))
        for name, modes in _modes(design).items()
    ]
    groups = [
        PoleGroup(name, poles, marker, colour, hollow)
        for (name, poles), (colour, marker, hollow) in zip(named, looks)
    ]
    if design.specification.estimator != "none":
        poles = design.evaluation.frequency_response.poles
        groups.append(PoleGroup("running loop (sampled, estimator, delay)", poles, "x", SERIES[1]))
    for loop, marker in zip(design.rigid.loops if design.rigid else (), ("1", "2")):
        poles = np.array([mode.eigenvalue for mode in loop.modes], dtype=complex)
        groups.append(PoleGroup(f"rigid law, {loop.side} side", poles, marker, SERIES[3]))
    words = []
    for name, modes in list(_modes(design).items())[:2]:
        times = [1.0 / -mode.eigenvalue.real for mode in modes if not _listed(mode)]
        constants = f", time constant{'s' if len(times) > 1 else ''} {range_text(times)} s" if times else ""
        many = f"{len(times)} modes decay" if len(times) != 1 else "1 mode decays"
        words.append(f"{name.capitalize()}: {many} without oscillating{constants}.")
    decays = f"{' '.join(words)} The law adds one mode for the integral of each joint's error."
    return [poles_figure(groups), mode_table(design), Paragraph(decays)]


def _modes(design: Design) -> Mapping[str, Sequence[Mode]]:
    error = design.evaluation.estimator_modes
    found = {"without control": design.evaluation.open_modes, "law on the true state": design.law_modes}
    return {**found, "estimation error": error} if error else found


def _listed(mode: Mode) -> bool:
    """Whether a mode has a row of its own; those that decay without oscillating are summed up in a sentence."""
    return bool(mode.eigenvalue.imag) or not mode.stable


def mode_table(design: Design, brief: bool = False) -> Table:
    """Modes that oscillate or do not decay; `brief`: that oscillate, of many joints the vibrations alone."""
    joints = len(design.robot.joint_names)
    rows = [
        {
            "loop": name, "mode": mode.name, "joint": mode.joint, "frequency": mode.frequency, "damping": mode.damping,
            "time": mode.time_constant,
        }
        for name, modes in _modes(design).items()
        for mode in modes
        if _listed(mode)
        and not (brief and (not mode.eigenvalue.imag or (joints > MANY and not mode.vibration)))
    ]  # fmt: skip
    columns = (
        Column("loop", key="loop"),
        Column("mode", key="mode"),
        *([Column("mainly", key="joint")] if joints > 1 else []),
        Column("frequency", "Hz", digits=4, key="frequency", brief="Hz"),
        Column("damping ratio", digits=4, key="damping", brief="damping"),
        Column("time constant", "s", digits=4, key="time", brief=None),
    )
    caption = "Modes that oscillate or do not decay, linearised at the goal, continuous time"
    title = f"γ* of the problem = {design.gamma_star:.5g}, γ = {design.gamma:.5g}\nOscillations at the goal"
    return Table.of(columns, rows, caption, "table-modes", title=title)


def pole_remarks(design: Design) -> Iterator[str]:
    """A vibration that rings, in the loop or in the estimation error."""
    after = vibration_damping(design.law_modes)
    if after and min(after) < RINGS:
        yield (
            f"A vibration has a damping ratio of {min(after):.2g} with this law: its weights hardly act on it. "
            "`--damping 0.3` searches for weights that do."
        )
    error = [mode for mode in design.evaluation.estimator_modes if mode.vibration]
    if not error:
        return
    worst, target = min(error, key=lambda mode: mode.damping), design.design_problem.target
    where = f" ({worst.joint})" if len(design.robot.joint_names) > 1 else ""
    if worst.damping < HARDLY_SEEN:
        yield (
            f"The estimator's error at {worst.frequency:.3g} Hz{where} has a damping ratio of "
            f"{worst.damping:.1g} only, and noise keeps it ringing, in the robot too. Measure link positions or joint "
            "torques, or raise --process-noise."
        )
    elif target is not None and worst.damping < target.damping:
        yield (
            f"The estimator's error at {worst.frequency:.3g} Hz{where} has a damping ratio of "
            f"{worst.damping:.2g}, less than required of the law. After a disturbance that the model does not know the "
            "loop rings with it. Try a larger --torque-noise, or another sensor (--measured)."
        )


def vibration_damping(modes: Sequence[Mode]) -> list[float]:
    """Damping ratios of the vibrations among some modes."""
    return [mode.damping for mode in modes if mode.vibration]
