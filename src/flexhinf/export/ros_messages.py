"""Messages of ROS 2 that a node reads: their fields as types, since rclpy makes the classes when it is installed.

A field has here the type that its users need; messages have more.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

from flexhinf.errors import InvalidInput
from flexhinf.robot import FollowGoal


class Stamp(Protocol):
    """`builtin_interfaces/Time` or Duration."""

    sec: int
    nanosec: int


class Header(Protocol):
    """`std_msgs/Header`."""

    stamp: Stamp


class TrajectoryPoint(Protocol):
    """`trajectory_msgs/JointTrajectoryPoint`: rad or m, and their derivatives, of each joint."""

    positions: Sequence[float]
    velocities: Sequence[float]
    accelerations: Sequence[float]
    effort: Sequence[float]
    time_from_start: Stamp


class JointTrajectory(Protocol):
    """`trajectory_msgs/JointTrajectory`."""

    header: Header
    joint_names: Sequence[str]
    points: Sequence[TrajectoryPoint]


class JointTolerance(Protocol):
    """`control_msgs/JointTolerance`."""

    name: str
    position: float
    velocity: float
    acceleration: float


class GoalRequest(Protocol):
    """The goal of `control_msgs/FollowJointTrajectory`."""

    trajectory: JointTrajectory
    path_tolerance: Sequence[JointTolerance]
    goal_tolerance: Sequence[JointTolerance]
    goal_time_tolerance: Stamp


class GoalFeedback(Protocol):
    """Its feedback."""

    header: Header
    joint_names: Sequence[str]
    desired: TrajectoryPoint
    actual: TrajectoryPoint
    error: TrajectoryPoint


class GoalResult(Protocol):
    """Its result."""

    error_code: int
    error_string: str


class FollowAction(Protocol):
    """The type of the action."""

    Feedback: Callable[[], GoalFeedback]
    Result: Callable[[], GoalResult]


class GoalId(Protocol):
    """`unique_identifier_msgs/UUID`."""

    uuid: bytes


class GoalHandle(Protocol):
    """`rclpy.action.server.ServerGoalHandle`."""

    request: GoalRequest
    goal_id: GoalId
    is_active: bool
    is_cancel_requested: bool

    def execute(self) -> None:
        """Begin with it."""
        ...

    def publish_feedback(self, feedback: GoalFeedback) -> None:
        """Tell where the joints are."""
        ...

    def succeed(self) -> None:
        """End as reached."""
        ...

    def canceled(self) -> None:
        """End as cancelled."""
        ...

    def abort(self) -> None:
        """End as missed."""
        ...


class SetParameter(Protocol):
    """`rclpy.parameter.Parameter`."""

    name: str
    value: bool | float


class SpeedFraction(Protocol):
    """`std_msgs/Float64`."""

    data: float


class TriggerResponse(Protocol):
    """The answer of `std_srvs/Trigger`."""

    success: bool
    message: str


def nanoseconds(stamp: Stamp) -> int:
    """Of `builtin_interfaces/Time` or Duration."""
    return 1_000_000_000 * stamp.sec + stamp.nanosec


def goal_of(
    trajectory: JointTrajectory,
    now: int,
    tolerances: Sequence[Sequence[JointTolerance]] = ((), ()),
    goal_time: float = 0.0,
) -> FollowGoal:
    """The goal of a `JointTrajectory` with tolerances of path and goal; `now`: ns, of the clock of its stamp.

    Raises InvalidInput: for rows that do not fit the joints, efforts, and tolerances of accelerations, which are not
    measured.
    """
    points, stamp = list(trajectory.points), nanoseconds(trajectory.header.stamp)
    if any(len(point.effort) for point in points):
        raise InvalidInput(
            "A trajectory states efforts.", "expected none", "positions, velocities, accelerations"
        )
    pairs: list[dict[str, tuple[float, float]]] = []
    for several in tolerances:  # of the path, and at the goal
        if any(one.acceleration > 0.0 for one in several):
            raise InvalidInput(
                "A tolerance is one of an acceleration.", "expected 0: it is not measured", "acceleration=0"
            )
        pairs.append({one.name: (one.position, one.velocity) for one in several})
    rows = {
        name: [list(getattr(point, name)) for point in points]
        for name in ("positions", "velocities", "accelerations")
    }
    velocities, accelerations = (
        rows[name] if any(rows[name]) else None for name in ("velocities", "accelerations")
    )
    return FollowGoal(
        list(trajectory.joint_names),
        [1e-9 * nanoseconds(point.time_from_start) for point in points],
        rows["positions"],
        velocities,
        accelerations,
        1e-9 * (stamp - now) if stamp else 0.0,
        path_tolerance=pairs[0],
        goal_tolerance=pairs[1],
        goal_time=goal_time,
    )
