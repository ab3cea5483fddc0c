"""A controller that follows trajectories as they come, sample by sample; messages are carried by others.

What happens is decided by ``NAME_follow`` of the export: splines, tolerances, cancel, replacement, and how goals end.
Here is what goes on around it: the controller's step, and what stops the robot.
"""

from __future__ import annotations

import copy
import threading
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import NamedTuple, Protocol

import numpy as np

from flexhinf.arrays import Numbers, Vector
from flexhinf.errors import InvalidInput, NumericalFailure, WrongPeriod, refuse_if
from flexhinf.export.compiled import CompiledController
from flexhinf.export.compiled_follower import CompiledFollower, compile_follower
from flexhinf.export.controller_c import MISSING_LIMIT, code_of
from flexhinf.export.follow import REASONS, TEXTS
from flexhinf.export.realtime import check_library
from flexhinf.loop import Controller
from flexhinf.robot import FollowCode, FollowGoal, Robot
from flexhinf.robot.follower import Follower
from flexhinf.robot.signals import signal_names
from flexhinf.validation import real_array

#: Codes of a compiled step after which it computes nothing that moves a robot.
FATAL = ("WENT_BACK", "STOPPED", "BAD_PERIOD")

#: Velocity of a commanded joint that rests, rad/s or m/s.
RESTING = 1e-9

#: Share of the inputs, of a ramp that is over but for rounding.
ROUNDING = 1e-9

#: Passes in which the pose is found from motors whose springs the weight twists: as in the plugin of ros2_control.
PASSES = 50


class RobotIO(Protocol):
    """A robot: what its sensors read, and where its inputs go."""

    def read(self) -> Numbers:
        """The measurement (p,), NaN where a sensor gives nothing; None where none does."""
        ...

    def write(self, input: np.ndarray) -> None:
        """Apply the input (m,) until the next one."""
        ...


class GoalEnd(NamedTuple):
    """How the goal of a number ended."""

    number: int
    code: FollowCode
    text: str


class ArmMotion(NamedTuple):
    """Where the links are to be, and where they are estimated to be; (n,) each, rad and rad/s, or m and m/s."""

    desired: Vector
    desired_velocity: Vector
    actual: Vector
    actual_velocity: Vector

    @property
    def pairs(self) -> tuple[tuple[Vector, Vector], ...]:
        """Positions and velocities: desired, actual, and their difference."""
        desired, actual = self[:2], self[2:]
        return desired, actual, (desired[0] - actual[0], desired[1] - actual[1])


class TrajectoryServer:
    """A controller for a workspace and its robot, which follow the goals that come.

    Messages may come from another thread than the one of the samples.

    Parameters
    ----------
    controller : Controller
        For the workspace of `robot`.
    robot : Robot
        Of the design.
    hardware : RobotIO
        An object with read() and write().
    library : CompiledController, optional
        Steps instead of the controller, of which it was compiled.
    pose : (n,), optional
        Link positions where the robot rests, rad or m; by default they are found from what is read.
    longest_unseen : int
        Samples that a sensor may be silent for.

    Attributes
    ----------
    motion : ArmMotion
        Of the last sample.
    stopped : str
        Why the robot was stopped; empty while it is not.
    is_released : bool
        Whether the inputs of a robot that was stopped have fallen to 0.
    stop_ramp : float
        Time in which they do so, s; 0: at once. It may be set, as `speed` may.
    stepped : Controller or CompiledController
        What steps. `step_code` is how the last step ended, as the C says it.
    input, measurement, unseen : (m,), (p,), (p,)
        Of the last sample, and for how many samples each sensor has been silent.
    late_samples : int
        Samples whose period was longer than one and a half.
    speed : float
        Fraction of its speed with which a trajectory is followed, 0 to 1; what is no number stops it. It may be set
        from any thread.

    Raises InvalidInput: for a controller that follows no trajectories, a library of another one, without a C compiler,
    or where the pose is neither stated nor measured.
    """

    def __init__(
        self,
        controller: Controller,
        robot: Robot,
        hardware: RobotIO,
        *,
        library: CompiledController | None = None,
        pose: Numbers = None,
        longest_unseen: int = MISSING_LIMIT,
    ) -> None:
        self.robot, self.hardware, self.period = robot, hardware, controller.period
        self.measured, self._longest = controller.measured, longest_unseen
        if library is not None:
            check_library(library, controller)
        self._fresh: Callable[[], Controller | CompiledController] = (
            controller.fresh if library is None else partial(copy.copy, library)
        )
        self.code = code_of(controller, "arm", "double", robot)
        self._follower: CompiledFollower = compile_follower(self.code)
        self._lock = threading.RLock()
        self._numbers, self.samples, self.speed, self.stop_ramp = 0, 0, 1.0, 0.0
        self._ends: deque[GoalEnd] = deque()
        q = measured_pose(robot, self.measured, hardware.read()) if pose is None else real_array(pose)
        self._begin(q)

    def _begin(self, q: Vector) -> None:
        """At rest at link positions, without a goal."""
        self._follower.reset(q)
        self.stepped = self._fresh()
        state, u = self.robot.operating_point(q)
        self.stepped.reset(state=state, input=u)
        self.input, self.unseen, self._failures = np.asarray(u, dtype=float), np.zeros(len(self.measured)), 0
        self.measurement, self.step_code, self.late_samples = (
            np.full(len(self.measured), np.nan),
            "WAITING",
            0,
        )
        none = np.zeros(len(self.robot.joint_names))
        self.motion, self.stopped = ArmMotion(q, none, q, none), ""
        self._stopped_for, self.is_released = 0.0, False

    # Goals, from any thread ----------------------------------------------------------------------------
    def refusal(self, goal: FollowGoal) -> str:
        """Why a goal would be refused wherever the arm is; empty where it would not."""
        with self._lock:
            if self.stopped:
                return self.stopped
            code = self._follower.check(goal)
        return "" if code is FollowCode.SUCCESSFUL else TEXTS[code]

    @property
    def follower(self) -> Follower:
        """With the tolerances and times of goals that state none."""
        return self._follower.follower

    def change(self, options: Mapping[str, object]) -> str:
        """Follow later goals with other options of `Follower`; why not, or empty.

        Nothing is changed while a goal is followed or the joints come to rest.

        Raises InvalidInput: for options that `Follower` refuses.
        """
        with self._lock:
            follower = replace(self.follower, **options)
            if self._follower.is_followed or np.abs(self.motion.desired_velocity).max() > RESTING:
                return "a trajectory is followed: wait until it ends, or cancel it"
            self._follower.follower = follower
            self._follower.reset(self.motion.desired)
            return ""

    @property
    def contested(self) -> bool:
        """Whether goals have led back and forth for more than a second, each before the one before has ended."""
        return self._follower.contested

    def submit(self, goal: FollowGoal) -> int:
        """Follow a goal from the next sample on; returns its number. The one before it ends with −1, but not where this
        one is refused, or before it begins."""
        with self._lock:
            self._numbers += 1
            number, code = self._numbers, FollowCode.PATH_TOLERANCE_VIOLATED
            if not self.stopped:
                code = self._follower.start(goal, number)
                self._tell()
            if code is not FollowCode.ACTIVE:
                self._ends.append(GoalEnd(number, code, self.stopped or TEXTS[code]))
            return number

    def cancel(self, number: int = 0) -> None:
        """Come to rest, if it is this goal that is followed, or whatever moves with 0; one that waits is dropped alone.
        What is cancelled ends with 0."""
        with self._lock:
            self._follower.cancel(number)
            self._tell()

    def ends(self) -> list[GoalEnd]:
        """How goals ended since this was called before."""
        with self._lock:
            found = list(self._ends)
            self._ends.clear()
            return found

    def _tell(self) -> None:
        """Keep how goals ended in the last call of the follower."""
        for number, code, reason in self._follower.ends:
            self._ends.append(GoalEnd(number, code, self.stopped or REASONS.get(reason) or TEXTS[code]))

    # Samples -------------------------------------------------------------------------------------------
    def sample(self, elapsed: float = 0.0) -> None:
        """Read, follow, step, write; `elapsed`: s since the sample before, 0 where that is not known.

        Nothing is computed after a fault, which `stopped` names: the inputs fall to 0 in `stop_ramp`, those of drives
        that take positions stay.
        """
        self.late_samples += elapsed > 1.5 * self.period
        y = None if self.stopped else self._measurement()
        with self._lock:
            if not self.stopped:
                self._step(y, elapsed)
        if self.stopped:
            self._stopped_for += elapsed or self.period
            left = max(0.0, 1.0 - self._stopped_for / self.stop_ramp) if self.stop_ramp else 0.0
            self._let_go(0.0 if left < ROUNDING else left)
        else:
            self.hardware.write(self.input)
            self.samples += 1

    def release(self) -> None:
        """Write the last inputs of a robot that was stopped, whatever the ramp, unless they are written."""
        if not self.is_released:
            self._let_go(0.0)

    def _let_go(self, share: float) -> None:
        self.is_released = share == 0.0
        self.hardware.write(self.input if self.robot.drive == "position" else share * self.input)

    def restart(self) -> str:
        """Begin again after a fault, at rest at the pose that is measured; why not, or empty.

        It is called in the thread of the samples, between two of them.
        """
        if not self.stopped:
            return "the robot is not stopped"
        if not self.is_released:
            return "the inputs still fall to 0: wait until they do"
        try:
            q = measured_pose(self.robot, self.measured, self.hardware.read())
        except InvalidInput as error:
            return str(error)
        with self._lock:
            self._begin(q)
        return ""

    def stop(self, reason: str) -> None:
        """Stop the robot; the goal ends with −4 and this reason."""
        with self._lock:
            self.stopped = self.stopped or reason
            self._follower.end_all(FollowCode.PATH_TOLERANCE_VIOLATED)
            self._tell()

    def _measurement(self) -> Vector | None:
        read = self.hardware.read()
        y = np.full(len(self.measured), np.nan) if read is None else np.ravel(real_array(read))
        refuse_if(
            y.shape != self.unseen.shape,
            "The robot does not read what the controller needs.",
            f"expected {len(self.measured)} numbers {list(self.measured)}, got shape {y.shape}",
            "read() that returns them in this order, NaN for one that is missing",
        )
        self.measurement, self.unseen = y, np.where(np.isfinite(y), 0.0, self.unseen + 1.0)
        for name in np.array(self.measured)[self.unseen > self._longest]:
            self.stop(f"{name} was not measured for {self._longest} samples")
        if self.unseen.min() > self._longest:
            self.step_code = "STOPPED"
        return y if np.isfinite(y).any() else None

    def _step(self, y: Vector | None, elapsed: float) -> None:
        actual, actual_velocity = self.motion[2:]
        followed = self._follower.step(actual, actual_velocity, self.speed, self.stepped.path_rate)
        self._tell()
        try:
            self.input = self.stepped.step(y, followed.row, elapsed)
            begun = self.step_code != "WAITING" or y is not None
            self._failures, self.step_code = 0, "OK" if y is not None else "PREDICTED" if begun else "WAITING"
        except WrongPeriod:
            self.step_code = "BAD_PERIOD"
        except NumericalFailure as failure:  # the input before it is held, once
            self._failures += 1
            self.step_code = "WENT_BACK" if self._failures > 1 else "BAD_RESULT"
            if self._failures > 1:
                self.stop(f"the controller cannot go on: {failure}")
        if isinstance(self.stepped, CompiledController):
            self.step_code = self.stepped.code
        if self.step_code in FATAL:
            self.stop(f"the controller stopped: {self.step_code}")
        n, x = len(actual), self.stepped.estimate
        if np.isfinite(x).all():
            actual, actual_velocity = x[:n], x[n : 2 * n]
        self.motion = ArmMotion(followed.position, followed.velocity, actual, actual_velocity)


def measured_pose(robot: Robot, measured: tuple[str, ...], y: Numbers) -> Vector:
    """Link positions (n,), rad or m, of a robot that rests, from a measurement (p,) of its links, or of its motors and
    the twist of the springs under the weight.

    Raises InvalidInput: where a joint has neither.
    """
    joints = robot.joint_names
    numbers = np.full(len(measured), np.nan) if y is None else np.ravel(real_array(y))
    there = dict(zip(measured, numbers))
    links, motors = (
        np.array([there.get(name, np.nan) for name in signal_names(kind, joints)])
        for kind in ("link_position", "motor_position")
    )
    by_motor = ~np.isfinite(links)
    q = np.where(by_motor, motors, links)
    refuse_if(
        not np.isfinite(q).all(),
        "The robot's pose is not known.",
        f"expected a position of each of the joints {list(joints)}, got {numbers.tolist()} of {list(measured)}",
        "pose=[…], the link positions where it rests; or a read() that returns them",
    )
    states = list(robot.plant().states)
    names = signal_names("motor_position", joints)
    elastic = np.array([name in states for name in names])
    places = [states.index(name) if name in states else 0 for name in names]
    for _ in range(PASSES if (by_motor & elastic).any() else 0):
        twisted = robot.operating_point(q)[0][places]
        left = np.where(by_motor & elastic, motors - twisted, 0.0)
        q = q + np.where(by_motor, robot.layout.at_links(left), 0.0)
    return q
