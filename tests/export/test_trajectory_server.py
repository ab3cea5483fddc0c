"""A controller that follows trajectories on an object with read() and write(), without ROS."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest
from tests.export.test_rest import elastic_controller, robot_of
from tests.export.test_ros2 import PERIOD, workspace_controller
from tests.export.trajectory_cases import CASES, TrajectoryCase
from tests.export.trajectory_runs import RUNS
from tests.export.trajectory_session import GOAL, JOINTS, LONGEST, MOVE, START, Followed
from tests.refusals import refused_with, unnamed

import flexhinf as fh
from flexhinf.errors import InvalidInput
from flexhinf.export import protected, trajectory_server
from flexhinf.export.compiled_follower import CompiledFollower, compile_follower
from flexhinf.export.controller_c import code_of
from flexhinf.export.ros_parameters import AtStart, check_at_start, goal_options, goal_parameters
from flexhinf.export.trajectory_server import TrajectoryServer, measured_pose
from flexhinf.loop import Start, Stop
from flexhinf.robot import FollowCode, FollowGoal, MuJoCoPlant

pytest.importorskip("mujoco")
pytestmark = [
    pytest.mark.usefixtures("unoptimised"),
    pytest.mark.ci("compiles one follower, and moves a robot with MuJoCo"),
]


class Arm:
    """MuJoCo's robot, whose time goes on by a period with each input."""

    def __init__(self, pose: Sequence[float] = START) -> None:
        self.robot = robot_of("planar-two-link")
        self.plant = MuJoCoPlant(self.robot, ("link_position", "motor_position"))
        self.plant.reset(self.robot.operating_point(pose)[0])
        self.unplugged: list[int] = []
        self.is_held = False
        self.inputs: list[np.ndarray] = []

    def read(self) -> np.ndarray:
        y = np.array(self.plant.output(), dtype=float)
        y[self.unplugged] = math.nan
        return y

    def write(self, input: np.ndarray) -> None:
        self.inputs.append(np.array(input))
        if not self.is_held:
            self.plant.step(input, [], PERIOD)


class ServedArm(Followed):
    """An arm and its server, used as `Session` of the plugin's tests is."""

    def __init__(self, controller: fh.Controller, pose: Sequence[float] = START, **other: Any) -> None:
        self.arm = Arm(pose)
        self.server = TrajectoryServer(controller, self.arm.robot, self.arm, **other)
        self.measured: list[np.ndarray] = []
        self.desired: list[list[float]] = []
        self.ends: dict[int, tuple[str, int]] = {}
        self.texts: dict[int, str] = {}
        self.number, self.cancelled = 0, set[int]()

    def goal(
        self, times: Any, *rows: Any, joints: Sequence[str] = JOINTS, begins: float = math.nan, goal_time: float = 0.0,
        path: Sequence[tuple[str, float, float]] = (), at_goal: Sequence[tuple[str, float, float]] = (),
    ) -> None:  # fmt: skip
        stacked = [[None if row is None else np.reshape(row, len(joints)) for row in part] for part in rows]
        tolerances = ({name: pair for name, *pair in several} for several in (path, at_goal))
        self.prepared = FollowGoal(
            list(joints), list(times), *(stacked or [np.zeros((0, len(joints)))]),
            begins=0.0 if math.isnan(begins) else begins,
            **dict(zip(("path_tolerance", "goal_tolerance"), tolerances)), goal_time=goal_time,
        )  # fmt: skip

    def accepted(self) -> bool:
        if self.server.refusal(self.prepared):
            return False
        self.number = self.server.submit(self.prepared)
        return True

    def manager(self, name: str, *arguments: Any) -> int:
        if name == "cancel_goal":
            self.server.cancel(self.number)
            self.cancelled.add(self.number)
        elif name == "cancel_nothing":
            self.server.cancel()
        elif name == "publish_trajectory":
            self.server.submit(self.prepared)
        elif name == "look_at":
            self.number = arguments[0].value
        else:
            assert name == "goal_handle"
            return self.number
        return 1

    def is_contested(self) -> bool:
        return self.server.contested

    @property
    def is_held(self) -> bool:
        return self.arm.is_held

    @is_held.setter
    def is_held(self, value: bool) -> None:
        self.arm.is_held = value

    def run(self, samples: int, speed: float = 1.0) -> ServedArm:
        self.server.speed = speed
        for _ in range(samples):
            self.server.sample()
            self.measured.append(self.arm.plant.state()[:2])
            desired, actual, error = (np.concatenate(pair) for pair in self.server.motion.pairs)
            assert error.tolist() == (desired - actual).tolist()
            self.desired.append(desired.tolist())
        return self

    def ended(self, number: int | None = None) -> tuple[str, int | None]:
        for end in self.server.ends():
            assert end.number not in self.ends, "told once"
            state = "cancelled" if end.number in self.cancelled else "aborted" if end.code else "succeeded"
            self.ends[end.number], self.texts[end.number] = (state, int(end.code)), end.text
        return self.ends.get(self.number if number is None else number, ("followed", None))


@pytest.fixture(scope="module")
def follower() -> CompiledFollower:
    """Compiled once: each server has a memory of its own."""
    return compile_follower(code_of(workspace_controller(), "arm", "double", robot_of("planar-two-link")))


@pytest.fixture
def make(follower: CompiledFollower, monkeypatch: pytest.MonkeyPatch) -> Callable[..., ServedArm]:
    one = CompiledFollower(follower._library, follower.follower, np.float64)
    monkeypatch.setattr(trajectory_server, "compile_follower", lambda code: one)

    def made(**other: Any) -> ServedArm:
        # parameters of the plugin are those of the follower
        own = {"stop_time", "cmd_timeout", "allow_partial_joints_goal"} & other.keys()
        other.pop("speed_scaling_interface", None)  # an attribute
        names = {"cmd_timeout": "timeout", "allow_partial_joints_goal": "partial"}
        for name in own:
            monkeypatch.setattr(one.follower, names.get(name, name), other.pop(name))
        return ServedArm(other.pop("controller", workspace_controller()), **other)

    return made


#: Rows of the table that are about messages, parameters, lifecycle and topics of ros2_control.
OTHER = {
    "efforts", "waypoint without positions", "moving at the goal", "topic, path tolerance",
    "path tolerance", "path tolerance 0", "path tolerance −1", "fault in mid-move",
    "deactivated, then active at another pose", "not active", "topic", "empty trajectory on the topic",
}  # fmt: skip
ROWS = [case for case in CASES if case.name not in OTHER]
#: Rows whose end another one has too, and whose path is the plugin's, which runs every row in CI.
NIGHTLY = {
    "linear, cubic, quintic", "one waypoint", "waypoints of mixed kinds", "past stamp, partly", "goal tolerance missed",
}  # fmt: skip


@pytest.mark.parametrize(
    "case",
    [
        pytest.param(
            case, marks=[pytest.mark.nightly("one more path of the same end")] * (case.name in NIGHTLY)
        )
        for case in ROWS
    ],
    ids=lambda case: case.name,
)
def test_a_goal_ends_as_that_of_the_plugin(case: TrajectoryCase, make: Any) -> None:
    """The same rows as `test_ros2_trajectories`, of the same robot."""
    state, code = RUNS[case.name](make)
    assert (state if code is None else f"{state}, {code}".replace("-", "−")) == case.result


def test_a_goal_that_is_replaced_or_leaves_its_path_is_told_so(make: Any) -> None:
    one = make()
    one.goal(*MOVE)
    assert one.accepted()
    first = one.number
    one.run(300)
    one.goal(*MOVE, path=[("elbow", 1e-6, 0.0)])
    assert one.accepted()
    one.goal(*MOVE, begins=2.0)
    one.run(1)
    assert one.ended(first) == ("aborted", FollowCode.INVALID_GOAL)
    assert "replaced" in one.texts[first]
    one.run(800)
    assert one.ended() == ("aborted", FollowCode.PATH_TOLERANCE_VIOLATED)
    assert one.desired[-1][2:] == [0.0, 0.0]
    one.is_smooth()


def test_a_goal_that_waits_ends_with_the_path_before_it(make: Any) -> None:
    one = make()
    one.goal(*MOVE, path=[("elbow", 1e-6, 0.0)])
    assert one.accepted()
    one.run(1)
    one.goal(*MOVE, begins=2.0)
    assert one.accepted()
    one.run(400)
    assert one.ended() == ("aborted", FollowCode.PATH_TOLERANCE_VIOLATED)


def test_a_goal_that_waits_is_not_ended_by_the_one_before_it(make: Any) -> None:
    one = make()
    one.goal([0.4], [np.add(START, 0.1)])
    assert one.accepted()
    one.run(1)
    one.goal([0.5], [GOAL], begins=1.0)
    assert one.accepted()
    one.run(900)
    assert one.desired[-1][:2] == pytest.approx(np.add(START, 0.1), abs=1e-6)
    assert one.ended() == ("followed", None)
    one.run(900)
    assert one.ended() == ("succeeded", 0)


def test_tolerances_are_those_of_the_estimate(make: Any) -> None:
    """A path of 0.3 rad within 10 mrad of where the links are estimated to be."""
    one = make()
    one.goal(*MOVE, path=[(joint, 0.01, 0.0) for joint in JOINTS], at_goal=[("elbow", 1e-3, 0.0)])
    assert one.finished() == ("succeeded", 0)
    np.testing.assert_allclose(one.server.motion.actual, one.measured[-1], atol=1e-4)
    np.testing.assert_allclose(one.server.motion.actual_velocity, [0.0, 0.0], atol=1e-3)


def test_a_late_cancel_leaves_the_goal_after_it_alone(make: Any) -> None:
    one = make()
    one.goal([0.5], [START])
    assert one.accepted()
    first = one.number
    one.goal(*MOVE)
    assert one.accepted()
    one.server.cancel(first)
    one.run(LONGEST)
    assert one.ended() == ("succeeded", 0)
    np.testing.assert_allclose(one.measured[-1], GOAL, atol=2e-3)


def test_a_speed_that_is_no_number_stops_the_arm_until_there_is_one(make: Any) -> None:
    one = make()
    one.goal(*MOVE)
    assert one.accepted()
    one.run(400).run(1500, speed=math.nan)
    assert one.ended() == ("followed", None)
    assert one.desired[-1][2:] == [0.0, 0.0]
    assert not np.allclose(one.measured[-1], GOAL, atol=0.05)
    one.run(LONGEST)
    assert one.ended() == ("succeeded", 0)
    one.is_smooth()
    np.testing.assert_allclose(one.measured[-1], GOAL, atol=2e-3)


def changed(one: ServedArm, **values: Any) -> str:
    """What a server answers to parameters of goals; the others stay as without any."""
    follower = one.server.follower
    return one.server.change(goal_options(follower, goal_parameters(follower) | values))


def test_options_of_goals_change_while_no_trajectory_is_followed(make: Any) -> None:
    """Not before the joints rest after a cancel either; the arm does not jump."""
    one = make()
    one.goal([1.0], [GOAL[:1]], joints=JOINTS[:1])
    assert not one.accepted()
    assert changed(one, allow_partial_joints_goal=True) == ""
    assert one.accepted()
    one.run(300)
    assert unnamed(changed(one, stop_time=0.1), "followed", "cancel") == []
    assert one.manager("cancel_goal")
    one.run(1)
    assert one.ended() == ("cancelled", 0)
    assert unnamed(changed(one, stop_time=0.1), "followed") == []
    one.run(900)
    before = one.arm.inputs[-1]
    assert changed(one, **{"stop_time": 0.1, "constraints.elbow.trajectory": 1e-6}) == ""
    assert one.server.follower.stop_time == 0.1
    one.run(5)
    np.testing.assert_allclose(one.arm.inputs[-1], before, atol=1e-3 * np.abs(before).max() + 1e-6)
    one.goal(*MOVE)
    assert one.accepted()
    one.run(LONGEST)
    assert one.ended() == ("aborted", FollowCode.PATH_TOLERANCE_VIOLATED)


@pytest.mark.parametrize(
    ("name", "value"),
    [("stop_time", 0.0), ("stop_time", 1e9), ("cmd_timeout", -1.0), ("constraints.elbow.goal", math.nan)],
)
def test_options_of_goals_that_do_not_fit_change_nothing(name: str, value: float, make: Any) -> None:
    one = make()
    follower = one.server.follower
    with refused_with(InvalidInput, "expected", "got"):
        changed(one, **{name: value})
    assert one.server.follower is follower


@pytest.mark.parametrize(
    ("name", "value", "advice"),
    [
        ("speed_scaling_factor", 0.0, "speed_scaling_factor:=0.01"),
        ("speed_scaling_factor", math.inf, "speed_scaling_factor:=0.01"),
    ],
)
def test_what_a_node_reads_when_it_begins_is_checked(name: str, value: float, advice: str) -> None:
    with refused_with(InvalidInput, "expected", advice):
        check_at_start(AtStart(**{name: value}))
    stated, number = advice.split(":=")
    check_at_start(AtStart(**{stated: float(number)}))


@pytest.mark.parametrize("unplugged", [[3], [0, 1, 2, 3]])
def test_an_encoder_whose_plug_is_pulled_stops_the_arm(unplugged: list[int], make: Any) -> None:
    """After ten samples, with inputs of 0; the goal says why, and later ones are refused."""
    one = make()
    one.goal(*MOVE)
    assert one.accepted()
    one.run(400)
    one.arm.unplugged = unplugged
    one.run(10)
    assert one.ended() == ("followed", None)
    before = len(one.arm.inputs)
    assert np.abs(one.arm.inputs[-1]).min() > 0.0
    one.run(5)
    assert not np.any(one.arm.inputs[before:])
    assert one.ended() == ("aborted", FollowCode.PATH_TOLERANCE_VIOLATED)
    assert unnamed(one.texts[one.number], one.server.measured[unplugged[0]], "cables") == []
    assert not one.accepted()
    one.server.submit(one.prepared)
    assert one.server.ends()[0].code is FollowCode.PATH_TOLERANCE_VIOLATED


def test_a_protective_stop_brakes_the_arm_which_begins_again_at_rest(make: Any) -> None:
    """The goal ends as the stop begins, the drives slow the arm down and lose their power; restarts are refused before
    that, with an encoder that is silent, off, or of an arm that moves."""
    one = make(controller=protected(workspace_controller(), robot_of("planar-two-link"))[0])
    assert "not stopped" in one.server.restart()
    one.goal(*MOVE)
    assert one.accepted()
    one.run(400)
    one.arm.unplugged = [2]
    one.run(11)
    assert one.ended() == ("aborted", FollowCode.PATH_TOLERANCE_VIOLATED)
    assert unnamed(one.server.stopped, "sensor", "motor_position_shoulder", "cables") == []
    assert one.server.stepped.stop == Stop.SENSOR_LOST
    assert "power" in one.server.restart()
    begins = len(one.arm.inputs)
    one.run(1100)
    off = begins + np.flatnonzero(np.any(one.arm.inputs[begins:], axis=1))[-1] + 1
    assert 50 < off - begins < 1100
    speeds = np.diff(one.measured[off - 20 : off], axis=0) / PERIOD
    assert np.abs(speeds).max() < 0.05
    assert unnamed(one.server.restart(), "reading", "cables", "nan") == []
    pose = np.array((-0.6, 0.5))
    rest = one.arm.robot.operating_point(pose)[0]
    one.arm.unplugged = []
    x = rest.copy()
    x[4] += 0.3
    one.arm.plant.reset(x)
    assert unnamed(one.server.restart(), "twist", "zeros") == []
    one.arm.plant.reset(rest)
    read, seen = one.arm.read, iter(np.linspace(0.0, 0.2, 60))
    one.arm.read = lambda: read() + next(seen)
    assert unnamed(one.server.restart(), "moves", "brakes") == []
    one.arm.read = read
    assert one.server.stopped
    assert not np.any(one.arm.inputs[-1])
    assert one.server.restart() == ""
    one.run(300)
    np.testing.assert_allclose(one.measured[-300:], np.broadcast_to(pose, (300, 2)), atol=2e-3)
    one.goal([1.0], [GOAL])
    assert one.finished() == ("succeeded", 0)


def test_a_robot_that_cannot_be_started_gets_no_input(make: Any) -> None:
    """Beyond its range, as an encoder in degrees reads; what no second reading tells is said."""
    controller = protected(workspace_controller(), robot_of("planar-two-link"))[0]
    assert not make(controller=controller).server.start
    arm = Arm()
    read = arm.read
    arm.read = lambda: 57.3 * read()
    with refused_with(InvalidInput, "cannot be", "started", "range", "unit"):
        TrajectoryServer(controller, arm.robot, arm)
    assert arm.inputs == []
    assert make().server.start == Start.NOT_CHECKED


def test_the_compiled_controller_does_the_same(make: Any, tmp_path: Any) -> None:
    """Its inputs are those of the controller in Python; a wrong period stops the arm."""
    library = fh.load_compiled(fh.compile_controller(workspace_controller(), tmp_path / "arm.so"))
    both = []
    for other in ({}, {"library": library}):
        one = make(**other)
        one.goal(*MOVE)
        assert one.finished() == ("succeeded", 0)
        both.append(np.array(one.arm.inputs))
    np.testing.assert_allclose(both[1], both[0], atol=1e-6 * np.abs(both[0]).max())
    for _ in range(100):
        one.server.sample(1.5 * PERIOD)
    assert (one.server.step_code, one.server.stepped.stop) == ("BAD_PERIOD", Stop.WRONG_PERIOD)
    assert unnamed(one.server.stopped, "period", "clock") == []
    assert np.array_equal(one.arm.inputs[-1], [0.0, 0.0])


def test_the_pose_is_that_of_the_links_or_of_motors_and_springs() -> None:
    robot = robot_of("planar-two-link")
    x, _ = robot.operating_point([0.5, -0.7])
    names = ("motor_position_shoulder", "motor_position_elbow", "link_position_elbow")
    assert np.abs(x[4:6] - x[:2]).max() > 1e-3
    for y in (x[[4, 5, 1]], [x[4], x[5], math.nan], [x[4], math.nan, x[1]]):
        np.testing.assert_allclose(measured_pose(robot, names, y), [0.5, -0.7], atol=1e-9)
    with refused_with(InvalidInput, "pose=["):
        measured_pose(robot, names, [math.nan, x[5], x[1]])
    with refused_with(InvalidInput, "pose=["):
        measured_pose(robot, names, None)


def test_a_robot_that_reads_something_else_is_refused(make: Any) -> None:
    one = make()
    one.arm.read = lambda: np.zeros(3)
    with refused_with(InvalidInput, "read"):
        one.run(1)


def test_a_controller_of_one_pose_is_refused() -> None:
    robot = robot_of("planar-two-link")
    with refused_with(InvalidInput, "trajectories", "--pose"):
        TrajectoryServer(elastic_controller(robot, moving=False), robot, Arm())
