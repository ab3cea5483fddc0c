"""A torque constant alone: the input of the motor is its current, A."""

from __future__ import annotations

import re

import numpy as np
import pytest
from tests.refusals import refused_with

from flexhinf.errors import InvalidInput
from flexhinf.robot import ElasticJoint, load_robot
from flexhinf.robot.arm import weigh_payload

FILE = """
[[joint]]
name = "a"
effort_limit = 6.0
{axis}[joint.link]
mass = 2.0
centre_of_mass = [0.0, 0.0, 0.3]
inertia = {{ xx = 0.05, yy = 0.05, zz = 0.01 }}
[joint.spring]
stiffness = 300.0
[joint.motor]
rotor_inertia = 1e-5
gear_ratio = 100.0
gear_efficiency = 0.8
friction = 0.3
{constant}
[[joint]]
name = "b"
effort_limit = 7.0
kind = "prismatic"
axis = [1, 0, 0]
[joint.link]
mass = 1.0
centre_of_mass = [0.1, 0.0, 0.0]
inertia = {{ xx = 0.01, yy = 0.02, zz = 0.02 }}
[joint.spring]
stiffness = 2000.0
[joint.motor]
motor_inertia = 1.5
{other}
[[payload]]
at = "a"
mass = {{ value = 0.0, range = [0.0, 1.0] }}
"""

#: Torque on the link side per ampere, N·m/A and N/A.
GAIN = np.array([100.0 * 0.8 * 0.05, 12.0])


@pytest.fixture
def made(tmp_path):
    def make(constants: bool):
        text = FILE.format(
            axis="axis = [0, 1, 0]\n",
            constant="torque_constant = 0.05" if constants else "",
            other="torque_constant = 12.0" if constants else "",
        )
        path = tmp_path / "arm.toml"
        path.write_text(text, encoding="utf-8")
        return load_robot(path)

    return make


def test_names_units_and_limits(made):
    robot = made(True)
    plant = robot.plant()
    assert robot.drive == "current"
    assert plant.inputs == ("motor_current_a", "motor_current_b")
    assert [plant.units[name] for name in plant.inputs] == ["A", "A"]
    assert plant.units["torque_constant[1]"] == "N·m/A"
    assert plant.units["torque_constant[2]"] == "N/A"
    assert robot.effort_limits == (6.0, 7.0)


def test_the_same_robot_with_torques(made):
    """Everything else equal, the torques are the currents times the constants, seen from the link."""
    amperes, torques = made(True), made(False)
    assert torques.drive == "torque"
    rng = np.random.default_rng(0)
    one, other = amperes.plant(), torques.plant()
    for _ in range(10):
        x, u, d = rng.normal(size=8), rng.normal(size=2), rng.normal(size=4)
        expected = other.derivative(x, GAIN * u, d)
        np.testing.assert_allclose(one.derivative(x, u, d), expected, rtol=1e-12, atol=1e-12)
    pose = [0.4, 0.1]
    (x, u), (same, torque) = amperes.operating_point(pose), torques.operating_point(pose)
    np.testing.assert_allclose(x, same)
    np.testing.assert_allclose(GAIN * u, torque, rtol=1e-12)
    motion = rng.normal(size=(5, 2))
    at, wanted = amperes.inverse_dynamics(*motion), torques.inverse_dynamics(*motion)
    np.testing.assert_allclose(at[0], wanted[0])
    np.testing.assert_allclose(GAIN * at[1], wanted[1], rtol=1e-12)


def test_a_payload_is_weighed_in_amperes(made):
    robot = made(True)
    pose = np.array([0.7, 0.0])
    loaded = robot.with_values({"payload_mass_a": 0.5})
    found = weigh_payload(robot, pose, loaded.operating_point(pose)[1])
    np.testing.assert_allclose(found.masses["payload_mass_a"], 0.5, rtol=1e-9)


def test_what_does_not_say_what_the_input_is_is_refused():
    for stated in (
        {"resistance": 1.0},
        {"torque_constant": 1.0, "back_emf_constant": 1.0},
        {"back_emf_constant": 1.0},
    ):
        with pytest.raises(InvalidInput, match=re.escape(f"{list(stated)}")):
            ElasticJoint(100.0, 0.1, **stated)
    with refused_with(InvalidInput, "inductance", "0.001 H"):
        ElasticJoint(100.0, 0.1, torque_constant=1.0, inductance=1e-3)
