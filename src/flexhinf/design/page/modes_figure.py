"""Modes drawn: damping over frequency."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from flexhinf.design.modes import Mode
from flexhinf.design.result import Design
from flexhinf.report import MUTED, SERIES, Figure, figure_to_svg, house_style, label, legend, new_figure

__all__ = ["modes_figure"]


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
