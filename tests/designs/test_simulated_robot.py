"""MuJoCo's robot as hardware, beside the same robot in a loop."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.export.test_rest import robot_of
from tests.export.test_ros2 import workspace_controller

import flexhinf as fh
from flexhinf.designs.simulated_robot import BLOCK, SimulatedRobot
from flexhinf.robot import MuJoCoPlant

pytest.importorskip("mujoco")
pytestmark = [
    pytest.mark.usefixtures("unoptimised"),
    pytest.mark.costs("compiles a loop with MuJoCo's robot"),
]

SAMPLES = 60


@pytest.mark.ci("compiles two loops")
@pytest.mark.parametrize("delay", [3, 0])
def test_its_robot_moves_as_that_of_a_loop(delay: int) -> None:
    """Quantised, and with inputs that are late; the numbers are the loop's, bit by bit."""
    robot, controller = robot_of("planar-two-link"), workspace_controller()
    x, u = robot.operating_point([-0.4, 0.2])
    goal = np.concatenate(robot.operating_point([-0.39, 0.2]))
    box = MuJoCoPlant(robot, ("link_position", "motor_position"))
    loop = fh.Loop(box, controller, quantisation=1e-4, delay=delay * controller.period)
    expected = fh.run_realtime(
        loop, dict(zip(controller.commanded, goal)), duration=(SAMPLES - 1) * controller.period,
        initial_state=x, initial_input=u, initial_estimate=x, real_time=False,
    ).trajectory  # fmt: skip
    hardware = SimulatedRobot(box, loop, None, 0, x, u)
    stepped = controller.fresh()
    stepped.reset(state=x, input=u)
    read, written = [], []
    for _ in range(SAMPLES):
        read.append(hardware.read())
        written.append(stepped.step(read[-1], goal))
        hardware.write(written[-1])
    assert np.array_equal(read, expected.signals["output"])
    assert np.array_equal(written, expected.signals["input"])


def test_noise_goes_on_for_ever_and_sensors_may_be_slow() -> None:
    """Blocks differ, deviations are those that are stated, and a sensor gives NaN between two measurements."""
    robot, controller = robot_of("planar-two-link"), workspace_controller()
    x, u = robot.operating_point([-0.4, 0.2])
    box = MuJoCoPlant(robot, ("link_position", "motor_position"))
    loop = fh.Loop(box, controller)
    hardware = SimulatedRobot(box, loop, [1e-3, 1e-4, 1e-4, 1e-5], 7, x, u)
    noise = np.array([hardware.read() for _ in range(3 * BLOCK)]) - np.array(box.output())
    np.testing.assert_allclose(noise.std(axis=0), [1e-3, 1e-4, 1e-4, 1e-5], rtol=0.05)
    assert not np.array_equal(noise[:BLOCK], noise[BLOCK : 2 * BLOCK])
    loop.channel = replace(loop.channel, periods=(1, 1, 5, 1))
    slow = SimulatedRobot(box, loop, None, 7, x, u)
    seen = np.isfinite([slow.read() for _ in range(20)])
    assert seen[:, [0, 1, 3]].all()
    assert np.flatnonzero(seen[:, 2]).tolist() == [0, 5, 10, 15]
