"""A ROS 2 node that carries messages between a `TrajectoryServer` and those who send it trajectories.

It publishes `sensor_msgs/JointState` on ``joint_states`` and takes `trajectory_msgs/JointTrajectory` on
``~/joint_trajectory``. Where control_msgs is installed, it takes goals of `FollowJointTrajectory` as
``~/follow_joint_trajectory``, and publishes `DynamicJointState` on ``~/state`` and `JointTrajectoryControllerState` on
``~/controller_state``. A topic may scale its speed. Names and answers are those of the plugin for ros2_control.
"""

from __future__ import annotations

import gc
import math
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from types import ModuleType
from typing import Any, NamedTuple, TypeVar

from flexhinf.arrays import Numbers
from flexhinf.errors import InvalidInput
from flexhinf.export.compiled import CompiledController
from flexhinf.export.names import identifier_of
from flexhinf.export.realtime import stopping, undisturbed, wait_until
from flexhinf.export.ros_messages import (
    FollowAction,
    GoalHandle,
    GoalRequest,
    GoalResult,
    JointTrajectory,
    SetParameter,
    SpeedFraction,
    Stamp,
    TrajectoryPoint,
    TriggerResponse,
    goal_of,
    nanoseconds,
)
from flexhinf.export.ros_parameters import AtStart, check_at_start, goal_options, goal_parameters
from flexhinf.export.ros_state import state_groups, state_values
from flexhinf.export.trajectory_server import GoalEnd, RobotIO, TrajectoryServer
from flexhinf.loop import Controller
from flexhinf.robot import FollowCode, FollowGoal, Robot
from flexhinf.validation import optional_package, required_package

#: Between two messages of joint states, and of feedback, s.
PUBLISHED = 0.01

#: Threads of the executor: two goals of which one replaces the other, and what goes on meanwhile.
THREADS = 4

#: For how long the end of a node waits for its threads, s.
ENDING = 5.0

#: Depth of the topics' queues.
DEPTH = 10

INSTALL = (
    "source setup.bash of ROS 2 Jazzy, whose python3 then has flexhinf; or pip install ros-jazzy-rclpy "
    "ros-jazzy-sensor-msgs ros-jazzy-trajectory-msgs ros-jazzy-rmw-fastrtps-cpp"
)

#: What a node does without where it is not installed.
OPTIONAL = ("control_msgs.action", "control_msgs.msg", "std_srvs.srv")

#: A value of a parameter.
Stated = TypeVar("Stated", bound=bool | float | str)

#: Topics of control_msgs, and the types of what is published there.
REPORTS = {"state": "DynamicJointState", "controller_state": "JointTrajectoryControllerState"}


def ros_packages() -> dict[str, ModuleType]:
    """Modules of ROS 2 by name, refused before any work where they are missing; without what is `OPTIONAL`."""
    names = (
        "rclpy", "rclpy.action", "rclpy.context", "rclpy.exceptions", "rclpy.executors", "rclpy.node",
        "rcl_interfaces.msg", "sensor_msgs.msg", "std_msgs.msg", "trajectory_msgs.msg",
    )  # fmt: skip
    found: dict[str, ModuleType] = {
        name: required_package(name, "ROS 2 is not installed for this Python.", INSTALL) for name in names
    }
    optional = {name: optional_package(name) for name in OPTIONAL}
    return found | {name: module for name, module in optional.items() if module is not None}


@dataclass(eq=False)
class _OpenGoal:
    """A goal of the action until it is told how it ended."""

    handle: GoalHandle
    number: int
    is_over: threading.Event = field(default_factory=threading.Event)
    is_answered: threading.Event = field(default_factory=threading.Event)
    end: GoalEnd | None = None


@dataclass(eq=False)
class _Restart:
    """A call of ``~/restart`` until a sample answers it: why not, or empty."""

    is_over: threading.Event = field(default_factory=threading.Event)
    why: str = ""

    def answer(self, why: str) -> None:
        self.why = why
        self.is_over.set()


def _tell_of_cancels(server: Any, tell: Callable[[], None]) -> None:
    """Say when a cancel comes to an action server: rclpy tells of those alone that meet a goal."""
    take = server.take_data

    def taken() -> Mapping[str, object]:
        data: Mapping[str, object] = take()
        if "cancel" in data:
            tell()
        return data

    server.take_data = taken


class RosNode:
    """Topics and action of a `TrajectoryServer`; a context, which stops the robot and gives all back at its end.

    Parameters
    ----------
    server : TrajectoryServer
        What decides.
    name : str
        Of the node.
    clock : callable, optional
        Time of stamps, ns; by default that of the node.
    action : type, optional
        ``control_msgs.action.FollowJointTrajectory``; by default it is looked for, and left out where it is missing.
    trigger : type, optional
        ``std_srvs.srv.Trigger`` of the service ``~/restart``; likewise.

    Tolerances and times of goals that state none are parameters of the node, with names of the plugin for ros2_control.
    With ``speed_scaling_topic``, a trajectory is followed with the fraction of its speed that `std_msgs/Float64` there
    states, times ``speed_scaling_factor``; before the first message, and for what is no number, it stands still.

    Raises InvalidInput: without rclpy, sensor_msgs or trajectory_msgs; for parameters that do not fit.
    """

    def __init__(
        self,
        server: TrajectoryServer,
        name: str,
        clock: Callable[[], int] | None = None,
        action: FollowAction | None = None,
        trigger: type | None = None,
    ) -> None:
        ros = ros_packages()
        self.server, self._ros = server, ros
        self.context = ros["rclpy.context"].Context()
        ros["rclpy"].init(args=None, context=self.context)
        self.node = ros["rclpy.node"].Node(name, context=self.context)
        try:
            self._declare()
            self._scale_by(self._at_start.speed_scaling_topic)
        except InvalidInput:
            self.node.destroy_node()
            ros["rclpy"].shutdown(context=self.context)
            raise
        if server.start:
            self.node.get_logger().warning(f"{server.start}: {server.start.look}")
        self._clock = clock or (lambda: int(self.node.get_clock().now().nanoseconds))
        self._states = self.node.create_publisher(ros["sensor_msgs.msg"].JointState, "joint_states", DEPTH)
        self.node.create_subscription(
            ros["trajectory_msgs.msg"].JointTrajectory, "~/joint_trajectory", self._receive, DEPTH
        )
        self._trigger: type | None = trigger or getattr(ros.get("std_srvs.srv"), "Trigger", None)
        self._pending_restart: _Restart | None = None
        if self._trigger is not None:
            self.node.create_service(self._trigger, "~/restart", self._restart)
        self._logged, self._contested, self._groups = "", False, state_groups(server.code)
        self._passes = 0
        self._every = max(1, round(PUBLISHED / server.period))
        self._reports = {
            topic: self.node.create_publisher(getattr(ros["control_msgs.msg"], kind), f"~/{topic}", DEPTH)
            for topic, kind in REPORTS.items()
            if "control_msgs.msg" in ros
        }
        self._action: FollowAction | None = action or getattr(
            ros.get("control_msgs.action"), "FollowJointTrajectory", None
        )
        self._lock = threading.Lock()
        self._goals: list[_OpenGoal] = []
        self._open: dict[bytes, _OpenGoal] = {}
        self._is_cancelled = threading.Event()
        self._served = (
            None
            if self._action is None
            else ros["rclpy.action"].ActionServer(
                self.node,
                self._action,
                "~/follow_joint_trajectory",
                self._execute,
                goal_callback=self._consider,
                handle_accepted_callback=self._begin,
                cancel_callback=self._allow_cancel,
            )
        )
        if self._served is not None:
            _tell_of_cancels(self._served, self._is_cancelled.set)
        self._executor = ros["rclpy.executors"].MultiThreadedExecutor(THREADS, context=self.context)
        self._executor.add_node(self.node)
        self._thread = threading.Thread(target=self._spin, daemon=True)

    def _declare(self) -> None:
        """Parameters, which a file or an argument of ROS may state; later values are checked as they come."""
        self._parameters = self._stated(goal_parameters(self.server.follower))
        self._at_start = AtStart(**self._stated(AtStart()._asdict()))
        check_at_start(self._at_start)
        refused = self.server.change(goal_options(self.server.follower, self._parameters))
        if refused:
            raise InvalidInput("The parameters of goals cannot be set.", refused, "a server without goals")
        self.node.add_on_set_parameters_callback(self._set)

    def _scale_by(self, topic: str) -> None:
        """Follow with the speed that a topic states, which is none before its first message; "": with the whole."""
        if not topic:
            return
        kind = self._ros["std_msgs.msg"].Float64
        try:
            self.node.create_subscription(kind, topic, self._scale, DEPTH)
        except (ValueError, self._ros["rclpy.exceptions"].NameValidationException) as error:
            raise InvalidInput(
                "The topic of the speed scaling cannot be.",
                f"expected a name of ROS 2, got {topic!r}: {error}",
                "speed_scaling_topic:=/speed_scaling_state_broadcaster/speed_scaling",
            ) from error
        self.server.speed = math.nan

    def _stated(self, usual: Mapping[str, Stated]) -> dict[str, Stated]:
        values: dict[str, Stated] = {}
        for name, value in usual.items():
            try:
                values[name] = self.node.declare_parameter(name, value).value
            except self._ros["rclpy.exceptions"].InvalidParameterTypeException as error:
                kinds = {bool: "true or false", str: "a text", float: "a number with a point"}
                advice = f"{name}:={str(value).lower() or 'TOPIC'}"
                raise InvalidInput(
                    f"The parameter {name} is of another type.",
                    f"expected {kinds[type(value)]}, {error}",
                    advice,
                ) from error
        return values

    def _set(self, changed: Sequence[SetParameter]) -> object:
        values = self._parameters | {one.name: one.value for one in changed if one.name in self._parameters}
        late = [one.name for one in changed if one.name in AtStart._fields]
        try:
            refused = (
                f"{late[0]} is read when the node begins: start it with -p {late[0]}:=VALUE"
                if late
                else self.server.change(goal_options(self.server.follower, values))
            )
        except InvalidInput as error:
            refused = str(error)
        if not refused:
            self._parameters = values
        return self._ros["rcl_interfaces.msg"].SetParametersResult(successful=not refused, reason=refused)

    @property
    def has_action(self) -> bool:
        """Whether goals of FollowJointTrajectory are served."""
        return self._served is not None

    @property
    def can_restart(self) -> bool:
        """Whether ``~/restart`` is served."""
        return self._trigger is not None

    def __enter__(self) -> RosNode:
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        try:
            self.server.stop("the node has ended")
        finally:
            self._close()

    def _close(self) -> None:
        self._tell()
        self._answer(lambda: self.server.stopped)
        for goal in list(self._goals):  # ended by nobody, as one that came just now
            goal.end = GoalEnd(goal.number, FollowCode.PATH_TOLERANCE_VIOLATED, self.server.stopped)
            goal.is_over.set()
        over = threading.Event()
        self._executor.create_task(self._answered, over)
        over.wait(ENDING)
        self._executor.shutdown(timeout_sec=ENDING)
        self._thread.join(ENDING)
        if self._served is not None:
            self._served.destroy()
        self.node.destroy_node()
        self._ros["rclpy"].shutdown(context=self.context)

    def _answered(self, over: threading.Event) -> None:
        """A task behind those that tell clients how their goals ended."""
        for goal in tuple(self._open.values()):
            goal.is_answered.wait(ENDING)
        self._executor.create_task(over.set)

    def _spin(self) -> None:
        try:
            self._executor.spin()
        except self._ros["rclpy.executors"].ExternalShutdownException:
            pass

    # Thread of the samples -----------------------------------------------------------------------------
    def sample(self, elapsed: float = 0.0) -> None:
        """One sample of the server, and what there is to say of it."""
        goals = tuple(self._goals)
        for goal in goals:
            if goal.handle.is_cancel_requested:
                self.server.cancel(goal.number)
        if self._is_cancelled.is_set():
            self._is_cancelled.clear()
            if not goals:  # which no goal answers: it means what moves
                self.server.cancel()
        self._answer(self.server.restart)
        self.server.sample(elapsed)
        self._tell()
        if self.server.stopped != self._logged:
            self._logged = self.server.stopped
            if self._logged:
                self.node.get_logger().error(f"the robot is stopped: {self._logged}")
        if self.server.contested != self._contested:
            self._contested = self.server.contested
            if self._contested:
                self._warn_of_sources()
        self._passes += 1  # also those of a robot that is stopped
        if self._passes % self._every == 0:
            self._publish()

    def _warn_of_sources(self) -> None:
        """Who sends trajectories that replace one another."""
        found = self.node.get_publishers_info_by_topic("~/joint_trajectory")
        names = [f"{one.node_namespace.rstrip('/')}/{one.node_name}" for one in found]
        self.node.get_logger().warning(
            "trajectories of two sources replace one another: publishers of "
            f"{self.node.get_name()}/joint_trajectory are {', '.join(names) or 'none'}, beside the action's clients. "
            "Stop one of them"
        )

    def _answer(self, decide: Callable[[], str]) -> None:
        """What ``~/restart`` waits for."""
        with self._lock:
            pending, self._pending_restart = self._pending_restart, None
        if pending is not None:
            pending.answer(decide())

    def _tell(self) -> None:
        ends = {end.number: end for end in self.server.ends()}
        if not ends:
            return
        with self._lock:
            for goal in [goal for goal in self._goals if goal.number in ends]:
                self._goals.remove(goal)
                goal.end = ends[goal.number]
                goal.is_over.set()

    def _publish(self) -> None:
        motion, stamp = self.server.motion, self.node.get_clock().now().to_msg()
        message = self._ros["sensor_msgs.msg"].JointState()
        message.header.stamp, message.name = stamp, list(self.server.robot.joint_names)
        message.position, message.velocity = motion.actual.tolist(), motion.actual_velocity.tolist()
        self._states.publish(message)
        self._report(stamp, message.name)
        for goal in tuple(self._goals):
            if self._action is None or not goal.handle.is_active:
                continue
            feedback = self._action.Feedback()
            feedback.header.stamp, feedback.joint_names = stamp, message.name
            self._fill(feedback.desired, feedback.actual, feedback.error)
            goal.handle.publish_feedback(feedback)

    def _fill(self, *points: TrajectoryPoint) -> None:
        """Where the links are to be, where they are, and the difference."""
        for place, numbers in zip(points, self.server.motion.pairs, strict=True):
            place.positions, place.velocities = (row.tolist() for row in numbers)

    def _report(self, stamp: Stamp, joints: list[str]) -> None:
        """What the plugin publishes too."""
        if publisher := self._reports.get("state"):
            messages = self._ros["control_msgs.msg"]
            whole = messages.DynamicJointState(joint_names=list(self._groups))
            whole.header.stamp = stamp
            whole.interface_values = [
                messages.InterfaceValue(interface_names=names, values=values.tolist())
                for names, values in zip(self._groups.values(), state_values(self.server), strict=True)
            ]
            publisher.publish(whole)
        if publisher := self._reports.get("controller_state"):
            of_motion = self._ros["control_msgs.msg"].JointTrajectoryControllerState(joint_names=joints)
            of_motion.header.stamp = stamp
            self._fill(of_motion.reference, of_motion.feedback, of_motion.error)
            of_motion.output.effort = self.server.input.tolist()
            publisher.publish(of_motion)

    # Threads of the executor ---------------------------------------------------------------------------
    def _receive(self, message: JointTrajectory) -> None:
        try:
            goal = goal_of(message, self._clock())
        except InvalidInput as error:
            self.node.get_logger().warning(f"a trajectory is ignored: {error}")
            return
        if why := self.server.refusal(goal):
            self.node.get_logger().warning(f"a trajectory is ignored: {why}")
        else:
            self.server.submit(goal)

    def _restart(self, request: object, response: TriggerResponse) -> TriggerResponse:
        """Wait for the sample that begins again."""
        with self._lock:
            pending = self._pending_restart = _Restart()
        if not pending.is_over.wait(ENDING):
            self._answer(lambda: "no sample came: the loop of the robot does not run")
            pending.is_over.wait()
        response.success = not pending.why
        response.message = pending.why or "it begins at rest at the measured pose"
        return response

    def _scale(self, message: SpeedFraction) -> None:
        self.server.speed = self._at_start.speed_scaling_factor * message.data

    def _wanted(self, request: GoalRequest) -> FollowGoal:
        tolerances = request.path_tolerance, request.goal_tolerance
        time_allowed = 1e-9 * nanoseconds(request.goal_time_tolerance)
        return goal_of(request.trajectory, self._clock(), tolerances, time_allowed)

    def _consider(self, request: GoalRequest) -> object:
        answers = self._ros["rclpy.action"].GoalResponse
        try:
            why = self.server.refusal(self._wanted(request))
        except InvalidInput as error:
            why = str(error)
        if why:
            self.node.get_logger().warning(f"a goal is rejected: {why}")
        return answers.REJECT if why else answers.ACCEPT

    def _begin(self, handle: GoalHandle) -> None:
        wanted = self._wanted(handle.request)
        with self._lock:  # before the loop tells how it ended
            goal = _OpenGoal(handle, self.server.submit(wanted))
            self._goals.append(goal)
            self._open[bytes(handle.goal_id.uuid)] = goal
        handle.execute()

    def _allow_cancel(self, handle: GoalHandle) -> object:
        """Always; the next sample sees that the goal is cancelled."""
        return self._ros["rclpy.action"].CancelResponse.ACCEPT

    def _execute(self, handle: GoalHandle) -> GoalResult:
        """Wait for the end of a goal, in a thread of its own."""
        goal = self._open[bytes(handle.goal_id.uuid)]
        goal.is_over.wait()
        end = goal.end
        assert end is not None
        assert self._action is not None
        result = self._action.Result()
        result.error_code, result.error_string = int(end.code), end.text
        if handle.is_cancel_requested:
            handle.canceled()
        elif end.code is FollowCode.SUCCESSFUL:
            handle.succeed()
        else:
            handle.abort()
        self._open.pop(bytes(handle.goal_id.uuid), None)
        goal.is_answered.set()
        return result


# The loop -------------------------------------------------------------------------------------------------
class RosRun(NamedTuple):
    """How a node of `run_ros` ended: samples, those that came later than a period, why the robot was stopped (empty
    where it was not), the signal that ended it (None at the end of the duration), and what the system permitted."""

    samples: int
    late: int
    stopped: str
    ended_by: int | None
    scheduling: tuple[str, ...]


def node_name(robot: Robot) -> str:
    """Of a robot's node: its name, with underscores where ROS 2 takes no other character."""
    return identifier_of(robot.name).lower()


def run_ros(
    controller: Controller,
    robot: Robot,
    hardware: RobotIO,
    *,
    library: CompiledController | None = None,
    pose: Numbers = None,
    name: str | None = None,
    duration: float | None = None,
    real_time: bool = True,
    timed: bool = True,
    priority: int | None = None,
    core: int | None = None,
    watch: Callable[[], bool] | None = None,
    ready: Callable[[RosNode], None] | None = None,
) -> RosRun:
    """Run a controller as a ROS 2 node that follows trajectories, until Ctrl-C or the end of `duration`.

    First `hardware` is read for 50 ms, and nothing is written: a robot that does not rest where its controller can
    begin is refused, see `Controller.at_rest`. Then it is read each period, the controller steps, and what
    `Controller.may_act` lets act is written. Where a sample is late, the next one is due a period after it. A
    protective stop ends the goal with −4, and drives without power get 0 (those that take positions the last input) for
    as long as the node goes on; so does the end of the node, at once. After a stop the node waits for ``~/restart``,
    which begins again as above; where std_srvs, which that needs, is not installed, it ends. Tolerances and times of
    goals that state none are parameters of the node, which may be set while no trajectory is followed.

    Parameters
    ----------
    controller : Controller
        For the workspace of `robot`.
    hardware : object
        With ``read()``, which returns the measurement (p,) in the order of ``controller.measured``, SI units, NaN for
        one that is missing; and ``write(input)``, of the inputs (m,).
    library : CompiledController, optional
        Steps instead of the controller, of which it was compiled; it then checks the period too.
    pose : (n,), optional
        Link positions where the robot rests, rad or m; by default from what is read.
    name : str, optional
        Of the node; by default the robot's.
    duration : float, optional
        s.
    real_time : bool
        Whether samples wait for the clock.
    timed : bool
        Whether the robot moves by the clock, as real ones do; not one that a period simulates.
    priority, core, watch
        As for `flexhinf.run_realtime`.
    ready : callable, optional
        Called with the node when its topics are there.

    Raises InvalidInput: without ROS 2 or a C compiler; for a controller of one pose; a library of another controller;
    a pose that is not known; a robot that cannot be started; or where read() returns another number of measurements.

    Examples
    --------
    >>> import flexhinf as fh
    >>> class Drives:  # your own, with the numbers of your bus
    ...     def read(self):
    ...         return [0.0, 0.0]  # as in controller.measured
    ...
    ...     def write(self, input):
    ...         self.sent = input
    >>> def follow(folder):  # until Ctrl-C
    ...     design = fh.load_design(folder)
    ...     return fh.run_ros(design.controller(), design.robot, Drives())
    """
    ros_packages()
    wait = partial(time.sleep, controller.period) if timed and real_time else None
    server = TrajectoryServer(controller, robot, hardware, library=library, pose=pose, wait=wait)
    period, late, passes = server.period, 0, 0
    most = None if duration is None else round(duration / period)
    frame = max(1, round(1.0 / 30.0 / period))
    with (
        RosNode(server, node_name(robot) if name is None else name) as node,
        undisturbed(priority, core) as scheduling,
        stopping() as request,
    ):
        gc.enable()  # a node runs for hours
        if ready is not None:
            ready(node)
        step, due, before = round(1e9 * period), time.perf_counter_ns(), 0
        while not request and passes != most and (node.can_restart or not server.is_released):
            passes += 1
            now = wait_until(due) if real_time else time.perf_counter_ns()
            node.sample(1e-9 * (now - before) if timed and real_time and before else 0.0)
            is_late = time.perf_counter_ns() > due + step
            due, before, late = (now if is_late else due) + step, now, late + is_late
            if watch is not None and passes % frame == 0 and not watch():
                request.append(0)
        run = RosRun(server.samples, late, server.stopped, request[0] if request else None, scheduling)
    return run
