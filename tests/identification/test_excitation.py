"""Motions that tell a robot's numbers: within limits, as telling as they say, and read again by the commands."""

from __future__ import annotations

import numpy as np
import pytest
from tests.logs import recorded
from tests.refusals import refused_with

import flexhinf as fh
from flexhinf.robot.waypoints import waypoints

# Models that are compiled for one motion: compiled in half the time.
pytestmark = pytest.mark.usefixtures("unoptimised")

ENCODERS = ("link_position", "motor_position")


def driven(robot, motion, seed):
    """A log of the robot with the motion's inputs, open loop."""
    start = robot.operating_point(motion.positions[0])[0]
    return recorded(robot.plant(ENCODERS), motion.inputs, motion.times[1], seed=seed, start=start)


CALM = {"measured": ENCODERS, "noise": {"link_torque": 1e-9, "motor_torque": 1e-9}}


@pytest.fixture(scope="module")
def proposed():
    robot = fh.load_robot("paper")
    names = ("stiffness", "friction", "motor_inertia", "link_inertia")
    return robot, names, fh.excitation(robot, names, duration=4.0, candidates=4, **CALM)


def test_currents_of_motors_follow_the_motion():
    motion = fh.excitation(fh.load_robot("paper"), ("inductance",), duration=0.5, candidates=1)
    assert 0.0 < motion.standard_errors["inductance"] < 1.0
    assert not motion.unidentifiable


@pytest.mark.ci("identifies four numbers of 4 s")
def test_what_it_promises_is_what_a_log_of_it_gives(proposed):
    robot, names, motion = proposed
    found = fh.identify(robot, driven(robot, motion, 1), names, measured=ENCODERS)
    assert not found.unidentifiable
    for name in names:
        promised = motion.standard_errors[name] * robot.nominal[name]
        assert 0.5 * promised < found.standard_errors[name] < 2.0 * promised
        assert abs(found.values[name] - robot.nominal[name]) < 4.0 * promised


@pytest.mark.ci("proposes a motion and identifies a log of it")
def test_a_robot_with_wrong_numbers_is_identified_by_the_motion_of_its_wrong_model():
    robot = fh.load_robot("paper")
    wrong = robot.with_values({"stiffness": 70.0, "friction": 0.15})
    motion = fh.excitation(wrong, ("stiffness", "friction"), measured=ENCODERS, duration=4.0, candidates=3)
    found = fh.identify(wrong, driven(robot, motion, 2), ("stiffness", "friction"), measured=ENCODERS)
    for name in found.names:
        assert abs(found.values[name] - robot.nominal[name]) < 5.0 * found.standard_errors[name]


@pytest.mark.ci("proposes two motions of two links")
def test_it_stays_within_the_limits_of_the_joints():
    robot = fh.load_robot("planar-two-link")
    motion = fh.excitation(
        robot, ("stiffness",), measured=("motor_position",), duration=3.0, candidates=2, seed=3
    )
    low, high = np.array(robot.links.limits).T
    assert (motion.positions >= low).all()
    assert (motion.positions <= high).all()
    near = fh.excitation(robot, ("stiffness",), reach=0.2, duration=3.0, candidates=2, seed=3)
    assert np.abs(near.positions - robot.home).max() <= 0.2 + 1e-9
    assert motion.reference.duration <= 3.0


def test_what_no_motion_tells_is_said():
    robot = fh.load_robot("paper")
    motion = fh.excitation(robot, ("mass", "length"), duration=2.0, candidates=1)
    (each,) = motion.unidentifiable
    assert set(each.direction) == {"mass", "length"}
    assert all(np.isinf(error) for error in motion.standard_errors.values())


def test_it_is_the_same_for_the_same_seed_and_read_again(proposed, tmp_path):
    robot, names, motion = proposed
    again = fh.excitation(robot, names, duration=4.0, candidates=4, **CALM)
    np.testing.assert_array_equal(again.positions, motion.positions)
    motion.save(tmp_path / "motion.csv")
    table = waypoints(tmp_path / "motion.csv")
    assert table.joints == robot.joint_names
    np.testing.assert_allclose(
        np.ravel(table.rows), motion.reference(np.array(table.times)).ravel(), atol=1e-8
    )


@pytest.mark.parametrize(
    ("arguments", "anchors"),
    [
        ({"parameters": ("stifness",)}, ("stifness", "stiffness_elbow")),
        ({"duration": -1.0}, ("duration",)),
        ({"reach": (0.2, 0.3, 0.4)}, ("reach",)),
        ({"reach": 100.0}, ("reach",)),
        ({"noise": {"motor": 1.0}}, ("motor",)),
    ],
)
def test_what_makes_no_motion_is_refused(arguments, anchors):
    robot = fh.load_robot("planar-two-link")
    with refused_with(fh.InvalidInput, *anchors):
        fh.excitation(robot, **{"parameters": ("stiffness",), **arguments})
