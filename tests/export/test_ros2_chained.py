"""The plugin below another controller of ros2_control, in its versions, with MuJoCo as the robot."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from tests.export.test_ros2 import PERIOD, Manager
from tests.export.trajectory_session import GOAL, JOINTS, MOVE, START, Session, package_of

import flexhinf as fh

pytest.importorskip("mujoco")
pytestmark = [
    pytest.mark.usefixtures("unoptimised"),
    pytest.mark.oracle,
    pytest.mark.ci("builds a package for each version, and moves it with MuJoCo"),
]


#: Of what a chained controller may export, ROLLING has all that JAZZY has.
JAZZY = pytest.param("JAZZY", marks=pytest.mark.nightly("one more package; ROLLING runs the same lines"))


@pytest.mark.parametrize("version", ["HUMBLE", JAZZY, "ROLLING"])
def test_another_controller_commands_the_arm(version: str, sources_of: Callable[..., Path]) -> None:
    """As joint_trajectory_controller does above it: positions and velocities each sample, then velocities alone. What
    nobody commands stays, a jump is refused, and messages are refused meanwhile. Above it the path rate is read."""
    library, package = package_of(version, sources_of)
    one = Session(Manager(library, package))
    assert one.manager("deactivate") == 0
    assert one.manager("export_references") == 4
    names = [one.manager("reference_name", k).decode() for k in range(4)]
    kinds = ("position", "velocity")
    assert names == [f"arm_controller/{joint}/{kind}" for kind in kinds for joint in JOINTS]
    assert one.manager("chain", 1) == 0
    one.activate(START)

    def refer(values: Sequence[float]) -> None:
        for k, value in enumerate(values):
            one.manager("refer", k, ctypes.c_double(value))

    one.run(20)
    np.testing.assert_allclose(one.measured[-1], START, atol=1e-3)
    one.goal(*MOVE)
    assert not one.accepted()
    moves = [fh.Quintic(a, b, 0.8) for a, b in zip(START, GOAL, strict=True)]
    for k in range(800):
        values = np.array([move.derivatives(PERIOD * (k + 1))[:2] for move in moves])
        refer([*values[:, 0], *values[:, 1]])
        one.run(1)
    one.run(120)
    one.is_smooth()
    np.testing.assert_allclose(one.measured[-1], GOAL, atol=2e-3)
    np.testing.assert_allclose(one.desired[-1][:2], GOAL, atol=1e-9)
    refer([GOAL[0] + 0.5, GOAL[1], math.nan, math.nan])
    one.run(50)
    np.testing.assert_allclose(one.measured[-1], GOAL, atol=2e-3)
    for _ in range(200):
        refer([math.nan, GOAL[1], -0.5, math.nan])
        one.run(1)
    refer([math.nan] * 4)
    one.run(200)
    np.testing.assert_allclose(one.measured[-1], (GOAL[0] - 0.1, GOAL[1]), atol=2e-3)
    if version != "HUMBLE":  # which exports no states
        assert one.manager("exported_state", 0) == 1.0
        for k in range(600):
            refer([GOAL[0] - 0.1 + 0.001 * k, GOAL[1], math.nan, math.nan])
            one.run(1)
        one.run(400)
        assert one.manager("exported_state", 0) == 0.0
    assert one.manager("deactivate") == 0
    assert one.manager("chain", 0) == 0
    one.activate(START)
    one.goal(*MOVE)
    assert one.finished() == ("succeeded", 0)
