"""Arms that move in a page: the lines that a drawing plays, and two arms in one run."""

# Not checked strictly: parts of Matplotlib have no types.
# pyright: reportUnknownMemberType=false

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from flexhinf.pages.design.step import arm_plane
from flexhinf.pages.drawing import figure_block, legend_above
from flexhinf.report import INK, SERIES, Figure, Film, LineStyle, house_style, label, panels
from flexhinf.robot import Robot
from flexhinf.robot.kinematics import skeleton

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: Instants of a film; the part of them that follows the way and not the clock; the largest distance from the end, in
#: parts of the largest of all, after the film: an arm rests for most of a long run, but for noise.
INSTANTS, BY_WAY, UNSEEN = 80, 0.6, 0.01


def film_of(
    axes: Axes, robot: Robot, time: np.ndarray, arms: Sequence[tuple[int, np.ndarray]], view: np.ndarray
) -> Film:
    """The film of some arms over a drawing that has been laid out.

    Parameters
    ----------
    axes : Axes
        Of the drawing, after `figure_block` has drawn it.
    robot : Robot
    time : (N,) array
        Instants of the run, s.
    arms : sequence of pairs
        Number of the series whose colour an arm has, and its joint positions (N, n), rad or m. The first one is in
        front.
    view : (3, 2) array
        Axes of the picture, to the right and up.
    """
    at = instants_of(time, np.hstack([positions for _, positions in arms]))
    high = float(axes.get_figure(root=True).bbox.height)  # type: ignore[union-attr]
    lines: list[tuple[int, np.ndarray]] = []
    for series, positions in reversed(arms):
        poses = [skeleton(robot, positions[k]) for k in at]
        for link in range(len(poses[0])):
            points = np.array([pose[link] @ view for pose in poses])
            flat = axes.transData.transform(points.reshape(-1, 2)).reshape(points.shape)
            lines.append((series, np.stack([flat[..., 0], high - flat[..., 1]], axis=-1)))
    return Film(time[at], tuple(lines))


def instants_of(time: np.ndarray, positions: np.ndarray) -> np.ndarray:
    """Samples of a film (k,), increasing, of joint positions (N, n) at some times (N,), s: close where much moves."""
    way = np.append(0.0, np.cumsum(np.abs(np.diff(positions, axis=0)).sum(axis=1)))
    if len(time) < 2 or not way[-1] > 0.0:
        return np.arange(min(1, len(time)))
    far = np.abs(positions - positions[-1]).max(axis=1)
    last = min(int(np.flatnonzero(far > UNSEEN * far.max()).max(initial=0)) + 1, len(time) - 1)
    clock = (time[: last + 1] - time[0]) / (time[last] - time[0])
    mixed = BY_WAY * way[: last + 1] / way[last] + (1.0 - BY_WAY) * clock
    return np.unique(np.searchsorted(mixed, np.linspace(0.0, 1.0, INSTANTS)).clip(max=last))


#: Lines of the first and of the second arm, as the page plays them; poses that are drawn, as shares of the film.
STYLES: tuple[LineStyle, ...] = (
    {"color": SERIES[0], "linewidth": 3.2},
    {"color": SERIES[1], "linewidth": 1.6, "dashes": (4.0, 2.0)},
)
SHARES = (0.0, 0.35, 0.6, 1.0)


@house_style()
def two_arms(
    name: str, robot: Robot, time: np.ndarray, arms: Sequence[tuple[str, np.ndarray]], says: str, title: str
) -> Figure | None:
    """Two arms of one robot in the same run, at a few instants and as a film; None for links without a length.

    Parameters
    ----------
    name : str
        Of the figure.
    time : (N,) array
        Instants, s.
    arms : sequence of two pairs
        What each is, and its joint positions (N, n), rad or m; a run that ended early stays where it ended.
    says, title : str
        Of the caption.
    """
    at = instants_of(time, np.hstack([positions for _, positions in arms]))
    places = at[[round(share * (len(at) - 1)) for share in SHARES]]
    seen = arm_plane(robot, [skeleton(robot, positions[k]) for k in places for _, positions in arms])
    if seen is None:
        return None
    view, names, (low, high) = seen
    figure, ((axes,),) = panels(1, 1, 4.3)
    for (text, positions), style in reversed(list(zip(arms, STYLES, strict=True))):
        for k, place in enumerate(places):
            for j, line in enumerate(skeleton(robot, positions[place])):
                gid, alpha = f"pose-{text.replace(' ', '-')}-{k}-{j}", 0.15 + 0.85 * k / (len(places) - 1)
                faint: LineStyle = {**style, "alpha": alpha}
                axes.plot(*(line @ view).T, **faint, gid=gid)
        axes.plot([], [], label=text, **style)
    base = skeleton(robot, arms[0][1][0])[0][0] @ view
    axes.plot(*base, "o", color=INK, markersize=4.0)
    axes.set_xlim(low[0], high[0], auto=True)  # at least: the aspect widens one of them
    axes.set_ylim(low[1], high[1], auto=True)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlabel(f"{names[0]} (m)")
    label(axes, names[1], "m")
    legend_above(figure, axes, 2)
    block = figure_block(name, figure, says, title)
    film = film_of(axes, robot, time, [(1, arms[0][1]), (2, arms[1][1])], view)
    return replace(block, film=film)
