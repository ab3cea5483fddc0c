"""The arm at a few instants of the step: links, and the motors as they stand behind the springs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from flexhinf.design.evaluation import LawEvaluation
from flexhinf.pages.drawing import figure_block, panels
from flexhinf.report import INK, MUTED, SERIES, WIDTH, Figure, house_style, label, number
from flexhinf.robot import Robot
from flexhinf.robot.kinematics import skeleton

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: Parts of the way at which the arm is drawn.
PARTS = (0.0, 0.25, 0.5, 0.75, 1.0)

#: Height of the figure, in inches, that legend, titles and names of the axes take.
AROUND = 1.25

#: Width, in inches, that the numbers beside the first panel take.
LEFT = 0.8

#: Points closer together than this part of the robot's size lie in one plane.
FLAT = 0.02


def arm_of(e: LawEvaluation) -> Figure | None:
    """The arm during the step; None for a run that diverges or links without a length."""
    response, n = e.step, len(e.setup.goal)
    if response.diverged_at is not None:
        return None
    motors = e.setup.robot.layout.whole(response.run.signals["state"].T)[2 * n : 3 * n].T
    at = instants(response.positions, response.start, response.goal)
    return arm_figure(e.setup.robot, response.run.time, response.positions, motors, at)


def instants(positions: np.ndarray, start: np.ndarray, goal: np.ndarray) -> list[int]:
    """Samples at which a run (N, n) first has done these `PARTS` of its way, the last one at the end of the run.

    Parameters
    ----------
    positions : (N, n)
        Link positions.
    start, goal : (n,)
    """
    way = goal - start
    length = float(way @ way)
    if not length:
        return [0]
    done = (positions - start) @ way / length
    found = [int(np.argmax(done >= part)) if np.any(done >= part) else len(done) - 1 for part in PARTS[:-1]]
    return sorted({*found, len(done) - 1})


def arm_figure(
    robot: Robot, time: np.ndarray, links: np.ndarray, motors: np.ndarray, at: Sequence[int]
) -> Figure | None:
    """Links and motors of a run at some samples; None for a robot whose links have no length.

    Parameters
    ----------
    time : (N,)
        s.
    links, motors : (N, n)
        Positions, the motors' seen from the link side.
    """
    poses = [(skeleton(robot, links[k]), skeleton(robot, motors[k])) for k in at]
    points = np.concatenate([line for pair in poses for lines in pair for line in lines])
    size = float(np.ptp(points, axis=0).max())
    if size < 1e-9:
        return None
    right, up, names = viewing_plane(np.asarray(robot.links.down, dtype=float), points, size)
    flat = points @ np.column_stack([right, up])
    low, high = flat.min(axis=0) - 0.08 * size, flat.max(axis=0) + 0.08 * size
    tall = float((high - low)[1] / (high - low)[0])  # of each panel, over its width
    height = AROUND + min(max(tall, 0.3), 2.0) * (WIDTH - LEFT) / len(at)
    figure, (axes,) = panels(1, len(at), height, sharex=True, sharey=True)
    for k, (axis, (own, held)) in enumerate(zip(axes, poses, strict=True)):
        _drawn(axis, own, held, right, up, first=k == 0)
        axis.set_title(f"{number(float(time[at[k]]), 3)} s")
        axis.set_xlabel(f"{names[0]} (m)")
    with house_style():
        for axis in axes:
            axis.set_xlim(low[0], high[0])
            axis.set_ylim(low[1], high[1])
            axis.set_aspect("equal")
        figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper left", ncols=3, frameon=False)
    label(axes[0], names[1], "m")
    return figure_block(
        "arm",
        figure,
        "The arm at five instants of the step. The angle between a link and its motor is the twist of the spring; "
        "motors are seen from the link side of their gears. A last link is drawn to twice the distance of its centre "
        "of mass.",
        "The arm during the step",
    )


def _drawn(
    axis: Axes,
    own: Sequence[np.ndarray],
    held: Sequence[np.ndarray],
    right: np.ndarray,
    up: np.ndarray,
    first: bool,
) -> None:
    """One pose: motors dashed behind the links, joints as dots."""
    with house_style():
        for j, line in enumerate(held):
            axis.plot(
                line @ right, line @ up, color=SERIES[1], linewidth=1.3, dashes=(4.0, 2.0),
                label="motors (springs without twist)" if first and j == 0 else None,
            )  # fmt: skip
        for j, line in enumerate(own):
            axis.plot(
                line @ right, line @ up, color=SERIES[0], linewidth=2.6, alpha=0.85,
                label="links" if first and j == 0 else None,
            )  # fmt: skip
        joints = np.array([line[0] for line in own])
        axis.plot(
            joints @ right, joints @ up, "o", color=INK, markersize=3.5, label="joints" if first else None
        )
        axis.axhline(float(own[0][0] @ up), color=MUTED, linewidth=0.6, zorder=0.5)


def viewing_plane(
    down: np.ndarray, points: np.ndarray, size: float
) -> tuple[np.ndarray, np.ndarray, tuple[str, str]]:
    """Two directions to look along, and their names: upright where the robot leaves the horizontal, else from above."""
    up = -down / np.linalg.norm(down)
    centred = points - points.mean(axis=0)
    level = centred - np.outer(centred @ up, up)
    spread = np.linalg.svd(level, full_matrices=True)[2]
    across = [row for row in spread if abs(row @ up) < 0.5]
    right = across[0] * (1.0 if across[0].sum() >= 0.0 else -1.0)
    if np.ptp(centred @ up) > FLAT * size:
        return right, up, ("horizontal", "height")
    ahead = np.cross(up, right)
    return right, ahead, ("horizontal", "seen from above")
