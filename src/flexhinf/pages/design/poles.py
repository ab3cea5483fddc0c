"""Poles at the goal: of the robot without control, of the loop, and of the estimation error."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from flexhinf.design.problem.modes import Mode
from flexhinf.design.result import Design
from flexhinf.design.specification import RINGS
from flexhinf.loop.simulation.metrics import damping_ratio
from flexhinf.pages.drawing import (
    figure_block,
    frequency_axis,
    panels,
    range_text,
    reference_line,
    vertical_line,
)
from flexhinf.report import MUTED, SERIES, Column, Figure, Paragraph, Table, house_style, label

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: An estimation error at a vibration with less damping than this is hardly corrected by the sensors.
HARDLY_SEEN = 0.01

#: Damping ratios whose lines are drawn in the s-plane.
RAYS = (0.1, 0.3, 0.7)

#: The s-plane reaches so many times as far as the fastest oscillation of robot and law; faster poles are on the right.
ROOM = 1.8

#: Below this frequency, Hz, a pole is at zero and has no place on a logarithmic axis.
SLOWEST = 1e-3


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


def poles_figure(groups: Sequence[PoleGroup]) -> Figure:
    """The s-plane near the imaginary axis, and damping over frequency for all poles."""
    figure, ((plane, damping),) = panels(1, 2, 3.6)
    shown = [group for group in groups if len(group.poles)]
    _plane(plane, shown)
    _damping(damping, shown)
    with house_style():
        figure.legend(
            *damping.get_legend_handles_labels(),
            loc="outside upper left",
            ncols=2,
            frameon=False,
        )
    return figure_block(
        "poles",
        figure,
        "Left: poles λ in the s-plane, upper half, near the imaginary axis (faster ones on the right only); dotted "
        f"rays have damping ratio {', '.join(f'{ray:g}' for ray in RAYS)}. Right: damping ratio −Re λ/|λ| over "
        "frequency of all poles; 1 decays without oscillating, below zero (shaded) grows. Poles at zero are left out "
        "on the right.",
        "Poles",
    )


def blocks(design: Design) -> list[Any]:
    """Figure, and a table of what oscillates or does not decay."""
    return [poles_figure(_groups(design)), _table(design), Paragraph(_decays(design))]


def remarks(design: Design) -> Iterator[str]:
    """A vibration that rings, in the loop or in the estimation error."""
    after = vibration_damping(design.law_modes)
    if after and min(after) < RINGS:
        yield (
            f"A vibration has a damping ratio of {min(after):.2g} with this law: its weights hardly act on it. "
            "`--damping 0.3` searches for weights that do."
        )
    error = [mode for mode in design.evaluation.estimator_modes if mode.vibration]
    unseen = [mode for mode in error if mode.damping < HARDLY_SEEN]
    target = design.design_problem.target
    required = 0.0 if target is None else target.damping
    if unseen:
        worst = min(unseen, key=lambda mode: mode.damping)
        yield (
            f"The estimator's error at {worst.frequency:.3g} Hz{_of(design, worst)} has a damping ratio of "
            f"{worst.damping:.1g} only, and noise keeps it ringing, in the robot too. Measure link positions or joint "
            "torques, or raise --process-noise."
        )
    elif error and min(mode.damping for mode in error) < required:
        worst = min(error, key=lambda mode: mode.damping)
        yield (
            f"The estimator's error at {worst.frequency:.3g} Hz{_of(design, worst)} has a damping ratio of "
            f"{worst.damping:.2g}, less than required of the law. After a disturbance that the model does not know the "
            "loop rings with it. Try a larger --torque-noise, or another sensor (--measured)."
        )


def _of(design: Design, mode: Mode) -> str:
    """The joint that moves most, where there are several."""
    return f" ({mode.joint})" if len(design.robot.joint_names) > 1 else ""


def vibration_damping(modes: Sequence[Mode]) -> list[float]:
    """Damping ratios of the vibrations among some modes."""
    return [mode.damping for mode in modes if mode.vibration]


def mode_groups(design: Design) -> list[tuple[str, Sequence[Mode]]]:
    """Named modes: without control, with the law on the true state, and of the estimation error where there is one."""
    error = design.evaluation.estimator_modes
    return [
        ("without control", design.evaluation.open_modes),
        ("law on the true state", design.law_modes),
        *([("estimation error", error)] if error else []),
    ]


def _groups(design: Design) -> list[PoleGroup]:
    """For the figure: the named modes, the running loop, and the rigid law."""
    looks = ((MUTED, "o", True), (SERIES[0], "o", False), (SERIES[2], "^", False))
    groups = [
        PoleGroup(name, _eigenvalues(modes), marker, colour, hollow)
        for (name, modes), (colour, marker, hollow) in zip(mode_groups(design), looks)
    ]
    if design.specification.estimator != "none":
        poles = design.evaluation.frequency_response.poles
        groups.append(PoleGroup("running loop (sampled, estimator, delay)", poles, "x", SERIES[1]))
    for loop, marker in zip(design.rigid.loops if design.rigid else (), ("1", "2")):
        groups.append(PoleGroup(f"rigid law, {loop.side} side", _eigenvalues(loop.modes), marker, SERIES[3]))
    return groups


def _eigenvalues(modes: Sequence[Mode]) -> np.ndarray:
    return np.array([mode.eigenvalue for mode in modes], dtype=complex)


def _table(design: Design) -> Table:
    several = len(design.robot.joint_names) > 1
    rows = [
        (
            name,
            mode.name,
            *([mode.joint] if several else []),
            mode.frequency,
            mode.damping,
            mode.time_constant,
        )
        for name, modes in mode_groups(design)
        for mode in modes
        if _listed(mode)
    ]
    names = ("loop", "mode", *(["mainly"] if several else []))
    columns = (*names, Column("frequency", "Hz", 3), Column("damping ratio"), Column("time constant", "s"))
    caption = "Modes that oscillate or do not decay, linearised at the goal, continuous time"
    return Table(columns, rows, caption, "table-modes")


def _listed(mode: Mode) -> bool:
    """Whether a mode has a row of its own; those that decay without oscillating are summed up in a sentence."""
    return bool(mode.eigenvalue.imag) or not mode.stable


def _decays(design: Design) -> str:
    words = []
    for name, modes in mode_groups(design)[:2]:
        times = [1.0 / -mode.eigenvalue.real for mode in modes if not _listed(mode)]
        ending = "s" if len(times) > 1 else ""
        constants = f", time constant{ending} {range_text(times)} s" if times else ""
        many = f"{len(times)} modes decay" if len(times) != 1 else "1 mode decays"
        words.append(f"{name.capitalize()}: {many} without oscillating{constants}.")
    return " ".join(words) + " The law adds one mode for the integral of each joint's error."


def _plane(axis: Axes, groups: Sequence[PoleGroup]) -> None:
    """Upper half of the s-plane."""
    poles = np.concatenate([group.poles for group in groups[:2]])  # without control, and with the law
    oscillating = np.abs(poles[np.abs(np.imag(poles)) > 0.0])
    size = ROOM * float(oscillating.max() if len(oscillating) else np.abs(poles).max(initial=1.0))
    with house_style():
        for ray in RAYS:
            turn = np.array([0.0, 2.0 * size])
            axis.plot(
                -ray * turn,
                np.sqrt(1.0 - ray**2) * turn,
                color=MUTED,
                linewidth=0.8,
                linestyle=(0, (1.0, 1.6)),
                zorder=0.5,
            )
        for group in groups:
            upper = group.poles[np.imag(group.poles) >= 0.0]
            axis.plot(np.real(upper), np.imag(upper), **group.style)
        right = min(size, float(np.real(poles).max(initial=0.0)))
        axis.set_xlim(-size, max(0.12 * size, 1.15 * right))
        axis.set_ylim(-0.03 * size, size)
        axis.set_xlabel("Re λ (1/s)")
    vertical_line(axis, 0.0)
    label(axis, "Im λ", "rad/s")


def _damping(axis: Axes, groups: Sequence[PoleGroup]) -> None:
    """Damping ratio over frequency."""
    low = -0.05
    with house_style():
        for group in groups:
            upper = group.poles[np.imag(group.poles) >= 0.0]
            frequency = np.abs(upper) / (2.0 * np.pi)
            seen = upper[frequency > SLOWEST]
            ratio = damping_ratio(seen)
            low = min([low, *(value - 0.05 for value in ratio.tolist() if value > -1.0 + 1e-9)])
            axis.plot(np.abs(seen) / (2.0 * np.pi), ratio, label=group.name, **group.style)
        frequency_axis(axis)
        axis.margins(x=0.06)
        axis.set_ylim(max(low, -1.05), 1.08)
        axis.axhspan(-2.0, 0.0, color=SERIES[1], alpha=0.08, linewidth=0)
        axis.set_xlabel("frequency |λ|/2π (Hz)")
    reference_line(axis)
    label(axis, "damping ratio", "")
