"""The shaper of streamed paths: frequencies of held motors, delays that follow the pose, what a soft spring leaves."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import root
from tests.builders import driven_robot
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.errors import InvalidInput
from flexhinf.robot import MuJoCoPlant, Parameter
from flexhinf.robot.shaper import vibration_frequencies

PERIOD = 4e-3


@pytest.fixture(scope="module")
def feedforward():
    return fh.Feedforward(driven_robot("planar-two-link"), PERIOD)


def with_rigid(robot, joint):
    """The same robot, one joint of which has no spring."""
    lost = {f"stiffness_{joint}", f"damping_{joint}"}
    kept = tuple(p for p in robot.parameters if p.name not in lost)
    return replace(robot, parameters=kept, rigid=(joint,))


@pytest.mark.quick_cases(4)
@pytest.mark.parametrize("drive", ["position", "velocity"])
@pytest.mark.parametrize(
    ("name", "rigid"),
    [
        ("planar-two-link", ""),
        ("spatial-three-link", ""),
        ("planar-two-link", "shoulder"),
        ("planar-two-link", "elbow"),
    ],
)
def test_frequencies_are_those_of_the_linearised_plant_with_stiff_drives(name, rigid, drive):
    """Eigenvalues of the whole plant, whose drives are far faster than its springs."""
    robot = driven_robot(name, drive, [3e4] * len(fh.load_robot(name).joint_names))
    robot = with_rigid(robot, rigid) if rigid else robot
    for pose in (robot.home, 0.5 * np.array(robot.home) - 0.4):
        frequencies = vibration_frequencies(robot, np.array([pose]))[0]
        modes = [mode.frequency for mode in robot.modes(pose) if mode.vibration]
        assert frequencies == pytest.approx(modes[: len(frequencies)], rel=2e-3)
        assert len(frequencies) == len(robot.joint_names) - bool(rigid)


def test_a_position_drive_that_yields_makes_them_slower_as_in_the_linearised_plant(feedforward):
    robot = feedforward.robot
    stiff, yielding = (
        vibration_frequencies(each, np.array([[0.3, 0.5]]))[0, 0]
        for each in (driven_robot("planar-two-link", hertz=(3e4, 3e4)), robot)
    )
    slowest = min(mode.frequency for mode in robot.modes((0.3, 0.5)) if mode.vibration)
    assert yielding == pytest.approx(slowest, rel=0.005)
    assert yielding < 0.98 * stiff


def test_a_step_comes_in_parts_of_one_two_and_one_quarter(feedforward):
    """At the periods of its goal, in closed form; the delay is their halves' sum."""
    goal = np.array([0.5, -0.7])
    step = np.vstack([np.zeros((1, 2)), np.repeat([goal], 300, axis=0)])
    slow, fast = vibration_frequencies(feedforward.robot, goal[None])[0]
    taps = [
        (i / (2 * slow) + j / (2 * fast), a * b / 16.0)
        for i, a in enumerate((1, 2, 1))
        for j, b in enumerate((1, 2, 1))
    ]
    shaped = feedforward.shaped(step)
    assert shaped[-1] == pytest.approx(goal, abs=1e-12)
    late = feedforward.shaping_delay(step)[-1]
    assert late == pytest.approx(0.5 / slow + 0.5 / fast)
    for after in (0.02, 0.5 / slow + 0.02, 0.9 / slow):
        row = 1 + round(after / PERIOD)
        if all(abs(after - at) > 2 * PERIOD for at, _ in taps):
            expected = math.fsum(weight for at, weight in taps if at < after)
            assert shaped[row] == pytest.approx(expected * goal, rel=0.05)
    assert (np.diff(shaped[:, 0]) >= -1e-12).all()


def test_a_row_needs_no_more_than_two_periods_before_it(feedforward):
    t = PERIOD * np.arange(900)
    path = np.column_stack([np.sin(2.0 * t), 0.5 * np.cos(3.0 * t)])
    whole = feedforward.shaped(path)
    frequencies = vibration_frequencies(feedforward.robot, path)
    size = math.ceil(2.0 * (1.0 / frequencies).sum(axis=1).max() / PERIOD) + 4
    for end in (size + 1, 600, 900):
        assert feedforward.shaped(path[end - size : end])[-1] == pytest.approx(whole[end - 1], abs=1e-12)


def test_a_pose_where_gravity_is_stronger_than_springs_is_refused(feedforward):
    """Links upright on springs of a tenth of their weight fall; the same path without a shaper is not refused."""
    weak = feedforward.robot.with_parameters(Parameter("stiffness_shoulder", 1.0))
    weak, upright = fh.Feedforward(weak, PERIOD), [[math.pi, 0.0]] * 4
    with refused_with(InvalidInput, "3.1416"):
        weak.shaped(upright)
    assert weak.rows(upright).link_position == pytest.approx(np.array(upright))


@pytest.mark.oracle
@pytest.mark.costs("two moves on MuJoCo, with the modes of each sample")
def test_soft_springs_on_mujoco_are_left_with_less_vibration(feedforward):
    pytest.importorskip("mujoco", reason="MuJoCo is not installed")
    robot = feedforward.robot
    soft = dict(robot.plant_parameters())
    soft["stiffness"] = 0.8 * np.asarray(soft["stiffness"])
    s = np.clip(PERIOD * np.arange(350) / 0.3, 0.0, 1.0)[:, None]
    path = np.array([0.2, -0.4]) + s**3 * (10.0 - 15.0 * s + 6.0 * s**2) * [-0.8, 0.9]
    plant, swings = MuJoCoPlant(robot, None, step=1e-3, parameters=soft), []
    for streamed in (path, feedforward.shaped(path)):
        commands, links = feedforward.rows(streamed).command, []
        start = root(lambda q, u=commands[0]: robot.operating_point(q, parameters=soft)[1] - u, path[0]).x
        plant.reset(robot.operating_point(start, parameters=soft)[0])
        for command in commands:
            plant.step(command, np.zeros(0), PERIOD)
            links.append(plant.state()[:2])
        swings.append(np.ptp(links[-100:], axis=0).max())
    assert swings[1] < 0.3 * swings[0]
