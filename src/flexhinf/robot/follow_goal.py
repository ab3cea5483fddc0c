"""The goal of a `Follower`: waypoints with times, and the tolerances of their path and their end."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple, cast

import numpy as np
from numpy.typing import ArrayLike

from flexhinf.arrays import Vector
from flexhinf.errors import refuse_if
from flexhinf.notebook import StatedRepr


class GoalRows(NamedTuple):
    """The numbers of a goal in the order of a robot's n joints."""

    times: Vector  # (N,)
    points: np.ndarray  # (3, N, n), NaN where nothing is stated
    orders: np.ndarray  # (N,)
    moves: np.ndarray  # (n,): 1, or 0 for a joint that is left out
    tolerances: np.ndarray  # (2, 2, n): of path and goal, of position and velocity


@dataclass(frozen=True, eq=False, repr=False)
class FollowGoal(StatedRepr):
    """Waypoints of joints, as trajectory_msgs/JointTrajectory and the action FollowJointTrajectory have them.

    Parameters
    ----------
    joint_names : sequence of str
        In any order.
    times : (N,)
        time_from_start, increasing, s.
    positions : (N, k)
        Link positions, rad or m, in the order of the names.
    velocities, accelerations : (N, k), optional
        rad/s and rad/s², or m/s and m/s². A row that is None or empty: this waypoint states none. Accelerations count
        beside velocities alone.
    begins : float
        Time from now until the trajectory begins, s; negative where its stamp is past.
    path_tolerance, goal_tolerance : mapping of str to (position, velocity)
        By joint, rad and rad/s, or m and m/s. 0 is what the follower has, −1 is any difference.
    goal_time : float
        Time after the end of the path in which the goal must be reached, s; 0 and −1 as above.

    Raises InvalidInput: for what is no number, shapes that do not fit each other, or tolerances that are no pairs.

    Examples
    --------
    >>> import flexhinf as fh
    >>> goal = fh.FollowGoal(["elbow", "shoulder"], [0.5, 1.0], [[0.1, 0.2], [0.2, 0.4]])
    >>> goal.orders.tolist()
    [1, 1]
    """

    joint_names: Sequence[str]
    times: ArrayLike
    positions: ArrayLike
    velocities: ArrayLike | None = None
    accelerations: ArrayLike | None = None
    begins: float = 0.0
    path_tolerance: Mapping[str, Sequence[float]] = field(default_factory=dict[str, Sequence[float]])
    goal_tolerance: Mapping[str, Sequence[float]] = field(default_factory=dict[str, Sequence[float]])
    goal_time: float = 0.0

    def __post_init__(self) -> None:
        refuse_if(
            isinstance(self.joint_names, str) or np.ndim(self.joint_names) != 1,
            "The joint names of a trajectory are no list.",
            f"expected several names, got {self.joint_names!r}",
            "joint_names=['elbow']",
        )
        _as_numbers("times", self.times, 1, "times=[0.5, 1.0]")
        for name in ("begins", "goal_time"):
            _as_numbers(name, getattr(self, name), 0, f"{name}=0.0")
        shape = np.size(self.times), len(self.joint_names)
        for name in ("positions", "velocities", "accelerations"):
            value = getattr(self, name) if name == "positions" else _filled(getattr(self, name), shape[1])
            found = None if value is None else _as_numbers(name, value, None, f"{name}=[[0.1, 0.2]]").shape
            refuse_if(
                found is not None and found != shape and np.size(self.times) > 0,
                f"The {name} of a trajectory do not fit its times and joints.",
                f"expected the shape {shape}, got {found}",
                "a row for each time, with a number for each joint",
            )
        for name in ("path_tolerance", "goal_tolerance"):
            pairs: object = getattr(self, name)
            refuse_if(
                not isinstance(pairs, Mapping)
                or not all(map(_is_pair, cast("Mapping[str, object]", pairs).values())),
                f"The {name.replace('_', ' ')} of a trajectory is none.",
                f"expected two numbers by joint, got {pairs!r}",
                f"{name}={{'elbow': (0.01, 0.1)}}, or {{'elbow': (0.01, 0)}}",
            )

    @property
    def arrays(self) -> list[np.ndarray]:
        """Positions, and what else there is (N, k); 0 where a waypoint states none."""
        shape = np.size(self.times), len(self.joint_names)
        accelerations = None if self.velocities is None else self.accelerations
        stated = (self.positions, *(_filled(rows, shape[1]) for rows in (self.velocities, accelerations)))
        return [np.reshape(np.asarray(rows, dtype=float), shape) for rows in stated if rows is not None]

    @property
    def orders(self) -> np.ndarray:
        """Derivatives of each waypoint (N,), the position included: 1, 2 or 3."""
        count = np.size(self.times)
        velocities, accelerations = (_stated(rows, count) for rows in (self.velocities, self.accelerations))
        return 1 + velocities + (velocities & accelerations)

    def ordered(self, joints: Sequence[str]) -> GoalRows | None:
        """In the order of a robot's joints; None where a name is none of them, or stands twice."""
        names, stated = list(self.joint_names), {*self.path_tolerance, *self.goal_tolerance}
        if not names or len({*names}) < len(names) or {*names, *stated} - {*joints}:
            return None
        times, places = np.array(self.times, dtype=float), [joints.index(name) for name in names]
        points, tolerances = np.full((3, len(times), len(joints)), np.nan), np.zeros((2, 2, len(joints)))
        for k, rows in enumerate(self.arrays):
            points[k][:, places] = rows
        for k, pairs in enumerate((self.path_tolerance, self.goal_tolerance)):
            for joint, pair in pairs.items():
                tolerances[k, :, joints.index(joint)] = pair
        moves = np.isin(np.arange(len(joints)), places).astype(np.intc)
        return GoalRows(times, points, self.orders, moves, tolerances)


def _listed(rows: ArrayLike | None) -> Sequence[ArrayLike | None] | None:
    return cast("Sequence[ArrayLike | None]", rows) if isinstance(rows, (list, tuple)) else None


def _is_left_out(row: ArrayLike | None) -> bool:
    return row is None or (np.ndim(row) == 1 and np.size(row) == 0)


def _filled(rows: ArrayLike | None, width: int) -> ArrayLike | None:
    """Rows with zeros in the place of those that a waypoint does not state."""
    listed = _listed(rows)
    if listed is None or not any(map(_is_left_out, listed)):
        return rows
    return cast("ArrayLike", [[0.0] * width if _is_left_out(row) else row for row in listed])


def _stated(rows: ArrayLike | None, count: int) -> np.ndarray:
    """Which waypoints (N,) state theirs."""
    if (listed := _listed(rows)) is None:
        return np.full(count, rows is not None)
    return np.array([not _is_left_out(row) for row in listed], dtype=bool)


def _is_pair(pair: object) -> bool:
    """Whether these are two numbers; which ones `Follower.check` judges."""
    try:
        return np.asarray(pair, dtype=float).shape == (2,)
    except (TypeError, ValueError):
        return False


def _as_numbers(name: str, value: ArrayLike | None, dimensions: int | None, advice: str) -> np.ndarray:
    """Numbers of a trajectory, finite or not: that is for `Follower.check`."""
    try:
        found = np.asarray(value, dtype=float)
        fits = value is not None and (dimensions is None or found.ndim == dimensions)
    except (TypeError, ValueError):
        found, fits = np.zeros(0), False
    kind = {0: "a number", 1: "a list of numbers", None: "rows of as many numbers as joints"}[dimensions]
    what = f"The {name.replace('_', ' ')} of a trajectory cannot be read."
    refuse_if(not fits, what, f"expected {kind}, got {value!r}", advice)
    return found
