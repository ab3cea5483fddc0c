"""Goals and waypoints of a point of the robot, x, y, z in the world, as positions of the joints.

`flexhinf.robot.kinematics` finds the joint positions first: everything after has joint positions only. Between two
waypoints the joints move smoothly, and the point not in a straight line.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from flexhinf.design.design_file import DesignRequest
from flexhinf.design.options import SLIDING, lengths
from flexhinf.design.waypoint_table import WaypointError, WaypointTable
from flexhinf.errors import InvalidInput
from flexhinf.robot import Robot
from flexhinf.robot.kinematics import Reached, pose_at
from flexhinf.validation import value_text, within_proportion

AXES = ("x", "y", "z")

#: Most waypoints of a point: each is a search.
MOST = 500


class Tool(NamedTuple):
    """The point that goals are for: of a link, by the name of its joint (None: the last), at an offset (3,), m."""

    link: str | None = None
    offset: tuple[float, ...] = (0.0, 0.0, 0.0)


#: The origin of the last link.
ORIGIN = Tool()


def tool_of(text: str) -> Tool:
    """``hand:0,0,0.1``, ``hand`` or ``:0,0,0.1``; the origin of the last link for an empty text."""
    link, colon, offset = text.partition(":")
    return Tool(link.strip() or None, _point("tool", offset) if colon else (0.0, 0.0, 0.0))


def with_joints(request: DesignRequest, goal: str = "", tool: str = "") -> DesignRequest:
    """The request with its goal ``x,y,z`` (m, or with a unit) and waypoints as positions of the joints, and notes."""
    robot, s, notes, point = request.robot, request.specification, list(request.notes), tool_of(tool)
    table = s.move if isinstance(s.move, WaypointTable) else None
    move = table if table and set(table.joints) == set(AXES) != set(robot.joint_names) else None
    if tool and not goal and move is None:
        raise InvalidInput(
            "A tool is stated, and nothing that it is to reach.",
            f"expected --pose-xyz, or waypoints with columns x, y, z, got --tool {value_text(tool, 60)} alone",
            "--pose-xyz 0.4,0,0.3, or leave out --tool",
        )
    if goal:
        if s.pose is not None:
            raise InvalidInput(
                "The goal is stated twice.", f"expected --pose-xyz or --pose, got {value_text(goal, 60)} and {s.pose}",
                "leave out one of them (--pose \"\" takes back that of a design file)",
            )  # fmt: skip
        reached = pose_at(robot, _point("goal-xyz", goal), point.link, point.offset, s.start)
        s = replace(s, pose=tuple(reached.pose.tolist()))
        notes += [f"The goal is the pose {_text(reached.pose)}.", *_singular("the goal", reached)]
    if move is not None:
        table, worst = _converted(robot, move, point)
        s = replace(s, move=table)
        notes += _singular("one of the waypoints", worst)
    return replace(request, specification=s, notes=tuple(notes))


def joint_waypoints(robot: Robot, table: WaypointTable, tool: Tool = ORIGIN) -> WaypointTable:
    """Waypoints x, y, z of a point as waypoints of the joints, each pose by a search from the one before.

    Raises InvalidInput: for a place out of reach, with its time; for more than 500 waypoints; for columns that are
        not x, y, z.
    """
    return _converted(robot, table, tool)[0]


def _converted(robot: Robot, table: WaypointTable, tool: Tool) -> tuple[WaypointTable, Reached]:
    wrong = [unit for unit in table.units if unit and unit not in SLIDING]
    if set(table.joints) != set(AXES) or len(table.joints) != 3 or wrong or len(table.rows) > MOST:
        raise WaypointError(
            "The waypoints are not those of a point.",
            f"expected columns x, y, z in m or mm, at most {MOST}, got {list(table.joints)} in {list(table.units)}, "
            f"{len(table.rows)} rows",
            "time,x [m],y [m],z [m]",
        )
    order, joints = [table.joints.index(axis) for axis in AXES], robot.joint_names
    poses: list[Reached] = []
    for time, row in zip(table.times, table.rows):
        near = poses[-1].pose if poses else None
        try:
            poses.append(pose_at(robot, [row[k] for k in order], tool.link, tool.offset, near))
        except InvalidInput as error:
            raise WaypointError(f"{error.what} (waypoint at {time:g} s)", error.found, error.advice) from None
    rows = tuple(tuple(reached.pose.tolist()) for reached in poses)
    worst = min(poses, key=lambda reached: reached.mobility)
    return WaypointTable(table.times, joints, ("",) * len(joints), rows), worst


def _singular(what: str, at: Reached) -> list[str]:
    text = (
        f"At {what}, {_text(at.pose)}, the robot is near a singular pose: in one direction its point moves by only "
        f"{at.mobility:.2g} of what it does elsewhere, so small errors of the place are large ones of the joints."
    )
    return [text] if at.near_singular else []


def _text(pose: np.ndarray) -> str:
    return f"({', '.join(f'{value:.4g}' for value in pose)})"


def _point(what: str, text: str) -> tuple[float, ...]:
    point: tuple[float, ...] = ()
    with suppress(ValueError):
        point = lengths(text)
    if len(point) != 3 or not all(map(within_proportion, point)):
        raise InvalidInput(
            f"The point of --{what} cannot be read.",
            f"expected x,y,z in m or mm, got {value_text(text, 80)}",
            "0.4,0,300mm",
        )
    return point
