"""Trajectories by topic and action: every row of the table in docs/ros2.md, with MuJoCo as the robot."""

from __future__ import annotations

import ctypes
import math
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.export.test_ros2 import HERE, PERIOD, STRICT, Manager
from tests.export.trajectory_cases import CASES, TrajectoryCase
from tests.export.trajectory_runs import RUNS, fighting
from tests.export.trajectory_session import (
    GOAL,
    JOINTS,
    LONGEST,
    MOVE,
    START,
    TINY,
    Make,
    Session,
    package_of,
)

yaml = pytest.importorskip("yaml")
pytest.importorskip("mujoco")
pytestmark = [
    pytest.mark.usefixtures("unoptimised"),
    pytest.mark.oracle,
    pytest.mark.ci("builds one package, and moves it with MuJoCo"),
]


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
    said = capfd.readouterr().err
    assert (said.count("/planner, /servo"), said.count("/arm_controller/joint_trajectory")) == (1, 1)


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
    assert capfd.readouterr().err.count("so many") > 0
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
