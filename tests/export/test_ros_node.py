"""The node in a real ROS 2 on this machine alone: a client sends trajectories as MoveIt does.

The robot's time goes on with samples that the test makes, and not with a clock.
"""

from __future__ import annotations

import os
import queue
import threading
from collections.abc import Callable, Iterator, Sequence
from importlib import import_module
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from tests.export.test_rest import robot_of
from tests.export.test_ros2 import flat, workspace_controller
from tests.export.test_trajectory_server import Arm
from tests.export.trajectory_session import GOAL, JOINTS, LONGEST, MOVE, START
from tests.refusals import refused_with, unnamed
from tests.ros_action import action_type, trigger_type

from flexhinf.errors import InvalidInput
from flexhinf.export import ros_node, trajectory_server
from flexhinf.export.compiled_follower import CompiledFollower, compile_follower
from flexhinf.export.controller_c import code_of
from flexhinf.export.rendering import render_c
from flexhinf.export.ros2 import ros2_values
from flexhinf.export.ros_node import RosNode, goal_of, run_ros
from flexhinf.export.trajectory_server import TrajectoryServer

yaml = pytest.importorskip("yaml")
rclpy = pytest.importorskip("rclpy", reason="not in the locks: rclpy of ROS 2")
pytest.importorskip("mujoco")
pytestmark = [
    pytest.mark.usefixtures("unoptimised"),
    pytest.mark.ci("nodes of ROS 2, and a follower that is compiled once"),
    pytest.mark.filterwarnings("ignore:module 'sre_:DeprecationWarning"),  # lark 0.12, which the wheels take
]

#: How long a message may take on a machine that is busy, s; none is awaited by sleeping.
PATIENCE = 60.0

SUCCEEDED, CANCELED, ABORTED = 4, 5, 6


@pytest.fixture(scope="module", autouse=True)
def local() -> Iterator[None]:
    """Nothing leaves this machine, and other nodes on it have another domain."""
    settings = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_DOMAIN_ID": str(1 + os.getpid() % 100)}
    with pytest.MonkeyPatch.context() as patch:
        for name, value in settings.items():
            patch.setenv(name, value)
        yield


@pytest.fixture(scope="module")
def follower() -> CompiledFollower:
    return compile_follower(code_of(workspace_controller(), "arm", "double", robot_of("planar-two-link")))


@pytest.fixture(scope="module")
def action(tmp_path_factory: pytest.TempPathFactory) -> Any:
    return action_type(tmp_path_factory.mktemp("control_msgs"))


@pytest.fixture(scope="module")
def trigger(tmp_path_factory: pytest.TempPathFactory) -> Any:
    return trigger_type(tmp_path_factory.mktemp("std_srvs"))


def settled(future: Any) -> Any:
    """The result of a future of a client, which another thread spins."""
    done = threading.Event()
    future.add_done_callback(lambda _: done.set())
    assert done.wait(PATIENCE), "no answer"
    return future.result()


def message(package: str, name: str) -> Any:
    """A type of messages."""
    return getattr(import_module(f"{package}.msg"), name)


def controller_parameters() -> str:
    """The plugin's file of parameters for the same controller."""
    code = code_of(workspace_controller(), "arm", "double", robot_of("planar-two-link"))
    values = {**code.values, "follows": True, **ros2_values(code, np.zeros(1))}
    return render_c("ros2/controller.yaml", "arm", code.real, **values)


class Client:
    """Another node, with a thread of its own."""

    def __init__(self, action: Any, node: str) -> None:
        self.type = action
        self.context = rclpy.context.Context()
        rclpy.init(context=self.context)
        self.node = rclpy.create_node("planner", context=self.context)
        self.states: queue.Queue[Any] = queue.Queue()
        self.node.create_subscription(
            message("sensor_msgs", "JointState"), "joint_states", self.states.put, 10
        )
        self.topic = self.node.create_publisher(
            message("trajectory_msgs", "JointTrajectory"), f"{node}/joint_trajectory", 10
        )
        self.status: queue.Queue[Any] = queue.Queue()
        self.node.create_subscription(
            message("action_msgs", "GoalStatusArray"),
            f"{node}/follow_joint_trajectory/_action/status",
            self.status.put,
            10,
        )
        self.reports: dict[str, queue.Queue[Any]] = {
            "state": queue.Queue(),
            "controller_state": queue.Queue(),
        }
        for topic, kind in (
            ("state", "DynamicJointState"),
            ("controller_state", "JointTrajectoryControllerState"),
        ):
            self.node.create_subscription(
                message("control_msgs", kind), f"{node}/{topic}", self.reports[topic].put, 10
            )
        self.action = import_module("rclpy.action").ActionClient(
            self.node, action, f"{node}/follow_joint_trajectory"
        )
        self.feedback: queue.Queue[Any] = queue.Queue()
        self.executor = rclpy.executors.SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.thread = threading.Thread(target=self.executor.spin, daemon=True)
        self.thread.start()
        assert self.action.wait_for_server(PATIENCE)

    def trajectory(self, times: Any, rows: Any, joints: Sequence[str] = JOINTS) -> Any:
        def point(time: float, row: Any) -> Any:
            whole = int(time)
            at = message("builtin_interfaces", "Duration")(sec=whole, nanosec=round(1e9 * (time - whole)))
            return message("trajectory_msgs", "JointTrajectoryPoint")(
                positions=[float(x) for x in row], time_from_start=at
            )

        return message("trajectory_msgs", "JointTrajectory")(
            joint_names=list(joints), points=list(map(point, times, rows))
        )

    def send(self, trajectory: Any, **other: Any) -> Any:
        """The handle of a goal."""
        goal = self.type.Goal(trajectory=trajectory, **other)
        return settled(self.action.send_goal_async(goal, feedback_callback=self.feedback.put))

    def close(self) -> None:
        self.executor.shutdown(timeout_sec=PATIENCE)
        self.action.destroy()
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)
        self.thread.join(PATIENCE)


class Served:
    """An arm, its node, and a client."""

    def __init__(self, action: Any, trigger: Any = None) -> None:
        self.arm = Arm()
        self.server = TrajectoryServer(workspace_controller(), self.arm.robot, self.arm)
        self.node = RosNode(self.server, "arm", action=action, trigger=trigger)
        self.node.__enter__()
        self.client = Client(action, "arm")
        self.is_open = True

    def run(self, samples: int) -> None:
        for _ in range(samples):
            self.node.sample()

    def at(self, goal: Sequence[float] | np.ndarray) -> None:
        np.testing.assert_allclose(self.arm.plant.state()[:2], goal, atol=2e-3)

    def end(self) -> None:
        if self.is_open:
            self.is_open = False
            self.node.__exit__()


@pytest.fixture
def served(action: Any, follower: CompiledFollower, monkeypatch: pytest.MonkeyPatch) -> Iterator[Served]:
    def again(code: Any) -> CompiledFollower:
        return CompiledFollower(follower._library, follower.follower, np.float64)

    monkeypatch.setattr(trajectory_server, "compile_follower", again)
    one = Served(action)
    yield one
    one.end()
    one.client.close()


def outcome(handle: Any, done: Any = None) -> tuple[int, int, str]:
    found = settled(done or handle.get_result_async())
    return found.status, found.result.error_code, found.result.error_string


def test_a_goal_is_followed_with_feedback_and_joint_states(served: Served) -> None:
    """Names in another order; what is published is where the links are."""
    shuffled = served.client.trajectory(MOVE[0], [row[::-1] for row in np.array(MOVE[1])], JOINTS[::-1])
    handle = served.client.send(shuffled)
    assert handle.accepted
    served.run(LONGEST)
    assert outcome(handle)[:2] == (SUCCEEDED, 0)
    served.at(GOAL)
    feedback = served.client.feedback.get(timeout=PATIENCE).feedback
    assert feedback.joint_names == list(JOINTS)
    kinds = (feedback.desired, feedback.actual, feedback.error)
    desired, actual, error = (np.array([one.positions, one.velocities]) for one in kinds)
    np.testing.assert_allclose(error, desired - actual, atol=1e-12)
    served.run(10)
    state = served.client.states.get(timeout=PATIENCE)
    while not np.allclose(state.position, GOAL, atol=2e-3):
        state = served.client.states.get(timeout=PATIENCE)
    assert state.name == list(JOINTS)


def latest(reports: queue.Queue[Any], served: Served) -> Any:
    """The first report from now on: another sample may be on its way."""
    while not reports.empty():
        reports.get()
    assert until(served, lambda: reports.qsize() > 2)
    return [reports.get() for _ in range(3)][-1]


def test_the_state_is_published_with_the_names_of_the_plugin(served: Served) -> None:
    """Groups and numbers of its template; in motion, at rest, and after a fault."""
    code = code_of(workspace_controller(), "arm", "double", robot_of("planar-two-link"))
    handle = served.client.send(served.client.trajectory(*MOVE))
    served.run(500)
    found = latest(served.client.reports["state"], served)
    numbers = {
        group: dict(zip(one.interface_names, one.values, strict=True))
        for group, one in zip(found.joint_names, found.interface_values, strict=True)
    }
    health = [row["name"] for row in ros2_values(code, np.zeros(1))["health"]]
    assert list(numbers["health"]) == health
    assert list(numbers) == ["health", "input", "measured", "estimate", "desired", "actual", "error"]
    for group, kind in (("input", "U"), ("measured", "Y"), ("estimate", "X")):
        assert list(numbers[group]) == list(code.signals[kind])
    assert numbers["health"]["code"] == code.codes["OK"].value
    assert numbers["health"]["path_rate"] == 1.0
    assert numbers["health"]["stopped"] == numbers["health"]["unseen.link_position_elbow"] == 0.0
    assert abs(numbers["desired"]["velocity_shoulder"]) > 0.1
    for name, error in numbers["error"].items():
        assert error == pytest.approx(numbers["desired"][name] - numbers["actual"][name], abs=1e-12)
        kind, joint = name.split("_")
        assert numbers["actual"][name] == numbers["estimate"][f"link_{kind}_{joint}"]
    state = latest(served.client.reports["controller_state"], served)
    assert state.joint_names == list(JOINTS)
    kinds = (state.reference, state.feedback, state.error)
    reference, feedback, error = (np.array([one.positions, one.velocities]) for one in kinds)
    np.testing.assert_allclose(error, reference - feedback, atol=1e-12)
    assert len(state.output.effort) == 2
    served.run(LONGEST)
    assert outcome(handle)[:2] == (SUCCEEDED, 0)
    served.arm.unplugged = [0, 1, 2, 3]
    served.run(20)
    found = latest(served.client.reports["state"], served)
    stopped = dict(zip(health, found.interface_values[0].values, strict=True))
    assert stopped["stopped"] == 1.0
    assert stopped["code"] == code.codes["PREDICTED"].value
    assert stopped["unseen.link_position_elbow"] == 11.0
    assert np.isnan(found.interface_values[2].values).all()


def test_a_goal_is_cancelled_at_speed(served: Served) -> None:
    handle = served.client.send(served.client.trajectory(*MOVE))
    served.run(500)
    assert np.abs(served.server.motion.desired_velocity).min() > 0.1
    assert settled(handle.cancel_goal_async()).goals_canceling
    served.run(1)
    assert outcome(handle)[:2] == (CANCELED, 0)
    assert np.abs(served.server.motion.desired_velocity).min() > 0.1
    served.run(700)
    assert not served.server.motion.desired_velocity.any()
    served.at(served.server.motion.desired)


def test_a_goal_is_replaced_at_speed_and_by_the_topic(served: Served) -> None:
    first = served.client.send(served.client.trajectory(*MOVE))
    served.run(300)
    second = served.client.send(served.client.trajectory([1.0], [START]))
    served.run(1)
    assert outcome(first)[:2] == (ABORTED, -1)
    served.run(200)
    served.client.topic.publish(served.client.trajectory([1.0], [GOAL]))
    done = second.get_result_async()
    assert until(served, done.done)
    assert outcome(second, done)[:2] == (ABORTED, -1)
    served.run(LONGEST)
    served.at(GOAL)


def cancel_all(served: Served) -> int:
    """How many goals a cancel of all meets."""
    service = import_module("action_msgs.srv").CancelGoal
    name = "arm/follow_joint_trajectory/_action/cancel_goal"
    client = served.client.node.create_client(service, name)
    assert client.wait_for_service(PATIENCE)
    found = settled(client.call_async(service.Request()))
    served.client.node.destroy_client(client)
    return len(found.goals_canceling)


def test_a_cancel_without_an_open_goal_stops_what_moves(served: Served) -> None:
    """That of the topic; a goal that comes later is followed."""
    served.client.topic.publish(served.client.trajectory(*MOVE))
    assert until(served, lambda: bool(np.abs(served.server.motion.desired_velocity).min() > 0.1))
    assert cancel_all(served) == 0
    served.run(900)
    assert not served.server.motion.desired_velocity.any()
    with pytest.raises(AssertionError):
        served.at(GOAL)
    handle = served.client.send(served.client.trajectory(*MOVE))
    served.run(LONGEST)
    assert outcome(handle)[:2] == (SUCCEEDED, 0)


def test_a_goal_that_cannot_start_does_not_end_the_one_under_way(served: Served) -> None:
    """The first goes on, and a cancel of all meets it alone."""
    first = served.client.send(served.client.trajectory(*MOVE))
    served.run(400)
    second = served.client.send(served.client.trajectory([0.005, 1.0], [np.add(GOAL, 0.5), GOAL]))
    assert second.accepted
    served.run(2)
    assert outcome(second)[:2] == (ABORTED, -1)
    assert np.abs(served.server.motion.desired_velocity).min() > 0.1
    assert cancel_all(served) == 1
    served.run(2)
    assert outcome(first)[:2] == (CANCELED, 0)
    served.run(900)
    assert not served.server.motion.desired_velocity.any()


def test_two_publishers_that_fight_are_named(served: Served, capfd: pytest.CaptureFixture[str]) -> None:
    """In the log and in the health; one alone is not."""
    other = rclpy.create_node("servo", context=served.client.context)
    kind = message("trajectory_msgs", "JointTrajectory")
    servo = other.create_publisher(kind, "arm/joint_trajectory", 10)
    places = [np.add(START, 0.2), np.add(START, -0.2)]
    assert until(served, lambda: served.node.node.count_publishers("arm/joint_trajectory") == 2)
    for k in range(60):
        before = served.server._numbers
        publisher = (served.client.topic, servo)[k % 2]
        publisher.publish(served.client.trajectory([0.8], [places[k % 2]]))
        assert until(served, lambda before=before: served.server._numbers > before)
        served.run(40)
        if served.server.contested:
            break
    served.run(20)
    code = code_of(workspace_controller(), "arm", "double", robot_of("planar-two-link"))
    health = [row["name"] for row in ros2_values(code, np.zeros(1))["health"]]
    report = latest(served.client.reports["state"], served)
    assert dict(zip(health, report.interface_values[0].values))["contested"] == 1.0
    assert unnamed(capfd.readouterr().err, "two sources", "/planner", "/servo") == []
    other.destroy_node()


def until(served: Served, condition: Callable[[], bool]) -> bool:
    """Samples until a message has come; the robot rests or moves meanwhile, however many they are."""
    over = threading.Event()
    timer = threading.Timer(PATIENCE, over.set)
    timer.start()
    while not condition() and not over.is_set():
        served.run(1)
    timer.cancel()
    return condition()


@pytest.mark.parametrize(
    ("times", "rows", "joints"),
    [([1.0], [GOAL], ("shoulder", "wrist")), ([0.5, 0.4], [START, GOAL], JOINTS), ([], [], JOINTS)],
)
def test_what_cannot_be_followed_is_rejected(
    times: Any, rows: Any, joints: Sequence[str], served: Served
) -> None:
    assert not served.client.send(served.client.trajectory(times, rows, joints)).accepted


def test_efforts_and_tolerances_of_accelerations_are_rejected(served: Served) -> None:
    trajectory = served.client.trajectory(*MOVE)
    tolerance = message("control_msgs", "JointTolerance")(name="elbow", acceleration=1.0)
    assert not served.client.send(trajectory, path_tolerance=[tolerance]).accepted
    trajectory.points[0].velocities = [0.1, 0.2]
    assert goal_of(trajectory, 0).orders.tolist() == [2, 1]
    trajectory.points[0].velocities = []
    trajectory.points[0].effort = [1.0, 1.0]
    assert not served.client.send(trajectory).accepted


def test_tolerances_a_fault_and_the_end_of_the_node_are_told(served: Served) -> None:
    tight = message("control_msgs", "JointTolerance")(name="elbow", position=1e-6)
    handle = served.client.send(served.client.trajectory(*MOVE), path_tolerance=[tight])
    served.run(LONGEST)
    assert outcome(handle)[:2] == (ABORTED, -4)
    handle = served.client.send(served.client.trajectory(*MOVE))
    served.run(300)
    served.arm.unplugged = [2]
    served.run(12)
    status, code, text = outcome(handle)
    assert (status, code) == (ABORTED, -4)
    assert unnamed(text, "motor_position_shoulder") == []
    assert not served.client.send(served.client.trajectory(*MOVE)).accepted


def test_the_end_of_the_node_ends_its_goal(served: Served) -> None:
    handle = served.client.send(served.client.trajectory(*MOVE))
    served.run(300)
    served.end()
    statuses: list[int] = []
    while ABORTED not in statuses:
        statuses = [one.status for one in served.client.status.get(timeout=PATIENCE).status_list]
    assert handle.accepted
    assert np.array_equal(served.arm.inputs[-1], [0.0, 0.0])


def set_parameters(served: Served, **values: Any) -> list[tuple[bool, str]]:
    """As `ros2 param set` sets them; dots are two underscores."""
    client = served.client.node.create_client(service("SetParameters"), "arm/set_parameters")
    assert client.wait_for_service(PATIENCE)
    parameter = import_module("rclpy.parameter").Parameter
    stated = [
        parameter(name.replace("__", "."), value=value).to_parameter_msg() for name, value in values.items()
    ]
    answers = settled(client.call_async(service("SetParameters").Request(parameters=stated))).results
    served.client.node.destroy_client(client)
    return [(answer.successful, answer.reason) for answer in answers]


def service(name: str) -> Any:
    return getattr(import_module("rcl_interfaces.srv"), name)


def test_parameters_of_goals_are_those_of_the_plugin(served: Served) -> None:
    """With their names and values, but for what belongs to interfaces; each answer is that of a goal."""
    stated = yaml.safe_load(controller_parameters())["arm_controller"]["ros__parameters"]
    kinds = ("allow_partial_joints_goal", "cmd_timeout", "stop_time", "constraints")
    expected = dict(flat({name: stated[name] for name in kinds}))
    found = {name: served.node.node.get_parameter(name).value for name in expected}
    assert found == expected
    partial = served.client.trajectory([1.0], [GOAL[:1]], JOINTS[:1])
    assert not served.client.send(partial).accepted
    assert set_parameters(served, allow_partial_joints_goal=True) == [(True, "")]
    handle = served.client.send(partial)
    assert handle.accepted
    served.run(300)
    ((done, why),) = set_parameters(served, stop_time=0.1)
    assert not done
    assert unnamed(why, "followed", "cancel") == []
    served.run(LONGEST - 300)
    assert outcome(handle)[:2] == (SUCCEEDED, 0)
    served.at((GOAL[0], START[1]))


def test_a_parameter_that_does_not_fit_is_refused_and_changes_nothing(served: Served) -> None:
    follower = served.server.follower
    ((done, why),) = set_parameters(served, constraints__elbow__goal=float("nan"))
    assert not done
    assert unnamed(why, "expected", "got") == []
    assert served.server.follower is follower
    assert set_parameters(served, stop_time=0.25) == [(True, "")]
    assert served.server.follower.stop_time == 0.25


def test_arguments_of_ros_state_parameters_and_one_of_another_type_is_refused(
    follower: CompiledFollower, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As a launch file or a file of parameters does it; the advice is taken."""
    monkeypatch.setattr(trajectory_server, "compile_follower", lambda code: follower)
    arm = Arm()
    server = TrajectoryServer(workspace_controller(), arm.robot, arm)
    monkeypatch.setattr("sys.argv", ["run", "--ros-args", "-p", "stop_time:=1"])
    with refused_with(InvalidInput, "stop_time", "point", "stop_time:=0.5"):
        RosNode(server, "arm")
    monkeypatch.setattr("sys.argv", ["run", "--ros-args", "-p", "stop_time:=0.3"])
    with RosNode(server, "arm"):
        assert server.follower.stop_time == pytest.approx(0.3)


def finished(served: Served, handle: Any) -> tuple[int, int, str]:
    """How a goal ends, however late it is begun."""
    done = handle.get_result_async()
    assert until(served, done.done)
    return outcome(handle, done)


def test_a_topic_scales_the_speed(
    follower: CompiledFollower, action: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In percent, as broadcasters of drivers publish it; nothing moves before the first message."""
    monkeypatch.setattr(trajectory_server, "compile_follower", lambda code: follower)
    monkeypatch.setattr("sys.argv", ["run", "--ros-args", "-p", "speed_scaling_factor:=0.0"])
    arm = Arm()
    server = TrajectoryServer(workspace_controller(), arm.robot, arm)
    with refused_with(InvalidInput, "speed scaling", "above 0", "speed_scaling_factor:=0.01"):
        RosNode(server, "arm")
    monkeypatch.setattr("sys.argv", ["run", "--ros-args", "-p", "speed_scaling_topic:='a topic'"])
    with refused_with(InvalidInput, "a topic", "speed_scaling_topic:="):
        RosNode(server, "arm")
    assert server.speed == 1.0
    stated = ("-p", "speed_scaling_topic:=/scaling", "-p", "speed_scaling_factor:=0.01")
    monkeypatch.setattr("sys.argv", ["run", "--ros-args", *stated])
    one = Served(action)
    try:
        scaling = one.client.node.create_publisher(message("std_msgs", "Float64"), "/scaling", 10)
        handle = one.client.send(one.client.trajectory(*MOVE))
        one.run(300)
        one.at(START)
        scaling.publish(message("std_msgs", "Float64")(data=50.0))
        assert until(one, lambda: one.server.speed == 0.5)
        one.run(1100)
        assert not handle.get_result_async().done()
        assert finished(one, handle)[:2] == (SUCCEEDED, 0)
        ((done, why),) = set_parameters(one, speed_scaling_topic="/other")
        assert not done
        assert unnamed(why, "speed_scaling_topic", "-p") == []
    finally:
        one.end()
        one.client.close()


def test_the_arm_begins_again_after_a_fault(
    follower: CompiledFollower, action: Any, trigger: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its drives lost their power; a call before that is refused."""
    monkeypatch.setattr(trajectory_server, "compile_follower", lambda code: follower)
    one = Served(action, trigger)
    calls = one.client.node.create_client(trigger, "arm/restart")

    def call() -> tuple[bool, str]:
        future = calls.call_async(trigger.Request())
        assert until(one, future.done)
        return future.result().success, future.result().message

    try:
        assert calls.wait_for_service(PATIENCE)
        success, why = call()
        assert not success
        assert unnamed(why, "stopped") == []
        handle = one.client.send(one.client.trajectory(*MOVE))
        one.run(300)
        one.arm.unplugged = [2]
        assert until(one, lambda: bool(one.server.stopped))
        one.run(20)
        assert outcome(handle)[:2] == (ABORTED, -4)
        assert not np.any(one.arm.inputs[-1])
        one.arm.unplugged = []
        one.arm.plant.reset(one.arm.robot.operating_point(START)[0])
        assert call()[0]
        handle = one.client.send(one.client.trajectory(*MOVE))
        assert finished(one, handle)[:2] == (SUCCEEDED, 0)
        one.at(GOAL)
    finally:
        one.end()
        one.client.close()


@pytest.mark.parametrize("serves", [False, True])
def test_a_run_after_a_fault_waits_where_it_can_begin_again(
    serves: bool, follower: CompiledFollower, trigger: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(trajectory_server, "compile_follower", lambda code: follower)
    packages, served = ros_node.ros_packages, SimpleNamespace(Trigger=trigger) if serves else None
    monkeypatch.setattr(ros_node, "ros_packages", lambda: {**packages(), "std_srvs.srv": served})
    arm = Arm()

    def unplug(node: RosNode) -> None:
        assert node.can_restart is serves
        arm.unplugged = [3]

    run = run_ros(workspace_controller(), arm.robot, arm, duration=0.1, real_time=False, ready=unplug)
    assert (run.samples, run.ended_by) == (10, None)
    assert "motor_position_elbow" in run.stopped
    assert len(arm.inputs) == (100 if serves else 11)


def test_a_run_ends_with_its_duration_and_lets_go(
    follower: CompiledFollower, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(trajectory_server, "compile_follower", lambda code: follower)
    arm, names = Arm(), []
    run = run_ros(
        workspace_controller(), arm.robot, arm, duration=0.05, real_time=False,
        ready=lambda node: names.append(node.node.get_name()),
    )  # fmt: skip
    assert (run.samples, run.stopped, run.ended_by) == (50, "", None)
    assert names == ["planar_two_link"]
    assert len(arm.inputs) == 51
    assert np.array_equal(arm.inputs[-1], [0.0, 0.0])
