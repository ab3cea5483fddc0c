"""The check before a start: the same answers in Python and in a compiled library."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from tests.builders import arm_controller
from tests.export.test_rest import robot_of
from tests.export.test_ros2 import workspace_controller
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.errors import InvalidInput
from flexhinf.export import compile_controller, load_compiled, protected

pytestmark = pytest.mark.usefixtures("unoptimised")

ROBOT = robot_of("planar-two-link")
HOME = np.array([-0.4, 0.2])

#: What is measured at sample k before a start: links, then motors.
Read = Callable[[int], np.ndarray]


def at(pose: Any, twist: float = 0.0, moves: float = 0.0) -> Read:
    """At rest by the robot's own statics; with a motor that is off, or that moves by so much each sample."""
    x, _ = ROBOT.operating_point(pose)
    y = np.concatenate([x[:2], x[4:6]])
    return lambda k: y + np.array([0.0, 0.0, twist, 0.0]) + moves * k


def missing(sample: int) -> Read:
    """One reading is not there at one sample."""
    return lambda k: at(HOME)(k) * np.where((k == sample) & (np.arange(4) == 3), np.nan, 1.0)


STARTS: dict[str, tuple[Read, fh.Start, int | None]] = {
    "at rest": (at(HOME), fh.Start(0), 50),
    "far from the command": (at([-2.4, 0.7]), fh.Start(0), 50),
    "it moves": (at(HOME, moves=1e-3), fh.Start.MOVES, None),
    "an encoder of a motor is off": (at(HOME, twist=0.3), fh.Start.TWISTED, None),
    "in degrees": (lambda k: 57.3 * at(HOME)(k), fh.Start.OUT_OF_RANGE, None),
    "a reading is not there once": (missing(20), fh.Start(0), 71),
}


def answers(one: Any, read: Read) -> tuple[int | None, fh.Start]:
    """At which of 80 samples it first rests, and what is said then, or at the last one."""
    one.reset()
    for k in range(80):
        if one.at_rest(read(k)):
            return k, one.start_reasons
    return None, one.start_reasons


@pytest.mark.ci("compiles a library")
def test_starts_are_judged_as_by_the_compiled_controller(tmp_path: Any) -> None:
    controller = protected(workspace_controller(), ROBOT)[0]
    library = load_compiled(compile_controller(controller, tmp_path / "arm.so"))
    for name, (read, why, rests) in STARTS.items():
        found = answers(controller, read)
        assert found == answers(library, read), name
        assert (found[0], found[1] & why) == (rests, why), name
    controller.at_rest(at(HOME, twist=0.3)(0))
    controller.reset()
    assert not controller.start_reasons
    with refused_with(InvalidInput, "measurement", "motor_position_elbow"):
        controller.at_rest([0.0])


@pytest.mark.parametrize("measured", [("motor_position",), ("motor_position", "joint_torque")])
def test_a_zero_that_no_second_reading_tells_is_said_to_be_unchecked(measured: tuple[str, ...]) -> None:
    """A torque sensor tells the twist, and nothing of where the encoder of the motor has its zero."""
    robot = fh.load_robot("paper")
    plain = arm_controller(
        robot, fh.ExtendedKalmanFilter, measured=measured, limit=24.0, q=1e-7, r=1e-10,
        supervision=fh.Supervision((-2.0, 2.0), following=0.2),
    )  # fmt: skip
    controller = protected(plain, robot, np.array([2.0]))[0]
    assert answers(controller, lambda k: np.zeros(len(measured))) == (50, fh.Start.NOT_CHECKED)
    assert "home" in controller.start_reasons.look
