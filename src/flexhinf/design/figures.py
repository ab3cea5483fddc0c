"""Drawings of a design: step response, estimation error, modes, and the rigid design beside it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from flexhinf.design.modes import Mode
from flexhinf.design.result import Design
from flexhinf.report import MUTED, SERIES, Figure, figure_to_svg, house_style, label, legend, new_figure

__all__ = ["estimation_figure", "modes_figure", "response_figure", "rigid_figure", "step_limits"]

#: More points than this per line say nothing more on a page.
POINTS = 1500

#: A line may leave the panel by this many steps: a loop that diverges would hide the others.
SHOWN_STEPS = 2.5


def _style(joint: int) -> dict[str, Any]:
    """One colour per joint, dashed when the colours start again."""
    dashed = {"dashes": (4.0, 2.0)} if joint >= len(SERIES) else {}
    return {"color": SERIES[joint % len(SERIES)], "linewidth": 1.5, **dashed}


def _thin(time: np.ndarray) -> slice:
    return slice(None, None, max(1, len(time) // POINTS))


def _units(design: Design) -> tuple[str, str]:
    """Of positions and of torques: the first joint's."""
    return ("m", "N") if design.robot.links.slides[0] else ("rad", "N·m")


def spring_torques(design: Design, run: Any) -> np.ndarray:
    """Torque of the nominal springs along a run (N, n)."""
    n = len(design.goal)
    p = design.problem.plant.parameters
    stiffness = np.atleast_1d(p.named(p.vector()).stiffness)
    state = run.signals["state"]
    return stiffness * (state[:, 2 * n : 3 * n] - state[:, :n])


def response_figure(design: Design) -> Figure:
    """Distance from the goal, spring torques and inputs of every joint."""
    response, joints = design.response, design.robot.joint_names
    thin = _thin(response.run.time)
    time, (length, torque) = response.run.time[thin], _units(design)
    figure, axes = new_figure(3, height=7.2)
    panels = (
        response.positions - design.goal,
        spring_torques(design, response.run),
        response.run.signals["input"],
    )
    with house_style():
        for axis, panel in zip(axes, panels):
            for joint, name in enumerate(joints):
                axis.plot(time, panel[thin, joint], label=name, **_style(joint))
        axes[0].axhline(0.0, color=MUTED, linewidth=1.0, linestyle=(0, (1.0, 1.6)), zorder=0.5)
    for axis, panel in zip(axes[:2], panels):
        axis.set_ylim(*_framed(panel[thin]))
    label(axes[0], "link position − goal", length)
    label(axes[1], "spring torque", torque)
    label(axes[2], "input", design.problem.plant.unit(design.problem.input_names[0]))
    if len(joints) > 1:
        legend(axes[0])
    return Figure(
        "figure-step",
        figure_to_svg(figure),
        f"The step from the start pose to the goal in the nonlinear closed loop, {_fed(design)}: link positions as "
        "distance from the goal (dotted), torques of the springs, inputs as applied.",
        "Step response",
    )


def _fed(design: Design) -> str:
    s = design.specification
    if s.estimator == "none":
        return "the true state fed back"
    return (
        f"with the {s.estimator.upper()} on {', '.join(s.measured).replace('_', ' ')} and measurement noise"
    )


def _framed(values: np.ndarray) -> tuple[float, float]:
    """Limits of an axis: all of what is finite, with a margin."""
    finite = values[np.isfinite(values)]
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (-1.0, 1.0)
    margin = 0.06 * max(high - low, 1e-12)
    return low - margin, high + margin


def estimation_figure(design: Design) -> Figure | None:
    """True minus estimated positions and velocities of links and motors; None without an estimator."""
    run, joints = design.response.run, design.robot.joint_names
    if design.specification.estimator == "none":
        return None
    n, thin = len(joints), _thin(run.time)
    error = run.signals["state"][:, : 4 * n] - run.signals["estimate"]
    length, _ = _units(design)
    figure, axes = new_figure(4, height=8.0)
    titles = ("link position", "link velocity", "motor position", "motor velocity")
    with house_style():
        for k, axis in enumerate(axes):
            for joint, name in enumerate(joints):
                axis.plot(
                    run.time[thin],
                    error[thin, k * n + joint],
                    label=name,
                    **{**_style(joint), "linewidth": 0.9},
                )
    for k, axis in enumerate(axes):
        label(axis, titles[k], f"{length}/s" if k % 2 else length)
    if n > 1:
        legend(axes[0])
    return Figure(
        "figure-estimate",
        figure_to_svg(figure),
        "True minus estimated state of every joint.",
        "Estimation error",
    )


def modes_figure(design: Design) -> Figure:
    """Frequency and damping ratio of all modes, without control, with the law, and with the rigid one."""
    groups: list[tuple[str, Sequence[Mode], str, str]] = [
        ("without control", design.open_modes, "o", MUTED),
        ("with this law", design.closed_modes, "o", SERIES[0]),
    ]
    if design.estimator_modes:
        groups.append(("estimation error", design.estimator_modes, "^", SERIES[2]))
    for loop, marker in zip(design.rigid.loops if design.rigid else (), ("x", "+")):
        groups.append((f"rigid law, fed from the {loop.side} side", loop.modes, marker, SERIES[1]))
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    figure, (axis,) = new_figure(1, height=3.6)
    low = -0.05
    with house_style():
        for name, modes, marker, colour in groups:
            seen = [mode for mode in modes if mode.frequency > 1e-3]
            filled = "none" if colour == MUTED else colour
            face: dict[str, Any] = {"markerfacecolor": filled} if marker == "o" else {}
            damping = [mode.damping for mode in seen]
            low = min([low, *(value - 0.05 for value in damping if value > -1.0 + 1e-9)])
            axis.plot(
                [mode.frequency for mode in seen], damping, marker, color=colour, label=name, markersize=6.0,
                linestyle="none", **face,
            )  # fmt: skip
        axis.set_xscale("log")
        axis.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0), numticks=30))
        axis.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.xaxis.set_minor_formatter(NullFormatter())
        axis.set_ylim(max(low, -1.05), 1.05)
        axis.axhspan(-2.0, 0.0, color=SERIES[1], alpha=0.08, linewidth=0)
        axis.set_xlabel("frequency |λ|/2π (Hz)")
    label(axis, "damping ratio", "")
    legend(axis)
    return Figure(
        "figure-modes",
        figure_to_svg(figure),
        "Modes of the linearisation at the goal, the true state fed back, and those of the estimation error "
        "(stationary gain), which the loop has too. Damping 1: no oscillation; below zero "
        "(shaded): the mode grows. Modes at rest (0 Hz) are left out.",
        "Modes",
    )


def worst_joint(design: Design) -> int:
    """The joint on which the rigid laws do worst, by its error in the second half of their runs."""
    assert design.rigid is not None
    late = np.zeros(len(design.goal))
    for loop in design.rigid.loops:
        positions = loop.response.positions
        error = np.abs(positions[len(positions) // 2 :] - design.goal)
        late += np.nan_to_num(error, nan=1e9, posinf=1e9).max(axis=0)
    return int(np.argmax(late))


def step_limits(start: float, goal: float) -> tuple[float, float]:
    """Of the axis of a step response that others may leave."""
    step = abs(start - goal) or 1.0
    return -SHOWN_STEPS * step, SHOWN_STEPS * step


def rigid_figure(design: Design) -> Figure | None:
    """Our step response and those of the rigid law, of the joint where the rigid law does worst."""
    if design.rigid is None:
        return None
    joint, (length, torque) = worst_joint(design), _units(design)
    where = f", {design.robot.joint_names[joint]}, where it does worst" if len(design.goal) > 1 else ""
    runs = [("this law, with its estimator", design.response, SERIES[0])]
    if design.specification.estimator == "none":
        runs = [("this law", design.response, SERIES[0])]
    for loop, colour in zip(design.rigid.loops, SERIES[1:]):
        runs.append((f"rigid law, fed from the {loop.side} side", loop.response, colour))
    figure, axes = new_figure(3, height=7.2)
    springs = []
    with house_style():
        for order, (text, response, colour) in enumerate(runs):
            thin = _thin(response.run.time)
            time, spring = response.run.time[thin], spring_torques(design, response.run)[thin, joint]
            signals = (
                response.positions[thin, joint] - design.goal[joint],
                spring,
                response.run.signals["input"][thin, joint],
            )
            for axis, signal in zip(axes, signals):
                axis.plot(time, signal, color=colour, label=text, linewidth=1.4, zorder=3.0 - 0.1 * order)
            springs.append((spring, signals[2]))
        axes[0].axhline(0.0, color=MUTED, linewidth=1.0, linestyle=(0, (1.0, 1.6)), zorder=0.5)
        axes[0].set_xlim(0.0, design.duration)
    axes[0].set_ylim(*step_limits(design.start[joint], design.goal[joint]))
    for axis, which in ((axes[1], 0), (axes[2], 1)):
        ours = springs[0][which]
        low, high = _framed(ours)
        axis.set_ylim(low - 0.75 * (high - low), high + 0.75 * (high - low))
    label(axes[0], "link position − goal", length)
    label(axes[1], "spring torque", torque)
    label(axes[2], "input", design.problem.plant.unit(design.problem.input_names[0]))
    legend(axes[0])
    return Figure(
        "figure-rigid",
        figure_to_svg(figure),
        f"The same step by the rigid design{where}. It is fed the true position and "
        "velocity of one side, without estimator or noise. Lines that leave the panels go on.",
        "The rigid design on the elastic robot",
    )
