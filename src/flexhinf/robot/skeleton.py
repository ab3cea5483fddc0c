"""Where the links of a robot are, as straight lines: for drawings."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from flexhinf.robot.kinematics import link_frames
from flexhinf.robot.robot import Robot


def skeleton(robot: Robot, positions: Sequence[float] | np.ndarray) -> tuple[np.ndarray, ...]:
    """The links at some joint positions, one line for each link.

    A link is drawn from its own joint through the joints that it carries. One that carries none ends at twice the
    distance of its centre of mass, where a uniform rod would end: a robot file states no shapes.

    Parameters
    ----------
    positions : (n,)
        rad or m.

    Returns
    -------
    tuple of (2 or more, 3) arrays
        Points of each link in the world's frame, m, in the order of the joints; the joint's own place is the first.
    """
    table = robot.plant().parameters
    tree, _, centres, _ = robot.links.rigid(table.named(table.vector()))
    turns, places = link_frames(robot, positions)
    n = len(tree)
    lines = []
    for i in range(n):
        carried = [places[k] for k in range(n) if tree.parents[k] == i]
        end = places[i] + 2.0 * turns[i] @ np.asarray(centres[i], dtype=float)
        lines.append(np.array([places[i], *(carried or [end])]))
    return tuple(lines)
