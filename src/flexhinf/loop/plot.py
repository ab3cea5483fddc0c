"""A plain plot of one run; the reports have their own style."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from flexhinf.loop.trajectory import Trajectory

__all__ = ["plot_trajectory"]


def plot_trajectory(run: Trajectory) -> Figure:
    """Tracked states (or all) with command and estimate above, inputs below; angles in degrees."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.0, 5.0), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    for k, name in enumerate(run.judged or run.names["estimate"]):
        _plot_state(above, run, name, f"C{k}")
    for k, name in enumerate(run.names["input"]):
        below.plot(run.time, run.signals["input"][:, k], f"C{k}", label=_label(name, run.units["input"][k]))
    below.set_xlabel("time in s")
    for axes in (above, below):
        axes.legend(frameon=False)
        axes.grid(alpha=0.3)
    return figure


def _plot_state(axes: Axes, run: Trajectory, name: str, colour: str) -> None:
    unit = dict(zip(run.names["estimate"], run.units["estimate"]))[name]
    scale, unit = (180.0 / np.pi, "°") if unit == "rad" else (1.0, unit)
    axes.plot(run.time, scale * run.tracked(name), colour, label=_label(name, unit))
    axes.plot(run.time, scale * run.signal("estimate", name), color="0.1", ls="--", lw=0.8, label="estimated")
    if name in run.names["reference"]:
        command = scale * run.signal("reference", name)
        axes.plot(run.time, command, color="0.4", ls=":", lw=0.9, label="command")


def _label(name: str, unit: str) -> str:
    words = name.replace("_", " ")
    return f"{words} in {unit}" if unit else words
