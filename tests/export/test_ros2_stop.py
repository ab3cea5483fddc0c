"""The protective stop of the plugin for ros2_control, on an arm that is integrated here: what acts, and what is said of
it, is that of `Controller.may_act`."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.export.test_rest import robot_of
from tests.export.test_ros2 import LOOKS, Manager, built, workspace_controller
from tests.export.trajectory_session import MOVE, Session
from tests.loop.controller.test_signs import AT, FAULTS, POSE, Arm, Happening, made, read, stuck

import flexhinf as fh
from flexhinf.export import protected
from flexhinf.loop.controller.stop import LONGEST
from flexhinf.stops import Stop

pytest.importorskip("yaml")
pytestmark = [
    pytest.mark.usefixtures("unoptimised"),
    pytest.mark.oracle,
    pytest.mark.ci("builds a package, which its tests share"),
]

#: Sample from which on the arm is to move, and samples after a fault in which a controlled stop must have ended.
MOVES, SAMPLES = 350, round((LONGEST + 0.1) / 1e-3)

Start = Callable[..., Manager]


@cache
def arm_controller() -> fh.Controller:
    return made()


@pytest.fixture(scope="module")
def start(sources_of: Callable[..., Path]) -> Start:
    """Managers of one package, which are configured."""
    library, package = built(sources_of(arm_controller()))

    def configured(**parameters: Any) -> Manager:
        one = Manager(library, package)
        assert one.configure(publish_every=1, **parameters) == 0
        return one

    return configured


class Run:
    """The plugin moves an arm that something happens to, and `Controller` steps beside it on the same readings.

    `reasons`: Why it stops. `ended`: After how many samples it takes the power away, None where it does not; `keeps`
    says so where `Controller`, which has no category 2, takes it.
    """

    def __init__(self, one: Manager, happens: Happening, keeps: bool = False, **options: Any) -> None:
        protection = arm_controller().protection
        assert protection is not None
        controller, arm = arm_controller().fresh(protection=replace(protection, **options)), Arm()
        y, self.ended = arm.run(float(controller.input_before()[0])), None
        assert one.activate(y) == 0
        pose, self.inputs = y[0], list[float]()
        controller.reset(*fh.load_robot("paper").operating_point(pose))
        for k in range(AT + SAMPLES):
            seen = happens(arm, y.copy(), k) if k >= AT else y
            if k == MOVES:
                one.send([POSE + 0.1])
            failed = one.update(seen)
            self.inputs.append(float(one.input()[0]))
            controller.step(seen, [POSE + 0.1 if k >= MOVES else pose])
            power = controller.may_act()
            assert failed == (not (power or keeps)), k
            if failed:
                self.ended = k - AT
                break
            if power:  # what was computed acts a sample later
                computed = one.published("input", "motor_voltage")
                assert computed == pytest.approx(controller.output[0], rel=1e-6, abs=1e-6), k
            y = arm.run(self.inputs[-1])
        self.reasons = Stop(
            sum(stop for stop in Stop if one.published("health", f"stop.{str(stop.name).lower()}"))
        )
        assert one.published("health", "stop") == int(self.reasons) == int(controller.stop)


FAULTY: dict[str, tuple[Happening, Stop]] = {
    "stuck": (stuck(1), Stop.INCONSISTENT),
    "silent": (read(1, lambda y, k: math.nan), Stop.SENSOR_LOST),
    "reversed": (FAULTS["drive is reversed"], Stop.INCONSISTENT),
}


@pytest.mark.parametrize("fault", FAULTY)
def test_a_fault_ends_without_power_and_says_why(
    fault: str, start: Start, capfd: pytest.CaptureFixture[str]
) -> None:
    """An arm without brakes is slowed down first; then the drives get 0, and the manager an error."""
    one, (happens, expected) = start(), FAULTY[fault]
    run = Run(one, happens)
    assert run.reasons == expected
    assert run.ended is not None
    assert run.inputs[-1] == 0.0 != run.inputs[-2]
    assert one.published("health", "stopped") == 1
    said = capfd.readouterr().err
    assert said.count(f"stops (code 0): {str(expected.name).lower()}") == 1
    assert said.count("Brake the") == 1
    assert [one.update(Arm().run(0.0)) for _ in range(3)] == [1] * 3  # it latches
    assert one.input() == 0.0
    assert one("deactivate") == 0
    Run(one, lambda arm, y, k: y)


@pytest.mark.parametrize("category", [0, 2])
def test_the_category_of_a_stop_is_a_parameter(category: int, start: Start) -> None:
    """Power off at once, or a controlled stop that goes on holding."""
    one = start(category=category)
    run = Run(one, FAULTS["link is silent"], keeps=category == 2, brakes=(category == 0,))
    assert run.reasons == Stop.SENSOR_LOST
    assert run.ended == (10 if category == 0 else None)
    assert (run.inputs[-1] == 0.0) == (category == 0)


@pytest.mark.parametrize("none", [[], [""]])
def test_what_stops_the_robot_is_a_parameter(none: list[str], start: Start) -> None:
    """Nothing does, as long as the other encoder tells where the arm is; a file writes no empty list but this one."""
    run = Run(start(stop_on=none), FAULTS["link is silent"], stop_on=())
    assert run.reasons == Stop(0)
    assert run.ended is None


def test_a_start_in_motion_or_with_a_wrong_zero_is_refused(
    start: Start, capfd: pytest.CaptureFixture[str]
) -> None:
    one, y = start(), Arm().run(0.0)
    for wrong, said in (([0.0, 0.3], "twisted"), ([0.0, math.nan], "missing")):
        assert one.activate(y + wrong) == 1
        assert f"start: {said}" in capfd.readouterr().err
    assert one.activate(y, looks=10) == 0
    weight = one.input()  # it is held meanwhile
    assert weight == pytest.approx(fh.load_robot("paper").operating_point(POSE)[1], rel=1e-2)
    moving = [one.update(y + 0.2e-3 * k) for k in range(LOOKS)]  # 0.2 rad/s
    assert sorted(moving) == moving
    assert moving[0] == 0
    assert moving[-1] == 1
    assert one.input() == 0.0
    assert "start: moves" in capfd.readouterr().err
    assert one.published("health", "stop.bad_start") == 1
    assert one("deactivate") == 0
    assert one.activate(y) == 0


@pytest.mark.parametrize(
    ("stamped", "stops", "after"),
    [(["motor_position"], "sensor_lost", 20), (["link_position", "motor_position"], "step_failed", 10)],
)
def test_a_reading_whose_stamp_stands_is_missing(
    stamped: list[str], stops: str, after: int, start: Start
) -> None:
    """Both encoders may have one counter. At rest readings repeat themselves, and without a stamp nothing is known."""
    stamps = {f"measurements__{name}__stamp": "arm/cycle" for name in stamped}
    one, y = start(longest_unseen=20, **stamps), Arm().run(0.0).tolist()
    assert one.names(False) == ["joint/position", "joint/motor_position", "arm/cycle"]
    assert one.activate([*y, 0.0]) == 0
    assert [one.update([*y, 1.0 + k // 4]) for k in range(100)] == [0] * 100
    assert one.published("health", "unseen.motor_position") == 3
    said = list[float]()
    for _ in range(30):
        one.update([*y, 25.0])
        said.append(one.published("health", f"stop.{stops}"))
    assert said.index(1.0) == after - 3


@pytest.mark.ci("builds a package of two joints, and moves them with MuJoCo")
def test_a_goal_ends_when_a_controlled_stop_begins(sources_of: Callable[..., Path]) -> None:
    """Of a controller for the workspace, whose move is slowed down to a stand before its drives lose their power."""
    pytest.importorskip("mujoco")
    robot = robot_of("planar-two-link")
    controller, _ = protected(workspace_controller(), robot)
    one = Session(Manager(*built(sources_of(controller, "double", robot))))
    one.goal(*MOVE)
    assert one.accepted()
    one.run(400)
    assert one.ended() == ("followed", None)
    assert one.manager.published("health", "stop") == 0
    moving, speeds = np.abs(one.plant.state()[2:4]).max(), list[float]()
    while one.manager.update([math.nan, *one.plant.output()[1:]]) == 0:
        one.plant.step(one.manager.input(), [], 1e-3)
        speeds.append(float(np.abs(one.plant.state()[2:4]).max()))
        assert len(speeds) < SAMPLES
        if len(speeds) == 12:
            assert one.manager.published("health", "stop.sensor_lost") == 1
            assert one.ended() == ("aborted", -4)
    assert len(speeds) > 50
    assert max(speeds[-50:]) < 0.25 * moving
    assert np.array_equal(one.manager.input(), [0.0, 0.0])


@pytest.mark.parametrize(
    ("name", "wrong", "advice", "tried"),
    [
        ("stop_on", ["sensor_gone"], "stop_on: [runaway, sensor_lost]", ["runaway", "sensor_lost"]),
        ("category", 3, "category: 1", 1),
        ("longest_unseen", 0, "longest_unseen: 10", 10),
        ("measurements__link_position__stamp", "count", "link_position.stamp: joint/stamp", "joint/stamp"),
    ],
)
def test_a_parameter_that_does_not_fit_is_refused_with_advice_that_works(
    name: str, wrong: Any, advice: str, tried: Any, start: Start, capfd: pytest.CaptureFixture[str]
) -> None:
    one = start()
    assert one.configure(**{name: wrong}) == 1
    said = capfd.readouterr().err
    assert advice in said
    assert "expected" in said
    assert (wrong[0] if isinstance(wrong, list) else str(wrong)) in said
    assert one.configure(**{name: tried}) == 0
