"""What the figures of a design have in common: lines of several joints, limits that hide no line, few points."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from flexhinf.report import INK, MUTED, SERIES, WIDTH, Figure, figure_to_svg, house_style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Canvas

#: Points of a line in a figure, at most: more cannot be told apart at the width of a page.
POINTS = 1500

#: A limit is drawn where the values reach this fraction of it; a caption names one that is further away.
NEAR = 0.25

DOTTED = (0, (1.0, 1.6))
DASHED = (6.0, 3.0)


def line_style(place: int) -> dict[str, Any]:
    """Colour of one joint or law among several; lines are dashed once the colours are used up."""
    dashed = {"dashes": (4.0, 2.0)} if place >= len(SERIES) else {}
    return {"color": SERIES[place % len(SERIES)], "linewidth": 1.5, **dashed}


def thin(time: np.ndarray, points: int = POINTS) -> slice:
    """Every k-th sample of a time axis, so that at most about `points` are left."""
    return slice(None, None, max(1, -(-len(time) // points)))


def framed(values: np.ndarray, margin: float = 0.06) -> tuple[float, float]:
    """Limits of an axis that shows every finite value, with a margin relative to their range."""
    finite = values[np.isfinite(values)]
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (-1.0, 1.0)
    room = margin * max(high - low, 1e-12)
    return low - room, high + room


def widened(low: float, high: float, least: float) -> tuple[float, float]:
    """An interval about the same middle that is at least `least` wide."""
    middle, half = 0.5 * (low + high), 0.5 * max(high - low, least)
    return middle - half, middle + half


def joint_lines(
    axes: Axes, time: np.ndarray, values: np.ndarray, joints: Sequence[str], **style: Any
) -> None:
    """Signals (N, n) of all joints over time (N,), with fewer points."""
    few = thin(time)
    with house_style():
        for joint, name in enumerate(joints):
            axes.plot(time[few], values[few, joint], label=name, **{**line_style(joint), **style})


def plan_lines(axes: Axes, time: np.ndarray, values: np.ndarray, name: str) -> None:
    """Planned signals (N, n) over time (N,), dotted."""
    few = thin(time)
    with house_style():
        for joint, column in enumerate(values[few].T):
            style: dict[str, Any] = {"color": MUTED, "linewidth": 1.2, "linestyle": DOTTED}
            axes.plot(time[few], column, label=None if joint else name, **style)


def reference_line(axes: Axes, value: float = 0.0) -> None:
    """A dotted horizontal line behind the others."""
    with house_style():
        axes.axhline(value, color=MUTED, linewidth=1.0, linestyle=DOTTED, zorder=0.5)


def vertical_line(axes: Axes, value: float, name: str | None = None) -> None:
    """A dotted vertical line behind the others."""
    with house_style():
        axes.axvline(value, color=MUTED, linewidth=1.0, linestyle=DOTTED, zorder=0.5, label=name)


def limit_lines(axes: Axes, limits: np.ndarray | None, values: np.ndarray, name: str) -> bool:
    """± limits (n,) of signals (N, n), dashed, on the sides where a signal comes near its own; returns whether any was
    drawn. Limits that differ have the colours of their joints.

    A limit that is far away would leave the values flat.
    """
    low, high = framed(values)
    if limits is None:
        return False
    same, sides = len(set(limits.tolist())) == 1, {}
    for joint in np.flatnonzero(np.isfinite(limits)).tolist():
        limit, (least, most) = float(limits[joint]), framed(values[:, joint])
        for side, size in ((limit, most), (-limit, -least)):
            if size > NEAR * limit:
                sides.setdefault(side, INK if same else line_style(joint)["color"])
    with house_style():
        for k, (side, color) in enumerate(sides.items()):
            axes.axhline(side, color=color, linewidth=1.0, dashes=DASHED, label=None if k else name)
    axes.set_ylim(*framed(np.array([low, high, *sides])))
    return bool(sides)


def frequency_axis(axes: Axes) -> None:
    """A logarithmic horizontal axis: powers of ten as plain numbers, marks at 2 and 5.

    Matplotlib's own labels start its reader of formulas, a quarter of a second; every mark takes a millisecond.
    """
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    with house_style():
        axes.set_xscale("log")
        axes.xaxis.set_major_locator(LogLocator(subs=(1.0,), numticks=12))
        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axes.xaxis.set_minor_locator(LogLocator(subs=(2.0, 5.0), numticks=12))
        axes.xaxis.set_minor_formatter(NullFormatter())


def panels(
    rows: int, columns: int, height: float, width: float = WIDTH, **options: Any
) -> tuple[Canvas, list[list[Axes]]]:
    """A grid of panels, each with an axis of its own unless the options of Matplotlib's ``subplots`` say otherwise."""
    from matplotlib.figure import Figure as Canvas

    with house_style():
        figure = Canvas(figsize=(width, height), layout="constrained")
        return figure, [list(row) for row in figure.subplots(rows, columns, squeeze=False, **options)]


def figure_block(name: str, figure: Canvas, sentences: str | Iterable[str], title: str) -> Figure:
    """The figure as a block of a page: anchor ``figure-<name>``, caption in sentences, title before it."""
    caption = sentences if isinstance(sentences, str) else " ".join(text for text in sentences if text)
    return Figure(f"figure-{name}", figure_to_svg(figure), caption, title)
