"""Laws that give torques, on drives with a loop of their own: the loop is that of the motor without one."""

import numpy as np
import pytest
from tests.builders import driven_robot

from flexhinf.baselines import GravityCompensatedLQR, MotorPD, TorqueFeedback

POSE = (0.5, -0.9)
DRIVES = pytest.mark.parametrize(
    ("drive", "share"), [("velocity", 0.0), ("velocity", 1.0), ("position", 0.3), ("position", 1.0)]
)


def with_and_without(drive, share):
    """A robot whose drives have an inner loop, and one of torques whose friction is all that brakes these motors."""
    robot = driven_robot("planar-two-link", drive, (8.0, 15.0), share)
    p = robot.plant_parameters()
    friction = p["drive_damping"] + share * p["friction"]
    own = robot.plant().parameters.values
    torque = driven_robot("planar-two-link", "torque").with_values(
        {f"friction_{joint}": value for joint, value in zip(robot.joint_names, friction)}
    )
    assert np.array_equal(torque.plant().parameters.values["motor_inertia"], own["motor_inertia"])
    return robot, torque


@pytest.mark.quick_cases(4)
@pytest.mark.oracle
@DRIVES
@pytest.mark.parametrize("ratio", [1.0, 0.4])
def test_a_pd_or_torque_feedback_has_the_loop_of_a_motor_of_torques(drive, share, ratio):
    problems = [robot.problem(pose=POSE) for robot in with_and_without(drive, share)]
    kind, more = (MotorPD, {}) if ratio == 1.0 else (TorqueFeedback, {"compensation": "goal"})
    laws = []
    for problem in problems:
        rotor = {} if ratio == 1.0 else {"rotor_inertia": ratio * laws_inertia(problem)}
        law = kind(
            plant=problem.plant,
            equilibrium=(problem.operating_point[:8], problem.operating_input),
            integrate=("link_position",),
            proportional=(900.0, 300.0),
            derivative=(40.0, 10.0),
            integral=(500.0, 90.0),
            **rotor,
            **more,
        )
        laws.append(law.closed_loop())
    np.testing.assert_allclose(laws[0], laws[1], rtol=1e-9, atol=1e-8)


def laws_inertia(problem):
    """Motors' inertias of a problem's robot."""
    return problem.plant.parameters.values["motor_inertia"]


@pytest.mark.oracle
@DRIVES
def test_a_compensated_weight_holds_every_pose(drive, share):
    robot, _ = with_and_without(drive, share)
    law, plant = GravityCompensatedLQR.design(robot.problem(pose=POSE)), robot.plant()
    assert np.linalg.eigvals(law.closed_loop()).real.max() < 0.0
    (x, u), data = law.equilibrium, law.law_data
    for pose in np.random.default_rng(2).normal(size=(3, 2)):
        at, held = robot.operating_point(pose)
        k = law.evaluate_about(np.concatenate([at - x, np.zeros(2)]), x, u, data)
        # what is left of the pose's own feedback on the link is that of the gain alone
        link = law.gain @ np.concatenate([pose - x[:2], np.zeros(2), pose - x[:2], np.zeros(4)])
        place = pose - x[:2] if drive == "position" else 0.0
        assert u + k - link + place == pytest.approx(held, abs=1e-9)
        assert np.abs(plant.derivative(at, u + k - link + place)).max() < 1e-6
