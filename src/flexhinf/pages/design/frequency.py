"""Frequency responses of the running loop: Bode, sensitivity, Nyquist; a line a joint, or a line a law."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from flexhinf.analysis import FrequencyResponse
from flexhinf.pages.drawing import (
    DASHED,
    figure_block,
    frequency_axis,
    line_style,
    panels,
    reference_line,
)
from flexhinf.report import INK, MUTED, Figure, house_style, label, legend

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: Decibels below the largest value that are shown.
SHOWN_DB = 90.0

#: Fraction of half the sampling frequency that a Bode diagram shows: the phase jumps at its end.
SHOWN_BAND = 0.97

#: How far a Nyquist diagram reaches to the left: the neighbourhood of −1 is what matters.
NYQUIST = 3.0

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
    return [
        bode_figure(loops, joints, load, position),
        sensitivity_figure(loops),
        nyquist_figure(loops, joints),
    ]


def bode_figure(loops: Sequence[Loop], joints: Sequence[str], load: str, position: str) -> Figure:
    """Command → link position (magnitude and phase), and torque on the link → link position."""
    figure, ((command, phase, torque),) = _stacked(3, 8.4)
    for name, style, response, joint in _lines(loops, joints):
        below = response.frequencies <= SHOWN_BAND * np.pi / response.period
        hertz = response.frequencies[below] / (2.0 * np.pi)
        followed, moved = response.command[below, joint, joint], _moved(response, joint)[below]
        with house_style():
            command.plot(hertz, _decibel(followed), label=name, **style)
            phase.plot(hertz, _degrees(followed), **style)
            torque.plot(hertz, _decibel(moved), **style)
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
        "bode",
        figure,
        f"{RUNNING} Magnitude and phase from the commanded to the true link position (dotted: 0 dB, and −3 dB, where "
        f"the bandwidth is read), and magnitude from a torque on the link to its position.{which}",
        "Bode diagram",
    )


def sensitivity_figure(loops: Sequence[Loop]) -> Figure:
    """Largest singular values of S and T, the loop broken at the inputs."""
    figure, ((axis,),) = _stacked(1, 3.6)
    for loop in loops:
        style, response = line_style(loop.style), loop.response
        hertz = response.frequencies / (2.0 * np.pi)
        name = "sensitivity S" if len(loops) == 1 else loop.name
        with house_style():
            axis.plot(hertz, _decibel(_largest(response.sensitivity)), label=name, **style)
            if len(loops) == 1:
                other = line_style(1)
                axis.plot(
                    hertz, _decibel(_largest(response.complementary)),
                    label="complementary sensitivity T", **other,
                )  # fmt: skip
    reference_line(axis)
    _bounded(axis)
    label(axis, f"largest singular value{'' if len(loops) == 1 else ' of S'}", "dB")
    legend(axis)
    what = (
        "S: how much the loop amplifies a disturbance at the motors (above 0 dB: more than without control)"
    )
    second = "; T: how much an error of the model is amplified" if len(loops) == 1 else ""
    return figure_block(
        "sensitivity", figure, f"{RUNNING} {what}{second}. Dotted: 0 dB.", "Sensitivity"
    )  # fmt: skip


def nyquist_figure(loops: Sequence[Loop], joints: Sequence[str]) -> Figure:
    """The open loop at each input, the others closed, with the circle about −1 that it does not enter."""
    from matplotlib.patches import Circle

    figure, ((axis,),) = panels(1, 1, 4.6)
    radius = np.inf
    for place, (name, style, response, joint) in enumerate(_lines(loops, joints)):
        opened = response.input_loops[:, joint]
        distance = float(np.nanmin(np.abs(1.0 + opened)))
        radius = min(radius, distance) if len(loops) == 1 else np.inf
        with house_style():
            axis.plot(np.real(opened), np.imag(opened), label=name, zorder=3.0 - 0.01 * place, **style)
    with house_style():
        turn = np.linspace(0.0, 2.0 * np.pi, 200)
        axis.plot(np.cos(turn), np.sin(turn), color=MUTED, linewidth=0.8, label="unit circle")
        axis.plot([-1.0], [0.0], "+", color=INK, markersize=9.0, label="−1")
        if np.isfinite(radius):
            circle = Circle((-1.0, 0.0), radius, fill=False, color=INK, linewidth=1.0, linestyle=(0, DASHED))
            axis.add_patch(circle)
        axis.set_xlim(-NYQUIST, 0.6 * NYQUIST)
        axis.set_ylim(-0.5 * NYQUIST, 0.5 * NYQUIST)
        axis.set_aspect("equal")
        axis.set_xlabel("real part")
    label(axis, "imaginary part", "")
    legend(axis)
    closest = (
        f" The dashed circle about −1 has the smallest distance, {radius:.2f}." if np.isfinite(radius) else ""
    )
    others = " The loops at the other inputs are closed." if len(joints) > 1 else ""
    return figure_block(
        "nyquist",
        figure,
        f"{RUNNING} The loop opened at one input, positive frequencies, negative feedback.{others}{closest} "
        "Curves that leave the frame go on.",
        "Nyquist diagram",
    )


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


def _stacked(rows: int, height: float) -> tuple[Any, list[list[Axes]]]:
    """Panels one above the other over one logarithmic axis of frequency, as one row."""
    figure, grid = panels(rows, 1, height, sharex=True)
    axes = [row[0] for row in grid]
    with house_style():
        axes[-1].set_xlabel("frequency (Hz)")
        figure.align_ylabels(axes)
    frequency_axis(axes[-1])
    return figure, [axes]


def _decibel(values: np.ndarray) -> np.ndarray:
    return 20.0 * np.log10(np.maximum(np.abs(values), 1e-300))


def _degrees(values: np.ndarray) -> np.ndarray:
    return np.degrees(np.unwrap(np.angle(values)))


def _largest(values: np.ndarray) -> np.ndarray:
    """σ_max at each frequency of (F, m, m)."""
    return np.linalg.norm(values, ord=2, axis=(1, 2))


def _bounded(axis: Axes) -> None:
    """No more than `SHOWN_DB` below the largest value: what is smaller says nothing."""
    low, high = axis.get_ylim()
    axis.set_ylim(max(low, high - SHOWN_DB), high)
