"""A controller that follows trajectories as they come, sample by sample; messages are carried by others.

What happens is decided by ``NAME_follow`` of the export: splines, tolerances, cancel, replacement, and how goals end.
Here is what goes on around it: the start, the controller's step, and what its `may_act` lets act.
"""

from __future__ import annotations

import copy
import threading
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import NamedTuple, Protocol

import numpy as np

from flexhinf.arrays import Numbers, Vector
from flexhinf.errors import InvalidInput, NumericalFailure, refuse_if
from flexhinf.export.compiled import CompiledController
from flexhinf.export.compiled_follower import CompiledFollower, compile_follower
from flexhinf.export.controller_c import code_of
from flexhinf.export.follow import REASONS, TEXTS
from flexhinf.export.realtime import check_library
from flexhinf.loop import Controller, Start
from flexhinf.loop.controller.protection import LONGEST_UNSEEN
from flexhinf.robot import FollowCode, FollowGoal, Robot
from flexhinf.robot.follower import Follower
from flexhinf.robot.signals import signal_names
from flexhinf.validation import real_array

#: Velocity of a commanded joint that rests, rad/s or m/s.
RESTING = 1e-9

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
    wait : callable, optional
        Wait for the next reading before the start; by default there is one at once.

    Attributes
    ----------
    motion : ArmMotion
        Of the last sample.
    start : Start
        What nothing told before the start.
    stopped : str
        Why the robot stops or was stopped, and what to look at; empty while it does not.
    is_released : bool
        Whether its drives have no power any more: inputs are those of `Controller.output` then.
    stepped : Controller or CompiledController
        What steps, and decides what may act. `step_code` is how the last step ended, as the C says it.
    input, measurement, unseen : (m,), (p,), (p,)
        Of the last sample, and for how many samples each sensor has been silent.
    late_samples : int
        Samples whose period was longer than one and a half.
    speed : float
        Fraction of its speed with which a trajectory is followed, 0 to 1; what is no number stops it. It may be set
        from any thread.

    Raises InvalidInput: for a controller that follows no trajectories, a library of another one, without a C compiler,
    where the pose is neither stated nor measured, or for a robot that does not rest where it can be started.
    """

    def __init__(
        self,
        controller: Controller,
        robot: Robot,
        hardware: RobotIO,
        *,
        library: CompiledController | None = None,
        pose: Numbers = None,
        wait: Callable[[], None] | None = None,
    ) -> None:
        self.robot, self.hardware, self.period = robot, hardware, controller.period
        self.measured, self._limits, self._wait = (
            controller.measured,
            controller.limits,
            wait or (lambda: None),
        )
        if library is not None:
            check_library(library, controller)
        self._fresh: Callable[[], Controller | CompiledController] = (
            controller.fresh if library is None else partial(copy.copy, library)
        )
        self.code = code_of(controller, "arm", "double", robot)
        self._follower: CompiledFollower = compile_follower(self.code)
        self._lock = threading.RLock()
        self._numbers, self.samples, self.speed = 0, 0, 1.0
        self._ends: deque[GoalEnd] = deque()
        self._begin(pose)

    def _begin(self, pose: Numbers = None) -> None:
        """At rest at link positions, by default those that are measured, without a goal.

        Raises InvalidInput: for a robot that does not rest where the controller can begin.
        """
        stepped = self._fresh()
        y = self._rested(stepped)
        q = measured_pose(self.robot, self.measured, y) if pose is None else real_array(pose)
        state, u = self.robot.operating_point(q)
        with self._lock:
            self.start = stepped.start_reasons
            self._follower.reset(q)
            stepped.reset(state=state, input=u)
            self.stepped, self.step_code, self._has_begun = stepped, "WAITING", False
            self.input, self.late_samples = np.asarray(u, dtype=float), 0
            none = np.zeros(len(self.robot.joint_names))
            self.motion, self.stopped, self.is_released = ArmMotion(q, none, q, none), "", False

    def _rested(self, stepped: Controller | CompiledController) -> Vector:
        """The last reading (p,) of each sensor of a robot that rests; another one is refused."""
        last = np.full(len(self.measured), np.nan)
        self.unseen = np.zeros(len(self.measured))
        while not stepped.at_rest(last):
            why = stepped.start_reasons
            refuse_if(
                why and (why != Start.MISSING or self.unseen.max() > LONGEST_UNSEEN),
                f"The robot cannot be started: {why}.",
                f"expected one that rests where its controller can begin, got "
                f"{dict(zip(self.measured, np.round(last, 4).tolist()))}",
                f"look at {why.look}",
            )
            self._read()
            self._wait()
            held = np.where(self.unseen > LONGEST_UNSEEN, np.nan, last)
            last = np.where(np.isfinite(self.measurement), self.measurement, held)
        return last

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
        """Read, follow, step, and write what may act; `elapsed`: s since the sample before, 0 where that is not known.

        A protective stop, which `stopped` names, ends goals. Once the drives have no power nothing is computed, and the
        inputs that are without power are written on.
        """
        self.late_samples += elapsed > 1.5 * self.period
        if not self.is_released:
            self._read()
            with self._lock:
                self._step(elapsed if self._has_begun else 0.0)
                self._has_begun = True
            self.samples += not self.is_released
        self.hardware.write(self.input)

    def restart(self) -> str:
        """Begin again after a stop, at rest at the pose that is measured; why not, or empty.

        It is called in the thread of the samples, between two of them.
        """
        if not self.stopped:
            return "the robot is not stopped"
        if not self.is_released:
            return "the robot is still being stopped: wait until its drives have no power"
        try:
            self._begin()
        except InvalidInput as error:
            return str(error)
        return ""

    def stop(self, reason: str) -> None:
        """Take the power of the drives at once; the goal ends with −4 and this reason."""
        with self._lock:
            self._end_goals(reason)
            if self.is_released:
                return
            if not self.robot.drive_kind.takes_positions:
                self.input = np.clip(0.0, self._limits.lower, self._limits.upper)
            self.is_released = True
        self.hardware.write(self.input)

    def _end_goals(self, reason: str) -> None:
        self.stopped = self.stopped or reason
        self._follower.end_all(FollowCode.PATH_TOLERANCE_VIOLATED)
        self._tell()

    def _read(self) -> None:
        read = self.hardware.read()
        y = np.full(len(self.measured), np.nan) if read is None else np.ravel(real_array(read))
        refuse_if(
            y.shape != self.unseen.shape,
            "The robot does not read what the controller needs.",
            f"expected {len(self.measured)} numbers {list(self.measured)}, got shape {y.shape}",
            "read() that returns them in this order, NaN for one that is missing",
        )
        self.measurement, self.unseen = y, np.where(np.isfinite(y), 0.0, self.unseen + 1.0)

    def _step(self, elapsed: float) -> None:
        actual, actual_velocity = self.motion[2:]
        followed = self._follower.step(actual, actual_velocity, self.speed, self.stepped.path_rate)
        self._tell()
        y = self.measurement if np.isfinite(self.measurement).any() else None
        with suppress(NumericalFailure):  # the code says it, and what acts is decided below
            self.stepped.step(y, followed.row, elapsed)
        self.step_code, self.is_released = self.stepped.code, not self.stepped.may_act()
        self.input, stop = self.stepped.output, self.stepped.stop
        if stop and not self.stopped:
            silent = [name for name, count in zip(self.measured, self.unseen) if count]
            missing = f" ({', '.join(silent)} missing)" if silent else ""
            self._end_goals(f"protective stop: {stop}{missing}; look at {stop.look}")
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
