"""A plant's linearisation as a plant."""

import numpy as np
import pytest
from tests.refusals import refused_with

from flexhinf.errors import InvalidInput
from flexhinf.plant import Plant, linear_plant
from flexhinf.robot import load_robot


@pytest.mark.oracle
@pytest.mark.parametrize("name", ["paper", "planar-two-link", "spatial-three-link"])
def test_it_is_the_jacobians_about_the_rest(name):
    robot = load_robot(name)
    plant, (x, u) = robot.plant(("link_position", "joint_torque")), robot.operating_point()
    linear = linear_plant(plant, x, u)
    a, b, g, c = plant.linearise(x, u)
    for found, expected in zip(linear.linearise(x + 1.0, u - 1.0), (a, b, g, c)):
        np.testing.assert_array_equal(found, expected)
    rng = np.random.default_rng(0)
    dx, du, d = rng.normal(size=len(x)), rng.normal(size=len(u)), rng.normal(size=len(plant.disturbances))
    np.testing.assert_allclose(
        linear.derivative(x + dx, u + du, d), a @ dx + b @ du + g @ d, rtol=1e-9, atol=1e-9
    )
    p = linear.parameters.named(linear.parameters.vector())
    at_rest = plant.output(x, u, plant.parameters.named(plant.parameters.vector()))
    np.testing.assert_allclose(linear.output(x, u, p), at_rest, rtol=1e-13)
    np.testing.assert_allclose(linear.output(x + dx, u, p), at_rest + c @ dx, rtol=1e-12)
    assert (linear.states, linear.inputs, linear.outputs) == (plant.states, plant.inputs, plant.outputs)
    assert linear.groups == plant.groups


def test_an_output_may_depend_on_the_input_and_nothing_may_disturb():
    plant = Plant(
        lambda x, u, d, p: np.array([-p.a * np.sin(x[0]) + u[0]]),
        lambda x, u, p: np.array([x[0] * u[0] + 2.0 * u[0]]), ("a",), ("u",), parameters={"a": 2.0},
    )  # fmt: skip
    rest = np.array([0.5]), np.array([2.0 * np.sin(0.5)])
    linear = linear_plant(plant, *rest)
    p = linear.parameters.named(linear.parameters.vector())
    found = linear.output(np.array([0.6]), rest[1] + 0.3, p)
    np.testing.assert_allclose(found, 2.5 * rest[1] + rest[1] * 0.1 + 2.5 * 0.3, rtol=1e-13)
    np.testing.assert_allclose(linear.derivative([0.6], rest[1]), [-2.0 * np.cos(0.5) * 0.1], rtol=1e-12)


def test_linearisations_of_one_size_share_their_code():
    robot = load_robot("paper")
    plant = robot.plant()
    hanging, raised = (linear_plant(plant, *robot.operating_point([q])) for q in (0.0, 1.2))
    assert hanging.code_key == raised.code_key


def test_what_is_no_rest_is_refused():
    robot = load_robot("paper")
    x, u = robot.operating_point([0.5])
    with refused_with(InvalidInput, "equilibrium", "motor_velocity = 0.9"):
        linear_plant(robot.plant(), x, u + 1.0)
    with refused_with(InvalidInput, "x", "4 finite", "[0.5, 0. ]"):
        linear_plant(robot.plant(), x[:2], u)
