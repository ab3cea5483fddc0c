"""Goals and waypoints in space become those of the joints, at the right places, and are refused out of reach."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from flexhinf.designs import Specification
from flexhinf.designs.design_file import tool_of
from flexhinf.designs.request import DesignRequest, with_joints
from flexhinf.errors import InvalidInput
from flexhinf.robot.kinematics import position_of

Robots = Callable[[str], Any]
TIP = ":400mm,0,0"
WAY = {"time": [0.0, 1.0, 2.0], "x [mm]": [700.0, 600.0, 500.0], "z": [0.0, 0.0, 0.0], "y": [0.0, 0.3, 0.4]}


def request(robot_of: Robots, **fields: Any) -> DesignRequest:
    return DesignRequest(robot_of("planar-two-link"), Specification(**fields), "planar-two-link")


def test_a_goal_in_space_is_a_pose_of_the_joints(robot_of: Robots) -> None:
    found = with_joints(request(robot_of), "0.6,300mm,0", TIP)
    assert found.specification.pose is not None
    place = position_of(found.robot, found.specification.pose, offset=(0.4, 0.0, 0.0))
    assert place == pytest.approx([0.6, 0.3, 0.0], abs=1e-6)
    assert "goal" in found.notes[-1]
    assert "singular" not in found.notes[-1]
    stretched = with_joints(request(robot_of, start=(0.3, 0.1)), "0.8999,0,0", TIP)
    assert "singular" in stretched.notes[-1]
    assert with_joints(request(robot_of)).specification == Specification()


def test_waypoints_in_space_are_waypoints_of_the_joints(robot_of: Robots) -> None:
    found = with_joints(request(robot_of, move=WAY), "", f"elbow{TIP}")
    table = found.specification.move
    assert table is not None
    assert table.joints == ("shoulder", "elbow")
    places = [position_of(found.robot, row, offset=(0.4, 0.0, 0.0)) for row in table.rows]
    np.testing.assert_allclose(places, [[0.7, 0.0, 0.0], [0.6, 0.3, 0.0], [0.5, 0.4, 0.0]], atol=1e-6)
    assert np.abs(np.diff(table.rows, axis=0)).max() < 1.0  # one configuration of the elbow throughout


def test_a_workspace_of_places_is_one_of_the_joints(robot_of: Robots) -> None:
    """As the move through these waypoints, which needs times."""
    untimed = {name: column for name, column in WAY.items() if name != "time"}
    move, space = (
        with_joints(request(robot_of, **fields), "", f"elbow{TIP}").specification
        for fields in ({"move": WAY}, {"workspace": untimed})
    )
    assert space.workspace.rows == move.move.rows
    assert space.workspace.joints == ("shoulder", "elbow")


@pytest.mark.parametrize(
    ("goal", "tool", "fields", "message"),
    [
        ("0.6,0.3", "", {}, "pose-xyz.*'0\\.6,0\\.3'"),
        ("a,b,c", "", {}, "pose-xyz.*'a,b,c'"),
        ("30DEG,0,0", "", {}, "pose-xyz.*'30DEG,0,0'"),
        ("30deg,0,0", "", {}, "pose-xyz.*'30deg,0,0'"),
        ("1e300,0,0", "", {}, "pose-xyz.*'1e300,0,0'"),
        ("0.6,0.3,0", ":1e200,0,0", {}, "tool.*'1e200,0,0'"),
        ("0.6,0.3,0", ":1e30,0,0", {}, "reach.*'elbow'.*1e\\+30 m"),
        ("", TIP, {}, "--pose-xyz.*--tool"),
        ("0.6,0.3,0", ":0.4", {}, "tool.*'0\\.4'"),
        ("0.6,0.3,0", ":0,0,1rad", {}, "tool.*'0,0,1rad'"),
        ("0.6,0.3,0", "hand", {}, "link.*'elbow'.*'hand'"),
        ("9,0,0", "", {}, "reach.*'elbow'.* 8\\.5 m"),
        ("0.6,0.3,0", TIP, {"pose": (0.1, 0.2)}, "twice.*--pose-xyz or --pose"),
        ("", TIP, {"move": {**WAY, "x [mm]": [700.0, 9e3, 0.0]}}, "reach.* 1 s.*'elbow'.* 8\\.1 m"),
        (
            "",
            TIP,
            {"move": {"time": [0, 1], "x [deg]": [0, 1], "y": [0, 1], "z": [0, 0]}},
            "waypoints.*'deg'",
        ),
    ],
)
def test_what_is_no_goal_is_refused(
    goal: str, tool: str, fields: dict[str, Any], message: str, robot_of: Robots
) -> None:
    with pytest.raises(InvalidInput) as refused:
        with_joints(request(robot_of, **fields), goal, tool)
    assert re.search(message, str(refused.value), re.DOTALL)


def test_a_tool_is_a_link_and_an_offset() -> None:
    assert tool_of("") == (None, (0.0, 0.0, 0.0))
    assert tool_of("elbow") == ("elbow", (0.0, 0.0, 0.0))
    assert tool_of("elbow:0,0,100mm") == ("elbow", (0.0, 0.0, pytest.approx(0.1)))
