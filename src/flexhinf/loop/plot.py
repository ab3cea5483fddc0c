"""A plain plot of one run; the reports have their own style."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from flexhinf.loop.trajectory import Trajectory

__all__ = ["plot_trajectory"]


def plot_trajectory(run: Trajectory) -> Figure:
    """Tracked states with command and estimate above, inputs below."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.0, 5.0), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    for k, name in enumerate(run.names.get("reference", ())):
        colour, label = f"C{k}", name.replace("_", " ")
        angle = (
            dict(zip(run.names.get("state", ()), run.units.get("state", ()), strict=True)).get(name) == "rad"
        )
        scale = 180.0 / np.pi if angle else 1.0
        above.plot(run.time, scale * run.tracked(name), colour, label=label)
        if name in run.names["estimate"]:
            above.plot(
                run.time,
                scale * run.signal("estimate", name),
                colour,
                ls="--",
                lw=1.0,
                label=f"{label}, estimated",
            )
        above.plot(
            run.time,
            scale * run.signal("reference", name),
            color="0.4",
            lw=0.9,
            ls=":",
            label=f"{label}, command",
        )
        above.set_ylabel("position in degrees" if angle else "position")
    for k, name in enumerate(run.names["input"]):
        unit = run.units["input"][k]
        label = name.replace("_", " ")
        below.plot(
            run.time, run.signals["input"][:, k], f"C{k}", label=f"{label} in {unit}" if unit else label
        )
    above.legend(frameon=False)
    below.legend(frameon=False)
    below.set_xlabel("time in s")
    for axes in (above, below):
        axes.grid(alpha=0.3)
    return figure
