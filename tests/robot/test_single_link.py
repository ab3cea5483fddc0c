import numpy as np
import pytest

from flexhinf.errors import InvalidInput
from flexhinf.plant.instruments import SENSORS
from flexhinf.robot import paper_arm

RNG = np.random.default_rng(11)


def drawn():
    """A plant with every parameter different from one, so that a missing factor shows."""
    values = {p.name: p.value * f for p, f in zip(paper_arm().parameters, RNG.uniform(0.5, 2.0, 11))}
    return values, paper_arm().with_values(values)


@pytest.mark.oracle
def test_the_arm_without_its_coil():
    v, robot = drawn()
    x, u, d = RNG.normal(size=(30, 4)), RNG.normal(size=(30, 1)), RNG.normal(size=(30, 2))
    q, dq, theta, dtheta = x.T
    current = (u[:, 0] - v["back_emf_constant"] * dtheta) / v["resistance"]
    spring = v["stiffness"] * (q - theta)
    weight = v["mass"] * v["gravity"] * v["length"] * np.sin(q)
    motor = spring - v["friction"] * dtheta + v["torque_constant"] * current + d[:, 1]
    expected = np.column_stack(
        [dq, (-weight - spring + d[:, 0]) / v["link_inertia"], dtheta, motor / v["motor_inertia"]]
    )
    np.testing.assert_allclose(robot.plant().derivative(x, u, d), expected, rtol=1e-12, atol=1e-12)


@pytest.mark.oracle
def test_the_arm_with_its_coil():
    v, robot = drawn()
    x, u, d = RNG.normal(size=(30, 5)), RNG.normal(size=(30, 1)), RNG.normal(size=(30, 2))
    q, dq, theta, dtheta, current = x.T
    spring = v["stiffness"] * (q - theta)
    weight = v["mass"] * v["gravity"] * v["length"] * np.sin(q)
    motor = spring - v["friction"] * dtheta + v["torque_constant"] * current + d[:, 1]
    coil = (u[:, 0] - v["resistance"] * current - v["back_emf_constant"] * dtheta) / v["inductance"]
    expected = np.column_stack(
        [dq, (-weight - spring + d[:, 0]) / v["link_inertia"], dtheta, motor / v["motor_inertia"], coil]
    )
    np.testing.assert_allclose(
        robot.plant(inductance=True).derivative(x, u, d), expected, rtol=1e-12, atol=1e-12
    )


def test_every_sensor_and_its_unit():
    plant = paper_arm().plant(measured=tuple(SENSORS))
    x = np.array([0.1, 0.2, 0.3, 0.4])
    y = np.asarray(plant.traced_output(x, [0.0], plant.parameters.vector()), dtype=float).ravel()
    np.testing.assert_allclose(y, [0.1, 0.2, 0.3, 0.4, 20.0, 0.2], rtol=1e-14)
    assert [plant.unit(name) for name in plant.outputs] == ["rad", "rad/s", "rad", "rad/s", "N·m", "rad"]
    assert plant.unit(plant.inputs[0]) == "V"
    assert paper_arm().plant("motor_position").outputs == ("motor_position",)


@pytest.mark.parametrize(
    "measured", [(), ("link",), ("link_position", "speed"), ("link_position", "link_position")]
)
def test_bad_sensors_are_refused(measured):
    with pytest.raises(InvalidInput):
        paper_arm().plant(measured=measured)


@pytest.mark.parametrize("name", ["link_inertia", "stiffness", "resistance", "inductance"])
def test_divisors_are_positive(name):
    with pytest.raises(InvalidInput, match=name):
        paper_arm().with_values({name: 0.0}).plant()
