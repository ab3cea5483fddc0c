"""Task of a robot: the poses for which its controller is made, with the one motion where a pose is stated.

A pose is a workspace of one point, with a motion to it; nothing below asks which of the two it is.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from flexhinf.designs.design_file import tool_of
from flexhinf.designs.motions import Jump, Motion
from flexhinf.designs.plans import run_ends, step_command
from flexhinf.designs.responses import joint_limits
from flexhinf.designs.specification import Specification
from flexhinf.errors import refuse_if
from flexhinf.robot import Robot, kinematics
from flexhinf.robot.waypoints import LIMITS
from flexhinf.robot.workspace import Workspace, workspace_of


@dataclass(frozen=True, eq=False)
class Task:
    """Poses of a robot, and the motion to the only one, where there is one."""

    space: Workspace
    motion: Motion | None = None  # None: moves between random poses

    @staticmethod
    def of(robot: Robot, s: Specification) -> Task:
        """The task of a specification: its pose with the motion to it, or its workspace, by default the joint ranges.

        Raises `InvalidInput` for what does not fit the robot.
        """
        if s.pose is None:
            return Task(stated_workspace(robot, s.workspace))
        motion = stated_motion(robot, s)
        return Task(Workspace(robot, motion.goal, motion.goal), motion)


def stated_workspace(robot: Robot, stated: Any) -> Workspace:
    """The workspace of a specification, by default the joint ranges; a box in space has its tool behind an @."""
    if not isinstance(stated, str):
        return workspace_of(robot, LIMITS if stated is None else stated)
    place, _, tool = stated.partition("@")
    return workspace_of(robot, place, tool_of(tool))


def stated_motion(robot: Robot, s: Specification) -> Motion:
    """The motion of a specification that states a pose: its move, its shaped command, or a jump.

    Raises `InvalidInput` for a move that does not fit the robot, for a pose that its motors do not hold, and where
    nothing is to be moved.
    """
    plan, start, goal = run_ends(robot, s)
    refuse_if(
        not np.any(goal != start) and plan is None,
        "There is nothing to move: the step starts at its goal.",
        f"expected another start than {goal.tolist()}",
        "another `start` or `pose`",
    )
    limits = joint_limits(robot, s)
    for pose in (start, goal):
        kinematics.check_holding(robot, pose, limits.effort)
    return Motion(start, goal, plan or step_command(robot, s, start, goal) or Jump(goal), s.duration)
