"""Places of points, against Pinocchio, and the joints that bring them there."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import flexhinf as fh
from flexhinf.errors import InvalidInput
from flexhinf.robot.kinematics import SINGULAR, link_frames, pose_at, position_of


@pytest.mark.oracle
@pytest.mark.parametrize("name", ["planar-two-link", "spatial-three-link", "seven-link"])
def test_frames_are_those_of_pinocchio(
    name: str, rigid: Callable[..., Any], pinocchio_model: Callable[..., Any]
) -> None:
    robot = fh.load_robot(name)
    pin = pytest.importorskip("pinocchio")
    model = pinocchio_model(*rigid(robot))
    data, q = model.createData(), np.linspace(0.3, -0.7, len(robot.joint_names))
    pin.forwardKinematics(model, data, q)
    turns, places = link_frames(robot, q)
    for k in range(len(q)):
        assert places[k] == pytest.approx(data.oMi[k + 1].translation, abs=1e-12)
        assert turns[k] == pytest.approx(data.oMi[k + 1].rotation, abs=1e-12)


@pytest.mark.parametrize("name", ["planar-two-link", "spatial-three-link", "seven-link"])
def test_a_place_that_is_reached_is_reached_again(name: str) -> None:
    robot, offset = fh.load_robot(name), (0.05, -0.1, 0.02)
    q = np.asarray(robot.home) + np.linspace(0.2, 0.4, len(robot.joint_names))
    wanted = position_of(robot, q, offset=offset)
    found = pose_at(robot, wanted, offset=offset)
    assert position_of(robot, found.pose, offset=offset) == pytest.approx(wanted, abs=1e-6)
    for value, pair in zip(found.pose, robot.links.limits):
        assert pair is None or pair[0] <= value <= pair[1]
    near = pose_at(robot, wanted, offset=offset, near=q)
    assert near.pose == pytest.approx(q, abs=1e-6)


def test_a_stretched_arm_is_near_singular() -> None:
    robot, offset = fh.load_robot("planar-two-link"), (0.4, 0.0, 0.0)
    bent, stretched = (
        pose_at(robot, position_of(robot, q, offset=offset), offset=offset, near=q)
        for q in ((0.3, 1.2), (0.3, 0.01))
    )
    assert stretched.mobility < SINGULAR <= bent.mobility


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (((5.0, 0.0, 0.0),), ", 4.5 m"),
        (((0.3, 0.0, 0.2),), ", 0.283 m"),
        (((0.3, 0.0),), "(0.3, 0.0)"),
        (((0.3, 0.0, np.nan),), "(0.3, 0.0, nan)"),
        (((0.3, 0.0, 0.0), "hand"), "'hand'"),
    ],
)
def test_what_cannot_be_reached_is_refused(arguments: Any, message: str) -> None:
    with pytest.raises(InvalidInput) as refused:
        pose_at(fh.load_robot("planar-two-link"), *arguments)
    assert message in str(refused.value)
