"""Pictures by which robots, designs and loops show themselves, in a notebook and on the page of a check."""

# Not checked strictly: parts of Matplotlib have no types.
# pyright: reportUnknownMemberType=false

from __future__ import annotations

import math
from base64 import b64encode
from collections.abc import Iterable
from html import escape

import numpy as np

from flexhinf.analysis import FrequencyResponse, Margins
from flexhinf.designs.result import BODE, Design
from flexhinf.loop.simulation.figure import NotebookFigure
from flexhinf.notebook import PICTURES
from flexhinf.numerals import number
from flexhinf.pages.design.step import arm_plane
from flexhinf.pages.drawing import figure_block
from flexhinf.pages.parts import PARTS
from flexhinf.report import INK, MUTED, SERIES, Figure, house_style, label, legend, panels
from flexhinf.robot import Robot
from flexhinf.robot.kinematics import skeleton

#: By how much an arrow moves a joint that turns, rad, and one that slides, of the robot's size.
TURN, SLIDE = math.radians(15.0), 0.12


@house_style()
def robot_picture(robot: Robot) -> Figure | None:
    """The links at the robot's home, and for each joint an arrow to where its positive direction moves the end of its
    link; None for links without a length."""
    home = np.asarray(robot.home, dtype=float)
    lines = skeleton(robot, home)
    size = float(np.ptp(np.concatenate(lines), axis=0).max())
    steps = np.diag(np.where(robot.links.slides, SLIDE * size, TURN))
    moved = [skeleton(robot, home + step) for step in steps]
    seen = arm_plane(robot, [lines, *moved])
    if seen is None:
        return None
    view, names, (low, high) = seen
    panel = np.array((5.0, min(max(5.0 * (high - low)[1] / (high - low)[0], 1.8), 3.6)))
    # As much to the inch in both directions, the whole panel used.
    half = 0.5 * max((high - low) / panel) * panel
    (left, bottom), (right, top) = 0.5 * (low + high) - half, 0.5 * (low + high) + half
    figure, ((axes,),) = panels(1, 1, 1.2 + float(panel[1]))
    for line in lines:
        axes.plot(*(line @ view).T, color=SERIES[0], linewidth=3.2)
    joints = np.array([line[0] for line in lines]) @ view
    axes.plot(*joints.T, "o", color=INK, markersize=4.5)
    numbers: list[np.ndarray] = []
    numbered = len(robot.joint_names) > len(SERIES) - 1  # more joints than colours
    for k, (joint, own) in enumerate(zip(robot.joint_names, lines)):
        ends = ((own[-1] @ view, moved[k][k][-1] @ view), (lines[-1][-1] @ view, moved[k][-1][-1] @ view))
        seen_ends = (pair for pair in ends if float(np.linalg.norm(pair[1] - pair[0])) > 1e-3 * size)
        if (pair := next(seen_ends, None)) is None:
            continue
        begin, end = pair
        colour = SERIES[1 + k % (len(SERIES) - 1)]
        arrow = {"arrowstyle": "-|>", "linewidth": 2.0, "shrinkA": 0, "shrinkB": 0, "color": colour}
        axes.annotate("", end, begin, arrowprops=arrow)
        if numbered:
            near = sum(float(np.linalg.norm(end - other)) < 0.03 * size for other in numbers)
            numbers.append(end)
            axes.annotate(
                str(k + 1), end, (10.0 + 12.0 * near, 7.0), textcoords="offset points", color=colour
            )
        axes.plot([], [], label=f"{k + 1} {joint}" if numbered else joint, linewidth=2.0, color=colour)
    axes.axhline(float(joints[0, 1]), color=MUTED, linewidth=0.6, zorder=0)
    axes.set(xlim=(left, right), ylim=(bottom, top), aspect="equal")
    axes.set_xlabel(f"{names[0]} (m)")
    label(axes, names[1], "m")
    legend(axes)
    place = ", ".join(
        f"{number(float(q), 3)} m" if slides else f"{number(math.degrees(q), 3)}°"
        for q, slides in zip(home, robot.links.slides)
    )
    return figure_block(
        "robot",
        figure,
        f"{robot.name} at home ({place}). An arrow leads where a joint moves the end of its link, or else of the "
        f"arm, when its position grows, by {math.degrees(TURN):.0f}° where it turns; a joint without one moves it out "
        "of the picture. A last link is drawn to twice the distance of its centre of mass.",
        "The arm",
    )


@PICTURES.register(Robot)
def _(robot: Robot) -> str:
    picture = robot_picture(robot)
    return "" if picture is None else on_white([picture])


@PICTURES.register(Design)
def _(design: Design) -> str:
    return on_white(PARTS(design.evidence).figures())


def on_white(figures: Iterable[Figure]) -> str:
    """Figures as HTML, on white: a notebook may have other colours."""
    return "".join(
        '<figure style="margin: 0.5em 0; max-width: 36em">'
        f'<img style="width: 100%; background: white" alt="{escape(figure.label)}" '
        f'src="data:image/svg+xml;base64,{b64encode(figure.svg.encode()).decode()}">'
        f"<figcaption>{escape(figure.caption)}</figcaption></figure>"
        for figure in figures
    )


#: Decibels below the largest value that a Bode diagram shows.
DEPTH_DB = 120.0


@BODE.register(FrequencyResponse)
@house_style()
def bode_figure(response: FrequencyResponse) -> NotebookFigure:
    """Magnitude and phase of L_i, opened at one input with the others closed, over the frequency in Hz.

    A dot on the magnitude is where the gain may rise to 1 at the edge of stability: its distance from 0 dB is the gain
    margin upwards.
    """
    figure = NotebookFigure(figsize=(7.0, 4.6), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
    linear = response.linear
    below_end = response.frequencies <= 0.97 * np.pi / linear.period  # at its end the phase jumps
    hertz = response.frequencies[below_end] / (2.0 * np.pi)
    factors = Margins(linear).gain_margins[:, 1]
    for i, name in enumerate(linear.inputs):
        opened, colour = response.input_loops[below_end, i], SERIES[i % len(SERIES)]
        decibel = 20.0 * np.log10(np.maximum(np.abs(opened), 1e-300))
        phase = np.degrees(np.unwrap(np.angle(opened)))
        phase -= 360.0 * np.ceil(phase[0] / 360.0)  # begins in (−360°, 0°]
        above.plot(hertz, decibel, color=colour, label=name.replace("_", " "))
        below.plot(hertz, phase, color=colour)
        if np.isfinite(factors[i]):
            critical = np.argmin(np.abs(opened + 1.0 / factors[i]))
            text = f"gain margin × {factors[i]:.3g}" if len(linear.inputs) == 1 else None
            above.plot(hertz[critical], decibel[critical], "o", color=colour, markersize=5.0, label=text)
    above.axhline(0.0, color=MUTED, linewidth=0.8, linestyle=":")
    below.axhline(-180.0, color=MUTED, linewidth=0.8, linestyle=":")
    above.set_xscale("log")
    low, high = above.get_ylim()
    above.set_ylim(bottom=max(low, high - DEPTH_DB))
    label(above, "open loop", "dB")
    label(below, "phase", "°")
    below.set_xlabel("frequency (Hz)")
    figure.align_ylabels([above, below])
    legend(above)
    return figure
