"""Trajectories by topic and action: every row of the table in docs/ros2.md, with MuJoCo as the robot."""

from __future__ import annotations

import ctypes
import math
import subprocess
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.export.test_rest import robot_of
from tests.export.test_ros2 import FOLLOWING, HERE, PERIOD, STRICT, Manager, built, workspace_controller
from tests.export.trajectory_cases import CASES, TrajectoryCase

from flexhinf.robot import MuJoCoPlant

yaml = pytest.importorskip("yaml")
pytest.importorskip("mujoco")
pytestmark = [
    pytest.mark.usefixtures("unoptimised"),
    pytest.mark.oracle,
    pytest.mark.ci("builds one package, and moves it with MuJoCo"),
]

JOINTS = ("shoulder", "elbow")
START = (-0.4, 0.2)
GOAL = (-0.1, -0.1)
STATES = {2: "followed", 4: "succeeded", 5: "cancelled", 6: "aborted"}

#: Longest time that a goal of a second may take: it ends 0.12 s later, and a step longer than a period may be missing.
LONGEST = 1300


class Session:
    """A robot at rest, and a manager of its controller, which is active."""

    def __init__(self, manager: Manager, pose: Sequence[float] = START, **parameters: Any) -> None:
        self.manager, self.robot = manager, robot_of("planar-two-link")
        self.library = manager.library
        for name in ("goal_text",):
            getattr(self.library, name).restype = ctypes.c_char_p
        self.library.goal_handle.restype = ctypes.c_void_p
        self.library.desired.restype = ctypes.c_double
        self.plant = MuJoCoPlant(self.robot, ("link_position", "motor_position"))
        self.measured: list[np.ndarray] = []
        self.desired: list[list[float]] = []
        self.is_held = False
        assert manager.configure(publish_every=1, **parameters) == 0
        self.activate(pose)

    def activate(self, pose: Sequence[float]) -> None:
        self.plant.reset(self.robot.operating_point(pose)[0])
        assert self.manager.activate([*self.plant.output(), *[1.0] * self.scaled]) == 0

    @property
    def scaled(self) -> int:
        """How many interfaces are behind those of the robot."""
        return len(self.manager.names(False)) - 4

    def goal(
        self, times: Any, *rows: Any, joints: Sequence[str] = JOINTS, begins: float = math.nan, goal_time: float = 0.0,
        path: Sequence[tuple[str, float, float]] = (), at_goal: Sequence[tuple[str, float, float]] = (),
    ) -> None:  # fmt: skip
        """Prepare a goal with positions, and velocities, accelerations and efforts where they are stated."""
        self.manager("trajectory", ctypes.c_double(begins), ctypes.c_double(goal_time))
        for name in joints:
            self.manager("joint", name.encode())
        for time, *stated in zip(times, *rows, strict=True):
            numbers = [np.reshape(part, len(joints)) for part in stated if part is not None]
            flat = np.ascontiguousarray(numbers, dtype=float)
            place = flat.ctypes.data_as(ctypes.c_void_p)
            self.manager("point", ctypes.c_double(time), len(numbers), len(joints), place)
        for is_goal, stated in enumerate((path, at_goal)):
            for name, *numbers in stated:
                self.manager("tolerance", is_goal, name.encode(), *map(ctypes.c_double, numbers))

    def accepted(self) -> bool:
        return bool(self.manager("send_goal"))

    def is_contested(self) -> bool:
        return self.manager.published("health", "contested") == 1.0

    def run(self, samples: int, speed: float = 1.0) -> Session:
        for _ in range(samples):
            assert self.manager.update([*self.plant.output(), *[speed] * self.scaled]) == 0
            if not self.is_held:
                self.plant.step(self.manager.input(), [], PERIOD)
            self.measured.append(self.plant.state()[:2])
            self.desired.append(
                [self.manager.published("desired", f"{kind}_{joint}") for kind in ("position", "velocity")
                 for joint in JOINTS]
            )  # fmt: skip
        return self

    def ended(self) -> tuple[str, int | None]:
        """How the last goal ended."""
        for _ in range(2):
            self.manager("spin")
        state = STATES[self.manager("goal_state")]
        return state, None if state == "followed" else self.manager("goal_code")

    def finished(self, goal: Sequence[float] | None = GOAL, samples: int = LONGEST) -> tuple[str, int | None]:
        """Send what was prepared, and how it ended; a goal that succeeded is where the links are."""
        if not self.accepted():
            return "rejected", None
        self.run(samples)
        if goal is not None:
            np.testing.assert_allclose(self.measured[-1], goal, atol=2e-3)
        return self.ended()

    def is_smooth(self) -> None:
        """Commanded velocities change by less than 0.05 rad/s in a sample: nothing jumps."""
        moves = np.array(self.desired)
        moves = moves[np.isfinite(moves).all(axis=1)]
        assert np.abs(np.diff(moves[:, 2:], axis=0)).max() < 0.05
        np.testing.assert_allclose(
            np.diff(moves[:, :2], axis=0), PERIOD * 0.5 * (moves[1:, 2:] + moves[:-1, 2:]), atol=2e-5
        )


Make = Callable[..., Session]
MOVE = [0.5, 1.0], [np.add(START, GOAL) / 2, GOAL]
TINY = [("elbow", 1e-12, 0.0)]


def shuffled(make: Make) -> Any:
    one = make()
    one.goal(MOVE[0], [row[::-1] for row in MOVE[1]], joints=JOINTS[::-1])
    return one.finished()


def one_waypoint(make: Make) -> Any:
    one = make()
    one.goal([1.0], [GOAL])
    return one.finished()


def from_now(make: Make) -> Any:
    """As MoveIt sends it: where the arm is, at rest, and then the others."""
    one = make()
    none, speed = np.zeros(2), np.subtract(GOAL, START)
    one.goal([0.0, *MOVE[0]], [START, *MOVE[1]], [none, speed, none], [none] * 3)
    found = one.finished()
    one.is_smooth()
    assert one.desired[500 + 60 + 1][:2] == pytest.approx(MOVE[1][0], abs=1e-3)
    return found


def polynomials(make: Make) -> Any:
    """The commanded path, 0.06 s earlier, is that of the waypoints: known in the middle of the second segment."""
    way, times = np.subtract(GOAL, START), [0.5, 1.0]
    speeds, none = [way, 0.0 * way], np.zeros((2, 2))
    middles = []
    for rows in ([], [speeds], [speeds, none]):
        one = make()
        one.goal(times, MOVE[1], *rows)
        found = one.finished()
        one.is_smooth()
        middles.append(one.desired[750 + 60 + 1][:2])
    # linear: ¾ of the way; cubic from ½ with v = way per s: ½ + ¼ + ⅛ · ½; quintic: ½ + ¼ + 5/32 · ½
    shares = [0.75, 0.75 + 0.5 / 8, 0.75 + 0.5 * 5 / 32]
    for middle, share in zip(middles, shares, strict=True):
        np.testing.assert_allclose(middle, START + share * way, atol=5e-4)
    return found


def mixed(make: Make) -> Any:
    """Velocities at the first waypoint alone: cubic, and then linear."""
    way = np.subtract(GOAL, START)
    one = make()
    one.goal([0.5, 1.0], MOVE[1], [way, None])
    found = one.finished()
    one.is_smooth()
    for at, share in ((250, 0.1875), (750, 0.75)):  # s = ½ of each: ¼ · 1 − ⅛ · ½, and the middle
        np.testing.assert_allclose(one.desired[at + 60 + 1][:2], START + share * way, atol=5e-4)
    return found


def refused(*arguments: Any, **other: Any) -> Callable[[Make], Any]:
    def run(make: Make) -> Any:
        one = make()
        one.goal(*arguments, **other)
        found = one.finished(None, 0)
        one.run(50)
        np.testing.assert_allclose(one.measured[-1], START, atol=1e-3)
        return found

    return run


def jumping(make: Make) -> Any:
    one = make()
    one.goal([0.005, 1.0], [GOAL, GOAL])
    assert one.accepted()
    one.run(50)
    np.testing.assert_allclose(one.measured[-1], START, atol=1e-3)
    return one.ended()


def swinging(make: Make) -> Any:
    """From the motion of now: the first way would end where it begins, by way of the end of the range."""
    one = make()
    still = np.zeros((1, 2))
    one.goal([0.7], [START], still, [(600.0, 0.0)])
    assert one.accepted()
    one.run(50)
    np.testing.assert_allclose(one.measured[-1], START, atol=1e-3)
    return one.ended()


def undisturbed(make: Make) -> Any:
    """A goal goes on, and may be cancelled, though another one was sent that cannot start."""
    ends = []
    for cancels in (False, True):
        one = make()
        one.goal(*MOVE)
        assert one.accepted()
        first = one.manager("goal_handle")
        one.run(500)
        one.goal([0.005, 1.0], [np.add(GOAL, 0.5), GOAL])
        assert one.accepted()
        one.run(2)
        assert one.ended() == ("aborted", -1)
        one.manager("look_at", ctypes.c_void_p(first))
        assert one.ended() == ("followed", None)
        if cancels:
            assert one.manager("cancel_goal") == 1
        one.run(LONGEST)
        one.is_smooth()
        assert one.desired[-1][2:] == [0.0, 0.0]
        assert np.allclose(one.measured[-1], GOAL, atol=2e-3) is not cancels
        ends.append(one.ended())
    assert ends[1] == ("cancelled", 0)
    return ends[0]


def open_until(make: Make) -> Any:
    """It succeeds while the other one waits."""
    one = make()
    one.goal([0.4], [np.add(START, 0.1)])
    assert one.accepted()
    first = one.manager("goal_handle")
    one.run(100)
    one.goal(*MOVE, begins=0.8)
    assert one.accepted()
    second = one.manager("goal_handle")
    one.run(600)
    one.manager("look_at", ctypes.c_void_p(first))
    found = one.ended()
    one.manager("look_at", ctypes.c_void_p(second))
    one.run(LONGEST)
    assert one.ended() == ("succeeded", 0)
    return found


def cancelled_waiting(make: Make) -> Any:
    one = make()
    one.goal(*MOVE)
    assert one.accepted()
    first = one.manager("goal_handle")
    one.run(300)
    one.goal([1.0], [START], begins=1.5)
    assert one.accepted()
    one.run(1)
    assert one.manager("cancel_goal") == 1
    one.run(2)
    found = one.ended()
    one.manager("look_at", ctypes.c_void_p(first))
    one.run(LONGEST)
    assert one.ended() == ("succeeded", 0)
    np.testing.assert_allclose(one.measured[-1], GOAL, atol=2e-3)
    return found


def cancelled_nothing(make: Make) -> Any:
    one = make()
    one.goal(*MOVE)
    one.manager("publish_trajectory")
    one.run(500)
    one.manager("cancel_nothing")
    one.run(LONGEST)
    one.is_smooth()
    assert one.desired[-1][2:] == [0.0, 0.0]
    assert abs(one.measured[-1] - GOAL).max() > 0.05
    one.goal(*MOVE)  # and what comes later is followed
    return "held" if one.finished() == ("succeeded", 0) else "?", None


def partial(make: Make) -> Any:
    one = make(allow_partial_joints_goal=True)
    one.goal(*MOVE)
    assert one.accepted()
    one.run(500)
    one.goal([0.6], [[0.1]], joints=("shoulder",))
    found = one.finished(None)
    one.is_smooth()
    assert one.measured[-1][0] == pytest.approx(0.1, abs=2e-3)
    assert one.desired[-1][3] == 0.0
    return found


def partly_past(make: Make) -> Any:
    """0.7 s are over: 0.3 s are left to the last waypoint."""
    one = make()
    one.goal(*MOVE, begins=-0.7)
    found = one.finished(samples=600)
    one.is_smooth()
    assert one.desired[300 + 121][:2] == pytest.approx(GOAL, abs=1e-9)
    return found


def future(make: Make) -> Any:
    """Links are where the stamp says: the goal before it is at its end by then."""
    one = make()
    one.goal([0.4], [np.add(START, 0.1)])
    assert one.accepted()
    one.run(100)
    one.goal(*MOVE, begins=0.8)
    assert one.accepted()
    one.run(700)
    assert one.desired[-1][:2] == pytest.approx(np.add(START, 0.1), abs=1e-3)
    one.run(600)
    assert one.desired[-1][:2] == pytest.approx(MOVE[1][0], abs=5e-3)
    one.run(800)
    np.testing.assert_allclose(one.measured[-1], GOAL, atol=2e-3)
    one.is_smooth()
    return one.ended()


def replaced(make: Make) -> Any:
    one = make()
    one.goal(*MOVE)
    assert one.accepted()
    one.run(500)
    before = one.manager("goal_handle")
    one.goal([0.5, 1.0], [START, GOAL])
    assert one.accepted()
    assert one.manager("goal_handle") != before
    one.run(LONGEST)
    np.testing.assert_allclose(one.measured[-1], GOAL, atol=2e-3)
    one.is_smooth()
    return one.ended()


def cancelled(make: Make) -> Any:
    """The motion goes on, and rests after stop_time and the smoothing."""
    one = make(stop_time=0.3)
    one.goal(*MOVE)
    assert one.accepted()
    one.run(500)
    at, speed = np.array(one.desired[-1]).reshape(2, 2)
    assert np.abs(speed).min() > 0.1
    assert one.manager("cancel_goal") == 1
    one.run(425)
    assert one.desired[-1][2:] == [0.0, 0.0]
    np.testing.assert_allclose(one.desired[-1][:2], at + speed * (0.06 + 0.15), atol=3e-3)
    one.is_smooth()
    one.run(300)
    np.testing.assert_allclose(one.measured[-1], one.desired[-1][:2], atol=2e-3)
    return one.ended()


def goal_missed(make: Make) -> Any:
    one = make()
    one.goal(*MOVE, at_goal=TINY, goal_time=0.2)
    assert one.accepted()
    one.run(1300)
    assert one.ended()[0] == "followed"
    one.run(30)
    return one.ended()


def moving_at_goal(make: Make) -> Any:
    """The links are where they shall be, and a velocity is never exactly zero."""
    one = make(constraints__stopped_velocity_tolerance=1e-12, constraints__goal_time=0.2)
    one.goal(*MOVE)
    return one.finished(samples=1400)


def nearly_at_rest(make: Make) -> Any:
    """What rounding leaves of a planner's last velocity is none."""
    one = make()
    one.goal(*MOVE, [(0.3, -0.3), (1e-7, -1e-9)])
    assert one.finished() == ("succeeded", 0)
    return refused(*MOVE, [(0.1, 0.1), (0.0, 2e-7)])(make)


def waiting(make: Make) -> Any:
    one = make()
    one.goal(*MOVE, at_goal=TINY)
    return one.finished(samples=3000)


def on_path(tolerance: float, parameter: float = 0.0) -> Callable[[Make], Any]:
    def run(make: Make) -> Any:
        one = make(constraints__elbow__trajectory=parameter)
        one.goal(*MOVE, path=[("elbow", tolerance, 0.0)])
        found = one.finished(None)
        one.is_smooth()
        assert one.desired[-1][2:] == [0.0, 0.0]
        return found

    return run


def held(make: Make) -> Any:
    """A robot that stands still, whose controller does not brake: as far as its path goes on while one would."""
    one = make()
    one.goal([2.0], [np.add(START, (0.69, 0.0))])
    assert one.accepted()
    one.is_held = True
    one.run(1300)
    assert one.ended() == ("followed", None)
    one.run(700)
    away = np.abs(np.array(one.desired)[:, 0] - START[0])
    allowed = FOLLOWING + 0.5 * 0.3 * 2.5
    assert allowed < np.nanmax(away) < allowed + 0.15  # it comes to rest from there
    return one.ended()


def braked(make: Make) -> Any:
    """The command leaves the box of the workspace, where the controller brakes until it begins again."""
    one = make()
    one.goal([1.5], [(0.6, 0.2)])
    found = one.finished(None, 1900)
    assert 0.3 < one.measured[-1][0] < 0.6
    np.testing.assert_allclose(np.diff(one.measured[-50:], axis=0), 0.0, atol=1e-4)
    return found


def fighting(make: Make) -> Any:
    """Twenty times a second, for more than a second; then one of them stops."""
    one = make()
    places = np.add(START, (0.2, 0.1)), np.add(START, (-0.2, -0.1))
    for k in range(36):
        assert one.is_contested() == (k > 21)
        one.goal([0.8], [places[k % 2]])
        one.manager("publish_trajectory")
        one.run(50)
    one.goal([0.8], [places[0]])
    one.manager("publish_trajectory")
    one.run(1500)
    assert not one.is_contested()
    np.testing.assert_allclose(one.measured[-1], places[0], atol=2e-3)
    return "contested", None


def streamed(make: Make) -> Any:
    """A servo: each point where a sine will be; the links are that much later, and nothing is contested."""
    one = make()
    way = [np.add(START, (0.2 * np.sin(2e-3 * 1.5 * k), 0.1 * np.sin(2e-3 * 1.5 * k))) for k in range(2000)]
    for k in range(0, 1700, 10):
        one.goal([0.1], [way[k]])
        one.manager("publish_trajectory")
        one.run(20)
        assert not one.is_contested()
    late = [np.abs(one.measured[2 * k + 100 + 60] - way[k]).max() for k in range(200, 1600)]
    assert max(late) < 0.03
    return "followed", None


def timed_out(make: Make) -> Any:
    one = make(cmd_timeout=0.3)
    one.goal(*MOVE, at_goal=TINY)
    assert one.accepted()
    one.run(1400)
    assert one.ended()[0] == "followed"
    one.run(30)
    return one.ended()


def scaled(make: Make) -> Any:
    """At half of its speed from the middle on: it ends half a second later."""
    one = make(speed_scaling_interface="scaling/factor")
    one.goal(*MOVE)
    assert one.accepted()
    one.run(500)
    one.run(600, speed=0.5)
    assert one.ended()[0] == "followed"
    one.run(600, speed=0.5)
    one.is_smooth()
    np.testing.assert_allclose(one.measured[-1], GOAL, atol=2e-3)
    return one.ended()


def fault(make: Make) -> Any:
    one = make()
    one.goal(*MOVE)
    assert one.accepted()
    one.run(400)
    codes = [one.manager.update([math.nan] * 4) for _ in range(15)]
    assert codes[-1] == 1
    assert np.array_equal(one.manager.input(), [0.0, 0.0])
    found = one.ended()
    assert b"stopped" in one.manager("goal_text")
    one.goal(*MOVE)
    assert not one.accepted()
    return found


def elsewhere(make: Make) -> Any:
    one = make()
    one.goal(*MOVE)
    assert one.accepted()
    one.run(400)
    assert one.manager("deactivate") == 0
    found = one.ended()
    pose = (-0.6, 0.5)
    one.activate(pose)
    one.run(300)
    np.testing.assert_allclose(one.measured[-300:], np.broadcast_to(pose, (300, 2)), atol=2e-3)
    one.goal([1.0], [GOAL])
    assert one.accepted()
    one.run(LONGEST)
    np.testing.assert_allclose(one.measured[-1], GOAL, atol=2e-3)
    assert one.ended() == ("succeeded", 0)
    return found


def off(make: Make) -> Any:
    one = make()
    assert one.manager("deactivate") == 0
    one.goal(*MOVE)
    return one.finished(None, 0)


def empty_topic(make: Make) -> Any:
    one = make()
    one.goal(*MOVE)
    assert one.accepted()
    one.run(300)
    one.goal([])
    one.manager("publish_trajectory")
    one.run(LONGEST - 300)
    one.is_smooth()
    np.testing.assert_allclose(one.measured[-1], GOAL, atol=2e-3)
    return one.ended()


def by_topic(make: Make) -> Any:
    one = make()
    one.goal(*MOVE)
    assert one.accepted()
    one.run(300)
    other = np.add(START, (0.2, 0.1))
    one.goal([1.0], [other])
    one.manager("publish_trajectory")
    one.run(LONGEST)
    np.testing.assert_allclose(one.measured[-1], other, atol=2e-3)
    one.is_smooth()
    return one.ended()


def by_topic_beyond(make: Make) -> Any:
    one = make(constraints__elbow__trajectory=1e-5)
    one.goal(*MOVE)
    one.manager("publish_trajectory")
    one.run(LONGEST)
    one.is_smooth()
    assert one.desired[-1][2:] == [0.0, 0.0]
    assert abs(one.measured[-1] - GOAL).max() > 0.1
    return "held", None


RUNS: dict[str, Callable[[Make], Any]] = {
    "shuffled names": shuffled, "linear, cubic, quintic": polynomials,
    "one waypoint": one_waypoint, "first waypoint at time 0": from_now, "waypoint without positions": refused([1.0]),
    "waypoints of mixed kinds": mixed, "empty goal": refused([]),
    "unknown joint": refused(*MOVE, joints=("shoulder", "wrist")),
    "joint left out": refused([1.0], [[0.1]], joints=("elbow",)),
    "joint left out, `allow_partial_joints_goal`": partial,
    "times that do not increase": refused([0.5, 0.5], MOVE[1]),
    "efforts": refused(*MOVE, *[[(0.0, 0.0)] * 2] * 3),
    "number that is not finite": refused(MOVE[0], [START, (math.nan, 0.0)]),
    "speed at the end": nearly_at_rest,
    "beyond the joint's range": refused([1.0], [(3.1, 0.0)]),
    "beyond range or speed between waypoints": refused([1.0, 1.7], [START] * 2, [(40.0, 0.0), (0.0, 0.0)]),
    "beyond range or speed from where it is": swinging,
    "jump between waypoints": refused([0.5, 0.51], [START, GOAL]),
    "jump from where it is": jumping, "goal before one that cannot start": undisturbed,
    "past stamp, over": refused(*MOVE, begins=-1.5), "past stamp, partly": partly_past, "future stamp": future,
    "goal before one with a future stamp": open_until,
    "replaced at speed": replaced, "cancelled at speed": cancelled,
    "cancelled before it begins": cancelled_waiting, "cancel without an open goal": cancelled_nothing,
    "goal tolerance missed": goal_missed,
    "moving at the goal": moving_at_goal,
    "goal time 0": waiting, "path tolerance": on_path(1e-5), "path tolerance 0": on_path(0.0, 1e-5),
    "path tolerance, unstated": held, "controller brakes": braked,
    "path tolerance −1": on_path(-1.0, 1e-5), "other negative tolerance": refused(*MOVE, path=[("elbow", -0.5, 0.0)]),
    "time-out": timed_out, "speed scaling": scaled, "fault in mid-move": fault,
    "deactivated, then active at another pose": elsewhere, "not active": off, "topic": by_topic,
    "topic, path tolerance": by_topic_beyond, "two publishers that fight": fighting,
    "one publisher at 50 Hz": streamed, "empty trajectory on the topic": empty_topic,
}  # fmt: skip


@cache
def package_of(version: str, sources_of: Callable[..., Path]) -> tuple[ctypes.CDLL, Path]:
    """The plugin of two joints in a library, and its folder."""
    return built(sources_of(workspace_controller(), "double", robot_of("planar-two-link")), version)


@pytest.fixture(scope="module", params=["HUMBLE"])
def make(request: pytest.FixtureRequest, sources_of: Callable[..., Path]) -> Make:
    """Sessions of one package."""
    library, package = package_of(request.param, sources_of)
    return lambda **parameters: Session(Manager(library, package), **parameters)


def test_every_row_of_the_table_is_run() -> None:
    assert list(RUNS) == [case.name for case in CASES]


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_a_row_ends_as_the_table_says(case: TrajectoryCase, make: Make) -> None:
    state, code = RUNS[case.name](make)
    assert (state if code is None else f"{state}, {code}".replace("-", "−")) == case.result


def test_moveit_is_told_the_action_and_its_joints(make: Make) -> None:
    """By the parameters of MoveIt's simple controller manager, with the name that the manager loads."""
    package = make().manager.package
    stated = yaml.safe_load((package / "config/moveit_controllers.yaml").read_text())
    loaded = yaml.safe_load((package / "config/arm_controller.yaml").read_text())
    (kind, listed) = stated["moveit_controller_manager"], stated["moveit_simple_controller_manager"]
    assert kind == "moveit_simple_controller_manager/MoveItSimpleControllerManager"
    (name,) = listed["controller_names"]
    assert "type" in loaded["controller_manager"]["ros__parameters"][name]
    own = listed[name]
    assert own == {
        "type": "FollowJointTrajectory",
        "action_ns": "follow_joint_trajectory",
        "default": True,
        "joints": list(JOINTS),
    }
    assert f"/{own['action_ns']}" in (package / "src/trajectories.cpp").read_text()


def test_rows_that_jump_or_twist_a_spring_are_refused(make: Make, capfd: pytest.CaptureFixture[str]) -> None:
    """Also while a goal is followed, which goes on; good rows end it, and a goal begins where they rest."""
    one = make()
    one.goal(*MOVE)
    assert one.accepted()
    one.run(200)
    far = np.concatenate(one.robot.operating_point((0.1, 0.6)))
    near = np.concatenate(one.robot.operating_point(one.desired[-1][:2]))
    one.manager.send(far)  # a jump from the motion of now
    one.manager.send([near, far])  # a jump in between
    twisted = near.copy()
    twisted[5] += 1e3
    one.manager.send(twisted)
    one.run(10)
    assert one.manager.published("health", "refused_commands") == 1
    assert capfd.readouterr().err.count("a row jumps") == 2
    assert one.ended() == ("followed", None)
    one.manager.send(np.concatenate(one.robot.operating_point(one.desired[-1][:2])))
    one.run(600)
    assert one.ended() == ("aborted", -1)
    one.goal([1.0], [GOAL])
    assert one.finished() == ("succeeded", 0)


def test_a_goal_of_the_same_period_as_rows_ends(make: Make) -> None:
    """Rows that come before the loop has read the goal end it too; nothing is published along no trajectory."""
    one = make()
    one.goal(*MOVE)
    assert one.accepted()
    one.manager.send(np.concatenate(one.robot.operating_point(START)))
    one.run(20)
    assert one.ended() == ("aborted", -1)
    one.goal(*MOVE)
    assert one.accepted()
    one.run(200)
    one.manager.send(np.concatenate(one.robot.operating_point(one.desired[-1][:2])))
    one.run(20)
    assert not np.isfinite(one.desired[-1]).any()


def test_a_goal_that_waits_ends_where_the_path_before_it_is_left(make: Make) -> None:
    one = make()
    one.goal(*MOVE, path=TINY)
    assert one.accepted()
    one.run(1)
    one.goal(*MOVE, begins=2.0)
    assert one.accepted()
    one.run(400)
    assert one.ended() == ("aborted", -4)


def test_a_refused_goal_ends_though_the_one_before_it_succeeds(make: Make) -> None:
    """Both end before the node's timer looks."""
    one = make()
    one.goal(*MOVE)
    assert one.accepted()
    one.run(200)
    one.goal([0.005, 1.0], [np.add(GOAL, 0.5), GOAL])
    assert one.accepted()
    for _ in range(LONGEST):
        one.manager.measure(one.plant.output())
        assert one.manager("update", ctypes.c_int64(round(1e9 * PERIOD))) == 0
        one.plant.step(one.manager.input(), [], PERIOD)
    assert one.ended() == ("aborted", -1)


def test_publishers_that_fight_are_named(make: Make, capfd: pytest.CaptureFixture[str]) -> None:
    """Once, until they fight again."""
    fighting(make)
    assert (
        capfd.readouterr().err.count("publishers of /arm_controller/joint_trajectory are /planner, /servo")
        == 1
    )


def test_goals_of_one_period_are_started_one_after_the_other(make: Make) -> None:
    """The second cannot start from the motion of the first, which goes on."""
    one = make()
    one.goal(*MOVE)
    assert one.accepted()
    first = one.manager("goal_handle")
    one.goal([0.005, 1.0], [np.add(GOAL, 0.5), GOAL])
    assert one.accepted()
    one.run(LONGEST)
    assert one.ended() == ("aborted", -1)
    one.manager("look_at", ctypes.c_void_p(first))
    assert one.ended() == ("succeeded", 0)
    np.testing.assert_allclose(one.measured[-1], GOAL, atol=2e-3)


def test_more_goals_than_the_loop_reads_are_refused(make: Make, capfd: pytest.CaptureFixture[str]) -> None:
    """None is lost without a word; those that were taken are followed one after the other."""
    one = make()
    handles = []
    for k in range(20):
        one.goal([1.0], [np.add(START, 0.01 * k)])
        assert one.accepted()
        handles.append(one.manager("goal_handle"))
        one.manager("publish_trajectory")
    assert capfd.readouterr().err.count("not read so many") > 0
    one.run(LONGEST)
    ends = []
    for handle in handles:
        one.manager("look_at", ctypes.c_void_p(handle))
        ends.append(one.ended())
    assert set(ends) == {("aborted", -1), ("succeeded", 0)}
    at = np.add(START, 0.01 * ends.index(("succeeded", 0)))
    np.testing.assert_allclose(one.measured[-1], at, atol=2e-3)


def test_a_late_cancel_leaves_the_goal_after_it_alone(make: Make) -> None:
    """Also one that meets no goal, and is noticed when there is another one."""
    one = make()
    one.goal([0.5], [START])
    assert one.finished(None) == ("succeeded", 0)
    one.manager("cancel_nothing")
    one.goal(*MOVE)
    assert one.finished() == ("succeeded", 0)


def test_no_update_of_a_goal_allocates(make: Make, tmp_path: Path) -> None:
    """Nor where one replaces another, or the controller stops."""
    built_in = make().manager.package.parent.parent
    objects = [
        built_in / f"{name}.o" for name in ("controller", "trajectories", "manager", "arm", "arm_follow")
    ]
    program = tmp_path / "allocations"
    subprocess.run(["g++", *STRICT, HERE / "allocations.cpp", *objects, "-lm", "-o", program], check=True)
    found = subprocess.run([program, "goals"], check=True, capture_output=True, text=True)
    assert found.stdout.split() == ["9", "0"]


def test_feedback_comes_meanwhile(make: Make) -> None:
    one = make()
    one.goal(*MOVE)
    assert one.accepted()
    one.run(300)
    assert one.manager("feedbacks") > 10
    found = [one.library.desired(ctypes.c_void_p(one.manager.address), place) for place in range(2)]
    assert found == pytest.approx(one.desired[-1][:2], abs=1e-3)


@pytest.mark.parametrize(
    "stated",
    [
        {"stop_time": 0.0},
        {"cmd_timeout": -1.0},
        {"constraints__elbow__goal": math.nan},
        {"constraints__goal_time": -1.0},
    ],
)
def test_parameters_that_are_none_are_refused(
    stated: dict[str, Any], make: Make, capfd: pytest.CaptureFixture[str]
) -> None:
    assert make().manager.configure(**stated) == 1
    assert "ERROR" in capfd.readouterr().err
