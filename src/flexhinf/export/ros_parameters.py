"""Parameters of a ROS 2 node, with names of the plugin for ros2_control where that has the same."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple, TypedDict

import numpy as np

from flexhinf.errors import refuse_if
from flexhinf.robot.follower import STOPPED, Follower

#: A tolerance that any velocity meets, rad/s or m/s; 0 is that of `Follower` itself.
ANY = 1e9

#: Longest stop time, s.
LONGEST_STOP = 1e6


class AtStart(NamedTuple):
    """What a node reads when it begins: a topic with the fraction of its speed with which a trajectory is followed,
    where there is one, and the factor from its numbers to the fraction."""

    speed_scaling_topic: str = ""
    speed_scaling_factor: float = 1.0


def goal_parameters(follower: Follower) -> dict[str, bool | float]:
    """Parameters by name, as they are without any; stop time and path tolerances are those of `follower`."""
    joints, paths = follower.robot.joint_names, follower.usual[0, 0].tolist()
    return {
        "allow_partial_joints_goal": False,
        "cmd_timeout": 0.0,
        "stop_time": float(follower.stop_time),
        "constraints.goal_time": 0.0,
        "constraints.stopped_velocity_tolerance": STOPPED,
        **{f"constraints.{joint}.trajectory": path for joint, path in zip(joints, paths)},
        **{f"constraints.{joint}.goal": 0.0 for joint in joints},
    }


class GoalOptions(TypedDict):
    """Options of `Follower`: s, and for each joint a tolerance of its position, rad or m, and of its velocity."""

    stop_time: float
    partial: bool
    path_tolerance: dict[str, tuple[float, float]]
    goal_tolerance: dict[str, tuple[float, float]]
    goal_time: float
    timeout: float


def goal_options(follower: Follower, values: Mapping[str, bool | float]) -> GoalOptions:
    """Options of `Follower` from values of all `goal_parameters`; tolerances rad or m.

    Raises InvalidInput: for a stop time below a period, or too long. What else does not fit is refused by `Follower`.
    """
    stop_time, period = float(values["stop_time"]), follower.period
    refuse_if(
        not period <= stop_time <= LONGEST_STOP,
        "The stop time does not fit.",
        f"expected seconds from {period:g} to {LONGEST_STOP:g}, got {stop_time!r}",
        "stop_time=0.5",
    )
    joints, stopped = follower.robot.joint_names, float(values["constraints.stopped_velocity_tolerance"])
    late, timeout = float(values["constraints.goal_time"]), float(values["cmd_timeout"])
    return {
        "stop_time": stop_time,
        "partial": bool(values["allow_partial_joints_goal"]),
        "path_tolerance": {j: (float(values[f"constraints.{j}.trajectory"]), 0.0) for j in joints},
        "goal_tolerance": {j: (float(values[f"constraints.{j}.goal"]), stopped or ANY) for j in joints},
        "goal_time": late,
        # as in joint_trajectory_controller
        "timeout": 0.0 if 0.0 <= timeout <= late else timeout,
    }


def check_at_start(stated: AtStart) -> None:
    """Refuse values that do not fit."""
    factor = float(stated.speed_scaling_factor)
    refuse_if(
        not 0.0 < factor < np.inf,
        "The factor of the speed scaling does not fit.",
        f"expected a number above 0, got {factor!r}",
        "speed_scaling_factor:=0.01, for a topic with percent",
    )
