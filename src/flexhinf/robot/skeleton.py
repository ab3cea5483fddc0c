"""Where the links of a robot are, as straight lines: for drawings."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from flexhinf.robot.dynamics.motion import frames_of
from flexhinf.robot.robot import Robot

__all__ = ["skeleton"]


def skeleton(robot: Robot, positions: Sequence[float] | np.ndarray) -> tuple[np.ndarray, ...]:
    """The links at some joint positions, one line for each link.

    A link is drawn from its own joint through the joints that it carries. One that carries none ends at twice the
    distance of its centre of mass, where a uniform rod would end: a robot file states no shapes.

    Parameters
    ----------
    robot : Robot
    positions : (n,)
        rad or m.

    Returns
    -------
    tuple of (2 or more, 3) arrays
        Points of each link in the world's frame, m, in the order of the joints; the joint's own place is the first.
    """
    table = robot.plant().parameters
    tree, _, centres, _ = robot.links.rigid(table.named(table.vector()))
    n = len(tree)
    turns, places = [np.eye(3)] * n, [np.zeros(3)] * n
    for i, frame in enumerate(frames_of(tree, np.asarray(positions, dtype=float))):
        parent = tree.parents[i]
        base = np.eye(3) if parent < 0 else turns[parent]
        at = np.zeros(3) if parent < 0 else places[parent]
        turns[i] = base @ np.asarray(frame.rotation, dtype=float)
        places[i] = at + base @ np.asarray(frame.translation, dtype=float)
    lines = []
    for i in range(n):
        carried = [places[k] for k in range(n) if tree.parents[k] == i]
        own = turns[i] @ np.asarray(tree.joints[i].alignment).T
        end = places[i] + 2.0 * own @ np.asarray(centres[i], dtype=float)
        lines.append(np.array([places[i], *(carried or [end])]))
    return tuple(lines)
