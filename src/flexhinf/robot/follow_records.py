"""Records of `flexhinf.robot.follow_machine`, which are structs in C, with the codes of what it answers."""

from __future__ import annotations

from enum import IntEnum
from typing import Annotated

import numpy as np

from flexhinf.codegen.c.source import Record

Joints = Annotated[list[float], "JOINTS"]
Flags = Annotated[list[int], "JOINTS"]
Three = Annotated[list[float], 3]
Six = Annotated[list[float], 6]
Long = Annotated[int, "long"]
Motion = Annotated[list[list[float]], 5, "JOINTS"]


class FollowCode(IntEnum):
    """What `Follower` answers: the codes of control_msgs/FollowJointTrajectory, and two of its own above them."""

    SUCCESSFUL = 0
    INVALID_GOAL = -1
    INVALID_JOINTS = -2
    OLD_HEADER_TIMESTAMP = -3
    PATH_TOLERANCE_VIOLATED = -4
    GOAL_TOLERANCE_VIOLATED = -5
    ACTIVE = 1
    IDLE = 2


class FollowReason(IntEnum):
    """Why a goal ended, beside its code."""

    BY_CODE = 0
    REPLACED = 1
    CANCELLED = 2
    BRAKED = 3
    DROPPED = 4


class Point(Record):
    """A waypoint."""

    time: float  # from the beginning of the trajectory
    position: Joints
    velocity: Joints
    acceleration: Joints
    order: int  # 1: positions alone; 2: velocities too; 3: accelerations too


class Tolerance(Record):
    """Of a goal: 0 is what the options have, -1 is any difference. Of the options: 0 is any difference."""

    position: Joints
    velocity: Joints


class Goal(Record):
    """A trajectory of waypoints."""

    points: Annotated[list[Point], "many"]  # they must stay where they are until another goal is followed
    count: int
    moves: Flags  # 0: a joint that the goal leaves out; its numbers are not read
    begins: float  # from now until the trajectory begins; below 0: since then
    path: Tolerance
    goal: Tolerance
    goal_time: float  # after the end of the path, in which the goal must be reached; 0 and -1 as above
    number: Long  # by which its end is told and it is cancelled; 0: neither


class Options(Record):
    """What holds for goals that state none."""

    path: Tolerance
    goal: Tolerance
    goal_time: float  # 0: any
    timeout: float  # after the end of a path, after which its goal is given up; 0: none
    stop_time: float  # in which joints come to rest after a cancelled goal, or that a goal leaves out
    partial: int  # whether a goal may leave joints out
    limited: int  # whether a goal that is too quick for the drives is refused


class Input(Record):
    """What a sample is given."""

    position: Joints  # as output.estimate of the last step
    velocity: Joints
    speed: float  # fraction of its speed with which a trajectory is followed, 0 to 1; at once at rest
    path_rate: (
        float  # output.path_rate of the last step; 1 before it. At 0 the path stands, and its goal ends
    )


class Output(Record):
    """What a sample gives."""

    r: Annotated[list[float], "COMMANDS"]
    position: Joints  # where the links are to be now
    velocity: Joints
    waits: int  # whether a goal waits until it begins; the one before is still followed
    contested: (
        int  # whether goals have replaced one another for more than a second, back and forth: two sources
    )
    result: int  # ACTIVE, IDLE, or in one sample how the goal ended


class End(Record):
    """How a goal ended."""

    number: Long
    code: int
    reason: int


class State(Record):
    """What is remembered between samples. Only `ended` and `ends` are for the caller: goals with numbers that ended in
    the last call; each that was started ends once."""

    ended: int  # how many
    ends: Annotated[list[End], "ENDS"]
    path: Annotated[np.ndarray, "SAMPLES", "JOINTS"]
    motion: Annotated[list[list[list[float]]], 2, 5, "JOINTS"]
    part: float
    before: Annotated[list[list[list[float]]], "DELAYED", 2, "JOINTS"]
    now: Annotated[list[list[float]], 3, "JOINTS"]
    begun: Annotated[list[list[float]], 3, "JOINTS"]  # the motion from which the goal, or a stop, began
    spent: Joints  # of the jump that smoothing takes
    target: Joints  # of the last goal, and how it moved the target of the one before
    turn: Joints
    speed: float
    since: float
    first: float
    age: float
    stop_time: float
    stopped_at: float
    goal: Goal
    next: Goal
    wait: Long  # samples, as those below
    late: Long
    contested: Long
    calm: Long
    newest: int
    has_next: int
    active: int
    stops: int  # whether there is no goal: what moves comes to rest
    segment: int
    left: int
    refused: int
