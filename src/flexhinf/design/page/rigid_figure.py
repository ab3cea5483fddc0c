"""The rigid design's step drawn beside ours."""

from __future__ import annotations

import numpy as np

from flexhinf.design.page.drawing import framed, thin, zero_line
from flexhinf.design.page.step_figure import spring_torques
from flexhinf.design.page.units import units_of
from flexhinf.design.result import Design
from flexhinf.report import SERIES, Figure, figure_to_svg, house_style, label, legend, new_figure

__all__ = ["rigid_figure", "step_limits", "worst_joint"]

#: A line may leave the panel by this many steps: a loop that diverges would hide the others.
SHOWN_STEPS = 2.5


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
    joint, units = worst_joint(design), units_of(design)
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
            few = thin(response.run.time)
            time, spring = response.run.time[few], spring_torques(design, response.run)[few, joint]
            signals = (
                response.positions[few, joint] - design.goal[joint],
                spring,
                response.run.signals["input"][few, joint],
            )
            for axis, signal in zip(axes, signals):
                axis.plot(time, signal, color=colour, label=text, linewidth=1.4, zorder=3.0 - 0.1 * order)
            springs.append((spring, signals[2]))
        zero_line(axes[0])
        axes[0].set_xlim(0.0, design.duration)
    axes[0].set_ylim(*step_limits(design.start[joint], design.goal[joint]))
    for axis, which in ((axes[1], 0), (axes[2], 1)):
        ours = springs[0][which]
        low, high = framed(ours)
        axis.set_ylim(low - 0.75 * (high - low), high + 0.75 * (high - low))
    label(axes[0], "link position − goal", units.position)
    label(axes[1], "spring torque", units.spring)
    label(axes[2], "input", units.effort)
    legend(axes[0])
    return Figure(
        "figure-rigid",
        figure_to_svg(figure),
        f"The same step by the rigid design{where}. It is fed the true position and "
        "velocity of one side, without estimator or noise. Lines that leave the panels go on.",
        "The rigid design on the elastic robot",
    )
