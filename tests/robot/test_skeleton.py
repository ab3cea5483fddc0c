"""Where links are, against closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest

import flexhinf as fh
from flexhinf.robot.kinematics import skeleton


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
