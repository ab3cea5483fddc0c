"""Where a robot may be sent: its joint ranges, a box of joint positions, poses or moves, or a box in space.

As text a workspace is ``limits``; one ``LOW:HIGH`` per joint (``-90deg:90deg,0:1.2``); or ``x=0.2:0.5,z=0:0.4`` (m) for
the tool. A file of waypoints, as for moves, is the poses in it and the straight ways between them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain, repeat
from typing import Any, cast

import numpy as np

from flexhinf.arrays import Vector
from flexhinf.errors import InvalidInput, refuse_if
from flexhinf.plant.joints import joint_ranges
from flexhinf.robot.kinematics import position_of, position_ranges
from flexhinf.robot.parameters import measured, split
from flexhinf.robot.robot import Robot
from flexhinf.robot.waypoints import (
    AXES,
    LIMITS,
    ORIGIN,
    Tool,
    WaypointTable,
    in_space,
    reached_waypoints,
    waypoints,
)
from flexhinf.validation import real_array, value_text

#: Poses that are tried for one whose tool is in a box in space.
TRIED = 100_000

#: Angles beyond this, rad, are asked whether degrees were meant.
DOUBTFUL_ANGLE = 2.0 * np.pi


@dataclass(frozen=True, eq=False)
class Workspace:
    """Poses of a robot: those in a box of joint positions, or near a path, or with the tool in a box in space."""

    robot: Robot
    lower: np.ndarray  # (n,), rad or m
    upper: np.ndarray
    path: np.ndarray | None = None  # (N, n), poses with straight ways between them
    box: np.ndarray | None = None  # (2, 3), m, of the tool
    tool: Tool = ORIGIN

    def sample(self, count: int, seed: int | Sequence[int]) -> np.ndarray:
        """Poses (count, n): uniform in the box, or on the path by its length in joint ranges.

        Raises `InvalidInput` where hardly any pose within the joint ranges has its tool in the box in space.
        """
        rng = np.random.default_rng(seed)
        if self.path is not None:
            return self._on_path(rng.uniform(size=count))
        if self.box is None:
            return rng.uniform(self.lower, self.upper, (count, len(self.lower)))
        poses: list[np.ndarray] = []
        for _ in range(TRIED):
            pose = rng.uniform(self.lower, self.upper)
            if self._has_tool(pose):
                poses.append(pose)
                if len(poses) == count:
                    break
        refuse_if(
            len(poses) < count,
            "The tool is hardly ever in the box in space.",
            f"expected {count} poses within the joint ranges whose tool is in it, got {len(poses)} of {TRIED}",
            "a larger box, or one nearer to the robot",
        )
        return np.array(poses)

    @property
    def home(self) -> np.ndarray:
        """Pose (n,) in the workspace where a controller begins: the robot's home, if it is there."""
        home = np.array(self.robot.home)
        if self.contains(home):
            return home
        inside = 0.5 * (self.lower + self.upper) if self.box is None else self.sample(1, 0)[0]
        return inside if self.path is None else self.path[0]

    def contains(self, pose: Any) -> bool:
        """Whether a pose (n,) is in it, up to rounding; of a path its smallest box of joint positions counts."""
        q, margin = np.asarray(pose, dtype=float), 1e-9
        inside = bool(np.all((q >= self.lower - margin) & (q <= self.upper + margin)))
        return inside and (self.box is None or self._has_tool(q))

    def _has_tool(self, pose: np.ndarray) -> bool:
        assert self.box is not None
        place = position_of(self.robot, pose, self.tool.link, self.tool.offset)
        return bool(np.all((place >= self.box[0]) & (place <= self.box[1])))

    def _on_path(self, shares: np.ndarray) -> np.ndarray:
        path = np.asarray(self.path)
        low, high = ranges(self.robot)
        lengths = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(path, axis=0) / (high - low), axis=1)))
        columns: list[Vector] = [np.interp(shares * lengths[-1], lengths, column) for column in path.T]
        return np.column_stack(columns)


def ranges(robot: Robot) -> np.ndarray:
    """`joint_ranges` (2, n) of a robot."""
    return joint_ranges(robot.joint_names, robot.links.slides, position_ranges(robot))


def workspace_of(robot: Robot, stated: Any = LIMITS, tool: Tool = ORIGIN) -> Workspace:
    """The workspace of a text, a file or table of waypoints, or one (low, high) per joint.

    Raises `InvalidInput` for what is none of them, and for one that leaves the joint ranges.
    """
    if isinstance(stated, str) and stated.strip() == LIMITS:
        return Workspace(robot, *ranges(robot))
    if isinstance(stated, str) and "=" in stated:
        return Workspace(robot, *ranges(robot), box=_in_space(stated), tool=tool)
    low, high = position_ranges(robot)
    path = None
    if isinstance(stated, str) and ":" in stated:
        units = chain(robot.links.position_units, repeat("rad"))
        ends = np.array([_ends(part, unit) for part, unit in zip(stated.split(","), units)]).T
    elif isinstance(stated, (list, tuple, np.ndarray)):
        ends = real_array(cast(object, stated)).T
    else:
        table = waypoints(stated, timed=False)
        if not isinstance(table, WaypointTable):
            raise _refusal(stated, "waypoints")
        table = reached_waypoints(robot, table, tool)[0] if in_space(robot, table) else table
        path = table.positions(robot.joint_names, robot.links.slides)
        ends = np.array([path.min(axis=0), path.max(axis=0)])
    n = len(robot.joint_names)
    if ends.shape != (2, n) or not np.all(np.isfinite(ends) & ((ends[0] < ends[1]) | (path is not None))):
        raise _refusal(
            stated,
            f"LOW:HIGH with LOW < HIGH for each of {list(robot.joint_names)}, {n} joints",
            ",".join([stated] * n) if isinstance(stated, str) and ends.shape == (2, 1) else "",
        )
    outside = np.flatnonzero((ends[0] < low - 1e-9) | (ends[1] > high + 1e-9))
    for k in outside[:1]:
        limits = f"{low[k]:g} to {high[k]:g}"
        turned = [row if slides else np.radians(row) for row, slides in zip(ends.T, robot.links.slides)]
        fits = not robot.links.slides[k] and low[k] - 1e-9 <= turned[k][0] and turned[k][1] <= high[k] + 1e-9
        degrees = ("{:g}:{:g}" if slides else "{:g}deg:{:g}deg" for slides in robot.links.slides)
        raise InvalidInput(
            f"The workspace leaves the range of joint {robot.joint_names[k]!r}.",
            f"expected {limits} at most, got {ends[0, k]:g} to {ends[1, k]:g}",
            f"--workspace {','.join(text.format(*row) for text, row in zip(degrees, ends.T))}, if degrees were meant"
            if fits and path is None and np.abs(ends[:, k]).max() > DOUBTFUL_ANGLE
            else "a workspace within the ranges of the robot's file",
        )
    return Workspace(robot, *ends, path=path)


def _ends(text: str, unit: str) -> list[float]:
    ends = [end.strip() for end in text.split(":")]
    try:
        if len(ends) == 2:
            parts = [split(end) for end in ends]
            return [measured(e if part and part[1] else f"{e} {unit}", unit) for e, part in zip(ends, parts)]
    except ValueError:
        pass
    raise _refusal(text, f"LOW:HIGH, two numbers in {unit} or with a unit of that kind")


def _in_space(text: str) -> np.ndarray:
    box, left = np.array([np.full(3, -np.inf), np.full(3, np.inf)]), list(map(str, AXES))
    for part in text.split(","):
        axis, _, ends = part.partition("=")
        if axis.strip() not in left:
            raise _refusal(text, "x, y and z once each, with LOW:HIGH, m")
        left.remove(axis.strip())
        box[:, "xyz".index(axis.strip())] = _ends(ends, "m")
    if not np.all(box[0] < box[1]):
        raise _refusal(text, "LOW < HIGH of each axis")
    return box


def _refusal(stated: Any, expected: str, example: str = "") -> InvalidInput:
    return InvalidInput(
        "This is no workspace.",
        f"expected {expected}, got {value_text(stated)}",
        f"--workspace {example}; or "
        * bool(example)
        + "--workspace limits; or --workspace -90deg:90deg,0:1.2 for two joints; or --workspace x=0.2:0.5,z=0:0.4; or "
        "--workspace waypoints.csv",
    )
