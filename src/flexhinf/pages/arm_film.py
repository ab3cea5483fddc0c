"""An arm that moves in a page: the lines that its drawing plays."""

# Not checked strictly: parts of Matplotlib have no types.
# pyright: reportUnknownMemberType=false

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from flexhinf.report import Film
from flexhinf.robot import Robot
from flexhinf.robot.kinematics import skeleton

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: Instants of a film, the part of them that follows the way and not the clock, and the part of the way after which it
#: ends: an arm rests for most of a long run.
INSTANTS, BY_WAY, SEEN = 80, 0.6, 0.995


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
        drawn = [skeleton(robot, positions[k]) for k in at]
        for link in range(len(drawn[0])):
            points = np.array([lines_of[link] @ view for lines_of in drawn])
            flat = axes.transData.transform(points.reshape(-1, 2)).reshape(points.shape)
            lines.append((series, np.stack([flat[..., 0], high - flat[..., 1]], axis=-1)))
    return Film(time[at], tuple(lines))


def instants_of(time: np.ndarray, positions: np.ndarray) -> np.ndarray:
    """Samples of a film (k,), increasing, of joint positions (N, n) at some times (N,), s: close where much moves."""
    way = np.append(0.0, np.cumsum(np.abs(np.diff(positions, axis=0)).sum(axis=1)))
    if len(time) < 2 or not way[-1] > 0.0:
        return np.arange(min(1, len(time)))
    last = max(1, int(np.searchsorted(way, SEEN * way[-1])))
    clock = (time[: last + 1] - time[0]) / (time[last] - time[0])
    mixed = BY_WAY * way[: last + 1] / way[last] + (1.0 - BY_WAY) * clock
    return np.unique(np.searchsorted(mixed, np.linspace(0.0, 1.0, INSTANTS)).clip(max=last))
