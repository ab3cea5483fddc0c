"""Where links are, against closed forms."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from tests.builders import joint_text

import flexhinf as fh
from flexhinf.robot.kinematics import FACTORS, magnification, picture_axes, skeleton


@pytest.mark.parametrize("angle", [0.0, 0.7, math.pi])
def test_the_single_link_hangs_at_zero_and_turns_about_its_joint(angle: float) -> None:
    (line,) = skeleton(fh.paper_arm(), [angle])
    length = fh.paper_arm().nominal["length"]
    assert line == pytest.approx(
        np.array([[0.0, 0.0, 0.0], [length * math.cos(angle), length * math.sin(angle), 0.0]])
    )


def test_the_second_link_begins_where_the_first_ends() -> None:
    first, second = skeleton(fh.load_robot("planar-two-link"), [0.4, 0.6])
    elbow = 0.5 * np.array([math.cos(0.4), math.sin(0.4), 0.0])
    tip = elbow + 0.4 * np.array([math.cos(1.0), math.sin(1.0), 0.0])
    assert first == pytest.approx(np.array([np.zeros(3), elbow]))
    assert second == pytest.approx(np.array([elbow, tip]))


@pytest.mark.parametrize("name", ["spatial-three-link", "seven-link"])
def test_links_keep_their_lengths(name: str) -> None:
    robot = fh.load_robot(name)
    moved = np.asarray(robot.home) + 0.3
    for before, after in zip(skeleton(robot, robot.home), skeleton(robot, moved)):
        lengths = [np.linalg.norm(np.diff(line, axis=0), axis=1) for line in (before, after)]
        assert lengths[0] == pytest.approx(lengths[1])


@pytest.mark.parametrize(
    ("name", "axes", "above", "planar"),
    [
        ("scara", [[1, 0, 0], [0, 1, 0]], True, False),
        ("planar-two-link", [[0, 1, 0], [-1, 0, 0]], False, True),
    ],
)
def test_an_arm_is_seen_along_the_axes_of_its_joints(
    name: str, axes: object, above: bool, planar: bool
) -> None:
    """A SCARA from above, at whatever heights its links are; its quill slides out of the picture."""
    view = picture_axes(fh.load_robot(name))
    assert view is not None
    assert (view.axes.T.tolist(), "above" in view.names[1], view.planar) == (axes, above, planar)


@pytest.mark.parametrize(
    ("axis", "right", "name"),
    [
        ([0, 1, 0], [1, 0, 0], "along x"),
        ([0, -1, 0], [1, 0, 0], "along x"),
        ([1, 0, 0], [0, 1, 0], "along y"),
        ([0.6, 0.8, 0], [0.8, -0.6, 0], "horizontal"),
    ],
)
def test_what_is_to_the_right_in_the_world_is_so_in_the_picture(
    axis: list[float], right: list[float], name: str, tmp_path: Path
) -> None:
    """Whichever way the joint turns: who asks for x = 0.6 m sees the arm there, and reads where that is."""
    text = joint_text("shoulder", axis=axis, effort_limit=10, spring="stiffness = 1000")
    (tmp_path / "arm.toml").write_text(text)
    view = picture_axes(fh.load_robot(tmp_path / "arm.toml"))
    assert view is not None
    np.testing.assert_allclose(view.axes.T, [right, [0, 0, 1]], atol=1e-12)
    assert name in view.names[0]


def test_joints_about_several_directions_have_no_such_view() -> None:
    assert picture_axes(fh.load_robot("seven-link")) is None


def test_how_much_larger() -> None:
    turns, slides = np.array([False, False]), np.array([False, True])
    assert magnification(np.full((3, 2), 0.001), turns, 1.0) == 200
    assert magnification(np.full((3, 2), 1.0), turns, 1.0) == 1
    assert magnification(np.array([[0.001, 0.01]]), slides, 0.5) == 5
    assert magnification(np.zeros((3, 2)), turns, 1.0) == FACTORS[-1]
