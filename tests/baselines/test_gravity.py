"""The gravity torque from a plant's flow against the robot's own inverse dynamics."""

import numpy as np
import pytest
from tests.baselines.conftest import NAMES, by_name, gravity_slope
from tests.refusals import refused_with

from flexhinf.errors import InvalidInput
from flexhinf.plant import Parameters, Plant
from flexhinf.plant.joints import GravityTorque


@pytest.mark.oracle
@pytest.mark.parametrize(
    "name", ["paper", "quanser", "rig", "planar-two-link", "spatial-three-link", "seven-link"]
)
def test_it_is_that_of_the_links_and_its_rate_that_of_differences(name):
    robot = by_name(name)
    plant, rng = robot.plant(), np.random.default_rng(3)
    n, p = len(robot.joint_names), plant.parameters.vector()
    weight = GravityTorque(plant)
    for q, dq in zip(rng.uniform(-3, 3, (5, n)), rng.normal(size=(5, n))):
        expected = robot.links.gravity_torque(q, Parameters(robot.plant_parameters()))
        scale = max(1.0, np.abs(expected).max())
        np.testing.assert_allclose(weight.torque(q, p), expected, atol=1e-11 * scale)
        torque, rate = weight.torque_and_rate(q, dq, p)
        np.testing.assert_allclose(torque, expected, atol=1e-11 * scale)
        np.testing.assert_allclose(rate, gravity_slope(robot, q) @ dq, atol=1e-6 * scale)


@pytest.mark.oracle
def test_the_parameters_are_data():
    robot = by_name("planar-two-link")
    plant, q = robot.plant(), np.array([0.7, -1.2])
    changed = robot.draw(np.random.default_rng(1))
    found = GravityTorque(plant).torque(q, plant.with_parameters(**changed).parameters.vector())
    np.testing.assert_allclose(found, robot.links.gravity_torque(q, Parameters(changed)), rtol=1e-11)


def test_robots_have_keys_of_their_own_and_numbers_do_not():
    keys = {name: GravityTorque(by_name(name).plant()).key for name in NAMES}
    assert len(set(keys.values())) == len(keys)
    heavier = by_name("paper").with_values({"mass": 1.3, "stiffness": 80.0})
    assert GravityTorque(heavier.plant()).key == keys["paper"]


def test_a_plant_without_elastic_joints_is_refused():
    plant = Plant(lambda x, u, d, p: np.array([x[1], u[0]]), lambda x, u, p: x[:1], ("a", "b"), ("u",))
    with refused_with(InvalidInput, "elastic", "['a', 'b']"):
        GravityTorque(plant)
