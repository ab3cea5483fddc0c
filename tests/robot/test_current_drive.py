"""A torque constant alone: the input of the motor is its current, A."""

from __future__ import annotations

import re

import numpy as np
import pytest
from tests.builders import joint_text
from tests.refusals import refused_with

from flexhinf.errors import InvalidInput
from flexhinf.robot import ElasticJoint, load_robot
from flexhinf.robot.arm import weigh_payload

PAYLOAD = '[[payload]]\nat = "a"\nmass = { value = 0.0, range = [0.0, 1.0] }\n'
GEARED = "rotor_inertia = 1e-5\ngear_ratio = 100.0\ngear_efficiency = 0.8\nfriction = 0.3\n"


def text_of(constants=("", ""), **keys):
    """A joint that turns and one that slides; with their torque constants, and more keys of the first."""
    turns = joint_text(
        "a", effort_limit=6.0, **keys, mass=2.0, centre=(0.0, 0.0, 0.3), inertia=(0.05, 0.05, 0.01),
        spring="stiffness = 300.0", motor=GEARED + constants[0],
    )  # fmt: skip
    slides = joint_text(
        "b", effort_limit=7.0, kind="prismatic", axis=[1, 0, 0], centre=(0.1, 0.0, 0.0), inertia=(0.01, 0.02, 0.02),
        spring="stiffness = 2000.0", motor="motor_inertia = 1.5\n" + constants[1],
    )  # fmt: skip
    return turns + slides + PAYLOAD


@pytest.fixture
def made(write):
    constants = ("torque_constant = 0.05", "torque_constant = 12.0")
    return lambda stated: load_robot(write(text_of(constants if stated else ("", ""), axis=[0, 1, 0])))


#: Torque on the link side per ampere, N·m/A and N/A.
GAIN = np.array([100.0 * 0.8 * 0.05, 12.0])


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
    with refused_with(InvalidInput, "inductance", "0.001 H"):  # a torque has no coil either
        ElasticJoint(100.0, 0.1, inductance=1e-3)
