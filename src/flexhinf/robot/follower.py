"""Trajectories as ROS 2 sends them, followed by an elastic arm: one reference for the controller each sample.

A goal has waypoints with times. Between two of them the path is linear, cubic or quintic, as they state positions,
velocities too, or accelerations too, like that of joint_trajectory_controller. The path is smoothed by the B-splines of
`Feedforward`, so that the inverse dynamics of the elastic joints have the four derivatives that they need: also where
a goal is replaced, cancelled or linear. What happens is decided by `flexhinf.robot.follow_machine`, which is the C of
an export too, in a bounded number of operations.
"""

# Not checked strictly: what a caller passes may be of another type than stated.
# pyright: reportUnnecessaryIsInstance=false

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike

from flexhinf.arrays import Numbers, Vector
from flexhinf.codegen.c.source import zeros
from flexhinf.errors import refuse_if
from flexhinf.notebook import StatedRepr
from flexhinf.robot import follow_machine
from flexhinf.robot.feedforward import Feedforward
from flexhinf.robot.follow_goal import FollowGoal
from flexhinf.robot.follow_limits import ROUNDING, FollowLimits, ranges_of, speeds_of
from flexhinf.robot.follow_records import (
    FollowCode as FollowCode,
    FollowReason as FollowReason,
    Goal,
    Input,
    Options,
    Output,
    Point,
    State,
)
from flexhinf.robot.robot import Robot
from flexhinf.validation import checked_array, checked_positive

#: Velocity below which a joint counts as stopped at the goal, rad/s or m/s: as in joint_trajectory_controller.
STOPPED = 0.01

#: Share of the braking time in which a path goes on at its speed, until a controller has braked it.
BRAKED = 0.5


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


class FollowEnd(NamedTuple):
    """How the goal of a number ended, and why."""

    number: int
    code: FollowCode
    reason: FollowReason


class Watched(Protocol):
    """`flexhinf.Supervision`, as far as a follower reads it."""

    @property
    def following(self) -> Numbers: ...  # noqa: D102
    @property
    def braking_time(self) -> float: ...  # noqa: D102


class Steered(Protocol):
    """`flexhinf.Controller`, likewise."""

    @property
    def period(self) -> float: ...  # noqa: D102
    @property
    def supervision(self) -> Watched | None: ...  # noqa: D102


class FollowerStatus:
    """What a memory tells, in Python or in C, of goals."""

    _state: State
    _output: Output

    @property
    def waits(self) -> bool:
        """Whether a goal waits until it begins; the one before is still followed."""
        return bool(self._state.has_next)

    @property
    def is_followed(self) -> bool:
        """Whether a goal is followed, or waits."""
        return bool(self._state.active or self._state.has_next)

    @property
    def contested(self) -> bool:
        """Whether goals replace one another, back and forth, for more than a second."""
        return bool(self._output.contested)

    @property
    def ends(self) -> list[FollowEnd]:
        """Goals with numbers that ended in the last call."""
        ends = self._state.ends[: self._state.ended]
        return [FollowEnd(one.number, FollowCode(one.code), FollowReason(one.reason)) for one in ends]


@dataclass(eq=False, repr=False)
class Follower(StatedRepr, FollowerStatus):
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

    Attributes
    ----------
    waits, contested : bool
        Whether a goal waits until it begins, while the one before is still followed; and whether goals have led back
        and forth for more than a second, each before the one before has ended: they come from two sources.
    ends : list of FollowEnd
        Goals with numbers that ended in the last call of `start`, `cancel`, `end_all` or `step`.

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
        self.own = FollowLimits.of(self.feedforward, int(self.latency), float(self.stop_time))
        self.reset(np.asarray(self.robot.home, dtype=float))

    @classmethod
    def for_controller(
        cls, robot: Robot, controller: Steered, latency: int, smoothing: float = 0.02
    ) -> Follower:
        """The follower of a controller: with its period, and with the path tolerances of its supervision.

        A joint may be from its path by `following`, from which on the controller brakes, and by what the path goes on
        until it rests: half of the braking time at the joint's speed limit, or where it has none at 2.5 rad/s or
        0.5 m/s. So the controller brakes first; what goes astray beyond that ends the goal.
        """
        follower, watched = cls(robot, controller.period, smoothing, latency), controller.supervision
        if watched is None or watched.following is None:
            return follower
        sizes = np.asarray(watched.following, dtype=float)
        sizes = sizes + BRAKED * watched.braking_time * follower.jumps / follower.smoothing
        pairs = zip(robot.joint_names, np.broadcast_to(sizes, len(robot.joint_names)).tolist())
        paths = {name: (float(f"{size:.3g}"), 0.0) for name, size in pairs if np.isfinite(size)}
        return replace(follower, path_tolerance=paths)

    # Bounds --------------------------------------------------------------------------------------------
    @property
    def ranges(self) -> np.ndarray:
        """Lower and upper ends (2, n) of the link positions, rad or m; infinite where the robot states none."""
        return ranges_of(self.robot)

    @property
    def speeds(self) -> Vector:
        """Largest mean speeds (n,) between two waypoints, rad/s or m/s; infinite where the robot states none."""
        return ROUNDING * speeds_of(self.robot)

    @property
    def jumps(self) -> Vector:
        """Largest jumps (n,) that smoothing takes, rad or m."""
        return np.array(self.own.farthest)

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
    def reset(self, position: ArrayLike) -> None:
        """Rest at link positions (n,), rad or m, without a goal."""
        n = self.own.joints
        q = checked_array(
            "The pose does not fit the robot.", position, (n,), f"{n} finite numbers", "one for each joint"
        )
        self._state, self._input, self._output = State(self.own), Input(self.own), Output(self.own)
        self._options = self._stated()
        follow_machine.stand_at(self.own, self._state, q.tolist())

    def check(self, goal: FollowGoal) -> FollowCode:
        """What `start` answers wherever the arm is: SUCCESSFUL, or why the goal is refused."""
        ordered = self._ordered(goal)
        if ordered is None:
            return FollowCode.INVALID_JOINTS
        return FollowCode(follow_machine.check(self.own, self._stated(), ordered))

    def start(self, goal: FollowGoal, number: int = 0) -> FollowCode:
        """Follow another goal, from the motion that there is: ACTIVE, or why it is refused; then all goes on as before.

        One that begins later leaves the old goal until then, but for 3 T: so the links are in time. A goal that is
        replaced ends when the new one is followed. `number`: By which `ends` tells of it; 0: not at all.
        """
        self._options, self._state.ended = self._stated(), 0
        ordered = self._ordered(goal)
        code = self.check(goal)
        if ordered is None or code is not FollowCode.SUCCESSFUL:
            return code
        ordered.number = number
        return FollowCode(follow_machine.start(self.own, self._state, self._options, ordered))

    def cancel(self, number: int = 0) -> None:
        """Come to rest within `stop_time`, whatever the speed, in the direction of the motion; and hold.

        A goal that waits is dropped. A stop that has begun goes on as it is. `number`: Of the goal, where only that one
        is meant; one that waits leaves the motion as it is.
        """
        self._options = self._stated()
        follow_machine.cancel_goal(self.own, self._state, self._options, number)

    def end_all(self, code: FollowCode, reason: FollowReason = FollowReason.BY_CODE) -> None:
        """End every goal with a code; the motion goes on as it is."""
        follow_machine.end_all(self._state, code, reason)

    def _stated(self) -> Options:
        """The options, as they are now."""
        options, usual = Options(self.own), self.usual.tolist()
        for one, (position, velocity) in zip((options.path, options.goal), usual):
            one.position, one.velocity = position, velocity
        options.goal_time, options.timeout, options.stop_time = self.goal_time, self.timeout, self.stop_time
        options.partial, options.limited = int(self.partial), int(self.limited)
        return options

    def _ordered(self, goal: FollowGoal) -> Goal | None:
        """The goal in the robot's order; none where it has other joints."""
        rows = goal.ordered(self.robot.joint_names)
        if rows is None:
            return None
        found = Goal(self.own)
        for time, order, *numbers in zip(rows.times.tolist(), rows.orders.tolist(), *rows.points.tolist()):
            point = Point(self.own)
            point.time, point.order = time, order
            point.position, point.velocity, point.acceleration = numbers
            found.points.append(point)
        for one, (position, velocity) in zip((found.path, found.goal), rows.tolerances.tolist()):
            one.position, one.velocity = position, velocity
        found.count, found.moves, found.begins = len(found.points), rows.moves.tolist(), float(goal.begins)
        found.goal_time = float(goal.goal_time)
        return found

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
            ``output.path_rate`` of the controller's last step: less than 1 where it brakes. At 0, and what is no
            number, the path stands, and its goal ends with PATH_TOLERANCE_VIOLATED.

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
        own, state, sample, found = self.own, self._state, self._input, self._output
        for name, value in (("position", position), ("velocity", velocity)):
            refuse_if(
                value is not None and np.shape(value) != (own.joints,),
                f"The {name} does not fit the robot.",
                f"expected the shape {(own.joints,)}, got {np.shape(value) if value is not None else None}",
                "one number for each joint",
            )
        sample.speed, sample.path_rate, motion = float(speed), float(path_rate), zeros(5, own.joints)
        follow_machine.sample(own, state, self._options, sample, motion, found)
        sample.position = found.position if position is None else np.asarray(position, dtype=float).tolist()
        sample.velocity = found.velocity if velocity is None else np.asarray(velocity, dtype=float).tolist()
        code = follow_machine.judge(own, state, self._options, sample, found)
        return FollowMotion(
            np.array(motion), np.array(found.position), np.array(found.velocity), FollowCode(code)
        )


def _are_tolerances(pair: Sequence[float]) -> bool:
    """Whether they are two numbers from 0 on."""
    return np.shape(pair) == (2,) and bool(np.all(np.isfinite(pair)) and np.min(pair) >= 0.0)
