"""How lines of several joints are drawn: one colour per joint, few points, limits that hide no other line."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from flexhinf.report import INK, MUTED, SERIES, house_style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["framed", "joint_lines", "joint_style", "limit_lines", "side_by_side", "thin", "zero_line"]

#: More points than this per line say nothing more on a page.
POINTS = 1500

#: A limit is drawn where values come to this share of it.
NEAR = 0.25


def joint_style(joint: int) -> dict[str, Any]:
    """One colour per joint, dashed when the colours start again."""
    dashed = {"dashes": (4.0, 2.0)} if joint >= len(SERIES) else {}
    return {"color": SERIES[joint % len(SERIES)], "linewidth": 1.5, **dashed}


def thin(time: np.ndarray) -> slice:
    """Every k-th sample, so that `POINTS` are left."""
    return slice(None, None, max(1, len(time) // POINTS))


def framed(values: np.ndarray) -> tuple[float, float]:
    """Limits of an axis: all of what is finite, with a margin."""
    finite = values[np.isfinite(values)]
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (-1.0, 1.0)
    margin = 0.06 * max(high - low, 1e-12)
    return low - margin, high + margin


def joint_lines(
    axes: Axes, time: np.ndarray, values: np.ndarray, joints: Sequence[str], **style: Any
) -> None:
    """Signals (N, n) of all joints over time (N,), thinned."""
    few = thin(time)
    with house_style():
        for joint, name in enumerate(joints):
            axes.plot(time[few], values[few, joint], label=name, **{**joint_style(joint), **style})


def zero_line(axes: Axes) -> None:
    """Where nothing is left to do, dotted."""
    with house_style():
        axes.axhline(0.0, color=MUTED, linewidth=1.0, linestyle=(0, (1.0, 1.6)), zorder=0.5)


def limit_lines(axes: Axes, limit: float | None, values: np.ndarray, name: str) -> bool:
    """± a limit, dashed, on the sides where the values come near it; whether it was drawn.

    A limit far away would leave the values flat: a caption then says so.
    """
    low, high = framed(values)
    if limit is None:
        return False
    reach = {limit: high, -limit: -low}
    sides = [side for side, size in reach.items() if size > NEAR * limit]
    with house_style():
        for k, side in enumerate(sides):
            axes.axhline(side, color=INK, linewidth=1.0, dashes=(6.0, 3.0), label=None if k else name)
    axes.set_ylim(*framed(np.array([low, high, *sides])))
    return bool(sides)


def side_by_side(count: int, height: float = 2.6) -> tuple[Figure, list[Axes]]:
    """Panels beside each other, each with an axis of its own."""
    from matplotlib.figure import Figure

    with house_style():
        figure = Figure(figsize=(7.2, height), layout="constrained")
        return figure, list(figure.subplots(1, count, squeeze=False)[0])
