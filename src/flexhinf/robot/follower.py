"""Trajectories as ROS 2 sends them, followed by an elastic arm: one reference for the controller each sample.

A goal has waypoints with times. Between two of them the path is linear, cubic or quintic, as they state positions,
velocities too, or accelerations too, like that of joint_trajectory_controller. The path is smoothed by the B-splines of
`Feedforward`, so that the inverse dynamics of the elastic joints have the four derivatives that they need: also where
a goal is replaced, cancelled or linear. All is done in a bounded number of operations; the C of an export computes the
same.
"""

# Not checked strictly: what a caller passes may be of another type than stated.
# pyright: reportUnnecessaryIsInstance=false

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import IntEnum
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from flexhinf.arrays import Vector
from flexhinf.errors import refuse_if
from flexhinf.notebook import StatedRepr
from flexhinf.robot.feedforward import Feedforward
from flexhinf.robot.follow_goal import FollowGoal
from flexhinf.robot.follow_path import GoalLimits, between
from flexhinf.robot.robot import Robot
from flexhinf.validation import checked_array, checked_positive

#: Points of a path that one sample may pass, which bounds its time: nearer ones are refused.
PASSED = 16

#: Jump of a joint that turns or slides without a stated speed limit, rad and m, that counts as none.
JUMPS = (0.05, 0.01)

#: Samples that are counted at most: a goal that waits longer begins then, one that ends is late by no more.
MOST_COUNTED = 2_000_000_000

#: What is above a speed limit by rounding alone.
ROUNDING = 1.001

#: Samples of a goal whose commands are judged at most: a longer one is refused where drives limit them.
MOST_JUDGED = 1_000_000

#: Velocity below which a joint counts as stopped at the goal, rad/s or m/s: as in joint_trajectory_controller.
STOPPED = 0.01

#: Largest velocity of a last waypoint that counts as rest, rad/s or m/s: as in joint_trajectory_controller.
RESTING = float(np.finfo(np.float32).eps)


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


class FollowSample(NamedTuple):
    """One sample of a `Follower`; (n,) each but the row, rad and rad/s, or m and m/s."""

    row: np.ndarray  # state and input that the controller is given
    position: np.ndarray  # where the links are to be now
    velocity: np.ndarray
    result: FollowCode  # ACTIVE, IDLE, or in one sample how a goal ended


class FollowMotion(NamedTuple):
    """One sample of a `Follower` before the inverse dynamics: rad, or m, and s."""

    motion: np.ndarray  # (5, n), as it is commanded: positions and four derivatives
    position: np.ndarray  # the others as of `FollowSample`
    velocity: np.ndarray
    result: FollowCode


class _Followed(NamedTuple):
    """A goal in the robot's order."""

    times: Vector  # (N,), s
    points: np.ndarray  # (3, N, n)
    orders: np.ndarray  # (N,): 1, 2 or 3
    moves: np.ndarray  # (n,), of bool
    path: np.ndarray  # (2, n): of positions and velocities; 0 is any
    goal: np.ndarray
    goal_time: float
    begins: float


@dataclass(eq=False, repr=False)
class Follower(StatedRepr):
    """References for a controller along trajectories that come, change and are cancelled while the arm moves.

    Parameters
    ----------
    robot : Robot
        Its links, springs and drives, ranges and speed limits.
    period : float
        Of the controller, s.
    smoothing : float
        T of `Feedforward`, s: the links are later than the trajectory by 3 T, and stop 6 T after its end.
    latency : int
        Samples from a row until the links are there: those after which the controller's input acts, and one more where
        what `step` is told is an estimate of the sample before.
    stop_time : float
        In which joints come to rest after a cancelled goal, or that a goal leaves out, s; sooner where a range ends.
    partial : bool
        Whether a goal may leave joints out.
    path_tolerance, goal_tolerance : mapping of str to (position, velocity)
        Where a goal states none; 0 and joints that are not there: any difference, but for 0.01 rad/s (m/s) at the goal.
    goal_time : float
        Where a goal states none, s; 0: it may take any time.
    timeout : float
        Time after the end of a path after which its goal is given up, s; 0: none.
    limited : bool
        Whether goals are refused whose commands change faster, or are accelerated more, than by seven tenths of what
        the robot's drives take.

    Raises InvalidInput: for numbers that are not positive, or joints that the robot does not have.

    Examples
    --------
    >>> import flexhinf as fh
    >>> import numpy as np
    >>> follower = fh.Follower(fh.load_robot("planar-two-link"), period=1e-3)
    >>> follower.reset([0.0, 0.0])
    >>> follower.start(fh.FollowGoal(["elbow", "shoulder"], [1.0], [[0.2, 0.4]])).name
    'ACTIVE'
    >>> for _ in range(1200):
    ...     sample = follower.step()
    >>> np.round(sample.position, 6).tolist()
    [0.4, 0.2]
    """

    robot: Robot
    period: float
    smoothing: float = 0.02
    latency: int = 0
    stop_time: float = 0.5
    partial: bool = False
    path_tolerance: Mapping[str, Sequence[float]] = field(default_factory=dict[str, Sequence[float]])
    goal_tolerance: Mapping[str, Sequence[float]] = field(default_factory=dict[str, Sequence[float]])
    goal_time: float = 0.0
    timeout: float = 0.0
    limited: bool = True

    def __post_init__(self) -> None:
        checked_positive("The stop time", self.stop_time, "seconds", "stop_time=0.5")
        self.feedforward = Feedforward(self.robot, self.period, self.smoothing)
        joints = self.robot.joint_names
        for name in ("path_tolerance", "goal_tolerance"):
            refuse_if(
                not isinstance(getattr(self, name), Mapping),
                f"The {name.replace('_', ' ')} is none.",
                f"expected pairs of numbers by joint, got {getattr(self, name)!r}",
                f"{name}={{{joints[0]!r}: (0.01, 0.1)}}",
            )
            unknown = [joint for joint in getattr(self, name) if joint not in joints]
            refuse_if(
                bool(unknown),
                f"The {name.replace('_', ' ')} has joints that the robot does not have.",
                f"expected some of {list(joints)}, got {unknown}",
                f"{name}={{{joints[0]!r}: (0.01, 0.1)}}",
            )
            wrong = [pair for pair in getattr(self, name).values() if not _are_tolerances(pair)]
            refuse_if(
                bool(wrong),
                f"The {name.replace('_', ' ')} is none.",
                f"expected two numbers from 0 on by joint, got {wrong}",
                f"{name}={{{joints[0]!r}: (0.01, 0.1)}}, or 0 for any difference",
            )
        for name in ("goal_time", "timeout"):
            value = getattr(self, name)
            refuse_if(
                not (np.isfinite(value) and value >= 0.0),
                f"The {name} is no time.",
                f"expected seconds from 0 on, got {value!r}",
                f"{name}=0.0, for any",
            )
        refuse_if(
            not isinstance(self.latency, (int, np.integer)) or not 0 <= self.latency <= 100,
            "The latency is no number of samples.",
            f"expected a whole number from 0 to 100, got {self.latency!r}",
            "controller.mode.latency",
        )
        self.reset(np.asarray(self.robot.home, dtype=float))

    # Bounds --------------------------------------------------------------------------------------------
    @property
    def ranges(self) -> np.ndarray:
        """Lower and upper ends (2, n) of the link positions, rad or m; infinite where the robot states none."""
        ends = [(-np.inf, np.inf) if pair is None else pair for pair in self.robot.links.limits]
        return np.array(ends, dtype=float).T

    @property
    def speeds(self) -> Vector:
        """Largest mean speeds (n,) between two waypoints, rad/s or m/s; infinite where the robot states none."""
        stated = self.robot.speed_limits or [None] * len(self.robot.joint_names)
        return np.array([np.inf if limit is None else ROUNDING * limit for limit in stated])

    @cached_property
    def limits(self) -> GoalLimits:
        """What the drives leave to goals."""
        return GoalLimits.of(self.feedforward)

    @property
    def jumps(self) -> Vector:
        """Largest jumps (n,) that smoothing takes, rad or m."""
        usual = np.array([JUMPS[int(slides)] for slides in self.robot.links.slides])
        return np.where(np.isfinite(self.speeds), self.speeds * self.smoothing, usual)

    @cached_property
    def usual(self) -> np.ndarray:
        """Tolerances (2, 2, n) where a goal states none: of path and goal, of position and velocity."""
        found = np.zeros((2, 2, len(self.robot.joint_names)))
        found[1, 1] = STOPPED
        for k, pairs in enumerate((self.path_tolerance, self.goal_tolerance)):
            for joint, pair in pairs.items():
                stated = np.asarray(pair, dtype=float)
                at = self.robot.joint_names.index(joint)
                found[k, :, at] = np.where(stated != 0.0, np.maximum(stated, 0.0), found[k, :, at])
        return found

    # Goals ---------------------------------------------------------------------------------------------
    @property
    def waits(self) -> bool:
        """Whether a goal waits until it begins; the one before is still followed."""
        return self._next is not None

    def reset(self, position: ArrayLike) -> None:
        """Rest at link positions (n,), rad or m, without a goal."""
        n, size = len(self.robot.joint_names), self.feedforward.weights.shape[1]
        q = checked_array(
            "The pose does not fit the robot.", position, (n,), f"{n} finite numbers", "one for each joint"
        )
        self._path = np.repeat(q[None], size, axis=0)  # the newest first
        standing = np.vstack([q[None], np.zeros((4, n))])
        self._motion, self._part = np.array([standing, standing]), 1.0
        self._before = np.repeat(standing[None, :2], self.latency + 1, axis=0)  # the newest first
        self._now = self._from = standing[:3]
        self._goal: _Followed | None = None
        self._next: _Followed | None = None
        self._active, self._wait, self._speed = False, 0, 1.0
        self._segment, self._since, self._first, self._age, self._stopped_at = 0, 0.0, 0.0, 0.0, 0.0
        self._left = self._ended = 0

    def check(self, goal: FollowGoal) -> FollowCode:
        """What `start` answers wherever the arm is: SUCCESSFUL, or why the goal is refused."""
        checked = self._checked(goal)
        return checked if isinstance(checked, FollowCode) else FollowCode.SUCCESSFUL

    def start(self, goal: FollowGoal) -> FollowCode:
        """Follow another goal, from the motion that there is: ACTIVE, or why it is refused; then all goes on as before.

        One that begins later leaves the old goal until then, but for 3 T: so the links are in time.
        """
        checked = self._checked(goal)
        if isinstance(checked, FollowCode):
            return checked
        samples = np.ceil((checked.begins - self.feedforward.delay) / self.period - 0.5)
        if samples >= 1.0:
            self._next, self._wait = checked, int(min(samples, MOST_COUNTED))
            return FollowCode.ACTIVE
        return self._begin(checked)

    def cancel(self) -> None:
        """Come to rest within `stop_time`, whatever the speed, in the direction of the motion; and hold.

        A goal that waits is dropped. A stop that has begun goes on as it is.
        """
        self._next = None
        if self._goal is not None and len(self._goal.times):
            self._stop()

    def _checked(self, goal: FollowGoal) -> _Followed | FollowCode:
        """The goal in the robot's order."""
        joints, own = list(goal.joint_names), self.robot.joint_names
        unknown = set(joints) - set(own)
        if not joints or unknown or len(set(joints)) < len(joints):
            return FollowCode.INVALID_JOINTS
        if len(joints) < len(own) and not self.partial:
            return FollowCode.INVALID_JOINTS
        if {*goal.path_tolerance, *goal.goal_tolerance} - set(own):
            return FollowCode.INVALID_JOINTS
        times = np.array(goal.times, dtype=float)  # of its own: the caller may change his
        if not len(times):
            return FollowCode.INVALID_GOAL
        places = [own.index(joint) for joint in joints]
        points = np.zeros((3, len(times), len(own)))
        for k, rows in enumerate(goal.arrays):
            points[k][:, places] = rows
        moves = np.isin(np.arange(len(own)), places)
        stated = np.zeros((2, 2, len(own)))
        for k, pairs in enumerate((goal.path_tolerance, goal.goal_tolerance)):
            for joint, pair in pairs.items():
                stated[k, :, own.index(joint)] = pair
        numbers = [*stated.ravel().tolist(), goal.goal_time]
        if not self._possible(times, points[:, :, moves], moves, numbers, goal.begins):
            return FollowCode.INVALID_GOAL
        if goal.begins + times[-1] <= 0.0:
            return FollowCode.OLD_HEADER_TIMESTAMP
        path, at_goal = np.where(stated > 0.0, stated, np.where(stated < 0.0, 0.0, self.usual))
        time = goal.goal_time
        allowed = time if time > 0.0 else 0.0 if time < 0.0 else self.goal_time
        followed = _Followed(times, points, goal.orders, moves, path, at_goal, allowed, goal.begins)
        return FollowCode.INVALID_GOAL if self._is_quick(followed) else followed

    def _possible(
        self,
        times: Vector,
        points: np.ndarray,
        moves: np.ndarray,
        tolerances: list[float],
        begins: float,
    ) -> bool:
        """Whether a robot can be there: finite, in order, within its ranges and speeds, at rest at the end."""
        low, high = self.ranges[:, moves]
        if not (np.isfinite(times).all() and np.isfinite(points).all()):
            return False
        gaps, distances = np.maximum(np.diff(times), 1e-9 * self.period), np.abs(np.diff(points[0], axis=0))
        far = (distances > self.jumps[moves]) & (
            (gaps[:, None] < self.smoothing) | (distances > self.speeds[moves] * gaps[:, None])
        )
        return bool(
            np.isfinite(begins)
            and all(np.isfinite(value) and (value >= 0.0 or value == -1.0) for value in tolerances)
            and times[0] >= 0.0
            and times[-1] > 0.0
            and (gaps >= self.period / PASSED).all()
            and ((points[0] >= low) & (points[0] <= high)).all()
            and not far.any()
            and (np.abs(points[1, -1]) <= RESTING).all()
        )

    def _is_quick(self, goal: _Followed) -> bool:
        """Whether drives do not take the commands from the first waypoint on, with the joints that are left out at
        home; the way to that waypoint is judged when it begins."""
        times, points = goal.times, goal.points
        if len(times) < 2 or not (self.limited and self.limits.limits):
            return False
        if times[-1] - times[0] > MOST_JUDGED * self.period:
            return True
        one = replace(self)
        begin = np.where(goal.moves, points[:, 0], [np.asarray(self.robot.home), one._now[1], one._now[2]])
        if goal.orders[0] == 1 and times[0] > 0.0:  # it has that velocity already
            begin[1] = np.where(goal.moves, (points[0, 1] - points[0, 0]) / (times[1] - times[0]), 0.0)
        one.reset(begin[0])
        ages = self.period * np.arange(len(one._path))[:, None]
        one._path, one._now = begin[0] - ages * (begin[1] - 0.5 * ages * begin[2]), begin
        one._take(goal, 1, float(times[1] - times[0]))
        rows = list[np.ndarray]()
        while not (one._is_over and one._left == 0):
            one._push(1.0)
            rows.append(one._motion[1])
        commands = self.robot.inverse_dynamics(*np.array(rows).transpose(1, 0, 2))[1]
        changes = [np.diff(commands, k, axis=0) / self.period**k for k in (1, 2)]
        return any(np.any(np.abs(change) > limit) for change, limit in zip(changes, self.limits.commands))

    def _begin(self, goal: _Followed) -> FollowCode:
        """From the motion of now to the first waypoint whose time is still to come."""
        gone = max(0.0, -goal.begins)
        segment = int(np.searchsorted(goal.times, gone, side="right"))
        first = float(goal.times[segment]) - gone
        way = np.abs(goal.points[0, segment] - self._now[0])
        far = (way > self.jumps) & ((first < self.smoothing) | (way > self.speeds * first))
        if np.any(far & goal.moves) or (
            self.limited and self.limits.forbid(self._now, goal, segment, first, self.feedforward.delay)
        ):
            return FollowCode.INVALID_GOAL
        self._take(goal, segment, first)
        return FollowCode.ACTIVE

    def _take(self, goal: _Followed, segment: int, first: float) -> None:
        """Follow a goal from the motion of now to a waypoint in so many s."""
        self._goal, self._next, self._active = goal, None, True
        self._from, self._segment, self._since, self._first, self._age = self._now, segment, 0.0, first, 0.0
        moving = (self._now[1:] != 0.0).any(axis=0) & ~goal.moves
        self._stopped_at = self.stop_time if moving.any() else 0.0
        self._left, self._ended = len(self._path), 0

    def _stop(self) -> None:
        none = np.zeros(len(self.robot.joint_names), dtype=bool)
        points, tolerances = np.zeros((3, 0, len(none))), np.zeros((2, len(none)))
        self._goal, self._next, self._active = (
            _Followed(np.zeros(0), points, np.zeros(0, dtype=int), none, tolerances, tolerances, 0.0, 0.0),
            None,
            False,
        )
        share = self._speed  # the stop is in true time, which a speed of 0 does not hold up
        self._now, self._speed = self._now * np.array([1.0, share, share * share])[:, None], 1.0
        self._from, self._segment, self._since, self._age = self._now, 0, 0.0, 0.0
        self._stopped_at = self.stop_time if self._now[1:].any() else 0.0
        self._left = len(self._path)

    # Samples -------------------------------------------------------------------------------------------
    def step(
        self,
        position: ArrayLike | None = None,
        velocity: ArrayLike | None = None,
        speed: float = 1.0,
        path_rate: float = 1.0,
    ) -> FollowSample:
        """The next sample.

        Parameters
        ----------
        position, velocity : (n,), optional
            Of the links, measured or estimated; by default they are as commanded.
        speed : float
            Fraction of its speed with which the trajectory is followed, 0 to 1: it changes smoothly, by 1 in
            `stop_time`, and at once where the path rests. What is no number counts as 0.
        path_rate : float
            ``output.path_rate`` of the controller's last step: less than 1 where it brakes.

        Raises InvalidInput: for a position or velocity of another shape; what is no number there breaks a tolerance.
        """
        now = self.advance(position, velocity, speed, path_rate)
        state, u = self.robot.inverse_dynamics(*now.motion)
        return FollowSample(np.concatenate([state, u]), now.position, now.velocity, now.result)

    def advance(
        self,
        position: ArrayLike | None = None,
        velocity: ArrayLike | None = None,
        speed: float = 1.0,
        path_rate: float = 1.0,
    ) -> FollowMotion:
        """As `step`, but the motion alone: the rows of many samples cost less together, by `Robot.inverse_dynamics`."""
        for name, value in (("position", position), ("velocity", velocity)):
            shape = np.shape(self._now[0])
            refuse_if(
                value is not None and np.shape(value) != shape,
                f"The {name} does not fit the robot.",
                f"expected the shape {shape}, got {np.shape(value) if value is not None else None}",
                "one number for each joint",
            )
        if self._next is not None:
            self._wait -= 1
            if self._wait <= 0 and self._begin(self._next) is FollowCode.INVALID_GOAL:
                self._next = None
                return self._sample(path_rate, speed, None, None, FollowCode.INVALID_GOAL)
        return self._sample(path_rate, speed, position, velocity, None)

    def _sample(
        self,
        path_rate: float,
        speed: float,
        position: ArrayLike | None,
        velocity: ArrayLike | None,
        result: FollowCode | None,
    ) -> FollowMotion:
        rate = _share(path_rate)
        self._part += rate
        if self._part > 1.0:
            self._part -= 1.0
            self._push(_share(speed))
        motion = self._motion[0] + self._part * (self._motion[1] - self._motion[0])
        motion = motion * rate ** np.arange(5.0)[:, None]
        self._before = np.vstack([motion[None, :2], self._before[:-1]])
        q, dq = self._before[-1]
        if result is None:
            at = q if position is None else np.asarray(position, dtype=float)
            moves = dq if velocity is None else np.asarray(velocity, dtype=float)
            result = self._judged(np.abs(np.array([at - q, moves - dq])))
        return FollowMotion(motion, q.copy(), dq.copy(), result)

    def _push(self, speed: float) -> None:
        """The next sample of the path."""
        most = self.period / self.stop_time
        if not self._now[1:].any():
            self._speed = speed
        elif self._goal is not None and len(self._goal.times):
            self._speed = min(max(speed, self._speed - most), self._speed + most)
        self._advance(self.period * self._speed)
        self._path = np.vstack([self._now[:1], self._path[:-1]])
        found = np.einsum("oa,an->on", self.feedforward.weights, self._path - self._path[0])
        found[0] += self._path[0]
        self._motion = np.array([self._motion[1], found])
        self._left = len(self._path) if not self._is_over else max(0, self._left - 1)

    @property
    def _is_over(self) -> bool:
        """Whether the path is at its end, where it rests."""
        goal = self._goal
        return goal is None or (self._segment == len(goal.times) and self._age >= self._stopped_at)

    def _advance(self, time: float) -> None:
        """The path so much later."""
        goal = self._goal
        if goal is None:
            return
        self._since += time
        self._age = min(self._age + time, self.stop_time)
        while self._segment < len(goal.times) and self._since >= self._length(goal):
            self._since -= self._length(goal)
            self._segment += 1
            self._first = -1.0
        stopped = self._stopping(self._age)
        if self._segment == len(goal.times):
            standing = np.zeros_like(self._now)
            standing[0] = goal.points[0, -1] if len(goal.times) else 0.0
            self._now = np.where(goal.moves, standing, stopped)
            return
        begin, order = self._from, goal.orders[self._segment]
        if self._first < 0.0:
            begin, order = goal.points[:, self._segment - 1], min(order, goal.orders[self._segment - 1])
        way = between(begin, goal.points[:, self._segment], self._length(goal), self._since, order)
        self._now = np.where(goal.moves, way, stopped)

    def _length(self, goal: _Followed) -> float:
        """Time from one waypoint to the next, s."""
        if self._first >= 0.0:
            return self._first
        return float(goal.times[self._segment] - goal.times[self._segment - 1])

    def _stopping(self, age: float) -> np.ndarray:
        """The motion (3, n) that comes to rest from the one at the beginning of the goal."""
        q, dq, ddq = self._from
        low, high = np.minimum(self.ranges[0], q), np.maximum(self.ranges[1], q)
        time = np.full(len(q), self.stop_time)
        end = q + time * (0.5 * dq + time * ddq / 12.0)
        for j in np.flatnonzero(
            (end < low) | (end > high)
        ):  # sooner, so that the stop ends where the range does
            bound = low[j] if end[j] < low[j] else high[j]
            time[j] = min(self.stop_time, max(self._time_to(bound - q[j], dq[j], ddq[j]), self.smoothing))
            end[j] = bound
        standing = np.array([end, np.zeros_like(q), np.zeros_like(q)])
        return np.where(age >= time, standing, between(self._from, standing, time, age, 3))

    @staticmethod
    def _time_to(way: float, velocity: float, acceleration: float) -> float:
        """Duration of the stop, from this motion, that takes a way, s: T (v/2 + T a/12) = way."""
        towards = 1.0 if way >= 0.0 else -1.0
        root = np.sqrt(max(0.0, 0.25 * velocity * velocity + acceleration * way / 3.0))
        divisor = 0.5 * towards * velocity + root
        return 2.0 * abs(way) / divisor if divisor > 0.0 else 0.0

    # Judgement -----------------------------------------------------------------------------------------
    def _judged(self, errors: np.ndarray) -> FollowCode:
        """What is said of differences (2, n) of position and velocity."""
        goal = self._goal
        if not self._active or goal is None:
            return FollowCode.IDLE
        if not (self._is_over and self._left == 0):
            if _within(errors, goal.path):
                return FollowCode.ACTIVE
            self._stop()
            return FollowCode.PATH_TOLERANCE_VIOLATED
        late = self._ended * self.period
        self._ended += 1
        if _within(errors, goal.goal):
            self._active = False
            return FollowCode.SUCCESSFUL
        if 0.0 < goal.goal_time < late or 0.0 < self.timeout < late:
            self._active = False
            return FollowCode.GOAL_TOLERANCE_VIOLATED
        return FollowCode.ACTIVE


def _are_tolerances(pair: Sequence[float]) -> bool:
    """Whether they are two numbers from 0 on."""
    return np.shape(pair) == (2,) and bool(np.all(np.isfinite(pair)) and np.min(pair) >= 0.0)


def _share(value: float) -> float:
    """A number from 0 to 1; 0 for what is none."""
    return min(max(float(value), 0.0), 1.0) if np.isfinite(value) else 0.0


def _within(errors: np.ndarray, allowed: np.ndarray) -> bool:
    """Whether differences are allowed; one that is no number is not, where 0 does not allow all."""
    return bool(np.all((allowed <= 0.0) | (errors <= allowed)))
