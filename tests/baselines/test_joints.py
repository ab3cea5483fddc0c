"""The joints' numbers from Jacobians against those of the robot's file."""

import numpy as np
import pytest
from tests.baselines.conftest import by_name, gravity_slope, links_at
from tests.refusals import refused_with

from flexhinf.errors import InvalidInput
from flexhinf.plant import Plant
from flexhinf.plant.joints import LinkCompliance, elastic_joints
from flexhinf.scalars import digest


@pytest.mark.oracle
@pytest.mark.parametrize(
    "name", ["paper", "quanser", "rig", "planar-two-link", "spatial-three-link", "seven-link"]
)
def test_numbers_are_those_of_the_file(name):
    robot = by_name(name)
    found, p = elastic_joints(robot.plant(), *robot.operating_point()), robot.plant_parameters()
    q = np.array(robot.home)
    np.testing.assert_allclose(found.stiffness, np.atleast_1d(p["stiffness"]), rtol=1e-12)
    np.testing.assert_allclose(found.motor_inertia, np.atleast_1d(p["motor_inertia"]), rtol=1e-12)
    np.testing.assert_allclose(found.link_inertia, links_at(robot, q)[0], rtol=1e-10, atol=1e-10)
    np.testing.assert_allclose(found.gravity_slope, gravity_slope(robot, q), rtol=1e-7, atol=1e-6)
    gain = p["torque_constant"] / p["resistance"] if robot.drive == "voltage" else 1.0
    emf = gain * p["back_emf_constant"] if robot.drive == "voltage" else 0.0
    np.testing.assert_allclose(
        found.torque_per_input, np.broadcast_to(gain, found.stiffness.shape), rtol=1e-12
    )
    np.testing.assert_allclose(found.motor_damping, np.atleast_1d(p["friction"] + emf), rtol=1e-10)
    np.testing.assert_array_equal(found.spring_damping, 0.0)


@pytest.mark.oracle
def test_a_damped_spring_is_seen():
    robot = by_name("planar-two-link")
    found = elastic_joints(robot.plant(extras="joint_damping"), *robot.operating_point())
    p = robot.plant_parameters()
    np.testing.assert_allclose(found.spring_damping, p["damping"], rtol=1e-12)
    emf = p["torque_constant"] * p["back_emf_constant"] / p["resistance"]
    np.testing.assert_allclose(found.motor_damping, p["friction"] + emf, rtol=1e-10)


def test_other_plants_are_refused():
    robot = by_name("paper")
    with refused_with(InvalidInput, "elastic", "'coil_current'"):
        elastic_joints(robot.plant(inductance=True), np.zeros(5), np.zeros(1))
    names = ("link_position", "link_velocity", "motor_position", "motor_velocity")
    groups = {name: (f"{name}_a", f"{name}_b") for name in (*names, "link_torque", "motor_torque")}
    states = [single for name in names for single in groups[name]]

    def coupled(x, u, d, p):
        spring = x[4:6] - x[:2]
        shared = u - spring + d[2:] + np.array([0.1 * u[1], 0.0])
        return np.concatenate([x[2:4], spring + d[:2], x[6:], shared])

    plant = Plant(
        coupled, lambda x, u, p: x[:2], states, ("a", "b"),
        (*groups["link_torque"], *groups["motor_torque"]), groups=groups,
    )  # fmt: skip
    with pytest.raises(InvalidInput, match="coupled"):
        elastic_joints(plant, np.zeros(8), np.zeros(2))


@pytest.mark.oracle
@pytest.mark.parametrize("name", ["quanser", "rig", "planar-two-link", "spatial-three-link", "seven-link"])
def test_the_compliance_is_the_inverse_of_the_mass_matrix(name):
    robot = by_name(name)
    plant, rng = robot.plant(), np.random.default_rng(4)
    changed = plant.with_parameters(**robot.draw(rng))
    compliance = LinkCompliance(plant)
    for model in (plant, changed):
        p = model.parameters.vector()
        for q in rng.uniform(-3, 3, (3, len(robot.joint_names))):
            m = np.linalg.inv(compliance.matrix(q, p))
            x = np.concatenate([q, 0 * q, q, 0 * q])
            a = model.linearise(x, np.zeros(len(q)))[0]
            k = np.atleast_1d(model.parameters.values["stiffness"])
            np.testing.assert_allclose(
                m @ a[len(q) : 2 * len(q), 2 * len(q) : 3 * len(q)], np.diag(k), atol=1e-8
            )
    np.testing.assert_allclose(
        np.linalg.inv(compliance.matrix(q, plant.parameters.vector())),
        links_at(robot, q)[0],
        rtol=1e-9,
        atol=1e-10,
    )
    assert digest(compliance.traced) == digest(LinkCompliance(changed).traced)
